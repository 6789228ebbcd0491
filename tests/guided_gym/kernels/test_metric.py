"""Distances and steps of single configurations, against the definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.kernels.metric import ball_samples, segment_separation, separation, shortest, steer

W, P = np.array([1.0, 1.0, 0.5]), np.array([0.0, 0.0, 2 * math.pi])
M = (W, P)
quick = settings(max_examples=80, deadline=None)
poses = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-math.pi, math.pi)).map(np.array)


def test_shortest__hand_worked() -> None:
    assert shortest(5.0, 0.0) == 5.0
    assert shortest(1.5 * math.pi, 2 * math.pi) == pytest.approx(-0.5 * math.pi)
    assert shortest(-1.5 * math.pi, 2 * math.pi) == pytest.approx(0.5 * math.pi)
    assert shortest(math.pi, 2 * math.pi) == pytest.approx(-math.pi)


def test_separation__hand_worked() -> None:
    assert separation(np.array([0.0, 0, 3]), np.array([3.0, 4, 3]), M) == 5
    turned = separation(np.array([0.0, 0, 3]), np.array([0.0, 0, -3]), M)
    assert turned == pytest.approx(0.5 * (2 * math.pi - 6))


@quick
@given(poses, poses, poses)
def test_separation__is_a_metric(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    ab = separation(a, b, M)
    assert ab == pytest.approx(separation(b, a, M))
    assert separation(a, a, M) == 0
    assert ab <= separation(a, c, M) + separation(c, b, M) + 1e-9


@quick
@given(poses, poses, poses)
def test_segment_separation__against_dense_sampling(a: np.ndarray, b: np.ndarray, q: np.ndarray) -> None:
    found = segment_separation(a, b, q, M)
    delta = np.array([shortest(d, p) for d, p in zip(b - a, P, strict=True)])
    along = a + np.linspace(0, 1, 400)[:, None] * delta
    turned = np.array([[shortest(d, p) for d, p in zip(row, P, strict=True)] for row in along - q])
    dense = float(np.sqrt(((W * turned) ** 2).sum(axis=1)).min())
    gap = separation(a, b, M) / 399
    assert found >= dense - gap - 1e-9  # never too small
    if found + separation(a, b, M) < 0.5 * math.pi:
        assert found <= dense + 1e-9  # exact there


@quick
@given(poses, poses, st.floats(0.01, 30))
def test_steer__stays_in_range(a: np.ndarray, b: np.ndarray, step: float) -> None:
    reached = steer(a, b, step, M)
    assert separation(a, reached, M) == pytest.approx(min(step, separation(a, b, M)), abs=1e-9)
    assert -math.pi <= reached[2] < math.pi


def test_steer__does_not_leave_the_range_by_rounding() -> None:
    reached = steer(np.zeros(3), np.array([0, 0, np.nextafter(math.pi, 4)]), 2.0, M)
    assert -math.pi <= reached[2] < math.pi


def test_ball_samples__hand_worked() -> None:
    out = ball_samples(np.zeros(3), np.array([[0.0, 0, 2], [3, 0, 0]]), np.array([1.0, 0.125]), 0.4, M)
    assert out == pytest.approx(np.array([[0, 0, 0.8], [0.2, 0, 0]]))  # an angle of 0.8 is a length of 0.4
