"""Methods with known laws, made without rendering: bias b, variance v / n, cost c n must come out of a study."""

import math

import numpy as np
import pytest

from phong_bsdf.convergence import study, tradeoff
from phong_bsdf.pictures.store import Pass

SHAPE = (10, 12, 3)
TRUTH = np.random.default_rng(0).uniform(0.2, 1, SHAPE)
WEIGHT = 1 / (TRUTH**2 + 0.01)
LEVELS = (1, 4, 16, 64)


def made(spp, repeat, seconds, warmup=0.0):
    return Pass(spp, 1000 * spp + repeat, repeat, seconds, warmup, "none", "none", "none", "now")


class Synthetic:
    """A method whose pictures are the truth, times 1 + bias, with noise of variance v / n; a sample takes `cost` s."""

    def __init__(self, name, *, bias=0.0, variance=0.04, cost=1e-3, jitter=0.0, seed=0):
        self.name, self.bias, self.variance, self.cost, self.jitter = name, bias, variance, cost, jitter
        self.rng = np.random.default_rng(seed)

    def passes(self, levels=LEVELS, repeats=5):
        for repeat in range(repeats):
            for spp in levels:
                noise = self.rng.normal(0, math.sqrt(self.variance / spp), SHAPE)
                seconds = self.cost * spp * math.exp(self.jitter * self.rng.normal())
                yield made(spp, repeat, seconds), TRUTH * (1 + self.bias) + noise

    def error(self, spp):
        """The true relMSE."""
        return float(np.mean(WEIGHT * ((self.bias * TRUTH) ** 2 + self.variance / spp)))


def reference(variance=1e-5, passes=8, seed=99):
    rng = np.random.default_rng(seed)
    return study.Reference("truth", [TRUTH + rng.normal(0, math.sqrt(variance), SHAPE) for _ in range(passes)])


def analysed(method, ref=None, **options):
    passes = list(method.passes(**options))
    return study.analyse(method.name, passes, ref or reference()), {(p.spp, p.repeat): p.seconds for p, _ in passes}


@pytest.mark.slow
def test_error_intervals_hold_the_true_error():
    """In 500 studies: 95 % +- 2 %."""
    hits = 0
    for seed in range(500):
        method = Synthetic("m", bias=0.05, seed=seed)
        result, _ = analysed(method, reference(passes=4, seed=10**6 + seed), levels=(16,))
        hits += result.levels[0].relmse.low <= method.error(16) <= result.levels[0].relmse.high
    # 500 trials know a share of 95 % to 1 %.
    assert 0.93 <= hits / 500 <= 0.97


@pytest.mark.parametrize("jitter", (0.0, 0.2))
def test_slope_is_minus_one(jitter):
    """Error v / n and cost c n: -1 against time and against samples, within an interval that is not wide."""
    for slope in (lambda r: r.slope, lambda r: r.slope_spp):
        found = slope(analysed(Synthetic("m", jitter=jitter))[0])
        # Times that jitter by 20 % move the medians of three levels by a few per cent of a factor of 16.
        assert found.value == pytest.approx(-1, abs=0.02 if jitter == 0 else 0.1)
    assert found.low <= -1 <= found.high and found.high - found.low < 0.1


def test_fixed_costs_do_not_count_as_slope():
    """Levels at which only the fixed cost is seen are left out of the slope against time."""
    method = Synthetic("m")
    passes = [(made(p.spp, p.repeat, 0.05 + p.seconds), image) for p, image in method.passes((1, 2, 4, 256, 1024))]
    found = study.analyse("m", passes, reference())
    # 0.306 s and 1.074 s for a factor of 4.
    assert found.slope.value == pytest.approx(-math.log(4) / math.log(1.074 / 0.306), abs=0.1)


@pytest.mark.parametrize("variance", (0.01, 0.04))
def test_efficiency(variance):
    """1 / (variance x seconds), whatever the number of samples."""
    found = analysed(Synthetic("m", variance=variance, cost=2e-3))[0].efficiency
    true = 1 / (np.mean(WEIGHT) * variance * 2e-3)
    # 5 passes of 360 values know a variance to 4 %.
    assert found.value == pytest.approx(true, rel=0.15) and found.low <= true <= found.high


def test_planted_bias_of_one_per_cent_is_found():
    """In each of ten studies, and its size with it; and no bias in any of ten without."""
    for seed in range(10):
        biased = analysed(Synthetic("m", bias=0.01, variance=1e-3, seed=seed), reference(1e-6))[0]
        assert biased.verdict == "biased"
        size = math.sqrt(biased.bias.value / np.mean(WEIGHT * TRUTH**2))
        # At 64 samples the noise of a pass is a third of the bias.
        assert size == pytest.approx(0.01, rel=0.15)
        assert analysed(Synthetic("m", variance=1e-3, seed=seed), reference(1e-6))[0].verdict == "unbiased"


def test_noisy_reference_is_no_bias():
    """Where the error reaches the reference's own noise, it still falls as it should."""
    method = Synthetic("m", variance=0.04)
    found, _ = analysed(method, reference(variance=0.005, passes=8))
    assert found.verdict == "unbiased"
    finest = found.levels[-1]
    # The reference's noise, 0.005 / 8, is as large as that of 64 samples.
    assert finest.relmse.low <= method.error(64) <= finest.relmse.high


def test_methods_without_noise():
    """A regular grid: the error falls or levels off; there is no efficiency, and no interval to speak of."""
    pattern = np.random.default_rng(3).normal(0, 1, SHAPE)

    def grid(name, error):
        passes = [(made(n, r, 1e-3 * n), TRUTH + error(n) * pattern) for n in LEVELS for r in range(3)]
        return study.analyse(name, passes, study.Reference("grid", [TRUTH], TRUTH + 1e-6 * pattern, "grid"))

    falling, stuck = grid("falling", lambda n: n**-0.75), grid("stuck", lambda n: 0.1 + 0.1 / n)
    assert (falling.verdict, stuck.verdict) == ("falling", "biased")
    assert falling.slope_spp.value == pytest.approx(-1.5, abs=1e-6)
    assert falling.efficiency is None
    assert falling.levels[0].relmse.high == pytest.approx(falling.levels[0].relmse.low, rel=1e-6)
    assert stuck.bias.value == pytest.approx((0.1 + 0.1 / 64) ** 2 * np.mean(WEIGHT * pattern**2), rel=1e-6)


def test_error_of_the_references_size_is_not_judged():
    """A grid's own error is a bound: below it nothing is called a bias."""
    pattern = np.random.default_rng(3).normal(0, 1, SHAPE)
    passes = [(made(n, r, 1e-3 * n), TRUTH + 0.01 * pattern) for n in LEVELS for r in range(3)]
    ref = study.Reference("grid", [TRUTH], TRUTH + 0.02 * pattern, "grid")
    assert ref.own_error["mse"] == pytest.approx(4e-4 * np.mean(pattern**2))
    assert study.analyse("m", passes, ref).verdict == "reference"


def test_equal_time_and_equal_error():
    """Of two methods with the same noise, one of which is twice as fast, and one that is biased."""
    slow, fast = Synthetic("slow", seed=1), Synthetic("fast", cost=5e-4, seed=2)
    biased = Synthetic("biased", bias=0.3, cost=5e-4, seed=3)
    pairs = [analysed(method) for method in (slow, fast, biased)]
    results, seconds = [result for result, _ in pairs], {result.name: times for result, times in pairs}
    table = tradeoff.equal_time(results)
    assert table.columns and set(table.rows) == {"slow", "fast", "biased"}
    for i, time in enumerate(table.columns):
        for method in (slow, fast):
            cell = table.rows[method.name][i]
            if method.cost * LEVELS[0] <= time <= method.cost * LEVELS[-1]:
                # The error of 5 passes of 360 values is known to 4 %; between levels the law is a straight line.
                assert cell.estimate.value == pytest.approx(method.error(1) * method.cost / time, rel=0.15)
            else:
                assert cell is None
    table = tradeoff.equal_error(results, seconds)
    for i, error in enumerate(table.columns):
        cells = [table.rows[name][i] for name in ("slow", "fast")]
        if None not in cells and not cells[0].at_most:
            assert cells[0].estimate.value == pytest.approx(2 * cells[1].estimate.value, rel=0.2)
        if error < 0.5 * biased.error(10**9):
            assert table.rows["biased"][i] is None
    assert any(cell.at_most for row in table.rows.values() for cell in row if cell)


def test_narrow_tables_have_columns_too():
    """Times and errors with no 1, 2 or 5 between them are compared at less round numbers."""
    results, seconds = [], {}
    for name, cost in (("a", 5.2e-3), ("b", 5.3e-3)):
        method = Synthetic(name, cost=cost, variance=0.05)
        passes = [(made(p.spp, p.repeat, cost * (1 + p.spp / 10)), image) for p, image in method.passes((1, 2))]
        results.append(study.analyse(name, passes, reference()))
        seconds[name] = {(p.spp, p.repeat): p.seconds for p, _ in passes}
    table = tradeoff.equal_time(results)
    assert table.columns and all(0.0053 * 1.1 <= time <= 0.0052 * 1.2 for time in table.columns)
    assert None not in [cell for row in table.rows.values() for cell in row]
    assert tradeoff.equal_error(results, seconds).columns


def test_pixels_that_are_no_numbers_are_counted():
    """No error is formed at that level, and the others stand."""
    passes = list(Synthetic("m").passes())
    passes[1][1][3, 4, 1] = math.nan
    passes[1][1][5, 5] = math.inf
    found = study.analyse("m", passes, reference())
    by_spp = {level.spp: level for level in found.levels}
    assert by_spp[4].nonfinite == 2 and by_spp[4].relmse is None
    assert by_spp[64].nonfinite == 0 and by_spp[64].relmse.value > 0
    assert sum(e.nonfinite for e in found.passes) == 2
    assert found.slope_spp.value == pytest.approx(-1, abs=0.05)


def test_bad_reference_leaves_no_error():
    """A reference with a pixel that is no number is counted, and nothing is measured against it."""
    bad = TRUTH.copy()
    bad[0, 0, 0] = math.nan
    ref = study.Reference("bad", [bad, TRUTH])
    found = analysed(Synthetic("m"), ref)[0]
    assert ref.nonfinite == 1 and found.verdict == "unknown"
    assert all(level.relmse is None for level in found.levels)


def test_few_passes_give_no_verdict():
    """Two repeats have no interval of the bias; one has none at all. Nothing fails."""
    for repeats in (1, 2):
        found = analysed(Synthetic("m"), repeats=repeats)[0]
        assert found.verdict == "unknown" and found.levels[0].relmse.value > 0
    assert tradeoff.equal_time([found]).columns


def test_warm_up_is_in_no_time():
    """It is shown by itself."""
    passes = [(made(n, r, 1e-3 * n, warmup=5.0 if r == 0 else 0.0), TRUTH * 1.01) for n in LEVELS for r in range(3)]
    found = study.analyse("m", passes, reference())
    assert found.levels[0].seconds.high == pytest.approx(1e-3) and found.levels[0].seconds_warmup == 5


def test_median_and_quartiles_of_time():
    """One slow pass does not move the median."""
    times = (1.0, 2.0, 3.0, 4.0, 100.0)
    passes = [(made(1, r, t), TRUTH * 1.01) for r, t in enumerate(times)]
    assert study.analyse("m", passes, reference()).levels[0].seconds == study.Spread(3, 2, 4)
