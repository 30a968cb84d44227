"""What a BSDF reflects, as curves: lobes in the plane of incidence, albedo."""

import math

import mitsuba as mi
import numpy as np
import pytest

from phong_bsdf.reflection import curves, matching


def blinn(lobe, p, **more):
    """A lobe with scales that differ in every number."""
    return matching.Lobe(lobe, (0.6, 0.3, 0.1), (0.2, 0.3, 0.4), p, **more)


@pytest.mark.parametrize("p", (0, 1, 10, 100, 1e4, 1e6))
@pytest.mark.parametrize("lobe", ("phong", "blinnphong"))
def test_albedo_at_normal_incidence(lobe, p):
    """kd plus the closed form of the lobe, for any width; to a thousandth."""
    bsdf = mi.load_dict({"type": lobe, "kd": 0.25, "ks": 0.5, "p": float(p)})
    wanted = 0.25 + 0.5 * matching.Lobe(lobe, (1,) * 3, (1,) * 3, p).unit_albedo
    assert curves.albedo(bsdf, 0) == pytest.approx(wanted, rel=1e-3)


def test_albedo_of_phong_at_grazing_incidence():
    """At p = 1, 60 degrees, by another integration: the lobe's cosine over the hemisphere of wo."""
    cos, sin = 0.5, math.sqrt(0.75)
    theta, phi = np.meshgrid((np.arange(1000) + 0.5) * math.pi / 2000, (np.arange(1000) + 0.5) * math.pi / 1000)
    r = np.sin(theta) * np.cos(phi) * sin + np.cos(theta) * cos
    wanted = np.sum(np.maximum(r, 0) * np.sin(theta)) * (math.pi / 2000) * (2 * math.pi / 1000) / math.pi
    bsdf = mi.load_dict({"type": "phong", "kd": 0.0, "ks": 1.0, "p": 1.0})
    assert curves.albedo(bsdf, 60) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("alpha", (0.3, 0.01, 0.001))
def test_albedo_of_a_mirror_like_conductor(alpha):
    """Without Fresnel loss a conductor reflects everything, however narrow its highlight is."""
    bsdf = mi.load_dict({"type": "roughconductor", "material": "none", "alpha": alpha})
    assert curves.albedo(bsdf, 30) == pytest.approx(1, rel=0.02 if alpha > 0.1 else 2e-3)


def test_albedo_in_a_scalar_variant():
    """Fewer points, evaluated one by one: to two percent."""
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "phong", "kd": 0.2, "ks": 1.0, "p": 100.0})
    assert curves.albedo(bsdf, 0) == pytest.approx(0.2 + 2 / 101, rel=0.02)


def test_lobe_in_the_plane_of_incidence():
    """f cos = (kd cos + ks (r.v)^p) / pi; the mirror direction lies at the angle of incidence."""
    bsdf = mi.load_dict({"type": "phong", "kd": 0.5, "ks": 0.3, "p": 1e4})
    points = dict(curves.lobe(bsdf, 30, width=0.02))
    assert points[30.0] == pytest.approx((0.5 * math.cos(math.radians(30)) + 0.3) / math.pi, rel=1e-4)
    assert points[-31.0] == pytest.approx(0.5 * math.cos(math.radians(31)) / math.pi, rel=1e-4)
