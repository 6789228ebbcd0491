"""Anchors: values worked by hand, and what collisions take away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.kernels.anchors import (
    anchored_values_of,
    candidate_values,
    charge_anchors,
    charged_anchors,
    nearest_segments,
)
from guided_gym.kernels.metric import segment_separation
from guided_gym.structures.nearest import GrowingIndex

M = (np.ones(2), np.zeros(2))


def test_anchored_values__hand_worked() -> None:
    vertices = np.array([[0, 1], [2, -1], [-1, -1], [0, 2], [0, 1]], np.int32)
    lengths = np.array([[1.0, 0.5], [1, 0], [0, 0], [np.inf, 4], [1, 2]])
    edges = np.array([[-1, -1], [-1, -1], [-1, -1], [-1, -1], [0, 0]], np.int32)
    distance, every = np.array([5.0, 6, np.inf]), np.arange(5)
    values = anchored_values_of(every, vertices, lengths, edges, np.array([3.0]), distance)
    assert values.tolist() == [6, np.inf, np.inf, np.inf, 8]  # the last: min(3 * 1 + 5, 3 * 2 + 6)
    some = anchored_values_of(np.array([4, 0]), vertices, lengths, edges, np.array([3.0]), distance)
    assert some.tolist() == [8, 6]


def some_anchors(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple]:
    """4 states, 6 vertices, 3 anchors each of which some are none or dropped, and 3 places with a lesson."""
    rng = np.random.default_rng(seed)
    q, points, places = (rng.uniform(0, 5, (n, 2)) for n in (4, 6, 3))
    vertices = rng.integers(-1, 6, (4, 3)).astype(np.int32)
    lengths = np.hypot(*(q[:, None] - points[vertices]).transpose(2, 0, 1))
    lengths[rng.random((4, 3)) < 0.2] = np.inf
    taught = places, rng.uniform(0.01, 2, 3), np.array([1.5, 3.0, np.inf])
    return q, points, vertices, lengths, taught


def charge(q: np.ndarray, v: np.ndarray, taught: tuple) -> float:
    """How many times its length an anchor costs: like an edge, each place that it passes near adds to it."""
    factor = 1.0
    for place, reach, times in zip(*taught, strict=True):
        if segment_separation(q, v, place, M) <= reach:
            factor += times - 1.0
    return factor


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32))
def test_charge_anchors__those_that_pass_near_and_no_others(seed: int) -> None:
    q, points, vertices, lengths, taught = some_anchors(seed)
    before = lengths.copy()
    charge_anchors(q, np.arange(3), vertices, lengths, points, taught, M)
    assert (lengths[3] == before[3]).all()  # only the first 3
    for i in range(3):
        for j in range(3):
            v = vertices[i, j]
            factor = charge(q[i], points[v], taught) if v >= 0 else 1.0
            assert lengths[i, j] == pytest.approx(before[i, j] * factor)


def test_charge_anchors__that_have_no_length() -> None:
    q = np.array([[1.0, 1.0]])
    lengths = np.zeros((1, 1))
    for reach, expected in ((0.05, 0.0), (0.2, np.inf)):
        taught = np.array([[1.0, 1.1]]), np.array([reach]), np.array([np.inf])
        charge_anchors(q, np.arange(1), np.zeros((1, 1), np.int32), lengths, q, taught, M)
        assert lengths[0, 0] == expected


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


@pytest.mark.parametrize("spread", [1e-9, 0.05, 0.3, 3.0])
def test_candidate_values__share_the_search_and_are_those_of_each_alone(spread: float) -> None:
    rng = np.random.default_rng(4)
    metric = np.array([1.0, 1.0, 0.5]), np.array([0.0, 0.0, 2 * np.pi])
    for array in metric:
        array.flags.writeable = False  # as a space's: compiled for those already
    k, index, lessons = 4, GrowingIndex(metric), GrowingIndex(metric)
    points = rng.uniform(-1, 1, (201, 3)) * (2, 2, np.pi)
    places, reaches = rng.uniform(-1, 1, (9, 3)) * (2, 2, np.pi), rng.uniform(0.05, 0.4, 9)
    index.add_many(points[:-1])  # the last one is the goal
    lessons.add_many(places)
    taught = places, reaches, rng.choice([1.5, np.inf], 9)
    rest = taught, lessons.state, float(reaches.max()), metric
    distance = rng.uniform(0, 5, 201)
    for middle in (points[3], points[-1], np.array([1.9, 1.9, 3.1])):
        q = middle + spread * rng.standard_normal((16, 3))
        together = candidate_values(q, index.state, points, distance, k, *rest)
        vertices, lengths, _ = charged_anchors(q, index.state, points, k, *rest)
        alone = (lengths + distance[vertices]).min(axis=1)
        np.testing.assert_allclose(together, alone, rtol=1e-13)  # the index rounds otherwise
