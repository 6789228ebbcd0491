"""Figures with 95 % intervals: bootstraps over seeds, differences of paired seeds, shares, trends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.errors import InvalidInputError

FloatArray = NDArray[np.float64]
Statistic = Callable[[FloatArray], FloatArray]  # reduces the last axis

CONFIDENCE = 0.95
Z_SCORE = 1.959963984540054  # of the normal distribution, for that confidence
RESAMPLES = 4000
_SEED = 20240403  # a table printed twice from the same results has to be the same table


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval; all NaN when there was nothing to estimate from."""

    estimate: float
    low: float
    high: float

    def below(self, other: Interval) -> bool:
        """Whether the whole of this interval lies below the whole of the other."""
        return self.high < other.low

    def within(self, low: float, high: float) -> bool:
        """Whether the whole of this interval lies between two bounds."""
        return low <= self.low and self.high <= high

    def outside(self, low: float, high: float) -> bool:
        """Whether the whole of this interval lies beyond one of two bounds."""
        return self.high < low or high < self.low

    def text(self, digits: int = 3) -> str:
        """For people: ``4.31 [4.12, 4.52]``."""
        low, high = significant(self.low, digits), significant(self.high, digits)
        return f"{significant(self.estimate, digits)} [{low}, {high}]"


def significant(value: float, digits: int = 3) -> str:
    """A number to some significant digits, without an exponent; integer digits are never dropped."""
    if not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{decimals}f}"


def mean(values: FloatArray) -> FloatArray:
    """Mean over the last axis."""
    return np.asarray(values.mean(axis=-1))


def median(values: FloatArray) -> FloatArray:
    """Median over the last axis."""
    return np.asarray(np.median(values, axis=-1))


_STATISTICS: dict[str, Statistic] = {"mean": mean, "median": median}


@lru_cache(maxsize=16)
def _draws(n: int, stream: int) -> NDArray[np.int64]:
    draws = np.random.default_rng((_SEED, stream)).integers(0, n, (RESAMPLES, n))
    draws.flags.writeable = False
    return draws


def _interval(estimate: float, replicates: FloatArray) -> Interval:
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(replicates, [tail, 1 - tail])
    return Interval(float(estimate), float(low), float(high))


def _checked(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, np.float64)
    if array.ndim != 1:
        raise InvalidInputError(f"values: expected one number per seed, got shape {array.shape}")
    return array[np.isfinite(array)]


def bootstrap(values: ArrayLike, statistic: Literal["mean", "median"] = "mean") -> Interval:
    """Percentile bootstrap of the mean or the median.

    Args:
        values: (n,) one number per seed; those that are not finite are left out.
        statistic: What is estimated.
    """
    array = _checked(values)
    if not array.size:
        return Interval(np.nan, np.nan, np.nan)
    function = _STATISTICS[statistic]
    return _interval(float(function(array)), function(array[_draws(array.size, 0)]))


def paired_difference(first: ArrayLike, second: ArrayLike) -> Interval:
    """Percentile bootstrap of the mean of first - second, seed by seed.

    The two searches of a seed share the problem and the random numbers, so their difference varies less
    than the two of them do, and intervals that overlap can hide one that is real.

    Args:
        first: (n,) one number per seed.
        second: (n,) of the same seeds; pairs that are not finite are left out.
    """
    a, b = _pair(first, second)
    return bootstrap(a - b)


def _pair(first: ArrayLike, second: ArrayLike) -> tuple[FloatArray, FloatArray]:
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if a.ndim != 1 or a.shape != b.shape:
        raise InvalidInputError(f"expected one pair of numbers per seed, got shapes {a.shape} and {b.shape}")
    both = np.isfinite(a) & np.isfinite(b)
    return a[both], b[both]


def paired_ratio_of_medians(numerator: ArrayLike, denominator: ArrayLike) -> Interval:
    """Percentile bootstrap of median(numerator) / median(denominator); the seeds are drawn in pairs."""
    top, bottom = _pair(numerator, denominator)
    if not top.size:
        return Interval(np.nan, np.nan, np.nan)
    draws = _draws(top.size, 1)
    return _interval(float(median(top) / median(bottom)), median(top[draws]) / median(bottom[draws]))


def wilson(successes: int, n: int) -> Interval:
    """A share with its Wilson interval, which stays within 0 and 1, and is no point at either end."""
    if not n:
        return Interval(np.nan, np.nan, np.nan)
    z, share = Z_SCORE, successes / n
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    low, high = max(float(centre - half), 0.0), min(float(centre + half), 1.0)
    return Interval(share, min(low, share), max(high, share))


def bootstrap_slope(sizes: ArrayLike, values: ArrayLike) -> Interval:
    """Slope of log(mean value) over log(size), by least squares; seeds are resampled.

    A slope below 1 means that the value rises slower than linearly.

    Args:
        sizes: (k,) sizes, all positive.
        values: (n, k) positive values: one row per seed, one column per size.
    """
    x, y = np.log(np.asarray(sizes, np.float64)), np.asarray(values, np.float64)
    if y.ndim != 2 or y.shape[1] != x.size:
        raise InvalidInputError(f"values: expected shape (seeds, {x.size}), got {y.shape}")
    if not y.shape[0]:
        return Interval(np.nan, np.nan, np.nan)
    x = x - x.mean()
    leverage = x / (x @ x)
    replicates = np.log(y[_draws(len(y), 0)].mean(axis=1)) @ leverage
    return _interval(float(np.log(y.mean(axis=0)) @ leverage), replicates)


def falling_trend(values: ArrayLike) -> float:
    """One-sided p-value of Page's trend test: the columns fall from the first to the last.

    Args:
        values: (n, k) one row per seed, one column per step of what is varied; n >= 2 and k >= 3.
    """
    array = np.asarray(values, np.float64)
    if array.ndim != 2 or array.shape[0] < 2 or array.shape[1] < 3:
        raise InvalidInputError(f"values: expected shape (n >= 2, k >= 3), got {array.shape}")
    from scipy.stats import page_trend_test

    return float(page_trend_test(array[:, ::-1], method="asymptotic").pvalue)
