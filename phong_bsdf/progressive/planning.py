"""What the passes of a picture are: how many samples each has, and which.

A pass depends on the plan and its number only, so it does not matter who renders it, where, when and in which order.
"""

import dataclasses
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi

from ..pictures import parts
from ..pictures.parts import Samples, Subject
from ..scene import fingerprint, rendering
from ..scene.rendering import LoadedScene
from ..tracing import camera as cameras

# Writing a pass takes as long as some 2 samples of each pixel: a pass of so many costs few percent more.
PASS_SPP = 64
# In a second a core or two do some 2^22 samples, scalar variants 2^15: passes take seconds or, if they must, minutes.
LEAST_SAMPLES, MOST_SAMPLES, SCALAR_SAMPLES = 2**22, 2**30, 2**16
# Fewer passes do not tell the error.
LEAST_PASSES = 4


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
        """Which samples a pass has."""
        seed = rendering.pass_seed(self.seed, index * self.spp) if self.random else 0
        if not self.grid:
            return Samples(self.spp, seed, self.random, index=index)
        step = self.grid // math.isqrt(self.spp)
        # Neighbouring passes are not neighbouring cells, so that the mean of some is not shifted.
        row, column = divmod(index * _stride(step * step) % (step * step), step)
        return Samples(self.spp, seed, self.random, step, (column, row), index)

    @property
    def total(self) -> int:
        """Samples per pixel of all passes."""
        return self.count * self.spp

    def json(self) -> str:
        """The plan as text: what travels, and what a folder of passes keeps."""
        return json.dumps(dataclasses.asdict(self), indent=1)


def from_json(text: str) -> Plan:
    """The plan that `Plan.json` wrote. Raises KeyError, TypeError or ValueError where it is none."""
    data = json.loads(text)
    return Plan(**{**data, "subject": parts.subject_from(data["subject"])})


def load(
    path: Path,
    defines: Mapping[str, str] | None = None,
    *,
    camera: int = 1,
    size: tuple[int, int] | None = None,
) -> tuple[LoadedScene, Subject]:
    """A scene in the active variant, its film of this size, and what its pictures show."""
    start = time.perf_counter()
    state = rendering.parse(path, defines, merge=False)
    loaded = rendering.load_parsed(path, rendering.merged(state), start)
    if size:
        rendering.resize(loaded, camera, *size)
    width, height = map(int, loaded.sensor(camera).film().crop_size())
    integrator = next(n.props.plugin_name() for n in state.nodes if n.type == mi.ObjectType.Integrator)
    subject = Subject(
        Path(path).name, fingerprint.scene_hash(path, state), tuple(sorted((defines or {}).items())),
        integrator, str(mi.variant()), camera, (width, height), fingerprint.versions(),
    )  # fmt: skip
    return loaded, subject


def samples_of(loaded: LoadedScene, subject: Subject, spp: int, seed: int) -> Samples:
    """The samples of a picture that is rendered at once."""
    spp = spp or loaded.sensor(subject.camera).sampler().sample_count()
    return Samples(samples_taken(loaded, subject.camera, spp), seed, _draws(loaded, subject.camera, spp))


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
    taken = {n: samples_taken(loaded, subject.camera, n) for n in free[-2:]}
    asked = next((n for n in reversed(free[-2:]) if taken[n] == n), free[-1])
    return Plan(subject, seed, asked, taken[asked], math.ceil(spp / taken[asked]))


def default_pass_spp(size: tuple[int, int], spp: int) -> int:
    """Samples per pixel of a pass where nobody says: large enough to cost little more, small enough to lose little."""
    pixels = size[0] * size[1]
    wanted = max(PASS_SPP, LEAST_SAMPLES // pixels) if dr.is_jit_v(mi.Float) else SCALAR_SAMPLES // pixels
    return max(1, min(wanted, MOST_SAMPLES // pixels, spp // LEAST_PASSES))


def samples_taken(loaded: LoadedScene, camera: int, spp: int) -> int:
    """Samples per pixel that a rendering takes when asked for `spp`."""
    return rendering.samples_taken(loaded, camera, spp)


def _draws(loaded: LoadedScene, camera: int, spp: int) -> bool:
    """Whether random numbers are used."""
    fixed = loaded.integrator == rendering.WHITTED and cameras.grid(spp)
    return not fixed or cameras.draws(loaded.sensor(camera))


def _powers(most: int) -> list[int]:
    """1, 2, 4, ... up to `most`."""
    return [2**k for k in range(most.bit_length())]


def _stride(cells: int) -> int:
    """A number coprime with `cells`, near the golden ratio of them."""
    stride = max(round(cells * (math.sqrt(5) - 1) / 2), 1)
    while math.gcd(stride, cells) > 1:
        stride += 1
    return stride
