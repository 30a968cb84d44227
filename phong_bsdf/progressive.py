"""A picture in passes: planned, rendered one by one anywhere, and folded into their mean.

A pass depends on the plan and its number only, and the picture on the set of finished passes only: not on who
rendered them, where, when and in which order.
"""

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from . import camera as cameras
from . import fingerprint, parts, passes, rendering
from .estimates import WeightedMean
from .parts import Part, Samples, Subject
from .passes import Pass, Store
from .rendering import LoadedScene, Rendering

# All passes of a folder have this key: a folder holds one picture.
KEY = "picture"

# A pass of so many samples takes about a second, or as long as it takes in scalar variants.
SAMPLES_PER_PASS = 2**22
SCALAR_SAMPLES_PER_PASS = 2**15
# As long as there are fewer passes than this, smaller ones: they tell the error.
LEAST_PASSES = 8


@dataclass(frozen=True)
class Plan:
    """A picture in passes: all that they depend on."""

    subject: Subject
    seed: int
    asked: int
    """Samples per pixel that each pass asks for; the sampler may round them to `spp`."""
    spp: int
    """Samples per pixel of each pass."""
    count: int
    """Number of passes. Plans that differ in nothing else share their passes."""
    grid: int = 0
    """With n > 0 the picture is that of `whitted` with n x n samples, and a pass has some of these."""
    random: bool = True
    """Whether random numbers are used."""

    def samples(self, index: int) -> Samples:
        """Those of one pass."""
        seed = rendering.pass_seed(self.seed, index * self.spp) if self.random else None
        if not self.grid:
            return Samples(self.spp, seed, index=index)
        step = self.grid // math.isqrt(self.spp)
        # Neighbouring passes are not neighbouring cells, so that the mean of some is not shifted.
        row, column = divmod(index * _stride(step * step) % (step * step), step)
        return Samples(self.spp, seed, step, (column, row), index)

    def json(self) -> str:
        return json.dumps(dataclasses.asdict(self), indent=1)


def from_json(text: str) -> Plan:
    """The plan that `Plan.json` wrote. Raises KeyError, TypeError or ValueError where it is none."""
    data = json.loads(text)
    return Plan(**{**data, "subject": parts.subject_from(data["subject"])})


# Before rendering ---------------------------------------------------------------------------------------------------


def load(
    path: Path,
    defines: Mapping[str, str] | None = None,
    *,
    camera: int = 1,
    size: tuple[int, int] | None = None,
) -> tuple[LoadedScene, Subject]:
    """A scene in the active variant, its film of this size, and what its pictures show."""
    state = rendering.parse(path, defines, merge=False)
    loaded = rendering.load_parsed(path, rendering.merged(state))
    if size:
        rendering.resize(loaded, camera, *size)
    width, height = map(int, loaded.sensor(camera).film().crop_size())
    integrator = next(n.props.plugin_name() for n in state.nodes if n.type == mi.ObjectType.Integrator)
    subject = Subject(
        Path(path).name, fingerprint.scene_hash(path, state), tuple(sorted((defines or {}).items())),
        integrator, mi.variant(), camera, (width, height), fingerprint.versions(),
    )  # fmt: skip
    return loaded, subject


def samples_of(loaded: LoadedScene, subject: Subject, spp: int, seed: int) -> Samples:
    """The samples of a picture that is rendered at once."""
    spp = spp or loaded.sensor(subject.camera).sampler().sample_count()
    return Samples(rendering.samples_taken(loaded, subject.camera, spp),
                   seed if _draws(loaded, subject.camera, spp) else None)  # fmt: skip


def plan(loaded: LoadedScene, subject: Subject, *, spp: int = 0, seed: int = 0, pass_spp: int | None = None) -> Plan:
    """Passes of about `pass_spp` samples, `spp` or a few more in all (0: as the scene says).

    Passes have a power of two of samples where the sampler allows it, since only those are the same
    bit by bit each time. Passes of a `whitted` grid share it without rest.
    """
    spp = spp or loaded.sensor(subject.camera).sampler().sample_count()
    across = cameras.grid(spp) if loaded.integrator == rendering.WHITTED else None
    wanted = min(pass_spp or default_pass_spp(subject.size, spp), spp)
    if across:
        side = max(n for n in _powers(math.isqrt(wanted)) if across % n == 0)
        return Plan(subject, seed, side**2, side**2, (across // side) ** 2, across, _draws(loaded, subject.camera, spp))
    # `whitted` would take squares for grids.
    free = [n for n in _powers(wanted) if loaded.integrator != rendering.WHITTED or not cameras.grid(n)] or [2]
    taken = {n: rendering.samples_taken(loaded, subject.camera, n) for n in free[-2:]}
    asked = next((n for n in reversed(free[-2:]) if taken[n] == n), free[-1])
    return Plan(subject, seed, asked, taken[asked], math.ceil(spp / taken[asked]))


def default_pass_spp(size: tuple[int, int], spp: int) -> int:
    """Samples per pixel of a pass where nobody says: some seconds' work, and enough passes to tell the error."""
    samples = SAMPLES_PER_PASS if dr.is_jit_v(mi.Float) else SCALAR_SAMPLES_PER_PASS
    return max(1, min(samples // (size[0] * size[1]), spp // LEAST_PASSES))


# One pass -----------------------------------------------------------------------------------------------------------


def render_pass(
    loaded: LoadedScene, plan: Plan, index: int, on_progress: Callable[[float], None] = lambda share: None
) -> Rendering:
    """Render one pass of a scene that `load` loaded; ValueError where that is not the plan's."""
    samples = plan.samples(index)
    with _part_of_grid(loaded, samples):
        return rendering.render(
            loaded, camera=plan.subject.camera, spp=plan.asked, seed=samples.seed or 0, on_progress=on_progress
        )


def check_subject(plan: Plan, subject: Subject) -> None:
    """ValueError where a scene, as `load` found it here, is not the one that the plan is for."""
    if found := parts.differences(subject, plan.subject):
        raise ValueError(f"this is not what was planned: {'; '.join(found)}")


# Passes on disk -----------------------------------------------------------------------------------------------------


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

    def write(self, index: int, image: np.ndarray, seconds: float = 0.0) -> None:
        """Keep a finished pass; once it is there, it counts."""
        samples = self.plan.samples(index)
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        made = Pass(samples.spp, samples.seed or 0, index, seconds, 0.0, self.plan.subject.variant,
                    self.plan.subject.versions, passes.machine(dr.thread_count()), now)  # fmt: skip
        self.store.add(KEY, made, image, parts.metadata(self.plan.subject, [samples]))

    def read(self, index: int) -> np.ndarray:
        """The picture of a pass; ValueError, with its path, where the file is broken or not of this pass."""
        path = self.path(index)
        part = _whole_part(path)
        width, height = self.plan.subject.size
        image = passes.read_image(path)
        if parts.differences(part.subject, self.plan.subject) or part.samples != (self.plan.samples(index),):
            raise ValueError(f"'{path}' is not pass {index} of this picture")
        if image.shape[:2] != (height, width):
            raise ValueError(f"'{path}' is broken: it has another size")
        return image

    def mean(self) -> WeightedMean:
        """The mean of the passes that have files, in the order of their numbers."""
        mean = WeightedMean()
        for index in self.finished():
            mean.add(self.read(index), self.plan.spp)
        return mean


def render(
    loaded: LoadedScene,
    folder: Folder,
    *,
    on_broken: Callable[[str], None] = lambda text: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Iterator[WeightedMean]:
    """Render the passes that are not on disk; the picture so far after each pass, in the order of their numbers.

    A file that is broken is named to `on_broken`, and its pass rendered again.
    """
    plan, mean = folder.plan, WeightedMean()
    for index in range(plan.count):
        image = _on_disk(folder, index, on_broken)
        if image is None:
            start = time.perf_counter()
            image = render_pass(loaded, plan, index, lambda share: on_progress((index + share) / plan.count)).image  # noqa: B023
            folder.write(index, image, time.perf_counter() - start)
        mean.add(image, plan.spp)
        on_progress((index + 1) / plan.count)
        yield mean


def _on_disk(folder: Folder, index: int, on_broken) -> np.ndarray | None:
    if not folder.has(index):
        return None
    try:
        return folder.read(index)
    except ValueError as error:
        on_broken(str(error))
        return None


def _whole_part(path: Path) -> Part:
    try:
        return parts.read(path)
    except ValueError:
        raise ValueError(f"'{path}' is broken") from None


# Samples ------------------------------------------------------------------------------------------------------------


def _draws(loaded: LoadedScene, camera: int, spp: int) -> bool:
    """Whether random numbers are used."""
    fixed = loaded.integrator == rendering.WHITTED and cameras.grid(spp)
    return not fixed or cameras.draws(loaded.sensor(camera))


@contextlib.contextmanager
def _part_of_grid(loaded: LoadedScene, samples: Samples):
    """Inside, `whitted` renders this part of its grid."""
    integrator = loaded.scene.integrator()
    if samples.step > 1:
        integrator.part = samples.step, samples.shift
    try:
        yield
    finally:
        if samples.step > 1:
            integrator.part = cameras.WHOLE


def _powers(most: int) -> list[int]:
    """1, 2, 4, ... up to `most`."""
    return [2**k for k in range(most.bit_length())]


def _stride(cells: int) -> int:
    """A number coprime with `cells`, near the golden ratio of them."""
    stride = max(round(cells * (math.sqrt(5) - 1) / 2), 1)
    while math.gcd(stride, cells) > 1:
        stride += 1
    return stride
