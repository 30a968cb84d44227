"""The cosine-power lobes of Phong and Blinn-Phong: value, density, sampling, normalisation.

Directions are in the local shading frame (n = +z), `wi` toward the viewer and `wo`
toward the light, both above the surface; the caller masks everything else. With theta
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

import drjit as dr

# Below this, a cosine is treated as this: tan(theta)^2 and its derivatives stay finite
# in float32. There tan(theta) > 1e8: the condition number leaves no digit to be lost.
TINY = 1e-9

# Densities are capped here: a float32 exponent of 1e38 would otherwise give infinity.
LARGEST = 1e38

# log(xi) stays finite at xi = 0; float32's smallest normal number is 1.2e-38.
SMALLEST_XI = 1.2e-38

# 1 / (8 pi) as the sum of two float32 numbers.
INV_8_PI = (0.03978873789310455, 1 / (8 * math.pi) - 0.03978873789310455)


def log1p(t):
    """log(1 + t) for t >= 0, accurate for tiny t (Kahan's correction of the rounded sum 1 + t)."""
    u = 1 + t
    lost = u == 1
    return dr.select(lost, t, dr.log(u) * t / dr.select(lost, 1, u - 1))


def expm1(x):
    """exp(x) - 1 for -80 <= x <= 0, accurate for tiny x."""
    return 2 * dr.sinh(0.5 * x) * dr.exp(0.5 * x)


def phong(wi, wo, p):
    """max(0, r.v)^p with r the mirror direction; 1 wherever p = 0."""
    tan2, cos = _phong_angle(wi, wo)
    return dr.select((cos > 0) | (p == 0), _cos_power(tan2, p), 0)


def blinnphong(wi, wo, p):
    """max(0, n.h)^p with h the bisector of wi and wo."""
    tan2, _ = _blinnphong_angle(wi, wo)
    return _cos_power(tan2, p)


def phong_pdf(wi, wo, p):
    """Density per solid angle of `sample_phong`: (p + 1) / (2 pi) (r.v)^p."""
    tan2, cos = _phong_angle(wi, wo)
    # Samples reach a right angle from the axis and no further, also for p = 0.
    x = 4 * _cos_power(tan2, p)
    return dr.select(cos > 0, _over_8_pi(dr.minimum(dr.fma(p, x, x), LARGEST)), 0)


def blinnphong_pdf(wi, wo, p):
    """Density per solid angle of `sample_blinnphong`: (p + 1) / (2 pi) (n.h)^p / (4 wo.h)."""
    tan2, length = _blinnphong_angle(wi, wo)
    # For unit wi and wo, wo.h = |wi + wo| / 2.
    x = _cos_power(tan2, p) / (0.5 * length)
    return _over_8_pi(dr.minimum(dr.fma(p, x, x), LARGEST))


def sample_phong(wi, p, xi):
    """Direction `wo` about the mirror direction of `wi`, from a point `xi` of the unit square."""
    v = _sample_cos_power(type(wi), p, xi)
    # The reflection that takes +z to r. The lobe is symmetric about its axis, so it serves as a rotation.
    axis = type(wi)(-wi.x, -wi.y, 1 + wi.z)
    return axis * (2 * dr.dot(v, axis) / dr.squared_norm(axis)) - v


def sample_blinnphong(wi, p, xi):
    """Direction `wo`: `wi` mirrored about a half vector drawn from the lobe; `xi` in the unit square."""
    h = _sample_cos_power(type(wi), p, xi)
    return h * (2 * dr.dot(wi, h)) - wi


def phong_normalization(p):
    """c(p) = (p + 2) / (2 pi): gives the lobe times cos(theta_o) albedo 1 at normal incidence."""
    return 4 * _over_8_pi(p + 2)


def blinnphong_normalization(p):
    """c(p) = (p + 2)(p + 4) / (8 pi (2^(-p/2) + p)), exact; albedo 1 at normal incidence."""
    # With m = 2^(-p/2) - 1, division by 1 + p + m gives 8 pi c = 5 + p - m + (3 - 4 m + m^2) / (1 + p + m):
    # no product that could overflow, and the roundings of small terms only.
    m = expm1(dr.maximum(-0.5 * math.log(2) * p, -80))
    return _over_8_pi(5 + ((p - m) + dr.fma(m, m - 4, 3) / (1 + (p + m))))


def phong_albedo_normal(p):
    """Integral of the lobe over the hemisphere of `wo` at normal incidence, over pi."""
    return 2 / (p + 1)


def blinnphong_albedo_normal(p):
    """Integral of the lobe over the hemisphere of `wo` at normal incidence, over pi."""
    # wo stays above the horizon while theta_h < 45 degrees.
    return 8 * (1 - dr.exp2(-0.5 * p - 1)) / (p + 2)


def _phong_angle(wi, wo):
    """tan(theta)^2 and cos(theta), up to a positive factor, between the mirror direction of wi and wo."""
    # |r x wo| and r.wo with r = (-wi.x, -wi.y, wi.z). The fused operations keep
    # small differences of products to the last digit.
    x = _sum_of_products(wi.y, wo.z, wi.z, wo.y)
    y = _sum_of_products(wi.z, wo.x, wi.x, wo.z)
    z = _sum_of_products(wi.y, wo.x, -wi.x, wo.y)
    cos = dr.fma(wi.z, wo.z, -dr.fma(wi.x, wo.x, wi.y * wo.y))
    rcp = 1 / dr.maximum(cos, TINY)
    return dr.square(x * rcp) + dr.square(y * rcp) + dr.square(z * rcp), cos


def _blinnphong_angle(wi, wo):
    """tan(theta)^2 between the normal and the bisector of wi and wo, and the length of the sum of the two."""
    h = wi + wo
    # Directions are unit only up to rounding. The bisector needs equal lengths:
    # to first order, |wi| / |wo| = 1 + (|wi|^2 - |wo|^2) / 2.
    h = dr.fma(wo, 0.5 * dr.dot(wi - wo, h), h)
    z = dr.maximum(h.z, TINY)
    # |h|^2 / |wi|^2 to first order, from 1 - |wi|^2, whose roundings cancel with its terms.
    excess = dr.fma(-wi.x, wi.x, dr.fma(-wi.y, wi.y, dr.fma(-wi.z, wi.z, 1)))
    length2 = dr.fma(h.x, h.x, dr.fma(h.y, h.y, dr.square(z)))
    return dr.square(h.x / z) + dr.square(h.y / z), dr.sqrt(dr.fma(length2, excess, length2))


def _over_8_pi(x):
    return dr.fma(x, INV_8_PI[0], x * INV_8_PI[1])


def _cos_power(tan2, p):
    return dr.exp(-0.5 * p * log1p(tan2))


def _sum_of_products(a, b, c, d):
    """a b + c d, with one rounding of c d made good: accurate also where the terms cancel."""
    cd = c * d
    return dr.fma(a, b, cd) + dr.fma(c, d, -cd)


def _sample_cos_power(vector, p, xi):
    """Unit vector about +z with density (p + 1) / (2 pi) cos(theta)^p."""
    # cos = xi^(1 / (p + 1)); sin^2 = 1 - cos^2 = -expm1(2 log cos), without the cancellation.
    log_cos = dr.log(dr.maximum(xi.x, SMALLEST_XI)) / (p + 1)
    cos = dr.exp(log_cos)
    sin = dr.safe_sqrt(2 * dr.sinh(-log_cos) * cos)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * xi.y)
    return vector(sin * cos_phi, sin * sin_phi, cos)
