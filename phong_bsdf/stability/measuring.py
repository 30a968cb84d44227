"""Numerical stability of the lobes: the worst error found at each exponent, beside the naive formulas.

Errors are relative to float64 values at the same float32 inputs, by formulas other than
those of `lobes.py` (`tests/stability/test_stability.py` checks them against mpmath). The bars are on
C = error / (u (1 + kappa)), u = 2^-24, with kappa the condition number of the quantity: the
error that a rounding of the inputs alone would cause.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..reflection import lobes
from . import exact, naive
from .inputs import pairs

U = 2.0**-24

BARS = {"value": 3.0, "pdf": 3.0, "sample": 3.0, "normalization": 3.0}
EXPONENTS = (0.0, 1e-6, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)

# Inputs for each quantity, lobe and exponent.
CASES = 2**22
QUICK_CASES = 2**18

# Beyond this condition number a first-order bound says nothing; values below 1e-30 are not judged.
WORST_CONDITION = 1e-2 / U
SMALLEST = 1e-30


@dataclass(frozen=True)
class Row:
    """The worst case of one quantity, lobe and exponent."""

    quantity: str
    """`value`, `pdf`, `sample` (sine of the sampled angle to the normal, at normal incidence) or `normalization`."""
    lobe: str
    p: float
    cases: int
    error: float
    """Largest relative error of the package's formula."""
    error_inputs: tuple[float, ...]
    """Its inputs: wi and wo, or xi, or p."""
    c: float
    """Largest error / (u (1 + kappa))."""
    c_inputs: tuple[float, ...]
    """Its inputs, which may be others than those of the largest error."""
    naive_error: float
    naive_c: float
    native_error: float | None
    """The same for the Beckmann distribution of Mitsuba's rough BSDFs at roughness sqrt(2 / (p + 2))."""
    native_c: float | None
    nanoseconds: float
    """Time of one evaluation, on all threads."""
    naive_nanoseconds: float
    native_nanoseconds: float | None = None
    """None where Mitsuba has no such function."""

    @property
    def passed(self) -> bool:
        """Whether the bar is met."""
        return self.c <= BARS[self.quantity]


def sweep(
    *,
    cases: int = CASES,
    exponents: tuple[float, ...] | None = None,
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Iterator[Row]:
    """The worst of `cases` inputs for every quantity, lobe and exponent (by default `EXPONENTS`).

    In the active variant, which must be a JIT one.
    """
    # As float32 has them.
    jobs = [(lobe, float(np.float32(p))) for lobe in LOBES for p in exponents or EXPONENTS]
    for i, (lobe, p) in enumerate(jobs):
        yield from _measure_directions(lobe, p, cases, seed + i)
        yield _measure_samples(lobe, p, cases, seed + i)
        yield _measure_normalization(lobe, p)
        on_progress((i + 1) / len(jobs))


# Ours and the naive formula.
LOBES = {
    "phong": {
        "value": (lobes.phong, naive.phong),
        "pdf": (lobes.phong_pdf, naive.phong_pdf),
        "sample": (lobes.sample_phong, naive.sample_phong),
        "normalization": (lobes.phong_normalization, naive.phong_normalization),
    },
    "blinnphong": {
        "value": (lobes.blinnphong, naive.blinnphong),
        "pdf": (lobes.blinnphong_pdf, naive.blinnphong_pdf),
        "sample": (lobes.sample_blinnphong, naive.sample_blinnphong),
        "normalization": (lobes.blinnphong_normalization, naive.blinnphong_normalization),
    },
}


def _measure_directions(lobe, p, cases, seed) -> Iterator[Row]:
    rng = np.random.default_rng(seed)
    wi, wo = pairs(lobe, p, cases, rng)
    truths = exact.value_and_pdf(lobe, wi, wo, p)
    inputs = mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.opaque(mi.Float, p)
    for quantity in ("value", "pdf"):
        stable, common = LOBES[lobe][quantity]
        truth, kappa = truths[quantity]
        values = [function(*inputs).numpy() for function in (stable, common)]
        error, c, *at = worst(values[0], truth, kappa)
        naive_error, naive_c, *_ = worst(values[1], truth, kappa)
        timed = [lambda f=f: f(*inputs) for f in (stable, common)]
        native_error = native_c = None
        if (lobe, quantity) == ("blinnphong", "value"):
            beckmann = naive.beckmann(inputs[0], inputs[1], p).numpy()
            native_error, native_c, *_ = worst(beckmann, *exact.beckmann(wi, wo, p))
            timed.append(lambda f=naive.beckmann: f(inputs[0], inputs[1], p))
        times = _interleaved(timed, len(wi))
        inputs_of = [tuple(float(x) for x in (*wi[i], *wo[i])) for i in at]
        ours = error, inputs_of[0], c, inputs_of[1]
        yield Row(quantity, lobe, p, len(wi), *ours, naive_error, naive_c, native_error, native_c, *times)


def _measure_samples(lobe, p, cases, seed) -> Row:
    """Sine of the angle to the normal, at normal incidence, against the exact quantile of xi."""
    rng = np.random.default_rng(seed)
    xi = np.concatenate([[0, 2.0**-24, 1 - 2.0**-24], rng.random(cases // 2), 1 - 10 ** rng.uniform(-7, 0, cases // 2)])
    xi = np.minimum(xi.astype(np.float32), np.float32(1 - 2.0**-24))
    truth, kappa, used = exact.sampled_sine(lobe, p, xi)
    wi, exponent, point = mi.Vector3f(0, 0, 1), dr.opaque(mi.Float, p), mi.Point2f(mi.Float(xi), 0.3)
    stable, common = (lambda f=f: f(wi, exponent, point) for f in LOBES[lobe]["sample"])

    def sine(wo):
        return np.hypot(wo.x.numpy().astype(np.float64), wo.y.numpy())[used]

    truth, kappa, xi = truth[used], kappa[used], xi[used]
    error, c, *at = worst(sine(stable()), truth, kappa)
    naive_error, naive_c, *_ = worst(sine(common()), truth, kappa)
    times = _interleaved([stable, common], len(used))
    ours = error, (float(xi[at[0]]),), c, (float(xi[at[1]]),)
    return Row("sample", lobe, p, len(xi), *ours, naive_error, naive_c, None, None, *times)


def _measure_normalization(lobe, p) -> Row:
    """c(p) and its neighbourhood, the exponents rounded to float32."""
    exponents = (p * (1 + np.linspace(-0.2, 0.2, 1001))).astype(np.float32)
    truth = np.array([exact.normalization(lobe, float(q)) for q in exponents])
    functions = LOBES[lobe]["normalization"]
    values = [f(mi.Float(exponents)).numpy() for f in functions]
    # p c'(p) / c(p), by central differences of the float64 formula.
    step = 1e-6 * np.maximum(exponents.astype(np.float64), 1e-3)
    around = [np.array([exact.normalization(lobe, float(q)) for q in exponents + sign * step]) for sign in (-1, 1)]
    kappa = exponents * (around[1] - around[0]) / (2 * step) / truth
    error, c, *at = worst(values[0], truth, kappa)
    naive_error, naive_c, *_ = worst(values[1], truth, kappa)
    # No literal, which the compiler would evaluate.
    wide = dr.opaque(mi.Float, p, 2**20)
    times = _interleaved([lambda f=f: f(wide) for f in functions], 2**20)
    ours = error, (float(exponents[at[0]]),), c, (float(exponents[at[1]]),)
    return Row("normalization", lobe, p, len(exponents), *ours, naive_error, naive_c, None, None, *times)


def worst(values, truth, kappa) -> tuple[float, float, int, int]:
    """Largest relative error, largest C, and the indices of the two."""
    judged = (truth > SMALLEST) & (kappa < WORST_CONDITION)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        error = np.where(judged, np.abs(values.astype(np.float64) / truth - 1), 0)
        c = error / (U * (1 + np.where(judged, kappa, 0)))
    error, c = (np.where(np.isfinite(x), x, np.inf) for x in (error, c))
    return float(error.max()), float(c.max()), int(error.argmax()), int(c.argmax())


def _interleaved(functions, evaluations: int, repeats: int = 5) -> list[float]:
    """Median nanoseconds of one evaluation of each function, run in turn."""
    seconds = [[] for _ in functions]
    for repeat in range(repeats + 1):
        for times, function in zip(seconds, functions, strict=True):
            dr.sync_thread()
            start = time.perf_counter()
            dr.eval(function())
            dr.sync_thread()
            # The first round compiles.
            if repeat > 0:
                times.append(time.perf_counter() - start)
    return [float(np.median(times)) / evaluations * 1e9 for times in seconds]
