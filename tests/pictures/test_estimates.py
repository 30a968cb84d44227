"""Estimates from independent passes: intervals that hold what they promise, bias apart from noise, curves of error."""

import math

import numpy as np
import pytest

from phong_bsdf.pictures import estimates

SHAPE = (10, 12, 3)
TRUTH = np.random.default_rng(0).uniform(0.2, 1, SHAPE)
WEIGHT = 1 / (TRUTH**2 + 0.01)
NOISE = 0.2


def passes(rng, n, bias=0.0, noise=NOISE):
    """Pictures with a relative bias and independent noise."""
    return [TRUTH * (1 + bias) + rng.normal(0, noise, SHAPE) for _ in range(n)]


def laws(bias):
    """Squared bias and variance of such a picture."""
    return float(np.mean(WEIGHT * (bias * TRUTH) ** 2)), float(np.mean(WEIGHT * NOISE**2))


def test_interval_of_a_mean():
    """Student's, by the textbook: mean 3, standard deviation 2, n = 4, t = 3.182."""
    found = estimates.mean([1, 3, 3, 5])
    half = 3.18245 * math.sqrt(8 / 3) / 2
    assert (found.value, found.low, found.high) == pytest.approx((3, 3 - half, 3 + half), rel=1e-5)
    assert estimates.mean([2.0]) == estimates.Estimate(2.0, None, None)


def test_geometric_mean():
    """For what varies by factors: 1 and 100 average to 10, and the interval is positive."""
    found = estimates.geometric_mean([1, 100, 10])
    assert found.value == pytest.approx(10) and 0 < found.low < 10 < found.high


@pytest.mark.slow
@pytest.mark.parametrize("bias", (0.0, 0.1))
def test_intervals_cover_the_truth(bias):
    """In 500 trials 95 % intervals of the error hold the true error in 95 % +- 2 %; the others in at least 93 %."""
    rng = np.random.default_rng(1)
    squared, variance = laws(bias)
    hits = np.zeros(3)
    for _ in range(500):
        p = estimates.products(passes(rng, 5, bias), passes(rng, 8, noise=NOISE / 2), WEIGHT)
        found = (estimates.error(p), estimates.variance(p), estimates.bias(p))
        hits += [e.low <= t <= e.high for e, t in zip(found, (squared + variance, variance, squared), strict=True)]
    error, spread, level = hits / 500
    # 500 trials know a share of 95 % to 1 %: two deviations.
    assert 0.93 <= error <= 0.97 and 0.93 <= spread <= 0.975
    # The jackknife of a product of two means is too wide where the bias is small against the noise.
    assert level >= 0.93


def test_bias_is_told_from_noise():
    """1 % of bias under a variance 15 times its square: found, to a fifth; and none where there is none."""
    rng = np.random.default_rng(2)
    reference = passes(rng, 16, noise=0.01)
    p = estimates.products(passes(rng, 8, 0.01, noise=0.02), reference, WEIGHT)
    found = estimates.bias(p, 0.99)
    assert found.low > 0 and found.low <= laws(0.01)[0] <= found.high
    assert math.sqrt(found.value / np.mean(WEIGHT * TRUTH**2)) == pytest.approx(0.01, rel=0.2)
    assert estimates.bias(estimates.products(passes(rng, 8, noise=0.02), reference, WEIGHT), 0.99).low <= 0


def test_parts_add_up():
    """Error = bias + variance, exactly."""
    rng = np.random.default_rng(3)
    p = estimates.products(passes(rng, 4, 0.1), passes(rng, 5), WEIGHT)
    assert estimates.error(p).value == pytest.approx(estimates.bias(p).value + estimates.variance(p).value, rel=1e-12)
    assert np.mean(estimates.errors(p)) == pytest.approx(estimates.error(p).value, rel=1e-12)


def test_noise_of_the_reference_is_taken_out():
    """Against a reference as noisy as the passes, the error is still that against the truth."""
    rng = np.random.default_rng(4)
    references = passes(rng, 4)
    p = estimates.products(passes(rng, 40), references, WEIGHT)
    variance = laws(0)[1]
    # Of 360 values: the reference's own noise, a quarter of the variance, is known to 7 %.
    assert estimates.error(p).value == pytest.approx(variance, rel=0.05)
    assert estimates.noise(p) == pytest.approx(variance / 4, rel=0.2)


def test_reference_of_one_picture_is_exact():
    """Then the error is the plain mean of w (x - r)^2, and has no noise of its own."""
    rng = np.random.default_rng(5)
    images = passes(rng, 3)
    p = estimates.products(images, [TRUTH], WEIGHT)
    assert estimates.noise(p) == 0
    assert estimates.errors(p) == pytest.approx([np.mean(WEIGHT * (x - TRUTH) ** 2) for x in images])


def test_large_pictures_go_in_parts(monkeypatch):
    """The products do not depend on them."""
    rng = np.random.default_rng(7)
    pictures = passes(rng, 3), passes(rng, 2), WEIGHT
    whole = estimates.products(*pictures)
    monkeypatch.setattr(estimates, "CHUNK", 50)
    parts = estimates.products(*pictures)
    for name in ("xx", "xr", "rr"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), rel=1e-12)


def test_passes_without_noise_have_no_interval_width():
    """Equal pictures: the interval is the value, whatever float64 leaves."""
    p = estimates.products([TRUTH * 1.1] * 4, [TRUTH], 1.0)
    assert estimates.variance(p).value == pytest.approx(0, abs=1e-15)
    found = estimates.error(p)
    assert (found.low, found.high) == pytest.approx((found.value, found.value), rel=1e-9)


@pytest.mark.parametrize(("statistic", "least"), ((estimates.error, 2), (estimates.bias, 3), (estimates.variance, 3)))
def test_too_few_passes_give_no_interval(statistic, least):
    """None, not one that is too narrow."""
    rng = np.random.default_rng(6)
    for n in (1, 2, 3):
        found = statistic(estimates.products(passes(rng, n), passes(rng, 4), WEIGHT))
        assert (found.low is None) == (n < least)


@pytest.mark.parametrize("exponent", (-0.5, -1.0, -1.5))
def test_slope_of_a_power(exponent):
    """Any power of time comes out; points without a logarithm are left out."""
    times = [1, 2, 8, 100]
    errors = [3 * t**exponent for t in times]
    assert estimates.slope(times, errors) == pytest.approx(exponent)
    assert estimates.slope([*times, 1000], [*errors, -1e-9]) == pytest.approx(exponent)
    assert estimates.slope([1, 1], [2, 3]) is None and estimates.slope([1], [1]) is None


def test_error_at_a_time():
    """On a power law: exact between points, none beyond them."""
    times, errors = [1, 4, 16], [8, 2, 0.5]
    assert estimates.error_at(times, errors, 2) == pytest.approx(4)
    assert estimates.error_at(times, errors, 16) == pytest.approx(0.5)
    assert estimates.error_at(times, errors, 0.9) is None and estimates.error_at(times, errors, 17) is None


def test_time_to_an_error():
    """The first time that the curve is there; the first point where that is good enough; none where it never is."""
    times, errors = [1, 4, 16, 64], [8, 2, 3, 0.5]
    assert estimates.time_to(times, errors, 4) == pytest.approx(2)
    assert estimates.time_to(times, errors, 2) == pytest.approx(4)
    assert estimates.time_to(times, errors, 9) == pytest.approx(1)
    assert estimates.time_to(times, errors, 0.4) is None


def test_ends_of_an_interval_keep_their_order():
    """Under a falling function, too."""
    assert estimates.Estimate(2, 1, 4).map(lambda x: 1 / x) == estimates.Estimate(0.5, 0.25, 1)
