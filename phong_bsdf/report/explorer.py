"""The explorer: one page on which the reflection models are shaded live, in JavaScript, without a server."""

from pathlib import Path

from .. import __version__
from . import page

SUMMARY = "Highlights as a computer graphics lecture teaches them: a ball, its lobe, and the formula with its numbers."


def write(path: Path) -> None:
    """Write the page; the same bytes for the same version of the package."""
    page.write(path, "explorer/explorer.html", title="Phong and Blinn-Phong", summary=SUMMARY, version=__version__)
