"""Directional albedo: the integral against brute force and closed forms, the table against the integral."""

import functools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from phong_bsdf.reflection import albedo, lobes

COMBINATIONS = [(lobe, reflectance) for lobe in albedo.LOBES for reflectance in (False, True)]


@functools.cache
def half_of_the_directions(n):
    """Cosines, their weights, and (n, n) directions: Gauss-Legendre in the cosine, midpoints in azimuth."""
    x, weights = np.polynomial.legendre.leggauss(n)
    cos, phi = (x + 1) / 2, (np.arange(n) + 0.5) / n * math.pi
    sin = np.sqrt(1 - cos**2)
    wo = np.stack(np.broadcast_arrays(sin[:, None] * np.cos(phi), sin[:, None] * np.sin(phi), cos[:, None]), axis=-1)
    return cos, weights, wo


def brute_force(lobe, cos_theta_i, p, reflectance, n=500):
    """The sum over all directions wo; nothing known of lobes or half vectors."""
    cos, weights, wo = half_of_the_directions(n)
    wi = np.array([math.sqrt(1 - cos_theta_i**2), 0, cos_theta_i])
    if lobe == "phong":
        cosine = np.maximum(wo @ (wi * [-1, -1, 1]), 0)
    else:
        h = wi + wo
        cosine = h[..., 2] / np.linalg.norm(h, axis=-1)
    f = cosine**p
    if reflectance:
        f *= cos[:, None] * float(getattr(lobes, f"{lobe}_normalization")(p)) * math.pi
    # Half the azimuths, twice.
    return np.sum(f * weights[:, None] / 2) * 2 * math.pi / n / math.pi


@pytest.mark.parametrize(("lobe", "reflectance"), COMBINATIONS)
@pytest.mark.parametrize("p", (0, 0.5, 3, 40))
def test_integral(lobe, reflectance, p):
    """Agrees with brute force, from normal incidence to grazing."""
    for cos in (1.0, 0.9, 0.5, 0.1, 0.03):
        exact = albedo.directional_albedo(lobe, cos, p, reflectance=reflectance)
        # Brute force sees the kink of max(0, r.v) only to its grid.
        assert exact == pytest.approx(brute_force(lobe, cos, p, reflectance), rel=1e-4)


@pytest.mark.parametrize(
    ("p", "values"), [(1, (1, 0.755409, 0.608998, 0.318310)), (20, (1, 0.707110, 0.500509, 0.088099))]
)
def test_albedo_of_phong(p, values):
    """The contract's numbers at 0, 45, 60 and 90 degrees, and its closed form at 90."""
    cos = np.cos(np.radians([0, 45, 60, 90])).clip(0)
    assert albedo.directional_albedo("phong", cos, p, reflectance=True) == pytest.approx(values, abs=1e-6)
    beta = math.gamma((p + 1) / 2) * math.gamma(1.5) / math.gamma((p + 1) / 2 + 1.5)
    assert albedo.directional_albedo("phong", 0, p, reflectance=True) == pytest.approx((p + 2) / (2 * math.pi) * beta)


@pytest.mark.parametrize("p", (0, 1, 100, 1e4, 1e8))
def test_albedo_at_normal_incidence(p):
    """1 for reflectances, 2 / (p + 1) and 8 (1 - 2^(-p/2 - 1)) / (p + 2) for coefficients."""
    for lobe in albedo.LOBES:
        assert albedo.directional_albedo(lobe, 1, p, reflectance=True) == pytest.approx(1, rel=1e-9)
    assert albedo.directional_albedo("phong", 1, p) == pytest.approx(2 / (p + 1), rel=1e-9)
    assert albedo.directional_albedo("blinnphong", 1, p) == pytest.approx(
        8 * (1 - 2 ** (-p / 2 - 1)) / (p + 2), rel=1e-9
    )


def test_reflectances_conserve_energy():
    """At no angle and no exponent is the albedo of a lobe of reflectance 1 above 1."""
    cos, p = np.linspace(0, 1, 201)[:, None], np.concatenate([[0], np.logspace(-3, 8, 60)])[None]
    for lobe in albedo.LOBES:
        assert albedo.directional_albedo(lobe, cos, p, reflectance=True).max() <= 1 + 1e-9


@pytest.mark.parametrize(("lobe", "reflectance"), COMBINATIONS)
def test_table(lobe, reflectance):
    """Within 1e-4 of the albedo at normal incidence, at random angles and exponents, in arrays and in numbers."""
    rng = np.random.default_rng(3)
    n = 20000
    cos = np.concatenate([rng.random(n), 10 ** rng.uniform(-6, 0, n), [0, 1]]).astype(np.float32)
    p = np.concatenate([10 ** rng.uniform(-3, 8, n), rng.random(n) * 10, [0, 0]]).astype(np.float32)
    table = albedo.Table(lobe, reflectance, mi.Float)
    exact = albedo.directional_albedo(lobe, cos, p, reflectance=reflectance)
    normal = albedo.directional_albedo(lobe, 1, p, reflectance=reflectance)
    computed = table(mi.Float(cos), mi.Float(p)).numpy()
    assert np.abs((computed - exact) / normal).max() < 1e-4
    in_numbers = albedo.Table(lobe, reflectance, float)
    for i in range(0, 2 * n + 2, 997):
        assert in_numbers(float(cos[i]), float(p[i])) == pytest.approx(computed[i], rel=1e-4)


def test_file_is_what_the_integral_gives():
    """`albedo.npz` was made by `tabulate`."""
    with np.load(albedo.FILE) as file:
        tables = albedo.tabulate()
        assert set(file) == set(tables)
        for name in file:
            # The last of 16 bits may differ between mathematics libraries.
            assert np.abs(file[name].astype(int) - tables[name].astype(int)).max() <= 1


@pytest.mark.parametrize(
    "arguments", [("cook", 1, 1), ("phong", 1.1, 1), ("phong", -0.1, 1), ("phong", 1, -1), ("phong", 1, math.inf)]
)
def test_bad_arguments(arguments):
    """Are errors that say what is wanted."""
    with pytest.raises(ValueError, match="directional_albedo: '"):
        albedo.directional_albedo(*arguments)


@pytest.mark.parametrize("vocabulary", ("coefficients", "reflectances"))
@pytest.mark.parametrize("kind", albedo.LOBES)
def test_lobe_is_chosen_by_its_albedo(kind, vocabulary):
    """The share of glossy samples is the lobe's share of what is reflected at this angle."""
    names = {
        "coefficients": ("kd", "ks", "p"),
        "reflectances": ("diffuse_reflectance", "specular_reflectance", "exponent"),
    }
    bsdf = mi.load_dict({"type": kind, **dict(zip(names[vocabulary], (0.3, 0.6, 20.0), strict=True))})
    n = 2**16
    rng = mi.PCG32(n)
    for cos in (1.0, 0.5, 0.1):
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi = mi.Vector3f(math.sqrt(1 - cos**2), 0, cos)
        xi = mi.Point2f(rng.next_float32(), rng.next_float32())
        bs, _ = bsdf.sample(mi.BSDFContext(), si, rng.next_float32(), xi)
        glossy = mi.has_flag(bs.sampled_type, mi.BSDFFlags.GlossyReflection)
        lobe = 0.6 * albedo.directional_albedo(kind, cos, 20, reflectance=vocabulary == "reflectances")
        share = lobe / (lobe + 0.3)
        # Four deviations.
        assert dr.count(glossy)[0] / n == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / n))
