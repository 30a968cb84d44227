"""What one BSDF reflects: its lobes in the plane of incidence, and its albedo over the angle of incidence.

Values come from `bsdf.eval` alone, so any BSDF of Mitsuba can be measured; a perfect mirror,
which `eval` leaves out, is not in them. Colours are averaged.
"""

from dataclasses import dataclass
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["ALBEDO_ANGLES", "LOBE_ANGLES", "Curves", "albedo", "lobe"]

LOBE_ANGLES = (0, 30, 60, 80)
"""Angles of incidence, in degrees, of `Curves.lobes`."""

ALBEDO_ANGLES = (0, 10, 20, 30, 40, 50, 60, 65, 70, 75, 80, 85, 89)
"""Angles of incidence, in degrees, of `Curves.albedos`."""

# Exponents of the lobes that the integration points are drawn from: some one is about as wide as any highlight.
RUNGS = tuple(16.0**k for k in range(7))
POINTS = 2048
# Scalar variants evaluate one point at a time, in Python.
SCALAR_POINTS = 64

NORMAL = np.array([0.0, 0.0, 1.0])

# Any four will do for a mean over colours.
WAVELENGTHS = (450.0, 520.0, 580.0, 640.0)


@dataclass(frozen=True)
class Curves:
    """Curves of one surface in one picture."""

    surface: str
    """Its name in the scene."""
    picture: str
    """Which one, as in `comparison.Comparison.images`."""
    plugin: str
    """What the surface is there: `phong`, `roughplastic`, ..."""
    lobes: tuple[tuple[tuple[float, float], ...], ...]
    """For each of `LOBE_ANGLES`: (outgoing angle in degrees, f cos(theta_o) in 1/sr), positive on the mirror's side."""
    albedos: tuple[float, ...]
    """For each of `ALBEDO_ANGLES`: share of the incoming light that is reflected."""


def measure(bsdf, surface: str, picture: str, plugin: str, width: float) -> Curves:
    """All curves of `bsdf`; `width` is the angle in radians within which its highlight needs finer steps."""
    lobes = tuple(tuple(lobe(bsdf, angle, width)) for angle in LOBE_ANGLES)
    return Curves(surface, picture, plugin, lobes, tuple(albedo(bsdf, angle) for angle in ALBEDO_ANGLES))


def lobe(bsdf: "mi.BSDF", incidence: float, width: float = 0.1) -> list[tuple[float, float]]:
    """(angle in degrees, f cos(theta_o) in 1/sr) over the half circle in the plane of incidence.

    `incidence`: angle of the light or viewer to the normal, in degrees; outgoing angles are positive on the mirror's
    side. `width`: angle in radians within which the highlight needs finer steps. Colours are averaged.
    """
    near = incidence + np.degrees(width) * np.linspace(-4, 4, 81)
    angles = np.unique(np.concatenate([np.arange(-89.0, 90.0, 2.0), near[np.abs(near) < 89.9]]).round(4))
    turned = np.radians(angles)
    wo = np.stack([np.sin(turned), np.zeros_like(turned), np.cos(turned)], axis=-1)
    return list(zip(angles.tolist(), values(bsdf, _toward(incidence), wo).tolist(), strict=True))


def albedo(bsdf: "mi.BSDF", incidence: float) -> float:
    """Integral of f cos(theta_o) over the hemisphere, for light or viewer at `incidence` degrees; a perfect mirror is
    not in it.

    At fixed points, so the same each time; scalar variants take fewer. Source: the balance heuristic of Veach and
    Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", 1995.
    """
    wo, density = _points(incidence, POINTS if dr.is_jit_v(mi.Float) else SCALAR_POINTS)
    return float(np.sum(values(bsdf, _toward(incidence), wo) / density))


def values(bsdf, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """f cos(theta_o) for one `wi` and many `wo`, (n, 3) in the shading frame; the mean over the colours, (n,)."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(*map(float, wi))
    si.uv = mi.Point2f(0.5)
    if mi.is_spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(*WAVELENGTHS)

    def evaluate(wo):
        return dr.mean(mi.unpolarized_spectrum(bsdf.eval(mi.BSDFContext(), si, wo)))

    if dr.is_jit_v(mi.Float):
        return np.array(evaluate(mi.Vector3f(wo.T.astype(np.float32))), np.float64) + np.zeros(len(wo))
    return np.array([evaluate(mi.Vector3f(*map(float, v))) for v in wo], np.float64)


def _toward(incidence: float) -> np.ndarray:
    angle = np.radians(incidence)
    return np.array([-np.sin(angle), 0.0, np.cos(angle)])


@cache
def _points(incidence: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Fixed directions above the surface, and how many of them fall on a unit of solid angle there.

    They are drawn from the hemisphere and from cosine-power lobes of every width, about the mirror direction and by
    half vectors, `n` from each. A point is weighted by the sum of all densities (the balance heuristic), so that
    each highlight is integrated by the lobe that fits it.
    """
    wi, mirror = _toward(incidence), _toward(incidence) * [-1, -1, 1]
    u, turn = (np.arange(n) + 0.5) / n, np.arange(n) * 0.6180339887498949 % 1
    drawn = [_cos_power(u, turn, 0.0)]
    for p in RUNGS:
        v = _cos_power(u, turn, p)
        # About the mirror direction: half a turn about the axis between it and the normal.
        axis = (mirror + NORMAL) / np.linalg.norm(mirror + NORMAL)
        drawn.append(2 * (v @ axis)[:, None] * axis - v)
        drawn.append(2 * (v @ wi)[:, None] * v - wi)
    wo = np.concatenate(drawn)
    wo = wo[wo[:, 2] > 0]
    length = np.linalg.norm(wi + wo, axis=1)
    cos_r = wo @ mirror
    cos_h = (wi + wo)[:, 2] / length
    density = np.full(len(wo), 1 / (2 * np.pi))
    for p in RUNGS:
        phong, blinn = np.maximum(cos_r, 0) ** p, cos_h**p / (2 * length)
        density += (p + 1) / (2 * np.pi) * (phong + blinn)
    return wo, n * density


def _cos_power(u: np.ndarray, turn: np.ndarray, p: float) -> np.ndarray:
    """Directions about the normal with density (p + 1) / (2 pi) cos^p, from points of the unit square."""
    log_cos = np.log(u) / (p + 1)
    cos, sin = np.exp(log_cos), np.sqrt(-np.expm1(2 * log_cos))
    return np.stack([sin * np.cos(2 * np.pi * turn), sin * np.sin(2 * np.pi * turn), cos], axis=-1)
