"""Anchors to stored paths, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.kernels.waypoints import path_anchors

M = (np.ones(2), np.zeros(2))


def test_path_anchors__hand_worked() -> None:
    points = np.array([[0.0, 0], [1, 0], [2, 0], [0, 1], [5, 5]])
    path_of = np.array([0, 0, 0, 1, 2], np.int32)
    distance = np.array([12.0, 11, 10, 3, 0])
    near = np.array([0, 1, 2, 3, 4])
    vertices, lengths = path_anchors(np.zeros((1, 2)), near, points, path_of, distance, 2.0, 3, M)
    # Path 1: 1 + 3. Path 0: all three total 12; the first wins. Path 2 is out of reach.
    assert vertices.tolist() == [[3, 0, -1]]
    assert lengths.tolist() == [[1, 0, np.inf]]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 4))
def test_path_anchors__agree_with_brute_force(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 8, rng.integers(1, 7))
    points = rng.uniform(0, 4, (counts.sum(), 2))
    path_of = np.repeat(np.arange(counts.size), counts).astype(np.int32)
    distance = rng.uniform(0, 10, len(points))
    distance[np.isin(path_of, rng.integers(0, counts.size, 2))] = np.inf  # filtered paths
    near = np.flatnonzero(rng.random(len(points)) < 0.8)
    q = rng.uniform(0, 4, (3, 2))
    vertices, lengths = path_anchors(q, near, points, path_of, distance, 1.5, k, M)
    for i in range(3):
        away = np.hypot(*(points - q[i]).T)
        best: dict[int, float] = {}
        for v in near:
            if away[v] <= 1.5 and np.isfinite(distance[v]):
                best[path_of[v]] = min(best.get(path_of[v], np.inf), away[v] + distance[v])
        expected = sorted(best.values())[:k]
        used = vertices[i] >= 0
        assert np.count_nonzero(used) == len(expected)
        assert lengths[i, used] + distance[vertices[i, used]] == pytest.approx(expected)
        assert len(set(path_of[vertices[i, used]])) == len(expected)  # on different paths
        assert np.isinf(lengths[i, ~used]).all()
