"""The lobes against mpmath, at the same float32 inputs."""

import drjit as dr
import mitsuba as mi
import mpmath as mp
import numpy as np
import pytest

from phong_bsdf import lobes

U = 2.0**-24
EXPONENTS = (0, 0.3, 1, 30, 1e3, 1e4, 1e6, 1e8)
LOBES = ("phong", "blinnphong")


def directions(rng, n):
    """Unit vectors above the horizon, half of them spread over seven decades of grazing cosines."""
    cos = np.where(rng.random(n) < 0.5, rng.random(n), 10 ** rng.uniform(-7, 0, n))
    phi = 2 * np.pi * rng.random(n)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def around(rng, axis, p):
    """Directions about `axis` at which cos^p is 1 down to 1e-30."""
    n = len(axis)
    log = -np.log(10) * rng.uniform(0, 30, n) * (rng.random(n) < 0.9) / max(p, 1e-3)
    cos, sin, phi = np.exp(log), np.sqrt(-np.expm1(2 * log)), 2 * np.pi * rng.random(n)
    other = np.where(np.abs(axis[:, :1]) > 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]])
    s = np.cross(axis, other)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    t = np.cross(axis, s)
    return cos[:, None] * axis + sin[:, None] * (np.cos(phi)[:, None] * s + np.sin(phi)[:, None] * t)


def pairs(lobe, p, seed, n=2000):
    """Float32 pairs (wi, wo) everywhere and within the lobe, some of them 1e-6 off unit length."""
    rng = np.random.default_rng(seed)
    wi = directions(rng, n)
    if lobe == "phong":
        wo = around(rng, wi * [-1, -1, 1], p)
    else:
        h = around(rng, np.tile([0.0, 0, 1], (n, 1)), p)
        wo = 2 * np.sum(wi * h, axis=1, keepdims=True) * h - wi
    wo = np.where(rng.random((n, 1)) < 0.3, directions(rng, n), wo)
    wo *= 1 + np.where(rng.random((n, 1)) < 0.3, rng.uniform(-1e-6, 1e-6, (n, 1)), 0)
    wi, wo = wi.astype(np.float32), wo.astype(np.float32)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    return wi[above], wo[above]


def exact(lobe, wi, wo, p):
    """Value and condition number of the lobe, the directions normalised exactly."""
    a, b = (mp.matrix([mp.mpf(float(x)) for x in v]) for v in (wi, wo))
    a, b = a / mp.norm(a), b / mp.norm(b)
    if lobe == "phong":
        r = mp.matrix([-a[0], -a[1], a[2]])
        cos = sum(r[i] * b[i] for i in range(3))
        if cos <= 0:
            # At a right angle the condition number is infinite; beyond, the lobe is exactly 0 (1 for p = 0).
            return mp.mpf(p == 0), mp.mpf(0) if cos < -1e-6 else mp.inf
        sin = mp.norm(mp.matrix([r[i - 2] * b[i - 1] - r[i - 1] * b[i - 2] for i in range(3)]))
        return cos**p, p * sin / cos
    h = a + b
    cos = h[2] / mp.norm(h)
    tan = mp.sqrt(h[0] ** 2 + h[1] ** 2) / h[2]
    return cos**p, p * tan / (mp.norm(h) / 2)


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("lobe", LOBES)
def test_value_is_as_exact_as_its_condition_allows(lobe, p):
    """The relative error is at most 3 u (1 + kappa) wherever the value exceeds 1e-30."""
    wi, wo = pairs(lobe, p, seed=1)
    values = getattr(lobes, lobe)(mi.Vector3f(wi.T), mi.Vector3f(wo.T), mi.Float(p)).numpy()
    assert np.all(np.isfinite(values)) and np.all((values >= 0) & (values <= 1 + U))
    worst = 0
    with mp.workdps(40):
        for value, v, w in zip(values, wi, wo, strict=True):
            true, kappa = exact(lobe, v, w, p)
            # Beyond kappa = 1e-3 / u the bound has lost its meaning as a first-order one.
            if kappa * U > 1e-3:
                continue
            if true > 1e-30:
                worst = max(worst, abs(mp.mpf(float(value)) / true - 1) / (U * (1 + kappa)))
            else:
                assert value <= 1.01e-30
    assert worst <= 3


@pytest.mark.parametrize("lobe", LOBES)
def test_lobe_is_one_where_the_exponent_is_zero(lobe):
    """0^0 = 1: with p = 0 the lobe is 1 wherever both cosines are positive, also where r.v is negative."""
    rng = np.random.default_rng(2)
    wi, wo = (mi.Vector3f(directions(rng, 1000).astype(np.float32).T) for _ in range(2))
    assert dr.all(getattr(lobes, lobe)(wi, wo, mi.Float(0)) == 1)


@pytest.mark.parametrize("lobe", LOBES)
def test_extreme_directions_give_numbers(lobe):
    """At normal incidence, at opposite horizons and with denormal cosines the lobe and its density are finite."""
    wi = mi.Vector3f([0, 1, 1, 1e-30, 1], [0, 0, 0, 0, 0], [1, 1e-7, 1e-40, 1, 1e-45])
    wo = mi.Vector3f([0, -1, -1, 0, 1], [0, 0, 1e-30, 1e-30, 0], [1, 1e-7, 1e-40, 1, 1e-45])
    for p in (0, 1, 1e8, 3e38):
        for function in (getattr(lobes, lobe), getattr(lobes, f"{lobe}_pdf")):
            assert dr.all(dr.isfinite(function(wi, wo, mi.Float(p))))
    assert getattr(lobes, lobe)(wi, wo, mi.Float(1e8))[0] == 1


@pytest.mark.parametrize("p", (0, 1, 30, 1e4, 1e8))
@pytest.mark.parametrize("lobe", LOBES)
def test_sampled_angles_follow_the_distribution(lobe, p):
    """The angle of a sample has the CDF 1 - cos^(p + 1) to float32 precision, xi = 0 and xi -> 1 included."""
    xi = np.array([0, 1e-30, 1e-6, 0.25, 0.5, 0.9, 1 - 2**-24], np.float32)
    wi = mi.Vector3f(0, 0, 1)
    wo = getattr(lobes, f"sample_{lobe}")(wi, mi.Float(p), mi.Point2f(mi.Float(xi), 0.125))
    sin = dr.sqrt(dr.square(wo.x) + dr.square(wo.y)).numpy()
    for s, z, x in zip(sin, wo.z.numpy(), xi, strict=True):
        cos = mp.mpf(float(max(x, np.float32(1.2e-38)))) ** (mp.mpf(1) / (p + 1))
        theta = mp.acos(cos) * (1 if lobe == "phong" else 2)
        # log, exp and sinh of float32 are off by an ulp or two each.
        assert float(s) == pytest.approx(float(mp.sin(theta)), rel=2e-6, abs=1e-7)
        assert float(z) == pytest.approx(float(mp.cos(theta)), rel=2e-6, abs=1e-6)


@pytest.mark.parametrize(("p", "c"), [(1, 0.349616), (10, 0.666368), (30, 1.443003), (100, 4.220789)])
def test_blinnphong_normalization_is_exact(p, c):
    """The constants of the contract; the popular (p + 8) / (8 pi) would be up to 7.5 % larger."""
    assert lobes.blinnphong_normalization(mi.Float(p))[0] == pytest.approx(c, rel=2e-6)


def test_normalizations_do_not_overflow():
    """Up to the largest float32 exponent."""
    p = mi.Float(3e38)
    assert dr.all(dr.isfinite(lobes.phong_normalization(p)) & dr.isfinite(lobes.blinnphong_normalization(p)))


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("lobe", LOBES)
def test_derivatives_are_finite(lobe, p):
    """With respect to both directions and the exponent, everywhere."""
    wi, wo = pairs(lobe, p, seed=3)
    extreme = np.array([[0, 0, 1], [1, 0, 1e-7], [1, 0, 1e-40]], np.float32)
    wi = mi.Vector3f(np.concatenate([wi, extreme]).T)
    wo = mi.Vector3f(np.concatenate([wo, extreme * [-1, 1, 1]]).T.astype(np.float32))
    exponent = mi.Float(p)
    for function in (getattr(lobes, lobe), getattr(lobes, f"{lobe}_pdf")):
        dr.enable_grad(wi, wo, exponent)
        dr.backward(dr.sum(function(wi, wo, exponent)))
        for x in (wi, wo, exponent):
            assert dr.all(dr.isfinite(dr.grad(x)), axis=None)
            dr.disable_grad(x)
