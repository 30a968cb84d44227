"""Directional albedo of the lobes: what part of the light from one direction they reflect.

`directional_albedo` integrates, on the host, to ten digits. `Table` answers inside of
kernels, from `albedo.npz`, with an error below 1e-4 of the albedo at normal incidence;
`python -m phong_bsdf.reflection.albedo` makes that file anew.

With theta_i the angle of incidence, both lobes leave integrals over one angle:

Phong. The hemisphere above the surface cuts the lobe about the mirror direction. Turning
it by d theta_i moves the cut along a great circle, on which the lobe is sin(theta_i)^p cos^p,
so the part of the lobe that stays above is 1 - K int_0^theta_i sin^p, K = 1 / B((p+1)/2, 1/2).

Blinn-Phong. In half vectors, d omega_o = 4 (v.h) d omega_h, and at each theta_h the
light is above the surface for |phi_h| < arccos(-cot(theta_i) cot(2 theta_h)).
"""

import itertools
import math
from pathlib import Path

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

__all__ = ["directional_albedo"]

LOBES = ("phong", "blinnphong")

# Nodes of each table, for the angle of incidence and for the exponent.
SIZE = 160
FILE = Path(__file__).with_name("albedo.npz")

# The tables hold 16-bit numbers, in units of 1 / UNIT.
UNIT = 65535

# Further than this many widths 1 / sqrt(p + 1) from its axis a lobe has ended.
WIDTHS = 9

NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


def directional_albedo(lobe: str, cos_theta_i: ArrayLike, p: ArrayLike, *, reflectance: bool = False) -> np.ndarray:
    """Integral of f cos(theta_o) over all wo above the surface.

    For `lobe` `phong` or `blinnphong` with exponent `p` (>= 0) and a scale of 1: ks, or with
    `reflectance` the specular reflectance; `cos_theta_i` in [0, 1]. Arrays are broadcast;
    float64, of their common shape. Relative error below 1e-6, above cos_theta_i = 1e-2 below 1e-10. ValueError for
    other lobes and for values outside of these ranges. Source: derived in docs/albedo.md.
    """
    if lobe not in LOBES:
        raise ValueError(f"directional_albedo: 'lobe' must be one of {', '.join(LOBES)}, got '{lobe}'")
    cos, p = np.broadcast_arrays(np.asarray(cos_theta_i, np.float64), np.asarray(p, np.float64))
    if not (np.all((cos >= 0) & (cos <= 1)) and np.all((p >= 0) & np.isfinite(p))):
        raise ValueError("directional_albedo: 'cos_theta_i' must be in [0, 1] and 'p' finite and >= 0")
    return {"phong": _phong, "blinnphong": _blinnphong}[lobe](cos, p, reflectance)


class Table:
    """The albedo of one lobe in one vocabulary, in kernels and in Python numbers."""

    def __init__(self, lobe: str, reflectance: bool, float_type):
        with np.load(FILE) as file:
            ratios = file[_name(lobe, reflectance)].astype(np.float32) / UNIT
        self.lobe, self.reflectance = lobe, reflectance
        self.jit = dr.is_jit_v(float_type)
        # Dr.Jit finds it here when it freezes a function, if this object's `__dict__` is in its reach.
        self.ratios = float_type(ratios.ravel()) if self.jit else ratios.ravel().tolist()

    def __call__(self, cos_theta_i, p):
        """`directional_albedo`, for cos_theta_i in [0, 1], to 1e-4 of its value at normal incidence."""
        x, y = _coordinates(dr.clip(cos_theta_i, 0, 1), p)
        x, y = x * (SIZE - 1), y * (SIZE - 1)
        column, row = dr.minimum(dr.floor(x), SIZE - 2), dr.minimum(dr.floor(y), SIZE - 2)
        x, y = x - column, y - row
        first = row * SIZE + column
        lower = dr.lerp(self._at(first), self._at(first + 1), x)
        upper = dr.lerp(self._at(first + SIZE), self._at(first + (SIZE + 1)), x)
        value = dr.lerp(lower, upper, y) * _size(self.lobe, self.reflectance, cos_theta_i, p)
        if self.lobe == "phong":
            # Where p = 0 the lobe is 1 behind its axis, too.
            value = dr.select(p == 0, 1 if self.reflectance else 2, value)
        return value

    def _at(self, index):
        if self.jit:
            return dr.gather(type(self.ratios), self.ratios, dr.uint32_array_t(self.ratios)(index))
        return self.ratios[int(index)]


# The table's coordinates, and what its numbers are relative to ------------------------------------------


def _coordinates(cos, p):
    """Elevation and exponent as numbers in [0, 1] in which the albedo is smooth."""
    elevation = dr.asin(cos) * (2 / math.pi)
    sharpness = 0.8 * dr.sqrt(p + 1) + 0.5
    return elevation * (1 + sharpness) / dr.fma(elevation, sharpness, 1), dr.rsqrt(p + 1)


def _size(lobe, reflectance, cos, p):
    """The albedo's order of magnitude."""
    if lobe == "phong" and not reflectance:
        return 2 / (p + 1)
    # cos, or the width of the lobe where that is larger; reflectances of Blinn-Phong go with its square.
    if lobe == "blinnphong" and reflectance:
        return dr.square(cos) + 2.2 / (p + 1)
    projection = dr.sqrt(dr.square(cos) + 0.9 / (p + 1))
    return projection if reflectance else 8 / (p + 2) * projection


def tabulate() -> dict[str, np.ndarray]:
    """The tables' numbers, 16-bit, by their names; rows for exponents, columns for angles."""
    x = np.linspace(0, 1, SIZE)[None, :]
    # For p = 0 what the neighbours of 0 have.
    p = np.maximum(np.maximum(np.linspace(0, 1, SIZE), 1e-7) ** -2 - 1, 1e-12)[:, None]
    sharpness = 0.8 * np.sqrt(p + 1) + 0.5
    cos = np.clip(np.sin(np.pi / 2 * np.minimum(x / (1 + sharpness - x * sharpness), 1)), 0, 1)
    tables = {}
    for lobe in LOBES:
        for reflectance in (False, True):
            size = np.vectorize(_size)(lobe, reflectance, cos, p)
            ratio = directional_albedo(lobe, cos, p, reflectance=reflectance) / size
            tables[_name(lobe, reflectance)] = np.round(UNIT * ratio).astype(np.uint16)
    return tables


def _name(lobe, reflectance):
    return f"{lobe}_{'reflectance' if reflectance else 'coefficient'}"


# Integration --------------------------------------------------------------------------------------------


def _phong(cos, p, reflectance):
    if not reflectance:
        # For p = 0 the lobe is 1 behind its axis, too.
        return 2 / (p + 1) * np.where(p == 0, 1, _part_above(cos, p))
    # n = cos r + sin t splits the cosine; the part along t is a line integral over the cut.
    log_sin = 0.5 * np.log1p(-(np.minimum(cos, 1 - 1e-16) ** 2))
    albedo = cos * _part_above(cos, p + 1) + np.exp((p + 2) * log_sin) * _beta((p + 1) / 2) / (2 * np.pi)
    return np.where(p == 0, 1, albedo)


def _part_above(cos, p):
    """Part of the lobe cos^p about the mirror direction that is above the surface."""
    elevation = np.arcsin(cos)
    end = np.minimum(elevation, WIDTHS / np.sqrt(p + 1))
    lobe = _integrate(lambda x, p: _cos_power(x, p), (0 * end, end / 3, end), p)
    return 0.5 + lobe / _beta((p + 1) / 2)


def _blinnphong(cos, p, reflectance):
    theta_i = np.arccos(cos)
    end = np.minimum((np.pi / 2 + theta_i) / 2, WIDTHS / np.sqrt(p + 1))
    # From here on only some azimuths are above.
    cut = np.minimum((np.pi / 2 - theta_i) / 2, end)
    limits = (0 * end, cut, np.maximum(cut, end / 8), np.maximum(cut, end / 3), end)

    def around(x, cos, theta_i, p):
        """Integral over the azimuth of h at its angle x."""
        sin = np.sin(theta_i)
        with np.errstate(divide="ignore", invalid="ignore"):
            limit = -cos * np.cos(2 * x) / (sin * np.sin(2 * x))
        phi = np.arccos(np.clip(np.where(np.isfinite(limit), limit, -np.inf), -1, 1))
        # v.h = a cos(phi) + b
        a, b = sin * np.sin(x), cos * np.cos(x)
        integral = 2 * a * np.sin(phi) + 2 * b * phi
        if reflectance:
            squared = a * a * (phi + np.sin(phi) * np.cos(phi)) + 4 * a * b * np.sin(phi) + 2 * b * b * phi
            integral = 2 * np.cos(x) * squared - cos * integral
        return 4 * integral * _cos_power(x, p) * np.sin(x)

    integral = _integrate(around, limits, cos, theta_i, p)
    if not reflectance:
        return integral / np.pi
    return integral * (p + 2) * (p + 4) / (8 * np.pi * (np.exp2(-p / 2) + p))


def _integrate(f, limits, *parameters):
    """Sum of the integrals of f(x, *parameters) between neighbouring `limits`, each by Gauss-Legendre."""
    # x = 3 s^2 - 2 s^3 takes the square roots away that f has at its ends.
    s = (NODES + 1) / 2
    x, weights = s * s * (3 - 2 * s), 3 * s * (1 - s) * WEIGHTS
    parameters = [parameter[..., None] for parameter in parameters]
    total = 0
    for a, b in itertools.pairwise(limits):
        width = (b - a)[..., None]
        total = total + np.sum(f(a[..., None] + width * x, *parameters) * weights * width, axis=-1)
    return total


def _cos_power(x, p):
    """cos(x)^p for x in [0, pi/2], accurate for any p."""
    sin = np.sin(x)
    small = np.exp(0.5 * p * np.log1p(-(np.minimum(sin, 0.9) ** 2)))
    return np.where(sin < 0.7, small, np.abs(np.cos(x)) ** p)


def _beta(a):
    """The beta function B(a, 1/2)."""
    exact = np.vectorize(lambda a: math.exp(math.lgamma(a) + math.lgamma(0.5) - math.lgamma(a + 0.5)))
    return np.where(a < 1e5, exact(np.minimum(a, 1e5)), np.sqrt(np.pi / a) * (1 + 1 / (8 * a)))


if __name__ == "__main__":
    np.savez_compressed(FILE, allow_pickle=False, **tabulate())
