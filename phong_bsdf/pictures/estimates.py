"""What independent passes say about an error: its mean, variance and bias with confidence intervals, its slope.

Plain arrays in, numbers out. All that is needed of pictures are their inner products, so the cost does not grow with
what is asked. A pass is an independent sample of a method's picture; so are the passes of its reference.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

CONFIDENCE = 0.95

# Values of each picture that are in memory in double precision at once.
CHUNK = 2**16


@dataclass(frozen=True)
class Estimate:
    """A number and its confidence interval, of 95 % where nothing else is said.

    Sources: Student, "The probable error of a mean", 1908; of what is computed from several passes at once, the
    jackknife of Tukey, "Bias and confidence in not-quite large samples", 1958.
    """

    value: float
    low: float | None = None
    """None, as `high`, where there are too few passes for one."""
    high: float | None = None

    def map(self, f: Callable[[float], float]) -> "Estimate":
        """`f`, monotone, of the value and of the interval's ends."""
        if self.low is None or self.high is None:
            return Estimate(f(self.value))
        ends = sorted((f(self.low), f(self.high)))
        return Estimate(f(self.value), *ends)


def mean(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """Mean of independent values, with Student's interval where there are two or more."""
    x = np.asarray(values, np.float64)
    return _estimate(float(x.mean()), _variance_of_mean(x), len(x) - 1, confidence)


def geometric_mean(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """Mean of the logarithms of positive values, for what varies by factors."""
    return mean(np.log(values).tolist(), confidence).map(math.exp)


# Pictures --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Products:
    """Mean over pixels and channels of w a b, for the differences a, b of passes to the mean of the reference's."""

    xx: np.ndarray
    """Pass with pass, (n, n)."""
    xr: np.ndarray
    """Pass with reference pass, (n, k)."""
    rr: np.ndarray
    """Reference pass with reference pass, (k, k). With k = 1 the reference counts as exact."""

    def without_pass(self, i: int) -> "Products":
        """The products as if pass `i` had not been made."""
        xx = np.delete(np.delete(self.xx, i, 0), i, 1)
        return replace(self, xx=xx, xr=np.delete(self.xr, i, 0))

    def without_reference_pass(self, i: int) -> "Products":
        """The products as if pass `i` of the reference had not been made."""
        rr = np.delete(np.delete(self.rr, i, 0), i, 1)
        return replace(self, rr=rr, xr=np.delete(self.xr, i, 1))


def products(passes: Sequence[np.ndarray], references: Sequence[np.ndarray], weight: np.ndarray | float) -> Products:
    """Inner products of pictures of one shape; `weight` is 1 for MSE, 1 / (r^2 + epsilon) for relMSE."""
    center = average(references)
    root, n, k = np.sqrt(np.broadcast_to(weight, center.shape)).ravel(), len(passes), len(references)
    flat, gram = [np.ravel(image) for image in (*passes, *references)], np.zeros((n + k, n + k))
    for start in range(0, center.size, CHUNK):
        part = slice(start, start + CHUNK)
        differences = (np.stack([image[part] for image in flat]) - center.ravel()[part]) * root[part]
        gram += differences @ differences.T / center.size
    return Products(gram[:n, :n], gram[:n, n:], gram[n:, n:])


class WeightedMean:
    """Mean of pictures of one scene, each weighted by its number of samples, and how far it may be from the truth.

    In double precision, in the order of `add`: the same pictures in the same order give the same bits. `judged`: the
    channels whose error counts, by their numbers; None: all.
    """

    def __init__(self, judged: Sequence[int] | None = None):
        self.judged = None if judged is None else list(judged)
        self.count = 0
        self.samples = 0
        self._sum = np.zeros(())
        self._squares = 0.0

    def add(self, image: np.ndarray, samples: int) -> None:
        """A picture, shape (height, width, channels), of so many samples per pixel."""
        weighted = samples * np.asarray(image, np.float64)
        self._squares += float(np.vdot(self._judged(weighted), self._judged(image)))
        self._sum = weighted if self.count == 0 else np.add(self._sum, weighted, out=self._sum)
        self.count += 1
        self.samples += samples

    def image(self) -> np.ndarray:
        """The mean, float32."""
        return (self._sum / self.samples).astype(np.float32)

    def relative_error(self) -> float | None:
        """Standard error of the mean, root mean square over pixels and channels, over the picture's mean value.

        From the spread of the pictures. None for fewer than two, and where it is no number.
        """
        if self.count < 2:
            return None
        total = self._judged(self._sum)
        # Pictures of independent samples spread by sigma^2 / samples.
        spread = self._squares - float(np.vdot(total, total)) / self.samples
        variance = max(spread, 0.0) / (self.count - 1) / total.size
        level = float(np.abs(total).sum()) / self.samples / total.size
        error = math.sqrt(variance / self.samples) / level if level > 0 else math.nan
        return error if math.isfinite(error) else None

    def _judged(self, image: np.ndarray) -> np.ndarray:
        return image if self.judged is None else np.ascontiguousarray(image[..., self.judged])


def average(images: Sequence[np.ndarray]) -> np.ndarray:
    """Mean of pictures of one shape, in double precision."""
    return sum((np.asarray(image, np.float64) for image in images), np.zeros(())) / len(images)


def error(p: Products, confidence: float = CONFIDENCE) -> Estimate:
    """Expected squared error of one pass against the true reference: the reference's own noise is taken out."""
    return _jackknife(lambda p: np.mean(np.diag(p.xx)) - 2 * np.mean(p.xr) + _between(p.rr), p, confidence, least=2)


def errors(p: Products) -> list[float]:
    """The squared error of each pass alone against the true reference."""
    return [float(p.xx[i, i] - 2 * np.mean(p.xr[i]) + _between(p.rr)) for i in range(len(p.xx))]


def bias(p: Products, confidence: float = CONFIDENCE) -> Estimate:
    """Squared error of the picture that the passes average to: what more passes cannot remove. About 0 without bias."""
    return _jackknife(lambda p: _between(p.xx) - 2 * np.mean(p.xr) + _between(p.rr), p, confidence, least=3)


def variance(p: Products, confidence: float = CONFIDENCE) -> Estimate:
    """Expected squared difference of a pass to the picture that the passes average to."""
    alone = replace(p, xr=np.zeros((len(p.xx), 1)), rr=np.zeros((1, 1)))
    return _jackknife(lambda p: np.mean(np.diag(p.xx)) - _between(p.xx), alone, confidence, least=3)


def noise(p: Products) -> float:
    """Expected squared error of the reference itself, from its passes; 0 where it has one."""
    k = len(p.rr)
    return float((np.mean(np.diag(p.rr)) - _between(p.rr)) / k) if k > 1 else 0.0


def _between(gram: np.ndarray) -> float:
    """Mean product of two different passes, in which noise has no part; of a single one, with itself."""
    n = len(gram)
    return float((gram.sum() - np.trace(gram)) / (n * (n - 1))) if n > 1 else float(gram[0, 0])


def _jackknife(statistic, p: Products, confidence: float, least: int) -> Estimate:
    """A statistic and its interval, from what it becomes when one pass, of either kind, is left out.

    `least`: passes without which it has no interval.
    """
    value = float(statistic(p))
    n, k = p.xr.shape
    if n < least:
        return Estimate(value)
    spread = [_spread([statistic(p.without_pass(i)) for i in range(n)])]
    freedom = [n - 1]
    # Of two reference passes, one alone would count as exact.
    if k > 2:
        spread.append(_spread([statistic(p.without_reference_pass(i)) for i in range(k)]))
        freedom.append(k - 1)
    total = sum(spread)
    # Welch and Satterthwaite: as many degrees of freedom as the larger part of the spread has.
    parts = sum(s * s / f for s, f in zip(spread, freedom, strict=True))
    return _estimate(value, total, total * total / parts if parts > 0 else n - 1, confidence)


def _spread(left_out: list[float]) -> float:
    x, n = np.asarray(left_out), len(left_out)
    return float((n - 1) / n * np.sum((x - x.mean()) ** 2))


def _variance_of_mean(x: np.ndarray) -> float:
    return float(x.var(ddof=1) / len(x)) if len(x) > 1 else math.nan


def _estimate(value: float, variance_of_value: float, freedom: float, confidence: float) -> Estimate:
    if freedom < 1 or not math.isfinite(variance_of_value):
        return Estimate(value)
    # Not scipy.stats, which takes a second to import.
    from scipy.special import stdtrit

    half = float(stdtrit(freedom, (1 + confidence) / 2)) * math.sqrt(variance_of_value)
    return Estimate(value, value - half, value + half)


# Curves of error over time ---------------------------------------------------------------------------------------


def slope(times: Sequence[float], errors: Sequence[float]) -> float | None:
    """Slope of log error against log time, by least squares: -1 for Monte Carlo. None for fewer than two points."""
    x, y = _logs(times, errors)
    if len(x) < 2 or np.ptp(x) == 0:
        return None
    return float(np.polyfit(x, y, 1)[0])


def error_at(times: Sequence[float], errors: Sequence[float], time: float) -> float | None:
    """Error at a time between two measured ones, on a straight line in logarithms; None beyond them."""
    x, y = _logs(times, errors)
    if not len(x) or not x[0] <= math.log(time) <= x[-1]:
        return None
    return float(np.exp(np.interp(math.log(time), x, y)))


def time_to(times: Sequence[float], errors: Sequence[float], error: float) -> float | None:
    """The first time at which the error is no larger, in the same way; None where it never is."""
    x, y = _logs(times, errors)
    wanted = math.log(error)
    for i in range(len(x)):
        if y[i] <= wanted:
            return float(np.exp(x[i] if i == 0 else np.interp(wanted, [y[i], y[i - 1]], [x[i], x[i - 1]])))
    return None


def _logs(times: Sequence[float], errors: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms in the order of time, without points that have none."""
    points = sorted((t, e) for t, e in zip(times, errors, strict=True) if t > 0 and e > 0 and math.isfinite(e))
    x, y = np.log(np.array(points).reshape(-1, 2)).T
    return x, y
