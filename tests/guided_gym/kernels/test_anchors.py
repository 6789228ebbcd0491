"""Anchors: values worked by hand, and what collisions take away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.kernels.anchors import anchored_values, drop_anchors, nearest_segments
from guided_gym.kernels.metric import Metric, segment_separation

M = Metric(np.ones(2), np.zeros(2))


def test_anchored_values__hand_worked() -> None:
    vertices = np.array([[0, 1], [2, -1], [-1, -1], [0, 2], [0, 1]], np.int32)
    lengths = np.array([[1.0, 0.5], [1, 0], [0, 0], [np.inf, 4], [1, 2]])
    edges = np.array([[-1, -1], [-1, -1], [-1, -1], [-1, -1], [0, 0]], np.int32)
    values = anchored_values(vertices, lengths, edges, np.array([3.0]), np.array([5.0, 6, np.inf]), 5)
    assert values.tolist() == [6, np.inf, np.inf, np.inf, 8]  # the last: min(3 * 1 + 5, 3 * 2 + 6)
    assert len(anchored_values(vertices, lengths, edges, np.array([3.0]), np.array([5.0, 6, 7]), 2)) == 2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.01, 2))
def test_drop_anchors__those_that_pass_near_and_no_others(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    q, points, contacts = (rng.uniform(0, 5, (n, 2)) for n in (4, 6, 3))
    vertices = rng.integers(-1, 6, (4, 3)).astype(np.int32)
    lengths = np.hypot(*(q[:, None] - points[vertices]).transpose(2, 0, 1))
    lengths[rng.random((4, 3)) < 0.2] = np.inf
    before = lengths.copy()
    drop_anchors(q, np.arange(3), vertices, lengths, points, contacts, radius, M)
    assert (lengths[3] == before[3]).all()  # only the first 3
    for i in range(3):
        for j in range(3):
            v = vertices[i, j]
            near = v >= 0 and any(segment_separation(q[i], points[v], c, M) <= radius for c in contacts)
            assert lengths[i, j] == (np.inf if near else before[i, j])


def test_drop_anchors__that_have_no_length() -> None:
    q = np.array([[1.0, 1.0]])
    lengths = np.zeros((1, 1))
    drop_anchors(q, np.arange(1), np.zeros((1, 1), np.int32), lengths, q, np.array([[1.0, 1.1]]), 0.2, M)
    assert lengths[0, 0] == np.inf


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32))
def test_nearest_segments__agree_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, tails, heads = rng.uniform(0, 5, (5, 3)), rng.uniform(0, 5, (7, 2)), rng.uniform(0, 5, (7, 2))
    heads[3] = tails[3]  # a segment without length
    segment, fraction, away = nearest_segments(q, tails, heads)
    for i in range(5):
        all_of_them = [
            segment_separation(a, b, q[i, :2].copy(), M) for a, b in zip(tails, heads, strict=True)
        ]
        assert away[i] == pytest.approx(min(all_of_them), abs=1e-6)
        e = segment[i]
        foot = tails[e] + fraction[i] * (heads[e] - tails[e])
        assert np.hypot(*(foot - q[i, :2])) == pytest.approx(away[i], abs=1e-6)
        assert 0 <= fraction[i] <= 1
