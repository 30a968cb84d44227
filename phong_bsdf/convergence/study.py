"""What passes say: errors at each number of samples, slopes, bias -> records.

Nothing is rendered here. Where passes come from does not matter: the tests bring their own, with known laws.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..pictures import estimates, metrics
from ..pictures.estimates import Estimate
from ..pictures.store import Pass

# Errors of a level; the first two without the reference's noise.
METRICS = ("relmse", "mse", "max_error", "flip")

# A method is called biased only where this sure.
SURE = 0.99

# A picture without noise whose error still falls like spp^-FALLING at the finest level is not called biased.
FALLING = 0.25

# Between two passes of a method without noise: only what float32 adds in another order.
NOISELESS = 1e-6

# Levels cheaper than so many times the cheapest say nothing about how error and time go together: they measure what any
# rendering costs.
GROWING = 2.0


class Reference:
    """What methods are measured against: passes of its own, or one picture that counts as exact."""

    def __init__(self, name: str, images: Sequence[np.ndarray], coarser=None, kind: str = "passes"):
        """`kind`: `passes`, `grid` (`coarser`: the picture of half as many samples across) or `file`."""
        self.name, self.kind, self.passes = name, kind, len(images)
        self.images = list(images)
        self.mean = estimates.average(self.images)
        self.nonfinite = metrics.nonfinite(self.mean)
        self.coarser = coarser

    @cached_property
    def weights(self) -> dict[str, np.ndarray | float]:
        """What the two squared errors are weighted with, at each pixel."""
        return {"relmse": 1 / (self.mean**2 + metrics.EPSILON), "mse": 1.0}

    @cached_property
    def own_error(self) -> dict[str, float | None]:
        """Its own expected error: of passes by their spread, of a grid at most its distance to the next coarser one."""
        if self.kind == "file" or self.nonfinite or (self.kind == "grid" and self.coarser is None):
            return dict.fromkeys(self.weights)
        if self.coarser is not None:
            square = (self.coarser - self.mean) ** 2
            return {name: float(np.mean(weight * square)) for name, weight in self.weights.items()}
        return {
            name: estimates.noise(estimates.products(self.images[:1], self.images, weight))
            for name, weight in self.weights.items()
        }


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of times, in seconds where nothing else is said."""

    median: float
    low: float
    """The lower quartile."""
    high: float
    """The upper quartile."""

    @classmethod
    def of(cls, times: Sequence[float]) -> "Spread":
        """The median and the quartiles of measured times."""
        return cls(*(float(np.quantile(times, q)) for q in (0.5, 0.25, 0.75)))


@dataclass(frozen=True)
class PassErrors:
    """Errors of one pass; None where its picture, or the reference, holds what is no number."""

    spp: int
    """Samples per pixel."""
    repeat: int
    """Its number, from 0."""
    relmse: float | None
    """The errors are those of `metrics.Errors`."""
    mse: float | None
    max_error: float | None
    flip: float | None
    nonfinite: int
    """Pixels that are no numbers."""


@dataclass(frozen=True)
class Level:
    """One method at one number of samples."""

    spp: int
    """Samples per pixel."""
    passes: int
    """Their number."""
    seconds: Spread
    """Of one rendering."""
    seconds_warmup: float
    """What the slowest first rendering took beyond that: compiling, mostly."""
    relmse: Estimate | None
    """Errors are None where no pass has one."""
    mse: Estimate | None
    max_error: Estimate | None
    flip: Estimate | None
    bias: Estimate | None
    """Part of `relmse` that more passes would not remove."""
    variance: Estimate | None
    """Part of `relmse` that they would."""
    nonfinite: int
    """Pixels that are no numbers, over all passes."""


@dataclass(frozen=True)
class Result:
    """All that is known of one method."""

    name: str
    """Of the method."""
    reference: str
    """Name of what it is measured against."""
    failure: str | None
    """Why it failed; None: it did not."""
    levels: tuple[Level, ...]
    passes: tuple[PassErrors, ...]
    slope: Estimate | None
    """Of log relMSE against log seconds, where these grow with the samples."""
    slope_spp: Estimate | None
    """The same against samples."""
    bias: Estimate | None
    """relMSE that it levels off at, from its finest level."""
    efficiency: Estimate | None
    """1 / (variance x seconds) at the finest level; None for a picture without noise."""
    verdict: str
    """`biased`, `unbiased` (none was found), `falling` (no noise, but the error still falls), `reference` (at the
    reference's own error) or `unknown`."""


def analyse(
    name: str,
    passes: Sequence[tuple[Pass, np.ndarray]],
    reference: Reference,
    flip: Mapping[tuple[int, int], float] | None = None,
) -> Result:
    """What the passes of one method say. `flip`: (spp, repeat) -> HDR-FLIP, where it is known."""
    levels, each, products = [], [], {}
    for spp in sorted({made.spp for made, _ in passes}):
        chosen = sorted(((made, image) for made, image in passes if made.spp == spp), key=lambda pair: pair[0].repeat)
        level, errors, products[spp] = _level(spp, chosen, reference, flip or {})
        levels.append(level)
        each += errors
    medians = {level.spp: level.seconds.median for level in levels}
    growing = [e for e in each if medians[e.spp] >= GROWING * min(medians.values())]
    finest = next((n for n in reversed(levels) if n.bias is not None), None)
    verdict = _verdict(levels, products, reference)
    noisy = finest is not None and not _noiseless(finest)
    return Result(
        name, reference.name, None, tuple(levels), tuple(each),
        slope=_slope(growing, lambda e: medians[e.spp]), slope_spp=_slope(each, lambda e: float(e.spp)),
        bias=finest and finest.bias,
        efficiency=finest.variance.map(lambda v: math.inf if v <= 0 else 1 / (v * finest.seconds.median))
        if noisy and finest.variance.low and finest.variance.low > 0 else None,
        verdict=verdict,
    )  # fmt: skip


def unmeasured(name: str, reference: str, failure: str | None) -> Result:
    """A method of which nothing is known but why it failed, if it did."""
    return Result(name, reference, failure, (), (), None, None, None, None, "unknown")


def _level(spp: int, chosen, reference: Reference, flip) -> tuple[Level, list[PassErrors], dict]:
    spread = Spread.of([made.seconds for made, _ in chosen])
    bad = [metrics.nonfinite(image) for _, image in chosen]
    warmup = max(made.seconds_warmup for made, _ in chosen)
    if any(bad) or reference.nonfinite:
        none = [
            PassErrors(spp, made.repeat, None, None, None, None, n) for (made, _), n in zip(chosen, bad, strict=True)
        ]
        return Level(spp, len(chosen), spread, warmup, None, None, None, None, None, None, sum(bad)), none, {}

    pictures = [image for _, image in chosen]
    products = {name: estimates.products(pictures, reference.images, w) for name, w in reference.weights.items()}
    squared = {name: estimates.errors(p) for name, p in products.items()}
    largest = [float(np.abs(image - reference.mean).max()) for image in pictures]
    numbers = zip(squared["relmse"], squared["mse"], largest, strict=True)
    each = [
        PassErrors(spp, made.repeat, *errors, flip.get((spp, made.repeat)), 0)
        for (made, _), errors in zip(chosen, numbers, strict=True)
    ]
    flips = [e.flip for e in each if e.flip is not None]
    p = products["relmse"]
    level = Level(
        spp, len(chosen), spread, warmup,
        estimates.error(p), estimates.error(products["mse"]), estimates.mean(largest),
        estimates.mean(flips) if flips else None,
        estimates.bias(p) if len(chosen) > 1 else None, estimates.variance(p) if len(chosen) > 1 else None, 0,
    )  # fmt: skip
    return level, each, products


def _verdict(levels: Sequence[Level], products, reference: Reference) -> str:
    known = [level for level in levels if level.bias is not None and level.bias.low is not None]
    if not known:
        return "unknown"
    finest, own = known[-1], reference.own_error["relmse"] or 0.0
    # A grid's own error is known as a bound only, and is in every error measured against it.
    floor = own if reference.coarser is not None else 0.0
    if _noiseless(finest):
        if finest.relmse.value <= own:
            return "reference"
        if len(known) < 2:
            return "unknown"
        before = known[-2]
        steps = math.log(finest.spp / before.spp)
        return "biased" if math.log(before.relmse.value / finest.relmse.value) < FALLING * steps else "falling"
    surely = estimates.bias(products[finest.spp]["relmse"], SURE)
    return "biased" if surely.low > floor else "unbiased"


def _noiseless(level: Level) -> bool:
    return level.variance is not None and abs(level.variance.value) <= NOISELESS * max(level.relmse.value, 0)


def complete_repeats(passes: Sequence[PassErrors]) -> list[list[PassErrors]]:
    """The passes of each repeat that has as many levels as any."""
    by_repeat: dict[int, list[PassErrors]] = {}
    for errors in passes:
        if errors.relmse is not None:
            by_repeat.setdefault(errors.repeat, []).append(errors)
    most = max(map(len, by_repeat.values()), default=0)
    return [curve for curve in by_repeat.values() if len(curve) == most]


def errors_of(passes: Sequence[PassErrors]) -> list[float]:
    """The relMSE of passes, of those that have one."""
    return [errors.relmse for errors in passes if errors.relmse is not None]


def _slope(each: Sequence[PassErrors], position) -> Estimate | None:
    slopes = [estimates.slope([position(e) for e in c], errors_of(c)) for c in complete_repeats(each)]
    known = [s for s in slopes if s is not None]
    return estimates.mean(known) if known else None
