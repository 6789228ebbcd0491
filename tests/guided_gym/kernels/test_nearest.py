"""The growing index against a linear scan: exact indices, exact ties, every order of insertion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from guided_gym.errors import InvalidInputError
from guided_gym.kernels import nearest as kernel
from guided_gym.structures.nearest import GrowingIndex

SE2 = ([1.0, 1.0, 0.5], [0.0, 0.0, 2 * np.pi])


def scan(points, q, weights, periods):
    """Squared distances of all points, one coordinate after the other (all coordinates wrapped already)."""
    weights, periods = np.asarray(weights), np.asarray(periods)
    delta = np.abs(points - q)
    delta = np.where(periods > 0, np.minimum(delta, periods - delta), delta) * weights
    squares = np.zeros(len(points))
    for j in range(points.shape[1]):
        squares += delta[:, j] * delta[:, j]
    return squares


@st.composite
def clouds(draw):
    """Points (few distinct coordinates, so that ties and duplicates abound), queries, weights, periods."""
    d = draw(st.integers(1, 4))
    periods = np.array(draw(st.lists(st.sampled_from([0.0, 1.0, 2 * np.pi]), min_size=d, max_size=d)))
    weights = np.array(draw(st.lists(st.sampled_from([0.3, 1.0, 2.0]), min_size=d, max_size=d)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 300))
    span = np.where(periods > 0, periods / 2, 2.0)
    points = rng.uniform(-span, span, (n, d))
    coarse = draw(st.sampled_from([0, 2, 5]))
    if coarse:
        points = np.round(points * coarse / span) / coarse * span * 0.999
    if draw(st.booleans()):
        points = points[np.lexsort(points.T)]
    queries = np.concatenate([rng.uniform(-span, span, (8, d)), points[rng.integers(0, n, 4)]])
    return points, queries, weights, periods


@settings(max_examples=25, deadline=None)
@given(clouds(), st.integers(1, 20))
def test_index__equals_a_linear_scan(cloud, k):
    points, queries, weights, periods = cloud
    index = GrowingIndex((weights, periods), capacity=4)
    for p in points:
        index.add(p)
    np.testing.assert_array_equal(index.points, points)
    for q in queries:
        squares = scan(points, q, weights, periods)
        order = np.lexsort((np.arange(len(points)), squares))[:k]  # ties are ties of the squares
        expected = np.sqrt(squares)
        assert index.nearest(q) == (order[0], expected[order[0]])
        ids, distances = index.k_nearest(q, k)
        np.testing.assert_array_equal(ids, order)
        np.testing.assert_array_equal(distances, expected[order])
        r = distances[-1]
        np.testing.assert_array_equal(index.within(q, r), np.flatnonzero(expected <= r))
    many, distances = index.nearest_many(queries)
    assert [(i, d) for i, d in zip(many, distances, strict=True)] == [index.nearest(q) for q in queries]


def test_index__neighbours_across_the_seam():
    index = GrowingIndex(SE2)
    index.add_many([[0, 0, 3.1], [0, 0, 0.0], [0.2, 0, -3.1]])
    assert index.nearest([0, 0, -3.1])[0] == 0
    assert index.nearest([0, 0, -3.1])[1] == pytest.approx(0.5 * (2 * np.pi - 6.2))
    np.testing.assert_array_equal(index.within([0, 0, np.pi], 0.25), [0, 2])


def test_index__angles_outside_one_turn_are_wrapped():
    index = GrowingIndex(SE2)
    index.add([1, 1, 0.5 + 4 * np.pi])
    index.add([1, 1, -np.pi])
    assert index.nearest([1, 1, 0.5 - 2 * np.pi])[1] == pytest.approx(0, abs=1e-12)
    assert index.nearest([1, 1, np.pi]) == (1, 0.0)


@pytest.mark.parametrize("order", ["ascending", "descending", "inward", "diagonal", "identical"])
def test_index__stays_balanced_for_adversarial_orders(order):
    n = 5000
    x = np.linspace(0, 1, n)
    points = {
        "ascending": np.stack([x, np.zeros(n)], 1),
        "descending": np.stack([x[::-1], np.zeros(n)], 1),
        "inward": np.stack([np.where(np.arange(n) % 2, x, 1 - x), np.zeros(n)], 1),
        "diagonal": np.stack([x, x], 1),
        "identical": np.full((n, 2), 0.25),
    }[order]
    index = GrowingIndex(([1, 1], [0, 0]))
    for p in points:
        index.add(p)
    assert kernel.depth(index.state[1]) <= 30
    rng = np.random.default_rng(1)
    for q in rng.uniform(-0.1, 1.1, (50, 2)):
        assert index.nearest(q)[0] == scan(points, q, [1, 1], [0, 0]).argmin()


def test_insert__says_full_and_changes_nothing():
    index = GrowingIndex(SE2, capacity=2)
    row = np.zeros(3)
    assert [kernel.insert(index.state, row) for _ in range(4)] == [0, 1, kernel.FULL, kernel.FULL]
    assert len(index) == 2
    index.reserve(2)
    assert kernel.insert(index.state, row) == 2


@njit
def _grow_from(state, q):
    while kernel.nearest(state, q)[1] < 10:
        q[0] += 0.01
        added = kernel.insert(state, q)
        if added < 0:
            return added
    return 0


def test_state__is_one_type_for_every_dimension_and_serves_fused_kernels():
    for d in (1, 3):
        index = GrowingIndex((np.ones(d), np.zeros(d)), capacity=3)
        index.add(np.zeros(d))
        assert _grow_from(index.state, np.zeros(d)) == kernel.FULL
    assert len(_grow_from.signatures) == 1


def test_index__refuses_bad_input_and_keeps_its_content():
    index = GrowingIndex(SE2)
    for call in (lambda: index.nearest([0, 0, 0]), lambda: index.nearest_many([[0, 0, 0]])):
        with pytest.raises(InvalidInputError, match="empty"):
            call()
    assert index.k_nearest([0, 0, 0], 3)[0].shape == index.within([0, 0, 0], 1).shape == (0,)
    index.add([0, 0, 0])
    bad = [[0, 0], [0, 0, np.nan], [0, np.inf, 0]]
    for q in bad:
        for call in (index.add, index.nearest, lambda q: index.k_nearest(q, 1), lambda q: index.within(q, 1)):
            with pytest.raises(InvalidInputError, match="expected"):
                call(q)
    with pytest.raises(InvalidInputError):
        index.add_many([[0, 0, 0], [0, 0, np.nan]])
    assert len(index) == 1
    with pytest.raises(InvalidInputError, match="k >= 1"):
        index.k_nearest([0, 0, 0], 0)


@pytest.mark.parametrize(
    ("weights", "periods"),
    [([1], [0, 0]), ([], []), ([0, 1], [0, 0]), ([1], [-1]), ([np.nan], [0]), ([1], [np.inf])],
)
def test_index__refuses_a_bad_metric(weights, periods):
    with pytest.raises(InvalidInputError, match="expected"):
        GrowingIndex((weights, periods))


def test_points__are_read_only():
    index = GrowingIndex(SE2)
    index.add([1, 2, 3])
    with pytest.raises(ValueError, match="read-only"):
        index.points[0] = 0
