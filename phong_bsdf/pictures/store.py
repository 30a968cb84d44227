"""Renderings on disk: a pass is one EXR file that holds its own record, written whole or not at all.

Nothing finished is ever changed or deleted, so a run that ends at any moment, however it ends, leaves what it has
finished, and the next run goes on from there.
"""

import contextlib
import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import images

# What a folder holds: a study of methods, one of the lobes' formulas, or one picture in passes.
RUN, LOBES, PICTURE = "run.json", "lobes.json", "picture.json"
HELD = {RUN: "measurements of a scene", LOBES: "measurements of the lobes' formulas", PICTURE: "a picture in passes"}
RECORD = "pass"
FAILURE = "failure.txt"


@dataclass(frozen=True)
class Pass:
    """What one rendering took, and under which conditions."""

    spp: int
    seed: int
    repeat: int
    seconds: float
    """Of a rendering whose kernels were compiled before."""
    seconds_warmup: float
    """What the rendering before that one took longer, if it was the scene's first or had to compile; else 0."""
    variant: str
    versions: str
    machine: str
    time: str
    """When it was finished, UTC."""


class Store:
    """A folder of passes: a folder for each key, a file for each pass."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        self.passes = self.folder / "passes"

    @contextlib.contextmanager
    def opened(self) -> Iterator["Store"]:
        """The store, for one process at a time; ValueError where another one writes to it."""
        self.passes.mkdir(parents=True, exist_ok=True)
        with open(self.passes / ".lock", "w") as lock:
            _lock(lock, self.folder)
            # Of passes that were being written when a process was killed.
            for leftover in self.passes.glob("*/.*.exr"):
                leftover.unlink()
            yield self

    def claim(self, kind: str) -> None:
        """ValueError where the folder holds what is not of this kind: `RUN`, `LOBES` or `PICTURE`."""
        for other, held in HELD.items():
            if other != kind and (self.folder / other).exists():
                raise ValueError(f"'{self.folder}' holds {held} already; choose another folder")

    def has(self, key: str, spp: int, repeat: int) -> bool:
        """Whether the pass has been made."""
        return self.path(key, spp, repeat).is_file()

    def add(
        self, key: str, made: Pass, image: np.ndarray, metadata: Mapping[str, str] | None = None,
        channels: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        """Write a pass, with `metadata` beside its record; OSError where the disk is full. `channels`: their names."""
        path = self.path(key, made.spp, made.repeat)
        path.parent.mkdir(exist_ok=True)
        said = {**(metadata or {}), RECORD: json.dumps(dataclasses.asdict(made))}
        images.write(path, image, channels=channels, metadata=said)

    def keep(self, key: str, spp: int, repeat: int, content: bytes) -> None:
        """Write a pass as the file that `add` made elsewhere; OSError where the disk is full."""
        path = self.path(key, spp, repeat)
        path.parent.mkdir(exist_ok=True)
        images.replace_file(path, content)

    def list(self, key: str) -> list[Pass]:
        """The records of all passes of a key, by samples, then repeats."""
        found = (self._read(path) for path in (self.passes / key).glob("*-spp-repeat-*.exr"))
        return sorted(found, key=lambda made: (made.spp, made.repeat))

    def files(self) -> "list[Path]":
        """The files of all passes."""
        return sorted(self.passes.glob("*/*-spp-repeat-*.exr"))

    def image(self, key: str, made: Pass) -> np.ndarray:
        """The picture of a pass, float32."""
        try:
            return images.read_checked(self.path(key, made.spp, made.repeat))
        except ValueError as error:
            raise ValueError(f"{error}; delete it, and the next run makes it again") from None

    def failure(self, key: str) -> str | None:
        """Why the method's last run failed; None if it did not."""
        path = self.passes / key / FAILURE
        return path.read_text(encoding="utf-8").strip() if path.is_file() else None

    def set_failure(self, key: str, reason: str | None) -> None:
        """Keep, or forget, why a method failed."""
        path = self.passes / key / FAILURE
        if reason is None:
            path.unlink(missing_ok=True)
            return
        path.parent.mkdir(exist_ok=True)
        images.replace_file(path, reason + "\n")

    @staticmethod
    def _read(path: Path) -> Pass:
        try:
            return Pass(**json.loads(images.read_metadata(path)[RECORD]))
        except (RuntimeError, KeyError, TypeError, ValueError):
            raise ValueError(f"'{path}' is no pass that this version wrote; delete it, and the next run makes "
                             "it again") from None  # fmt: skip

    def path(self, key: str, spp: int, repeat: int) -> Path:
        """Where a pass is, or will be."""
        return self.passes / key / f"{spp:06}-spp-repeat-{repeat:03}.exr"


def _lock(file, folder: Path) -> None:
    try:
        import fcntl
    except ImportError:
        # No such locks on Windows; two runs at once would only do work twice.
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ValueError(f"'{folder}': another run is writing there; wait for it, or choose another folder") from None
    except OSError:
        # Some file systems of clusters have no such locks either.
        return
