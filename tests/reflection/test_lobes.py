"""The lobes against mpmath, at the same float32 inputs (`phong_bsdf.stability` makes them)."""

import math

import drjit as dr
import mitsuba as mi
import mpmath as mp
import numpy as np
import pytest
from scipy import stats

from helpers.mpmath_lobes import by_mpmath, numbered_pairs
from phong_bsdf import stability
from phong_bsdf.reflection import lobes
from phong_bsdf.reflection.parameters import LARGEST_EXPONENT
from phong_bsdf.stability import exact, inputs

U = 2.0**-24
EXPONENTS = (0, 0.3, 1, 30, 1e3, 1e4, 1e6, 1e8)
LOBES = ("phong", "blinnphong")


def function(lobe, quantity):
    return getattr(lobes, lobe if quantity == "value" else f"{lobe}_pdf")


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("quantity", ("value", "pdf"))
@pytest.mark.parametrize("lobe", LOBES)
def test_errors_are_those_of_the_inputs(lobe, quantity, p):
    """Relative error at most C u (1 + kappa) wherever the value exceeds 1e-30, C = 3."""
    wi, wo, numbers = numbered_pairs(lobe, p, seed=1, n=1500)
    values = function(lobe, quantity)(mi.Vector3f(wi.T), mi.Vector3f(wo.T), mi.Float(p)).numpy()
    _, kappa = exact.value_and_pdf(lobe, wi, wo, p)[quantity]
    assert np.all(np.isfinite(values)) and np.all(values >= 0)
    with mp.workdps(40):
        for value, x, k in zip(values, numbers, kappa, strict=True):
            # Beyond kappa = 1e-3 / u the bound has lost its meaning as a first-order one.
            if k * U > 1e-3:
                continue
            true = by_mpmath(lobe, quantity, x)
            if true > 1e-30:
                assert abs(float(value) / true - 1) <= stability.BARS[quantity] * U * (1 + k)
            else:
                assert value <= 1.01e-30


@pytest.mark.parametrize("p", (1, 1e4, 1e8))
@pytest.mark.parametrize("lobe", LOBES)
def test_opposite_horizons(lobe, p):
    """The bar holds down to cosines of 1e-30 at both ends, equal and unequal, for lengths that are off by 1e-6."""
    rng = np.random.default_rng(3)
    n = 1000
    cos = 10 ** rng.uniform(-30, -5, (2, n))
    cos[1] = np.where(rng.random(n) < 0.5, cos[0], cos[1])
    turn = 2 * np.pi * rng.random(n) * (rng.random(n) < 0.5)
    low = [np.stack([np.sqrt(1 - c**2) * np.cos(turn), np.sqrt(1 - c**2) * np.sin(turn), c], -1) for c in cos]
    length = 1 + rng.uniform(-1e-6, 1e-6, (2, n, 1))
    wi, wo = (low[0] * length[0]).astype(np.float32), (low[1] * [-1, -1, 1] * length[1]).astype(np.float32)
    values = function(lobe, "value")(mi.Vector3f(wi.T), mi.Vector3f(wo.T), mi.Float(p)).numpy()
    judged = 0
    with mp.workdps(100):
        for value, v, w in zip(values, wi, wo, strict=True):
            x = [mp.mpf(float(c)) for c in (*v, *w)]
            cos = by_mpmath(lobe, "value", [*x, 1])
            kappa = p * mp.sqrt(abs(1 - cos**2)) / abs(cos)
            if lobe == "blinnphong":
                a, b = (mp.matrix(side) / mp.norm(mp.matrix(side)) for side in (x[:3], x[3:]))
                kappa /= mp.norm(a + b) / 2
            if kappa * U < 1e-2 and cos**p > 1e-30:
                judged += 1
                assert abs(float(value) / float(cos**p) - 1) <= stability.BARS["value"] * U * (1 + float(kappa))
    assert judged > 100


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("quantity", ("value", "pdf"))
@pytest.mark.parametrize("lobe", LOBES)
def test_derivatives(lobe, quantity, p):
    """With respect to wi, wo and p: finite everywhere, and mpmath's where the value exceeds 1e-20."""
    wi, wo, numbers = numbered_pairs(lobe, p, seed=5, n=1000)
    v, w, exponent = mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.full(mi.Float, p, len(wi))
    dr.enable_grad(v, w, exponent)
    dr.backward(function(lobe, quantity)(v, w, exponent))
    computed = np.concatenate([dr.grad(v).numpy(), dr.grad(w).numpy(), dr.grad(exponent).numpy()[None]]).T
    assert np.all(np.isfinite(computed))

    truth, kappa = exact.value_and_pdf(lobe, wi, wo, p)[quantity]
    # max(0, cos)^p has no derivative at p = 0 where cos <= 0; closer to 0 than 1e-9 it counts as 1e-9.
    cos = np.sum(wi * [-1, -1, 1] * wo, axis=1) if lobe == "phong" else 1
    judged = np.flatnonzero((truth > 1e-20) & (kappa * U < 2e-3) & (cos > 1e-6))
    assert len(judged) > 20
    with mp.workdps(50):
        for i in judged[:25]:
            orders = [tuple(int(j == k) for j in range(7)) for k in range(7)]
            true = [float(mp.diff(lambda *x: by_mpmath(lobe, quantity, x), numbers[i], order)) for order in orders]
            # 200 roundings are 1e-5. At the peak, where the derivative vanishes, a rounding of the inputs moves it by
            # the second derivative, of order (p + 1) / cos(theta_d)^2.
            half = 1 if lobe == "phong" else max(np.linalg.norm(wi[i].astype(float) + wo[i]) / 2, 1e-7)
            second = (p + 1) * truth[i] / half**2
            # Along wi and wo the density is constant: terms of the order of the density cancel.
            along = 40 * U * truth[i] / half
            bound = 200 * U * (1 + kappa[i]) * np.abs(true[:6]).max() + 2 * U * second + along + 1e-25
            assert np.abs(computed[i, :6] - true[:6]).max() <= bound
            if (lobe, quantity, p) == ("phong", "pdf", 0):
                continue  # Another sampler serves p = 0.
            # d/dp is a sum of two terms that can cancel: of the lobe, and of the factor p + 1 of the density.
            terms = abs(true[6]) + truth[i] / (p + 1) * (quantity == "pdf")
            assert computed[i, 6] == pytest.approx(true[6], abs=200 * U * (1 + kappa[i]) * terms + 1e-12 * truth[i])


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("lobe", LOBES)
def test_derivatives_are_finite_at_the_edges(lobe, p):
    """At the peak, at normal incidence, at opposite horizons and with denormal cosines."""
    wi = mi.Vector3f([0, 1, 1, 1e-30, 1, 0.6], [0, 0, 0, 0, 0, 0], [1, 1e-7, 1e-40, 1, 1e-45, 0.8])
    wo = mi.Vector3f([0, -1, -1, 0, 1, -0.6], [0, 0, 1e-30, 1e-30, 0, 0], [1, 1e-7, 1e-40, 1, 1e-45, 0.8])
    exponent = dr.full(mi.Float, p, 6)
    for quantity in ("value", "pdf"):
        dr.enable_grad(wi, wo, exponent)
        value = function(lobe, quantity)(wi, wo, exponent)
        dr.backward(value)
        assert dr.all(dr.isfinite(value))
        for x in (wi, wo, exponent):
            assert dr.all(dr.isfinite(dr.grad(x)), axis=None)
            dr.disable_grad(x)


@pytest.mark.parametrize("p", (0, 1, 1e8, LARGEST_EXPONENT))
@pytest.mark.parametrize("lobe", LOBES)
def test_no_infinity_leaves(lobe, p):
    """For any exponent that a BSDF has, value, density, normalisation and samples are numbers."""
    wi, wo = (mi.Vector3f(v.T) for v in inputs.pairs(lobe, p, 4096, np.random.default_rng(2)))
    xi = mi.Point2f([0, 2.0**-24, 0.5, 1 - 2.0**-24], [0, 0.9, 0.2, 1 - 2.0**-24])
    exponent = mi.Float(p)
    assert dr.all(dr.isfinite(function(lobe, "value")(wi, wo, exponent)))
    assert dr.all(dr.isfinite(function(lobe, "pdf")(wi, wo, exponent)))
    assert dr.all(dr.isfinite(getattr(lobes, f"{lobe}_normalization")(exponent)))
    for v in (mi.Vector3f(0, 0, 1), mi.Vector3f(1, 0, 1e-7)):
        assert dr.all(dr.isfinite(getattr(lobes, f"sample_{lobe}")(v, exponent, xi)), axis=None)


@pytest.mark.parametrize("lobe", LOBES)
def test_lobe_is_one_where_the_exponent_is_zero(lobe):
    """0^0 = 1: with p = 0 the lobe is 1 wherever both cosines are positive, also where r.v is negative."""
    wi, wo = (mi.Vector3f(v.T) for v in inputs.pairs(lobe, 0, 1000, np.random.default_rng(2)))
    assert dr.all(function(lobe, "value")(wi, wo, mi.Float(0)) == 1)


@pytest.mark.parametrize("p", (0, 1, 30, 1e4, 1e8))
@pytest.mark.parametrize("lobe", LOBES)
def test_sampled_angles_follow_the_distribution(lobe, p):
    """Kolmogorov-Smirnov: cos(theta)^(p + 1) of the samples is uniform, theta found in float64 from the directions."""
    rng = mi.PCG32(2**16)
    wi = mi.Vector3f(0, 0, 1)
    wo = getattr(lobes, f"sample_{lobe}")(wi, mi.Float(p), mi.Point2f(rng.next_float32(), rng.next_float32()))
    x, y, z = (c.numpy().astype(np.float64) for c in (wo.x, wo.y, wo.z))
    theta = np.arctan2(np.hypot(x, y), z) / (1 if lobe == "phong" else 2)
    uniform = np.exp((p + 1) * np.log(np.maximum(np.cos(theta), 1e-300)))
    if p > 100:
        uniform = np.exp((p + 1) * 0.5 * np.log1p(-(np.sin(theta) ** 2)))
    assert stats.kstest(uniform, "uniform").pvalue > 1e-4


@pytest.mark.parametrize("p", (0, 1, 30, 1e4, 1e8))
@pytest.mark.parametrize("lobe", LOBES)
def test_sampled_quantiles(lobe, p):
    """The angle of a sample is the exact quantile of its xi, xi = 0 and xi -> 1 included."""
    xi = np.array([0, 1e-30, 1e-6, 0.25, 0.5, 0.9, 1 - 2**-24], np.float32)
    wi = mi.Vector3f(0, 0, 1)
    wo = getattr(lobes, f"sample_{lobe}")(wi, mi.Float(p), mi.Point2f(mi.Float(xi), 0.125))
    sines = np.hypot(wo.x.numpy().astype(np.float64), wo.y.numpy())
    for sine, z, x in zip(sines, wo.z.numpy(), xi, strict=True):
        cos = mp.mpf(float(max(x, np.float32(lobes.SMALLEST_XI)))) ** (mp.mpf(1) / (p + 1))
        theta = mp.acos(cos) * (1 if lobe == "phong" else 2)
        # log, exp and sinh of float32 are off by an ulp or two each.
        assert sine == pytest.approx(float(mp.sin(theta)), rel=1e-6, abs=1e-7)
        assert float(z) == pytest.approx(float(mp.cos(theta)), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(("p", "c"), [(1, 0.349616), (10, 0.666368), (30, 1.443003), (100, 4.220789)])
def test_blinnphong_normalization_is_exact(p, c):
    """The constants of the contract; the popular (p + 8) / (8 pi) would be up to 7.5 % larger."""
    assert lobes.blinnphong_normalization(mi.Float(p))[0] == pytest.approx(c, rel=2e-6)


@pytest.mark.parametrize("lobe", LOBES)
def test_normalization_gives_albedo_one(lobe):
    """Times the cosine, the normalised lobe integrates to 1 at normal incidence (float64 quadrature)."""
    for p in (0.0, 0.5, 7.0, 200.0):
        # Nodes in the angle of the lobe, which is half of that of wo for Blinn-Phong.
        x, weights = np.polynomial.legendre.leggauss(400)
        half = 1 if lobe == "phong" else 2
        theta = (x + 1) * math.pi / 4
        f = np.cos(theta / half) ** p * np.cos(theta) * np.sin(theta)
        integral = 2 * math.pi * np.sum(weights * f) * math.pi / 4
        c = getattr(lobes, f"{lobe}_normalization")(mi.Float(p))[0]
        assert c * integral == pytest.approx(1, rel=1e-6)


def corners(n, seed):
    """`wi` at and near the normal and the horizon, exponents and `xi` at and near the ends of their ranges."""
    rng = np.random.default_rng(seed)
    tiny = 10 ** rng.uniform(-40, 0, (6, n))
    pick = rng.integers(0, 3, (4, n))
    sin, cos = tiny[0], np.sqrt(1 - tiny[0] ** 2)
    sin, cos = np.where(pick[0] == 0, (sin, cos), (cos, sin))
    sin = np.where(pick[0] == 2, 0, sin)
    cos = np.where(pick[0] == 2, 1, cos)
    phi = 2 * np.pi * np.where(pick[1] == 0, rng.integers(0, 4, n) / 4, rng.random(n))
    wi = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos]).astype(np.float32)
    p = np.choose(pick[2], (tiny[1], 10 ** rng.uniform(-3, 8, n), rng.choice([0, 1, 1e8], n))).astype(np.float32)
    ends = rng.choice([0, 2.0**-24, 0.5, 1 - 2.0**-24], (2, n))
    xi = np.where(pick[3] == 0, tiny[2:4], np.where(pick[3] == 1, rng.random((2, n)), ends)).astype(np.float32)
    return mi.Vector3f(wi), mi.Float(p), mi.Point2f(np.minimum(xi, np.float32(1 - 2.0**-24)))


@pytest.mark.parametrize("lobe", LOBES)
def test_samples_are_unit_directions(lobe):
    """Also where `wi` is within 1e-7 of the normal and p near 0; none of Phong is below the surface."""
    wi, p, xi = corners(2**20, seed=1)
    wo = np.array(getattr(lobes, f"sample_{lobe}")(wi, p, xi), np.float64)
    # Ten roundings of 6e-8, each of which moves the length by no more.
    assert np.abs(np.linalg.norm(wo, axis=0) - 1).max() < 10 * U
    if lobe == "phong":
        assert wo[2].min() >= 0


def test_half_vectors_up_to_45_degrees_stay_above_the_surface():
    """What `sample_blinnphong` promises, at every corner of its inputs."""
    wi, p, xi = corners(2**20, seed=2)
    wo = lobes.sample_blinnphong(wi, p, xi)
    half = lobes._sample_cos_power(mi.Vector3f, p, xi)
    assert dr.all((half.z < math.sqrt(0.5) + 1e-6) | (wo.z >= 0))


@pytest.mark.parametrize("lobe", LOBES)
def test_derivatives_of_sampled_directions_are_finite(lobe):
    """With respect to `wi`, p and xi, at every corner."""
    wi, p, xi = corners(2**18, seed=3)
    dr.enable_grad(wi, p, xi)
    wo = getattr(lobes, f"sample_{lobe}")(wi, p, xi)
    dr.backward(wo.x + 0.7 * wo.y - 0.3 * wo.z)
    for x in (wi, p, xi):
        assert dr.all(dr.isfinite(dr.grad(x)), axis=None)


@pytest.mark.parametrize("p", (*EXPONENTS, LARGEST_EXPONENT))
@pytest.mark.parametrize("quantity", ("value", "pdf"))
@pytest.mark.parametrize("lobe", LOBES)
def test_derivatives_are_finite_for_every_pair(lobe, quantity, p):
    """Opposite, equal, mirrored and unrelated directions, down to cosines of 1e-40; for any exponent of a BSDF."""
    n = 2**17
    wi, wo = (np.array(corners(n, seed)[0]) for seed in (4, 5))
    kind = np.arange(n) % 4
    near = 10 ** np.random.default_rng(6).uniform(-12, -1, (3, n)) * (np.arange(n) % 3)
    wo = np.select([kind == 0, kind == 1, kind == 2], [wi, wi * [[-1], [-1], [1]] + near, -wi + near], wo)
    wo[2] = np.abs(wo[2])
    wo = (wo / np.linalg.norm(wo, axis=0)).astype(np.float32)
    v, w, exponent = mi.Vector3f(wi), mi.Vector3f(wo), dr.full(mi.Float, p, n)
    dr.enable_grad(v, w, exponent)
    dr.backward(function(lobe, quantity)(v, w, exponent))
    for x in (v, w, exponent):
        assert dr.all(dr.isfinite(dr.grad(x)), axis=None)


@pytest.mark.parametrize("p", (0, 1, 20))
@pytest.mark.parametrize("cos", (1e-1, 1e-2, 1e-3))
def test_derivatives_of_the_density_toward_opposite_horizons(cos, p):
    """Where |wi + wo|, whose inverse the density of Blinn-Phong has, is small: mpmath's, in each component."""
    sin = math.sqrt(1 - cos**2)
    wi = np.array([sin, 0, cos], np.float32)
    sin = math.sqrt(1 - (1.5 * cos) ** 2)
    wo = np.array([-sin * math.cos(0.3 * cos), sin * math.sin(0.3 * cos), 1.5 * cos], np.float32)
    v, w, exponent = mi.Vector3f(wi), mi.Vector3f(wo), mi.Float(p)
    dr.enable_grad(v, w, exponent)
    dr.backward(lobes.blinnphong_pdf(v, w, exponent))
    computed = np.concatenate([np.array(dr.grad(x)).ravel() for x in (v, w, exponent)])
    numbers = [mp.mpf(float(x)) for x in (*wi, *wo)] + [mp.mpf(p)]
    orders = [tuple(int(j == k) for j in range(7)) for k in range(7)]
    with mp.workdps(50):
        true = [float(mp.diff(lambda *x: by_mpmath("blinnphong", "pdf", x), numbers, order)) for order in orders]
    # The sum wi + wo of size 2 cos has lost log2(1 / cos) bits: 100 roundings of what is left.
    assert computed == pytest.approx(true, rel=100 * U / cos, abs=100 * U / cos * np.abs(true).max())
