"""The passes of a picture on disk, and the picture that they make.

The picture depends on the set of finished passes only.
"""

from collections.abc import Sequence
from pathlib import Path

import drjit as dr
import numpy as np

from ..host import machine
from ..pictures import images, parts
from ..pictures import store as passes
from ..pictures.estimates import WeightedMean
from ..pictures.parts import Part
from ..pictures.store import Pass, Store
from . import planning
from .planning import Plan

# All passes of a folder have this key: a folder holds one picture.
KEY = "picture"


def stored(store: Store) -> Plan | None:
    """The plan of a folder's passes; None where it holds none. ValueError where nobody can tell."""
    store.claim(passes.PICTURE)
    path = store.folder / passes.PICTURE
    try:
        return planning.from_json(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        if any(store.passes.glob(f"{KEY}/*.exr")):
            raise ValueError(f"'{store.folder}' holds passes, but its {passes.PICTURE} is gone; choose another folder, "
                             "and merge both") from None  # fmt: skip
        return None
    except (KeyError, IndexError, TypeError, ValueError):
        raise ValueError(f"'{path}' is nothing that this version wrote; choose another folder") from None


def claim(store: Store, plan: Plan) -> "Folder":
    """The folder of a plan's passes; it may hold some, and those of a longer or shorter plan. ValueError where it holds
    passes of another plan."""
    held = stored(store)
    if held and (found := _differences(plan, held)):
        raise ValueError(f"this is another picture than that of the passes in '{store.folder}': {'; '.join(found)}. "
                         "Choose another folder")  # fmt: skip
    if not held or held.count < plan.count:
        images.replace_file(store.folder / passes.PICTURE, plan.json() + "\n")
    return Folder(store, plan)


def _differences(a: Plan, b: Plan) -> list[str]:
    """What of `a` does not go with passes of `b`, in words."""
    found = parts.differences(a.subject, b.subject)
    if a.grid != b.grid:
        names = [f"a grid of {p.grid} x {p.grid} samples" if p.grid else "random samples" for p in (a, b)]
        return [*found, f"{names[0]}, not {names[1]} (grids of other sizes are other samples)"]
    if a.random and a.seed != b.seed:
        found.append(f"seed {a.seed}, not {b.seed}")
    if a.spp != b.spp:
        found.append(f"passes of {a.spp} spp, not {b.spp}")
    return found


class Folder:
    """The passes of one plan on disk. The store is open: `with Store(path).opened() as store`."""

    def __init__(self, store: Store, plan: Plan):
        self.store, self.plan = store, plan

    def path(self, index: int) -> Path:
        """Where a pass is, or will be."""
        return self.store.path(KEY, self.plan.spp, index)

    def has(self, index: int) -> bool:
        """Whether there is a file for the pass."""
        return self.store.has(KEY, self.plan.spp, index)

    def finished(self) -> list[int]:
        """Numbers of the passes that have files."""
        return [index for index in range(self.plan.count) if self.has(index)]

    def write(self, index: int, image: np.ndarray, seconds: float = 0.0, channels: Sequence[str] | None = None) -> None:
        """Keep a finished pass; once it is there, it counts. `channels`: their names."""
        samples = self.plan.samples(index)
        made = Pass(samples.spp, samples.seed, index, seconds, 0.0, self.plan.subject.variant,
                    self.plan.subject.versions, machine.described(dr.thread_count()), machine.now())  # fmt: skip
        self.store.add(KEY, made, image, parts.metadata(self.plan.subject, [samples]), channels)

    def keep(self, index: int, content: bytes) -> None:
        """Keep a pass as the file that `write` made elsewhere."""
        self.store.keep(KEY, self.plan.spp, index, content)

    def read(self, index: int) -> np.ndarray:
        """The picture of a pass; ValueError, with its path, where the file is broken or not of this pass."""
        path = self.path(index)
        part = _whole_part(path)
        width, height = self.plan.subject.size
        image = images.read_checked(path)
        if parts.differences(part.subject, self.plan.subject) or part.samples != (self.plan.samples(index),):
            raise ValueError(f"'{path}' is not pass {index} of this picture")
        if image.shape[:2] != (height, width):
            raise ValueError(f"'{path}' is broken: it has another size")
        return image

    def judged(self, index: int) -> list[int] | None:
        """Which channels of the pictures an error is told of, by the file of a pass."""
        return images.judged(images.read_channels(self.path(index)))

    def mean(self) -> WeightedMean:
        """The mean of the passes that have files, in the order of their numbers."""
        finished = self.finished()
        mean = WeightedMean(self.judged(finished[0]) if finished else None)
        for index in finished:
            mean.add(self.read(index), self.plan.spp)
        return mean


def _whole_part(path: Path) -> Part:
    try:
        return parts.read(path)
    except ValueError:
        raise ValueError(f"'{path}' is broken") from None
