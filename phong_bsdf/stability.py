"""Numerical stability of the lobes: the worst error found at each exponent, beside the naive formulas.

Errors are relative to float64 values at the same float32 inputs, by formulas other than
those of `lobes.py` (`tests/test_stability.py` checks them against mpmath). The bars are on
C = error / (u (1 + kappa)), u = 2^-24, with kappa the condition number of the quantity: the
error that a rounding of the inputs alone would cause.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import lobes

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


# Inputs ---------------------------------------------------------------------------------------------


def directions(rng, n: int) -> np.ndarray:
    """Unit vectors above the horizon, (n, 3), half of them spread over seven decades of grazing cosines."""
    cos = np.where(rng.random(n) < 0.5, rng.random(n), 10 ** rng.uniform(-7, 0, n))
    return _polar(cos, np.sqrt(1 - cos * cos), rng.random(n))


def pairs(lobe: str, p: float, n: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Float32 directions (wi, wo), each (<= n, 3): everywhere, and where the lobe is 1 down to 1e-30.

    One in a hundred pairs is an edge case: at the peak, at normal incidence, at opposite
    horizons, and one at a right angle to the axis up to 1e-10; three in ten directions have a length that is off by up
    to 1e-6.
    """
    wi = directions(rng, n)
    log_cos = -np.log(10) * rng.uniform(0, 30, n) * (rng.random(n) < 0.9) / max(p, 1e-3)
    cos = np.where(rng.random(n) < 0.01, rng.choice([-1, 1], n) * 10 ** rng.uniform(-10, -1, n), np.exp(log_cos))
    about_axis = _polar(cos, np.where(cos > 0.1, np.sqrt(-np.expm1(2 * log_cos)), np.sqrt(1 - cos**2)), rng.random(n))
    if lobe == "phong":
        wo = _to_axis(about_axis, wi * [-1, -1, 1])
    else:
        wo = 2 * np.sum(wi * about_axis, axis=1, keepdims=True) * about_axis - wi
    wo = np.where(rng.random((n, 1)) < 0.3, directions(rng, n), wo)
    for v in (wi, wo):
        v *= 1 + np.where(rng.random((n, 1)) < 0.3, rng.uniform(-1e-6, 1e-6, (n, 1)), 0)

    edge = rng.integers(0, 500, n)
    wo[edge == 0] = (wi * [-1, -1, 1])[edge == 0]
    wi[edge == 1], wo[edge == 1] = [0, 0, 1], [0, 0, 1]
    # At opposite horizons.
    cos = np.where(rng.random(n) < 0.5, 1e-7, 10 ** rng.uniform(-12, -4, n))
    low = _polar(cos, np.sqrt(1 - cos**2), rng.random(n))
    off = 1 + 10 ** rng.uniform(-7, -6, (2, n, 1)) * rng.choice([-1, 1], (2, n, 1))
    wi[edge == 2], wo[edge == 2] = (low * off[0])[edge == 2], (low * [-1, -1, 1] * off[1])[edge == 2]
    wo[edge == 3] = wi[edge == 3]
    # And across from each other at unequal heights.
    wi[edge == 4], wo[edge == 4] = (
        low[edge == 4],
        (_polar(cos[::-1], np.sqrt(1 - cos[::-1] ** 2), 0) + 0 * low)[edge == 4],
    )

    wi, wo = wi.astype(np.float32), wo.astype(np.float32)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    return wi[above], wo[above]


def _polar(cos, sin, turn):
    phi = 2 * np.pi * turn
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos + 0 * phi], axis=-1)


def _to_axis(v, axis):
    """Directions about +z as directions about `axis`."""
    z = axis + np.array([0, 0, 1])
    return 2 * np.sum(v * z, axis=1, keepdims=True) / np.sum(z * z, axis=1, keepdims=True) * z - v


# What is true: float64 --------------------------------------------------------------------------------


def exact(lobe: str, wi: np.ndarray, wo: np.ndarray, p: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(value, condition number) of `value` and `pdf` in float64, the directions normalised first."""
    wi, wo = wi.astype(np.float64), wo.astype(np.float64)
    tan_h, cos_d = _bisector(wi, wo)
    wi, wo = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (wi, wo))
    with np.errstate(divide="ignore", invalid="ignore", under="ignore", over="ignore"):
        if lobe == "phong":
            axis = wi * [-1, -1, 1]
            cos, sin = np.sum(axis * wo, axis=1), np.linalg.norm(np.cross(axis, wo), axis=1)
            value = np.where(cos > 0, _cos_power(cos, sin, p), float(p == 0))
            # Closer to a right angle float64 knows the side no more.
            kappa = np.where(np.abs(cos) < 1e-13, np.inf, np.where(cos > 0, p * sin / cos, 0))
            mirrored = 2 * wi[:, 2] * cos - wo[:, 2]
            pdf = (p + 1) / (2 * np.pi) * value * np.where((mirrored < 0) & (p > 0), 2, 1)
            kappa_pdf = kappa
        else:
            cos = 1 / np.hypot(1, tan_h)
            value = _cos_power(cos, tan_h * cos, p)
            sin_d = np.linalg.norm(wi - wo, axis=1) / 2
            kappa = p * tan_h / cos_d
            mirrored = 2 * wi[:, 2] * (2 * cos**2 - 1) - wo[:, 2]
            pdf = (p + 1) / (2 * np.pi) * value / (4 * cos_d) * np.where(mirrored < 0, 2, 1)
            kappa_pdf = kappa + sin_d / cos_d
        # Where the density jumps to twice its value, a rounding decides.
        kappa_pdf = np.where((np.abs(mirrored) < 4e-6) & (p > 0), np.inf, kappa_pdf)
        return {"value": (value, kappa), "pdf": (pdf, kappa_pdf)}


def _bisector(wi, wo):
    """Tangent of the angle between normal and bisector, and cosine of that between bisector and wi.

    In float64, from float32 directions of any length. Products of two float32 numbers are exact there, so no digit is
    lost where the directions are at opposite horizons.
    """
    (length_i, sin_i, z_i), (length_o, sin_o, z_o) = (
        (np.linalg.norm(v, axis=1), np.hypot(v[:, 0], v[:, 1]), v[:, 2]) for v in (wi, wo)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        dot, cross = np.sum(wi[:, :2] * wo[:, :2], axis=1), wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
        not_opposite = np.where(dot < 0, cross**2 / (sin_i * sin_o - dot), sin_i * sin_o + dot)
        unequal = (sin_i * z_o - sin_o * z_i) * (sin_i * z_o + sin_o * z_i) / (sin_i * length_o + sin_o * length_i)
        across = np.hypot(np.nan_to_num(unequal), np.sqrt(2 * length_i * length_o * not_opposite))
    along = z_i * length_o + z_o * length_i
    return across / along, np.hypot(across, along) / (2 * length_i * length_o)


def _cos_power(cos, sin, p):
    # log(cos) from whichever of the two has kept its digits.
    log_cos = np.where(sin < 0.7, 0.5 * np.log1p(-(np.minimum(sin, 0.9) ** 2)), np.log(np.maximum(cos, 1e-300)))
    return np.exp(p * log_cos)


def exact_normalization(lobe: str, p: float) -> float:
    """c(p) in float64."""
    if lobe == "phong":
        return (p + 2) / (2 * np.pi)
    return (p + 2) * (p + 4) / (8 * np.pi * (2 ** (-p / 2) + p))


# What is common: the naive formulas ---------------------------------------------------------------------


def _naive_phong(wi, wo, p):
    cos = dr.maximum(dr.dot(mi.Vector3f(-wi.x, -wi.y, wi.z), wo), 0)
    return dr.power(cos, p)


def _naive_blinnphong(wi, wo, p):
    return dr.power(dr.maximum(dr.normalize(wi + wo).z, 0), p)


def _naive_phong_pdf(wi, wo, p):
    cos = dr.dot(mi.Vector3f(-wi.x, -wi.y, wi.z), wo)
    twice = (2 * wi.z * cos < wo.z) & (p > 0)
    return dr.select(twice, 2, 1) * (p + 1) * dr.inv_two_pi * dr.power(dr.maximum(cos, 0), p)


def _naive_blinnphong_pdf(wi, wo, p):
    h = dr.normalize(wi + wo)
    twice = 2 * wi.z * (2 * dr.square(h.z) - 1) < wo.z
    return dr.select(twice, 2, 1) * (p + 1) * dr.inv_two_pi * dr.power(dr.maximum(h.z, 0), p) / (4 * dr.dot(wo, h))


def _naive_sample_phong(wi, p, xi):
    return mi.Frame3f(mi.Vector3f(-wi.x, -wi.y, wi.z)).to_world(_naive_cos_power_sample(p, xi))


def _naive_sample_blinnphong(wi, p, xi):
    h = _naive_cos_power_sample(p, xi)
    return h * (2 * dr.dot(wi, h)) - wi


def _naive_cos_power_sample(p, xi):
    cos: Any = dr.power(xi.x, 1 / (p + 1))
    sin = dr.sqrt(1 - dr.square(cos))
    sin_phi, cos_phi = dr.sincos(dr.two_pi * xi.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)


def _beckmann(wi, wo, p):
    """The lobe of `roughconductor` at the matched roughness, evaluated as it does."""
    alpha = float(np.sqrt(2 / (p + 2)))
    return mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, alpha, alpha, False).eval(dr.normalize(wi + wo))


def _exact_beckmann(wi, wo, p):
    h = np.sum([v / np.linalg.norm(v.astype(np.float64), axis=1, keepdims=True) for v in (wi, wo)], axis=0)
    length = np.linalg.norm(h, axis=1)
    tan2, cos = (h[:, 0] ** 2 + h[:, 1] ** 2) / h[:, 2] ** 2, h[:, 2] / length
    alpha2 = float(np.float32(np.sqrt(2 / (p + 2)))) ** 2
    with np.errstate(under="ignore", over="ignore", divide="ignore"):
        value = np.exp(-tan2 / alpha2) / (np.pi * alpha2 * cos**4)
        return value, (2 * np.sqrt(tan2) / (alpha2 * cos**2) + 4 * np.sqrt(tan2)) / (length / 2)


LOBES = {
    "phong": {
        "value": (lobes.phong, _naive_phong),
        "pdf": (lobes.phong_pdf, _naive_phong_pdf),
        "sample": (lobes.sample_phong, _naive_sample_phong),
        "normalization": (lobes.phong_normalization, lambda p: (p + 2) / dr.two_pi),
    },
    "blinnphong": {
        "value": (lobes.blinnphong, _naive_blinnphong),
        "pdf": (lobes.blinnphong_pdf, _naive_blinnphong_pdf),
        "sample": (lobes.sample_blinnphong, _naive_sample_blinnphong),
        "normalization": (
            lobes.blinnphong_normalization,
            lambda p: (p + 2) * (p + 4) / (8 * dr.pi * (dr.power(2, -p / 2) + p)),
        ),
    },
}


# Measuring ---------------------------------------------------------------------------------------------


def _measure_directions(lobe, p, cases, seed) -> Iterator[Row]:
    rng = np.random.default_rng(seed)
    wi, wo = pairs(lobe, p, cases, rng)
    truths = exact(lobe, wi, wo, p)
    inputs = mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.opaque(mi.Float, p)
    for quantity in ("value", "pdf"):
        stable, naive = LOBES[lobe][quantity]
        truth, kappa = truths[quantity]
        values = [function(*inputs).numpy() for function in (stable, naive)]
        error, c, *worst = _worst(values[0], truth, kappa)
        naive_error, naive_c, *_ = _worst(values[1], truth, kappa)
        timed = [lambda f=f: f(*inputs) for f in (stable, naive)]
        native_error = native_c = None
        if (lobe, quantity) == ("blinnphong", "value"):
            beckmann = _beckmann(inputs[0], inputs[1], p).numpy()
            native_error, native_c, *_ = _worst(beckmann, *_exact_beckmann(wi, wo, p))
            timed.append(lambda f=_beckmann: f(inputs[0], inputs[1], p))
        times = _interleaved(timed, len(wi))
        inputs_of = [tuple(float(x) for x in (*wi[i], *wo[i])) for i in worst]
        ours = error, inputs_of[0], c, inputs_of[1]
        yield Row(quantity, lobe, p, len(wi), *ours, naive_error, naive_c, native_error, native_c, *times)


def _measure_samples(lobe, p, cases, seed) -> Row:
    """Sine of the angle to the normal, at normal incidence, against the exact quantile of xi."""
    rng = np.random.default_rng(seed)
    xi = np.concatenate([[0, 2.0**-24, 1 - 2.0**-24], rng.random(cases // 2), 1 - 10 ** rng.uniform(-7, 0, cases // 2)])
    xi = np.minimum(xi.astype(np.float32), np.float32(1 - 2.0**-24))
    with np.errstate(divide="ignore"):
        log_cos = np.log(np.maximum(xi.astype(np.float64), lobes.SMALLEST_XI)) / (p + 1)
    cos, sin = np.exp(log_cos), np.sqrt(-np.expm1(2 * log_cos))
    truth = sin if lobe == "phong" else 2 * sin * cos
    # The largest of the relative changes of sin(theta), or of sin(2 theta) for a direction mirrored at h, with xi,
    # with p and (mirrored) with wi.
    slope = (cos / sin) ** 2 if lobe == "phong" else np.abs(1 - (cos / sin) ** 2)
    kappa = slope * np.maximum(1, -log_cos * p) / (p + 1)
    kappa = kappa if lobe == "phong" else np.maximum(kappa, 1)
    # A half vector beyond 45 degrees gives a direction below the horizon.
    used = np.full(len(xi), True) if lobe == "phong" else sin < cos
    wi, exponent, point = mi.Vector3f(0, 0, 1), dr.opaque(mi.Float, p), mi.Point2f(mi.Float(xi), 0.3)
    stable, naive = (lambda f=f: f(wi, exponent, point) for f in LOBES[lobe]["sample"])

    def sine(wo):
        return np.hypot(wo.x.numpy().astype(np.float64), wo.y.numpy())[used]

    truth, kappa, xi = truth[used], kappa[used], xi[used]
    error, c, *worst = _worst(sine(stable()), truth, kappa)
    naive_error, naive_c, *_ = _worst(sine(naive()), truth, kappa)
    times = _interleaved([stable, naive], len(used))
    ours = error, (float(xi[worst[0]]),), c, (float(xi[worst[1]]),)
    return Row("sample", lobe, p, len(xi), *ours, naive_error, naive_c, None, None, *times)


def _measure_normalization(lobe, p) -> Row:
    """c(p) and its neighbourhood, the exponents rounded to float32."""
    exponents = (p * (1 + np.linspace(-0.2, 0.2, 1001))).astype(np.float32)
    truth = np.array([exact_normalization(lobe, float(q)) for q in exponents])
    functions = LOBES[lobe]["normalization"]
    values = [f(mi.Float(exponents)).numpy() for f in functions]
    # p c'(p) / c(p), by central differences of the float64 formula.
    step = 1e-6 * np.maximum(exponents.astype(np.float64), 1e-3)
    around = [np.array([exact_normalization(lobe, float(q)) for q in exponents + sign * step]) for sign in (-1, 1)]
    kappa = exponents * (around[1] - around[0]) / (2 * step) / truth
    error, c, *worst = _worst(values[0], truth, kappa)
    naive_error, naive_c, *_ = _worst(values[1], truth, kappa)
    # No literal, which the compiler would evaluate.
    wide = dr.opaque(mi.Float, p, 2**20)
    times = _interleaved([lambda f=f: f(wide) for f in functions], 2**20)
    ours = error, (float(exponents[worst[0]]),), c, (float(exponents[worst[1]]),)
    return Row("normalization", lobe, p, len(exponents), *ours, naive_error, naive_c, None, None, *times)


def _worst(values, truth, kappa) -> tuple[float, float, int, int]:
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
