"""The cosine-power lobes of Phong and Blinn-Phong: value, density, sampling, normalisation.

Directions are in the local shading frame (n = +z), `wi` toward the viewer and `wo`
toward the light. The light is above the surface, and so is the viewer, but for the values
of the lobes, which the course convention also asks for from below the horizon; the caller
masks everything else. With theta
the angle between the lobe's axis and the direction compared with it (r and v for Phong,
n and h for Blinn-Phong), a lobe is cos(theta)^p.

Numerical stability. A float32 cosine near 1 has lost its angle: at p = 1e6,
`power(dot, p)` is wrong by 15 %. So the cosine is never formed. The square of the
tangent comes from the transverse part of a vector, which keeps its relative precision
however small it is, and

    cos(theta)^p = exp(-p/2 log1p(tan(theta)^2)).

All functions work on Dr.Jit arrays and on Python floats, and are differentiable
with finite derivatives everywhere.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr

# Below this, a cosine is treated as this: tan(theta)^2 and its derivatives stay finite in float32.
TINY = 1e-15

# The same for |wi + wo|, of which the density has the inverse: 1e-9 is far closer to opposite than
# float32 directions can be.
SHORTEST = 1e-9

# A unit of length in which no power of 1 / |wi + wo| overflows, nor a derivative; a power of two rounds nothing.
UNIT = 2.0**-15

# log(xi) stays finite at xi = 0; float32's smallest normal number is 1.2e-38.
SMALLEST_XI = 1.2e-38

# 1 / (8 pi) and 1 / (4 pi), each as the sum of two float32 numbers.
INV_8_PI = (0.03978873789310455, 1 / (8 * math.pi) - 0.03978873789310455)
INV_4_PI = (2 * INV_8_PI[0], 2 * INV_8_PI[1])


def log1p(t):
    """log(1 + t) for t >= 0, accurate for tiny t: what the rounding of 1 + t took is added to first order."""
    u, lost = _sum(t, 1)
    return dr.log(u) + lost / u


def expm1(x):
    """exp(x) - 1 for -80 <= x <= 0, accurate for tiny x."""
    return 2 * dr.sinh(0.5 * x) * dr.exp(0.5 * x)


def phong(wi, wo, p):
    """max(0, r.v)^p with r the mirror direction; 1 wherever p = 0."""
    return _value(*_phong_angle(wi, wo), p)


def blinnphong(wi, wo, p):
    """max(0, n.h)^p with h the bisector of wi and wo; 1 wherever p = 0."""
    return _value(*_blinnphong_angle(wi, wo), p)


def either(is_phong, wi, wo, p):
    """`phong` where `is_phong`, else `blinnphong`; the same numbers for less than the price of both."""
    (tan2_r, cos_r), (tan2_h, cos_h) = _phong_angle(wi, wo), _blinnphong_angle(wi, wo)
    return _value(dr.select(is_phong, tan2_r, tan2_h), dr.select(is_phong, cos_r, cos_h), p)


def reflected(lobe, factor, cos_theta_o, diffuse, specular):
    """f cos(theta_o) of a diffuse base and a lobe of value `lobe`; a scale that is None leaves its part out.

    `factor` is None for coefficients, (diffuse cos + specular lobe) / pi, and `reflectance_factor` for
    reflectances, (diffuse / pi + specular c(p) lobe) cos.
    """
    f = 0
    if specular is not None:
        f = specular * lobe if factor is None else specular * lobe * factor
    if diffuse is not None:
        f = f + diffuse * cos_theta_o
    return f * dr.inv_pi


def reflectance_factor(normalization, cos_theta_o):
    """What a lobe of the normalization c(p) is multiplied with in `reflected`."""
    return dr.pi * normalization * cos_theta_o


def phong_pdf(wi, wo, p):
    """Density per solid angle of `sample_phong`: (p + 1) / (2 pi) (r.v)^p, twice that where samples are mirrored to."""
    tan2, cos = _phong_angle(wi, wo)
    # The mirror image of wo across the lobe's axis is below the surface.
    twice = (2 * wi.z * cos < wo.z) & (p > 0)
    x = dr.select(twice, 8, 4) * _cos_power(tan2, p)
    return dr.select((cos > 0) | (p == 0), _over_8_pi(dr.fma(p, x, x)), 0)


def blinnphong_pdf(wi, wo, p):
    """Density per solid angle of `sample_blinnphong`: (p + 1) / (2 pi) (n.h)^p / (4 wo.h), or twice that."""
    # For unit wi and wo, 2 wo.h = |h| with h = wi + wo, here in multiples of UNIT.
    h, h_lost = _sum(wi / UNIT, wo / UNIT)
    z = dr.maximum(h.z, SHORTEST / UNIT)
    y2, z2 = dr.square(h.y), dr.square(z)
    length2, lost = _sum(z2, dr.fma(h.x, h.x, y2))
    rcp = dr.rsqrt(length2)
    # How far rcp is from 1 / |h|. Rounding errors have no derivative.
    longer = 2 * _imbalance(wi, wo, h)
    lost += 2 * dr.dot(h, h_lost) + dr.fma(h.y, h.y, -y2) + dr.fma(z, z, -z2) - dr.square(longer)
    length = length2 * rcp
    short = dr.detach(dr.fma(-length, rcp, 1) - dr.fma(length2, rcp, -length) * rcp - lost * dr.square(rcp))
    # The product of the lengths of wi and wo, unit only up to rounding, is 1 - excess.
    excess = longer * UNIT + dr.fma(-wi.x, wi.x, dr.fma(-wi.y, wi.y, dr.fma(-wi.z, wi.z, 1)))
    short -= excess
    # Five factors in a row, each rounded, would be too many: each product keeps what its rounding took.
    rcp = rcp / UNIT
    scale = _product((rcp, 0.5 * short * rcp), INV_4_PI)
    scale, lost = _product(scale, _sum(p, 1))
    lobe = _cos_power(_blinnphong_angle(wi, wo)[0], p)
    # The light that belongs to the mirror image of h across the normal is below the surface.
    twice = 2 * wi.z * (2 * z2 - length2) < wo.z * length2
    return dr.select(twice, 2, 1) * dr.fma(lobe, scale, lobe * lost)


def sample_phong(wi, p, xi):
    """Direction `wo` from the lobe about the mirror direction of `wi`, for p = 0 about n; `xi` in the unit square.

    None is below the surface: those that would be are mirrored across the lobe's axis.
    """
    v = _sample_cos_power(type(wi), p, xi)
    # The reflection that takes +z to r. The lobe is symmetric about its axis, so it serves as a rotation.
    axis = type(wi)(-wi.x, -wi.y, 1 + wi.z)
    wo = _mirror(v, axis)
    wo = dr.select(wo.z < 0, _mirror(_across(v, wi), axis), wo)
    # Near the normal, and by a rounding, it can still be below, by 1e-9.
    wo.z = dr.abs(wo.z)
    return dr.select(p == 0, v, wo)


def sample_blinnphong(wi, p, xi):
    """Direction `wo`: `wi` mirrored about a half vector drawn from the lobe; `xi` in the unit square.

    Where `wo` would be below the surface, the half vector is mirrored across the normal. That helps up to theta_h = 45
    degrees; beyond, `wo` can be below.
    """
    h = _sample_cos_power(type(wi), p, xi)
    wo = _mirror(wi, h)
    return dr.select(wo.z < 0, _mirror(wi, _across(h, wi)), wo)


def phong_normalization(p):
    """c(p) = (p + 2) / (2 pi): gives the lobe times cos(theta_o) albedo 1 at normal incidence."""
    return 4 * _over_8_pi(p + 2)


def blinnphong_normalization(p):
    """c(p) = (p + 2)(p + 4) / (8 pi (2^(-p/2) + p)), exact; albedo 1 at normal incidence."""
    # With m = 2^(-p/2) - 1, division by 1 + p + m gives 8 pi c = 5 + p - m + (3 - 4 m + m^2) / (1 + p + m):
    # no product that could overflow, and the roundings of small terms only.
    m = expm1(dr.maximum(-0.5 * math.log(2) * p, -80))
    return _over_8_pi(5 + ((p - m) + dr.fma(m, m - 4, 3) / (1 + (p + m))))


@dataclass(frozen=True)
class Lobe:
    """One lobe's functions."""

    value: Callable
    pdf: Callable
    sample: Callable
    normalization: Callable


LOBES = {
    "phong": Lobe(phong, phong_pdf, sample_phong, phong_normalization),
    "blinnphong": Lobe(blinnphong, blinnphong_pdf, sample_blinnphong, blinnphong_normalization),
}


def _phong_angle(wi, wo):
    """tan(theta)^2 and cos(theta), up to a positive factor, between the mirror direction of wi and wo."""
    # |r x wo| and r.wo with r = (-wi.x, -wi.y, wi.z). The fused operations keep
    # small differences of products to the last digit.
    x = _sum_of_products(wi.y, wo.z, wi.z, wo.y)
    y = _sum_of_products(wi.z, wo.x, wi.x, wo.z)
    z = _sum_of_products(wi.y, wo.x, -wi.x, wo.y)
    # r.wo with what its roundings took: near a right angle that decides on which side wo is.
    a, b, c = wi.x * wo.x, wi.y * wo.y, wi.z * wo.z
    across, lost = _sum(a, b)
    cos, lost_too = _sum(c, -across)
    lost += dr.fma(wi.x, wo.x, -a) + dr.fma(wi.y, wo.y, -b)
    cos += lost_too + dr.fma(wi.z, wo.z, -c) - lost
    inv_cos = 1 / dr.maximum(cos, TINY)
    return _squared_norm(v * inv_cos for v in (x, y, z)), cos


def _blinnphong_angle(wi, wo):
    """tan(theta)^2 and cos(theta), up to a positive factor, between the normal and the bisector of wi and wo."""
    # Directions are unit only up to rounding, so the bisector is wi |wo| + wo |wi|. Near opposite horizons its sums
    # would lose everything, so its part across the normal is split: with s the sines to the normal, one is
    # s_i |wo| - s_o |wi|, where lengths drop out, and the other that of azimuths that are not opposite.
    s2_i, s2_o = (dr.fma(v.x, v.x, dr.square(v.y)) for v in (wi, wo))
    z2_i, z2_o = dr.square(wi.z), dr.square(wo.z)
    s_i, s_o = (dr.sqrt(dr.maximum(s2, SHORTEST**2)) for s2 in (s2_i, s2_o))
    # |v| = (1 + |v|^2) / 2 for lengths of almost 1.
    length_i, length_o = dr.fma(0.5, s2_i + z2_i, 0.5), dr.fma(0.5, s2_o + z2_o, 0.5)
    cos = dr.fma(wi.z, length_o, wo.z * length_i)
    inv_z = 1 / dr.maximum(cos, TINY)
    # s_i^2 |wo|^2 - s_o^2 |wi|^2 from sums and differences of the directions, which are exact where it is small.
    h, d = wi + wo, wi - wo
    squares = dr.fma(dr.fma(h.x, d.x, h.y * d.y), z2_i + z2_o, -h.z * d.z * (s2_i + s2_o))
    unequal = squares / (2 * dr.fma(s_i, length_o, s_o * length_i)) * inv_z
    # s_i s_o + wi.wo across the normal; by the cross product where that cancels.
    sines, dot = s_i * s_o, dr.fma(wi.x, wo.x, wi.y * wo.y)
    cross = _sum_of_products(wi.x, wo.y, -wi.y, wo.x) * inv_z
    opposite = dot < 0
    both = dr.maximum(sines - dot, SHORTEST**2)
    not_opposite = dr.select(opposite, cross, (sines + dot) * inv_z) * dr.select(opposite, cross / both, inv_z)
    return dr.fma(unequal, unequal, 2 * length_i * length_o * not_opposite), cos


def _imbalance(wi, wo, h):
    """(|wi| - |wo|) / (|wi| + |wo|) for vectors of a length of almost 1, whose sum is h."""
    return 0.5 * dr.dot(wi - wo, h) / (dr.squared_norm(wi) + dr.squared_norm(wo))


def _over_8_pi(x):
    return dr.fma(x, INV_8_PI[0], x * INV_8_PI[1])


def _value(tan2, cos, p):
    return dr.select((cos > 0) | (p == 0), _cos_power(tan2, p), 0)


def _cos_power(tan2, p):
    return dr.exp(-0.5 * p * log1p(tan2))


def _sum_of_products(a, b, c, d):
    """a b + c d, with one rounding of c d made good: accurate also where the terms cancel."""
    cd = c * d
    return dr.fma(a, b, cd) + dr.fma(c, d, -cd)


def _mirror(v, axis):
    """`v` turned by 180 degrees about `axis`."""
    return axis * (2 * dr.dot(v, axis) / dr.squared_norm(axis)) - v


def _across(v, wi):
    """`v` mirrored in the plane through the normal that is perpendicular to the plane of incidence of `wi`."""
    # Along the normal there is no such plane, and no need of one: there `v` stays.
    across = dr.fma(wi.x, wi.x, dr.square(wi.y))
    scale = 2 * dr.fma(v.x, wi.x, v.y * wi.y) / dr.select(across > SHORTEST**2, across, math.inf)
    return type(v)(dr.fma(-scale, wi.x, v.x), dr.fma(-scale, wi.y, v.y), v.z)


def _squared_norm(components):
    """Sum of squares; of ratios rather than a ratio of sums, which would not have finite derivatives everywhere."""
    total = 0
    for x in components:
        total = dr.fma(x, x, total)
    return total


def _sum(a, b):
    """a + b, and what its rounding took."""
    total = a + b
    from_b = total - a
    return total, (a - (total - from_b)) + (b - from_b)


def _product(a, b):
    """Product of two numbers that are pairs: a value, and what roundings took from it."""
    product = a[0] * b[0]
    return product, dr.fma(a[0], b[0], -product) + dr.fma(a[0], b[1], a[1] * b[0])


def _sample_cos_power(vector, p, xi):
    """Unit vector about +z with density (p + 1) / (2 pi) cos(theta)^p."""
    # cos = xi^(1 / (p + 1)); sin^2 = 1 - cos^2 = -expm1(2 log cos), without the cancellation.
    log_cos = dr.log(dr.maximum(xi.x, SMALLEST_XI)) / (p + 1)
    cos = dr.exp(log_cos)
    sin = dr.safe_sqrt(2 * dr.sinh(-log_cos) * cos)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * xi.y)
    return vector(sin * cos_phi, sin * sin_phi, cos)
