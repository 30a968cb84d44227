"""The pages, and the blocks of code in them."""

import re
from dataclasses import dataclass
from pathlib import Path

from helpers import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

# What an indented block starts with, if it is of commands; others are formulas, or what a command prints.
COMMANDS = ("phong-bsdf", "make", "pip", "pytest", "python3", "pipx")


@dataclass(frozen=True)
class Block:
    """A block of code: where it begins, its language, its text."""

    place: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """Fenced and indented blocks, in the order of the page."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in re.finditer(r"^```(\S*)\n(.*?)^```$|(?<=\n\n)((?:    [^\n]*\n|\n(?=    ))+)", text, re.M | re.S):
        language, body = match[1], match[2]
        if body is None:
            body = re.sub(r"^    ", "", match[3], flags=re.M)
            language = "bash" if body.split()[0] in COMMANDS else "text"
        found.append(Block(f"{page.name}:{text.count(chr(10), 0, match.start()) + 1}", language, body))
    return found


def links(page: Path) -> list[tuple[str, str]]:
    """What the page links to, or shows: (address, what follows a #), outside of code."""
    text = re.sub(r"^```.*?^```$|^    [^\n]*$|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return [tuple(address.partition("#")[::2]) for address in re.findall(r"\]\(([^)\s]+)\)", text)]


def headings(page: Path) -> set[str]:
    """The names by which its headings are linked to."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}
