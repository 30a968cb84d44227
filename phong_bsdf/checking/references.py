"""A rendering against a reference that is stored beside the tests: one EXR file, with noise a second one.

NAME.exr holds the picture. Where another seed gives another picture, it is the mean of many passes, and
NAME-variance.exr holds how much the passes scatter: the variance of the means over tiles of 16 x 16 pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from .. import __version__
from ..pictures import images
from ..scene import rendering
from .verdict import ALPHA, Sampled, Verdict, compare, compare_noisy, sample

# Seeds of references: no test uses them, or its noise would not be independent.
FIRST_SEED = 2**20

# A reference is made once and serves often: it gets so many times the passes of a check.
REFERENCE_PASSES = 4

# Two renderings that differ by less than this part of the brightest value have no noise.
SAME = 1e-5


class NoReference(ValueError):
    """A reference that is missing or of no use."""


@dataclass(frozen=True)
class Options:
    """How a scene is rendered and compared."""

    camera: int = 1
    size: tuple[int, int] | None = None
    spp: int | None = None
    """Samples per pixel in all; None: as the scene says."""
    seed: int = 0
    defines: Mapping[str, str] | None = None
    """Values for the <default>s of a scene file."""
    absolute: float = 1e-4
    relative: float = 1e-3
    ulps: int = 0
    edges: float = 1e-3
    """Without noise: as `verdict.compare` has them."""
    alpha: float = ALPHA
    passes: int = 16
    """With noise: probability of a false alarm, and the number of parts the samples are rendered in."""


@dataclass(frozen=True)
class Outcome:
    """A comparison, with the pictures."""

    verdict: Verdict
    actual: np.ndarray
    expected: np.ndarray
    noisy: bool


def files(path: Path) -> tuple[Path, Path]:
    """The picture of a reference, and its scatter."""
    path = Path(path)
    return path.with_name(f"{path.name}.exr"), path.with_name(f"{path.name}-variance.exr")


def update(path: Path, scene, options: Options) -> None:
    """Render a scene (a file, a dictionary, a `mitsuba.Scene`) or take a picture (an array) as the new reference.

    ValueError where it cannot be one.
    """
    picture, variance = files(path)
    render = _renderer(scene, options)
    metadata = {"phong_bsdf": __version__, "variant": mi.variant() or ""}
    first = render(FIRST_SEED, 1)
    broken = compare(first, first)
    if not broken.passed:
        raise ValueError(f"this cannot be a reference. {broken.words}")
    picture.parent.mkdir(parents=True, exist_ok=True)
    if not _is_noisy(render, first):
        variance.unlink(missing_ok=True)
        images.write(picture, first, metadata=metadata)
        return
    count = REFERENCE_PASSES * options.passes
    sampled = sample(render(FIRST_SEED + i, options.passes) for i in range(count))
    # The picture last: without it there is no reference.
    images.write(variance, sampled.variance, metadata={**metadata, "passes": str(count)})
    images.write(picture, sampled.mean, metadata={**metadata, "passes": str(count)})


def check(path: Path, scene, options: Options) -> Outcome:
    """Compare with the reference; `NoReference` where there is none, ValueError where sizes differ."""
    # First, so that a mistake in the scene is told before a missing reference.
    render = _renderer(scene, options)
    picture, variance = files(path)
    if not picture.is_file():
        raise NoReference(f"there is no reference '{picture}'")
    try:
        expected = images.read_exr(picture)
        scatter = images.read_exr(variance).astype(np.float64) if variance.is_file() else None
        passes = int(images.read_metadata(picture).get("passes", 1))
    except Exception as error:
        # OpenEXR raises whatever its C++ side throws.
        raise NoReference(f"the reference '{picture}' cannot be read: {error}") from None
    if passes > 1 and scatter is None:
        raise NoReference(f"'{variance}' is missing, which belongs to the reference '{picture.name}'")
    if scatter is None:
        actual = render(options.seed, 1)
        limits = {"absolute": options.absolute, "relative": options.relative, "ulps": options.ulps}
        return Outcome(compare(actual, expected, edges=options.edges, **limits), actual, expected, False)
    sampled = sample(render(options.seed + i, options.passes) for i in range(options.passes))
    reference = Sampled(expected.astype(np.float64), scatter, passes)
    found = compare_noisy(sampled, reference, alpha=options.alpha)
    return Outcome(found, sampled.mean.astype(np.float32), expected, True)


def _renderer(scene, options: Options):
    """A function of a seed, and of the number of parts that the samples are split in, that renders the scene."""
    if isinstance(scene, np.ndarray):
        if scene.ndim not in (2, 3):
            raise ValueError(f"a picture is an array (height, width, channels), not one of shape {scene.shape}")
        image = scene if scene.ndim == 3 else scene[..., None]
        return lambda seed, parts: image
    path = Path(scene) if isinstance(scene, str | Path) else Path("scene")
    if isinstance(scene, str | Path):
        loaded = rendering.load(path, {name: str(value) for name, value in (options.defines or {}).items()})
    else:
        scene = mi.load_dict(scene) if isinstance(scene, dict) else scene
        if not isinstance(scene, mi.Scene):
            raise TypeError(f"a scene is a path, a dictionary, a mitsuba.Scene or an array, not {type(scene).__name__}")
        loaded = rendering.LoadedScene(path, scene, type(scene.integrator()).__name__, 0.0)
    if options.size:
        rendering.resize(loaded, options.camera, *options.size)
    spp = options.spp or loaded.sensor(options.camera).sampler().sample_count()

    def render(seed: int, parts: int) -> np.ndarray:
        return rendering.render(loaded, camera=options.camera, spp=-(-spp // parts), seed=seed, color=True).image

    return render


def _is_noisy(render, image: np.ndarray) -> bool:
    """Whether another seed gives another picture."""
    other = render(FIRST_SEED + 1, 1)
    finite = np.isfinite(image) & np.isfinite(other)
    difference = np.abs(np.where(finite, image - other, 0))
    return bool(difference.max(initial=0) > SAME * max(np.abs(image[finite]).max(initial=0), 1e-6))
