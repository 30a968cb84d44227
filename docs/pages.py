"""What the scripts of this folder share: pictures side by side, and tables inside of pages."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from phong_bsdf.pictures import images
from phong_bsdf.report import page

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"


def beside(pictures: Iterable[np.ndarray]) -> np.ndarray:
    """One picture of several of the same height."""
    return np.concatenate(list(pictures), axis=1)


def below(rows: Iterable[np.ndarray]) -> np.ndarray:
    """One picture of several of the same width."""
    return np.concatenate(list(rows), axis=0)


def error_map(difference: np.ndarray) -> np.ndarray:
    """A difference in false colours, bright from 0.1 on; linear values, which a PNG file shows in those colours."""
    return images.from_srgb(page.false_colours(difference, 0.1))


def insert(name: str, table: str, file: str) -> None:
    """Put a table into a page, between its marks."""
    path = DOCS / file
    before, start, rest = path.read_text(encoding="utf-8").partition(f"<!-- table {name} -->\n")
    _, end, after = rest.partition("<!-- end of table -->\n")
    if not end:
        raise ValueError(f"{path}: there is no place for the table '{name}'")
    lines = "\n".join(line.rstrip() for line in table.split("\n"))
    images.replace_file(path, f"{before}{start}```text\n{lines}```\n{end}{after}")
