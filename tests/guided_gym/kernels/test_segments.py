"""Which edges pass near a configuration, against brute force over every way round."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import InvalidInputError
from guided_gym.structures.segments import SegmentIndex

SE2 = (np.array([1.0, 1.0, 0.54]), np.array([0.0, 0.0, 2 * np.pi]))


def segment_distances(q, a, b, weights, periods):
    """Distance of q from the short way a to b, over all copies of q one period away."""
    short = b - a
    short = np.where(
        periods > 0, short - periods * np.round(short / np.where(periods > 0, periods, 1)), short
    )
    best = np.inf
    for turns in itertools.product(*[(-2, -1, 0, 1, 2) if p > 0 else (0,) for p in periods]):
        offset = (a - q + np.array(turns) * periods) * weights
        way = short * weights
        t = np.clip(-(offset @ way) / max(way @ way, 1e-300), 0, 1)
        best = min(best, np.linalg.norm(offset + t * way))
    return best


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([(0.0, 0.0), (0.0, 6.0), (2.0, 3.0)]), st.floats(0.05, 2))
def test_segments__within_equals_brute_force(seed, periods, r):
    rng = np.random.default_rng(seed)
    periods, weights = np.array(periods), np.array([1.0, 0.6])
    span = np.where(periods > 0, periods / 2, 3.0)
    points = rng.uniform(-span, span, (30, 2))
    edges = rng.integers(0, 30, (60, 2))
    index = SegmentIndex(points, edges, (weights, periods))
    for q in rng.uniform(-span, span, (5, 2)):
        exact = np.array([segment_distances(q, points[u], points[v], weights, periods) for u, v in edges])
        if np.min(np.abs(exact - r)) > 1e-9:
            np.testing.assert_array_equal(index.within(q, r), np.flatnonzero(exact <= r))


def test_segments__across_the_seam_by_hand():
    points = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    index = SegmentIndex(points, [[0, 1], [2, 3], [2, 2]], SE2)
    np.testing.assert_array_equal(index.within([0, 0, -np.pi], 0.01), [0])
    np.testing.assert_array_equal(index.within([0, 0.1, 3.1], 0.11), [0])
    np.testing.assert_array_equal(index.within([2, 0.3, 0], 0.31), [1])
    np.testing.assert_array_equal(index.within([0.8, 0, 0], 0.21), [1, 2])
    assert index.within([0, 0, 0], 0.5).size == 0
    with pytest.raises(InvalidInputError):
        index.within([0, 0], 1)
    with pytest.raises(InvalidInputError):
        SegmentIndex(points, [[0, 4]], SE2)
    assert SegmentIndex(points, np.empty((0, 2)), SE2).within([0, 0, 0], 9).size == 0


def test_segments__long_edges_among_short_ones():
    rng = np.random.default_rng(3)
    points = rng.uniform([0, 0, -np.pi], [10, 10, np.pi], (500, 3))
    edges = np.stack([np.arange(499), np.arange(1, 500)], axis=1)  # any length
    index = SegmentIndex(points, edges, SE2)
    for q in points[::50]:
        exact = [segment_distances(q, points[u], points[v], *SE2) for u, v in edges]
        np.testing.assert_array_equal(index.within(q, 0.7), np.flatnonzero(np.array(exact) <= 0.7))
