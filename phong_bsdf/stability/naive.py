"""The formulas of `lobes.py` as textbooks write them, by the same names; and a microfacet distribution of Mitsuba."""

from typing import Any

import drjit as dr
import mitsuba as mi

from ..reflection import matching


def phong(wi, wo, p):
    cos = dr.maximum(dr.dot(mi.Vector3f(-wi.x, -wi.y, wi.z), wo), 0)
    return dr.power(cos, p)


def blinnphong(wi, wo, p):
    return dr.power(dr.maximum(dr.normalize(wi + wo).z, 0), p)


def phong_pdf(wi, wo, p):
    cos = dr.dot(mi.Vector3f(-wi.x, -wi.y, wi.z), wo)
    twice = (2 * wi.z * cos < wo.z) & (p > 0)
    return dr.select(twice, 2, 1) * (p + 1) * dr.inv_two_pi * dr.power(dr.maximum(cos, 0), p)


def blinnphong_pdf(wi, wo, p):
    h = dr.normalize(wi + wo)
    twice = 2 * wi.z * (2 * dr.square(h.z) - 1) < wo.z
    return dr.select(twice, 2, 1) * (p + 1) * dr.inv_two_pi * dr.power(dr.maximum(h.z, 0), p) / (4 * dr.dot(wo, h))


def phong_normalization(p):
    return (p + 2) / dr.two_pi


def blinnphong_normalization(p):
    return (p + 2) * (p + 4) / (8 * dr.pi * (dr.power(2, -p / 2) + p))


def sample_phong(wi, p, xi):
    return mi.Frame3f(mi.Vector3f(-wi.x, -wi.y, wi.z)).to_world(_sample_cos_power(p, xi))


def sample_blinnphong(wi, p, xi):
    h = _sample_cos_power(p, xi)
    return h * (2 * dr.dot(wi, h)) - wi


def _sample_cos_power(p, xi):
    cos: Any = dr.power(xi.x, 1 / (p + 1))
    sin = dr.sqrt(1 - dr.square(cos))
    sin_phi, cos_phi = dr.sincos(dr.two_pi * xi.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)


def beckmann(wi, wo, p):
    """The lobe of `roughconductor` at the matched roughness, evaluated as it does."""
    alpha = matching.roughness(p)
    return mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, alpha, alpha, False).eval(dr.normalize(wi + wo))
