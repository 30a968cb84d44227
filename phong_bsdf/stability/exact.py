"""What is true, in float64, by formulas other than those of `lobes.py`.

`tests/stability/test_stability.py` checks them against mpmath. Condition numbers are relative: the change of the value
by that of its inputs.
"""

import numpy as np

from ..reflection import lobes, matching


def value_and_pdf(lobe: str, wi: np.ndarray, wo: np.ndarray, p: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
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


def sampled_sine(lobe: str, p: float, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sine of the sampled angle to the normal at normal incidence, its condition number, and whether it is used: not
    where the direction is below the horizon. For float32 `xi`, (n,)."""
    with np.errstate(divide="ignore"):
        log_cos = np.log(np.maximum(xi.astype(np.float64), lobes.SMALLEST_XI)) / (p + 1)
    cos, sin = np.exp(log_cos), np.sqrt(-np.expm1(2 * log_cos))
    # The largest of the relative changes of sin(theta), or of sin(2 theta) for a direction mirrored at h, with xi,
    # with p and (mirrored) with wi.
    slope = (cos / sin) ** 2 if lobe == "phong" else np.abs(1 - (cos / sin) ** 2)
    kappa = slope * np.maximum(1, -log_cos * p) / (p + 1)
    if lobe == "phong":
        return sin, kappa, np.full(len(xi), True)
    # A half vector beyond 45 degrees gives a direction below the horizon.
    return 2 * sin * cos, np.maximum(kappa, 1), sin < cos


def normalization(lobe: str, p: float) -> float:
    """c(p) in float64."""
    if lobe == "phong":
        return (p + 2) / (2 * np.pi)
    return (p + 2) * (p + 4) / (8 * np.pi * (2 ** (-p / 2) + p))


def beckmann(wi: np.ndarray, wo: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """(value, condition number) of the Beckmann distribution whose roughness matches `p`, for float32 directions."""
    h = np.sum([v / np.linalg.norm(v.astype(np.float64), axis=1, keepdims=True) for v in (wi, wo)], axis=0)
    length = np.linalg.norm(h, axis=1)
    tan2, cos = (h[:, 0] ** 2 + h[:, 1] ** 2) / h[:, 2] ** 2, h[:, 2] / length
    alpha2 = float(np.float32(matching.roughness(p))) ** 2
    with np.errstate(under="ignore", over="ignore", divide="ignore"):
        value = np.exp(-tan2 / alpha2) / (np.pi * alpha2 * cos**4)
        return value, (2 * np.sqrt(tan2) / (alpha2 * cos**2) + 4 * np.sqrt(tan2)) / (length / 2)
