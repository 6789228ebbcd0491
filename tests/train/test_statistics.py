"""Intervals and trends: cases worked out by hand, and what every bootstrap has to obey."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from guided_gym.errors import InvalidInputError
from guided_gym.train.statistics import (
    Interval,
    bootstrap,
    bootstrap_slope,
    falling_trend,
    paired_difference,
    paired_ratio_of_medians,
    significant,
    wilson,
)

samples = arrays(np.float64, st.integers(1, 30), elements=st.floats(-1e6, 1e6))


def test_intervals__below() -> None:
    low, high, middle = Interval(1, 0, 2), Interval(5, 4, 6), Interval(3, 2, 4)
    assert low.below(high)
    assert not high.below(low)
    assert not low.below(middle)  # they touch


def test_bootstrap__of_one_value_is_that_value() -> None:
    assert bootstrap([3.0]) == Interval(3.0, 3.0, 3.0)
    assert bootstrap([2.0, 2.0, 2.0], "median") == Interval(2.0, 2.0, 2.0)


def test_bootstrap__of_two_values_reaches_both() -> None:
    # A resample of (0, 1) has the means 0, 1/2, 1 with probabilities 1/4, 1/2, 1/4.
    assert bootstrap([0.0, 1.0]) == Interval(0.5, 0.0, 1.0)


def test_bootstrap__agrees_with_theory_on_many_values() -> None:
    values = np.random.default_rng(0).normal(10.0, 2.0, 400)
    interval = bootstrap(values)
    half = 1.96 * values.std() / np.sqrt(values.size)
    assert interval.low == pytest.approx(values.mean() - half, abs=0.03)
    assert interval.high == pytest.approx(values.mean() + half, abs=0.03)


def test_bootstrap__leaves_out_what_is_not_finite() -> None:
    assert bootstrap([1.0, np.nan, np.inf, 1.0]) == Interval(1.0, 1.0, 1.0)
    assert np.isnan(bootstrap([np.nan]).estimate)


def test_bootstrap__wants_one_number_per_seed() -> None:
    with pytest.raises(InvalidInputError, match="one number per seed"):
        bootstrap(np.zeros((3, 3)))


@given(values=samples, statistic=st.sampled_from(["mean", "median"]))
@settings(max_examples=25, deadline=None)
def test_bootstrap__stays_within_the_values_and_repeats_itself(values: np.ndarray, statistic: str) -> None:
    interval = bootstrap(values, statistic)
    slack = 1e-9 * (1 + np.abs(values).max())
    assert values.min() - slack <= interval.low <= interval.high <= values.max() + slack
    assert interval == bootstrap(values, statistic)


def test_ratio_of_medians__by_hand() -> None:
    assert paired_ratio_of_medians([4.0, 4.0, 4.0], [2.0, 2.0, 2.0]) == Interval(2.0, 2.0, 2.0)
    # Drawn in pairs, each twice the other: so is every resample's median.
    values = np.array([1.0, 5.0, 2.0, 9.0])
    assert paired_ratio_of_medians(2 * values, values) == Interval(2.0, 2.0, 2.0)


def test_paired_difference__is_that_of_pairs() -> None:
    values = np.random.default_rng(0).normal(50.0, 20.0, 30)
    assert paired_difference(values + 1.0, values).low == pytest.approx(1.0)
    assert paired_difference([1.0, np.nan, 3.0], [0.0, 0.0, np.inf]) == Interval(1.0, 1.0, 1.0)
    assert np.isnan(paired_difference([], []).estimate)
    with pytest.raises(InvalidInputError, match="pair of numbers per seed"):
        paired_difference([1.0, 2.0], [1.0])


def test_paired_difference__covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        shared = rng.exponential(10.0, 60)
        first, second = shared + rng.normal(0.3, 1.0, 60), shared + rng.normal(0.0, 1.0, 60)
        interval = paired_difference(first, second)
        hits += interval.low <= 0.3 <= interval.high
    assert hits >= 180  # 190 are expected; fewer than 180 come by chance once in a thousand times


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    # Brown, Cai and DasGupta (2001): (p + z^2 / 2n -+ z sqrt(p q / n + z^2 / 4n^2)) / (1 + z^2 / n), by hand.
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (5, 10, 0.2366, 0.7634), (123, 128, 0.9118, 0.9832)],
)
def test_wilson__by_hand(successes: int, n: int, low: float, high: float) -> None:
    interval = wilson(successes, n)
    assert interval.estimate == successes / n
    assert interval.low == pytest.approx(low, abs=1e-4)
    assert interval.high == pytest.approx(high, abs=1e-4)
    assert np.isnan(wilson(0, 0).estimate)


def test_interval__within_and_outside_of_bounds() -> None:
    interval = Interval(1.0, 0.5, 1.5)
    assert interval.within(0.5, 1.5)
    assert not interval.within(0.6, 2.0)
    assert interval.outside(2.0, 3.0)
    assert interval.outside(0.0, 0.4)
    assert not interval.outside(0.0, 1.0)


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_slope__of_a_power_law_is_its_power(power: float) -> None:
    sizes = np.array([10, 100, 1000])
    values = np.array([1.0, 2.0, 7.0])[:, None] * sizes**power
    slope = bootstrap_slope(sizes, values)
    assert slope.estimate == pytest.approx(power)
    assert slope.high == pytest.approx(power)


def test_slope__wants_a_column_per_size() -> None:
    with pytest.raises(InvalidInputError, match=r"shape \(seeds, 3\)"):
        bootstrap_slope([1, 2, 3], np.ones((4, 2)))


def test_trend__falls_rises_or_is_none() -> None:
    noise = np.random.default_rng(1).normal(size=(40, 5))
    falling = np.arange(5)[::-1] + 0.5 * noise
    assert falling_trend(falling) < 1e-6
    assert falling_trend(falling[:, ::-1]) > 0.999
    assert falling_trend(noise) > 0.05


def test_trend__wants_several_seeds_and_steps() -> None:
    with pytest.raises(InvalidInputError, match="k >= 3"):
        falling_trend(np.zeros((10, 2)))


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (1234.5, "1,234"), (12.345, "12.3"), (0.012345, "0.0123"), (1.0, "1.00"), (np.nan, "–")],
)
def test_significant__digits(value: float, text: str) -> None:
    assert significant(value) == text
