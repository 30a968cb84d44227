"""Is a picture right? Two pictures without noise pixel by pixel, two with noise by statistics.

    verdict = compare(actual, expected, absolute=1e-4)
    verdict = compare_noisy(sample(passes), reference)
    assert verdict.passed, verdict.words

Pictures are arrays (height, width, channels), encoded in the same way. Pixels that are not finite fail first.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..pictures import metrics

__all__ = ["Sampled", "Verdict", "compare", "compare_noisy", "sample"]

# Pixels next to each other share what they see, and a mistake shows in many: means over squares of this side tell a
# brightness that is off by 1 % where no single pixel can.
TILE = 16

# Probability that two right pictures are called different. Sidak's correction shares it among the tiles. With fixed
# seeds a picture that passes keeps passing.
ALPHA = 0.01

# What rounding alone may do to a tile's mean: relative, and absolute.
ROUNDING = (1e-5, 1e-6)


@dataclass(frozen=True)
class Verdict:
    """What a comparison found."""

    passed: bool
    words: str
    """One or two sentences for whoever made the picture."""
    wrong: np.ndarray
    """The pixels that are off, (height, width), bool, without those that are forgiven."""
    excess: np.ndarray
    """How far each pixel is off, in multiples of what is allowed, (height, width): 1 is the limit."""

    @property
    def share(self) -> float:
        """The part of the pixels that is off, 0 to 1."""
        return float(self.wrong.mean()) if self.wrong.size else 0.0


@dataclass(frozen=True)
class Sampled:
    """A noisy picture: the mean of several passes of different seeds, and how much they scatter."""

    mean: np.ndarray
    """(height, width, channels), float64."""
    variance: np.ndarray
    """Of the mean over each tile of 16 x 16 pixels of one pass, (rows of tiles, columns of tiles, channels)."""
    passes: int
    """Their number."""


def compare(
    actual: np.ndarray,
    expected: np.ndarray,
    *,
    absolute: float | np.ndarray = 0.0,
    relative: float = 0.0,
    ulps: int = 0,
    edges: float = 0.0,
) -> Verdict:
    """Compare two pictures without noise, (height, width, channels), encoded in the same way.

    ValueError where their sizes or channels differ. Pixels that are not finite fail first. A value is right within
    `absolute` + `relative` |expected|, or within `ulps` steps of float32. `edges` is the part of the pixels that may be
    off at edges, which a rounding hits or misses: there the expected picture changes, from a pixel to those around it,
    by at least half as much. They are forgiven if there are no more of them.
    """
    actual, expected = metrics.check_shapes(actual, expected)
    broken = _not_finite(actual, expected)
    if broken:
        return broken
    allowed = absolute + relative * np.abs(expected, dtype=np.float64)
    difference = np.abs(actual - expected.astype(np.float64))
    if ulps:
        difference = np.where(_steps(actual, expected) <= ulps, 0, difference)
    excess = _over(difference, allowed).max(axis=-1)
    off = excess > 1
    at_edge = off & (difference.max(axis=-1) <= 2 * _contrast(expected))
    forgiven = at_edge if at_edge.mean() <= edges else np.zeros_like(at_edge)
    wrong = off & ~forgiven
    return Verdict(not wrong.any(), _words(actual, expected, wrong, excess, int(forgiven.sum())), wrong, excess)


def sample(passes: Iterable[np.ndarray]) -> Sampled:
    """The mean and the scatter of passes, (height, width, channels), of the same scene with different seeds.

    ValueError for fewer than two.
    """
    count, mean, tiles, squares = 0, np.zeros(()), np.zeros(()), np.zeros(())
    for image in passes:
        count += 1
        image = np.asarray(image, np.float64)
        mean = mean + (image - mean) / count
        step = tile_means(image) - tiles
        tiles = tiles + step / count
        squares = squares + step * (tile_means(image) - tiles)
    if count < 2:
        raise ValueError(f"the scatter of noise needs at least 2 passes, got {count}")
    return Sampled(mean, squares / (count - 1), count)


def compare_noisy(actual: Sampled, expected: Sampled, *, alpha: float = ALPHA) -> Verdict:
    """Compare two pictures with noise of their own; `alpha` (0.01) is the probability of a false alarm.

    ValueError where their sizes or channels differ, ImportError without scipy (`phong-bsdf[check]`). By Welch's t-test
    on the means of 16 x 16 pixels, and of the whole picture, with Sidak's correction for their number. Sources: Welch,
    "The generalization of 'Student's' problem when several different population variances are involved", 1947; Sidak,
    "Rectangular confidence regions for the means of multivariate normal distributions", 1967.
    """
    mean, reference = metrics.check_shapes(actual.mean, expected.mean)
    broken = _not_finite(mean, reference)
    if broken:
        return broken
    a, b = tile_means(mean), tile_means(reference)
    # The tiles, and as one more "tile" the whole picture.
    wholes = [x.mean(axis=(0, 1)) for x in (mean, reference)]
    difference = np.abs(np.vstack([_rows(a - b), wholes[0] - wholes[1]]))
    p = _welch(difference, _with_whole(actual), _with_whole(expected), actual.passes, expected.passes)
    limit = -np.expm1(np.log1p(-alpha) / p.size)
    # Where nothing scatters, only rounding may differ.
    off = (p < limit) & (difference > ROUNDING[0] * np.vstack([_rows(np.abs(b)), wholes[1]]) + ROUNDING[1])
    if not off.any():
        nothing = np.zeros(mean.shape[:2])
        return Verdict(True, f"No difference beyond the noise in {len(off) - 1} tiles.", nothing > 0, nothing)
    excess = np.where(off, np.log(np.maximum(p, 1e-300)) / np.log(limit), 0).max(axis=-1)
    tiles = excess[:-1] if off[:-1].any() else np.full(len(off) - 1, excess[-1])
    excess = _spread(tiles.reshape(a.shape[:2]), mean.shape)
    return Verdict(False, _noisy_words(a, b, off, excess) + _brightness(mean, reference), excess > 0, excess)


def tile_means(image: np.ndarray) -> np.ndarray:
    """Means over tiles of `TILE` x `TILE` pixels, (rows, columns, channels); the last ones may be smaller."""
    rows, columns = (np.arange(0, side, TILE) for side in image.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0, dtype=np.float64), columns, axis=1)
    return sums / tile_sizes(image.shape)[..., None]


def tile_sizes(shape) -> np.ndarray:
    """Number of pixels in each tile of a picture of this shape."""
    heights, widths = (np.diff([*range(0, side, TILE), side]) for side in shape[:2])
    return heights[:, None] * widths


def _rows(tiles: np.ndarray) -> np.ndarray:
    return tiles.reshape(-1, tiles.shape[-1])


def _with_whole(sampled: Sampled) -> np.ndarray:
    """Variances of the means over the tiles, and over the whole picture: noise differs from tile to tile."""
    sizes = tile_sizes(sampled.mean.shape)[..., None] / (sampled.mean.shape[0] * sampled.mean.shape[1])
    return np.vstack([_rows(sampled.variance), (sizes**2 * sampled.variance).sum(axis=(0, 1))])


def _welch(difference, variance, reference_variance, passes: int, reference_passes: int) -> np.ndarray:
    """Probability of a difference as large as this, were the pictures equal."""
    try:
        from scipy.special import stdtr
    except ImportError:
        raise ImportError(
            "comparing noisy pictures needs the package scipy, which is not installed: pip install 'phong-bsdf[check]'"
        ) from None
    parts = variance / passes, reference_variance / reference_passes
    total = parts[0] + parts[1]
    squares = parts[0] ** 2 / (passes - 1) + parts[1] ** 2 / (reference_passes - 1)
    scatters = squares > 0
    freedom = np.where(scatters, total**2 / np.where(scatters, squares, 1), 1)
    t = difference / np.sqrt(np.where(scatters, total, 1))
    return np.where(scatters, 2 * stdtr(freedom, -t), np.where(difference > 0, 0.0, 1.0))


def _noisy_words(a, b, off, excess) -> str:
    tiles = off[:-1].any(axis=-1)
    if not tiles.any():
        return "The picture as a whole differs by more than noise, though no part of it does alone."
    worst = np.argmax(np.where(tiles, excess[::TILE, ::TILE].ravel(), 0))
    row, column = np.unravel_index(worst, a.shape[:2])
    return (
        f"{int(tiles.sum())} of {tiles.size} tiles of {TILE} x {TILE} pixels differ by more than noise, most at "
        f"row {TILE * row}, column {TILE * column}: {_values(a[row, column])} instead of {_values(b[row, column])}."
    )


def _spread(tiles: np.ndarray, shape) -> np.ndarray:
    return tiles.repeat(TILE, 0).repeat(TILE, 1)[: shape[0], : shape[1]]


def _not_finite(actual, expected) -> Verdict | None:
    for name, image in (("", actual), ("expected ", expected)):
        bad = ~np.isfinite(image).all(axis=-1)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            words = (
                f"{_pixels(int(bad.sum()))} of the {name}picture {'is' if bad.sum() == 1 else 'are'} not finite, "
                f"first at row {row}, column {column}: {_values(image[row, column])}."
            )
            return Verdict(False, words, bad, np.where(bad, np.inf, 0.0))
    return None


def _steps(actual, expected) -> np.ndarray:
    """How many float32 numbers lie between two values."""

    def order(x):
        bits = np.ascontiguousarray(x, np.float32).view(np.int32).astype(np.int64)
        return np.where(bits < 0, -(2**31) - bits, bits)

    return np.abs(order(actual) - order(expected))


def _over(difference, allowed) -> np.ndarray:
    """difference / allowed, also where nothing is allowed."""
    exact = np.where(difference > 0, np.inf, 0.0)
    return np.where(allowed > 0, difference / np.where(allowed > 0, allowed, 1), exact)


def _contrast(image: np.ndarray) -> np.ndarray:
    """How much an image varies in the 3 x 3 around each pixel, (height, width)."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return (np.maximum.reduce(around) - np.minimum.reduce(around)).max(axis=-1)


def _words(actual, expected, wrong, excess, forgiven: int) -> str:
    at_edges = ""
    if forgiven:
        at_edges = f" {_pixels(forgiven)} at edges {'is' if forgiven == 1 else 'are'} off, which is allowed."
    if not wrong.any():
        return f"The picture is right.{at_edges}" if forgiven else "Every pixel is right."
    row, column = np.unravel_index(np.argmax(np.where(wrong, excess, -1)), wrong.shape)
    return (
        f"{int(wrong.sum())} of {wrong.size} pixels are off ({100 * wrong.mean():.3g} %), most at row {row}, "
        f"column {column}: {_values(actual[row, column])} instead of {_values(expected[row, column])}."
        f"{_brightness(actual, expected)}{at_edges}"
    )


def _brightness(actual, expected) -> str:
    found, wanted = metrics.energy(actual), metrics.energy(expected)
    if wanted <= 0 or abs(found / wanted - 1) < 1e-3:
        return ""
    if found >= 2 * wanted:
        return f" On the whole it is {found / wanted:.2g} times as bright."
    if found < 0.005 * wanted:
        return " On the whole it is black."
    return f" On the whole it is {100 * abs(found / wanted - 1):.2g} % {'brighter' if found > wanted else 'darker'}."


def _pixels(count: int) -> str:
    return f"{count} pixel{'' if count == 1 else 's'}"


def _values(pixel) -> str:
    return ", ".join(f"{x:.4g}" for x in pixel)
