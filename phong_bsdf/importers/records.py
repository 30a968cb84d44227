"""What a conversion did: one record for each change and for each loss."""

import re
from dataclasses import dataclass
from pathlib import Path

CHANGE, LOSS = "change", "loss"


class ConversionError(ValueError):
    """A file that cannot be converted, or must not be. The message names the file and, where there is one, the line."""

    @property
    def reason(self) -> str:
        """The message without the place."""
        return re.sub(r"^.*?, line \d+: ", "", str(self))


@dataclass(frozen=True, order=True)
class Record:
    """One thing that the new scene says in another way, or does not say."""

    file: str
    """Of the old scene."""
    line: int
    """Counted from 1; 0 where the record is about the whole file."""
    kind: str
    """`change`: the same meaning in other words. `loss`: something could not be carried over, or only nearly."""
    what: str
    """What the old scene says."""
    why: str
    """What became of it, or why it could not be carried over."""

    def __str__(self):
        place = f"{self.file}, line {self.line}" if self.line else self.file
        return f"{place}: {self.what}: {self.why}"


@dataclass(frozen=True)
class Conversion:
    """A new scene, and the story of how it came about."""

    output: Path
    """The new scene."""
    files: tuple[Path, ...]
    """Every file that was written, the scene first."""
    records: tuple[Record, ...]
    """In the order of the file, included files after it."""

    @property
    def changes(self) -> tuple[Record, ...]:
        """What is said in other words, with the same meaning."""
        return tuple(record for record in self.records if record.kind == CHANGE)

    @property
    def losses(self) -> tuple[Record, ...]:
        """What could not be carried over, or only nearly."""
        return tuple(record for record in self.records if record.kind == LOSS)


class Journal:
    """Collects the records of one conversion; the same record counts once."""

    def __init__(self):
        self._records: dict[Record, None] = {}

    def change(self, place, what: str, why: str) -> None:
        """Note a change at `place`, a pair of file name and line."""
        self._records[Record(*place, kind=CHANGE, what=what, why=why)] = None

    def loss(self, place, what: str, why: str) -> None:
        """Note a loss at `place`, a pair of file name and line."""
        self._records[Record(*place, kind=LOSS, what=what, why=why)] = None

    def records(self) -> tuple[Record, ...]:
        """All records, by file in the order in which the files were read, then by line."""
        files = list(dict.fromkeys(record.file for record in self._records))
        return tuple(sorted(self._records, key=lambda r: (files.index(r.file), r.line)))


def header(source: str, journal: Journal) -> str:
    """The comment at the top of a new scene: where it comes from, and what was lost on the way."""
    losses = [str(record) for record in journal.records() if record.kind == LOSS]
    lines = [f"Converted by phong-bsdf from {source}."]
    if losses:
        lines += ["Not carried over, or only nearly:", *(f"- {loss}" for loss in losses)]
    # Two hyphens would end an XML comment.
    return "\n".join("    " + re.sub("-{2,}", "-", line).rstrip("-") for line in lines)


def story(conversion: Conversion) -> str:
    """The records as text for a reader: what changed, what was lost, what was written."""
    lines = []
    for title, records in (
        ("Said in other words:", conversion.changes),
        ("Not carried over, or only nearly:", conversion.losses),
    ):
        lines += [title, *(f"  {record}" for record in records), ""] if records else []
    others = len(conversion.files) - 1
    beside = f", {others} file{'s' * (others != 1)} in {conversion.files[1].parent}" if others else ""
    counts = f"{_count(conversion.changes, 'change', 'changes')}, {_count(conversion.losses, 'loss', 'losses')}"
    return "\n".join([*lines, f"{conversion.output}: {counts}{beside}", ""])


def _count(records, one: str, many: str) -> str:
    return f"{len(records)} {one if len(records) == 1 else many}"
