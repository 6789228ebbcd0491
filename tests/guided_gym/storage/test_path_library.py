"""Paths in memory: lengths worked by hand, and the similarity query against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import InvalidInputError
from guided_gym.storage.path_library import PathLibrary

PLANE = ([1.0, 1.0], [0.0, 0.0])
RIGID = ([1.0, 1.0, 0.5], [0.0, 0.0, 2 * math.pi])


def test_lengths__hand_worked() -> None:
    library = PathLibrary.from_paths([[[0, 0], [3, 4], [3, 5]], [[1, 1], [1, 1]], [[2, 2]]], *PLANE)
    assert len(library) == 3
    assert library.offsets.tolist() == [0, 3, 5, 6]
    assert library.remaining.tolist() == [6.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    assert library.lengths.tolist() == [6.0, 0.0, 0.0]
    assert library.path(0).tolist() == [[0, 0], [3, 4], [3, 5]]
    assert library.starts.tolist() == [[0, 0], [1, 1], [2, 2]]
    assert library.goals.tolist() == [[3, 5], [1, 1], [2, 2]]


def test_length__takes_the_short_way_round() -> None:
    library = PathLibrary.from_paths([[[0, 0, 3.0], [0, 0, -3.0]]], *RIGID)
    assert library.lengths[0] == pytest.approx(0.5 * (2 * math.pi - 6.0))


def test_remaining__long_paths_beside_short_ones_lose_no_digits() -> None:
    library = PathLibrary.from_paths([[[0, 0], [1e12, 0]], [[0, 0], [0, 1e-3], [0, 3e-3]]], *PLANE)
    assert library.remaining[2:].tolist() == [3e-3, 2e-3, 0.0]


def test_most_similar__hand_worked() -> None:
    paths = [[[0, 0], [9, 9]], [[0, 1], [9, 9]], [[0, 0], [5, 5]], [[0, 0], [9, 9]]]
    library = PathLibrary.from_paths(paths, *PLANE)
    assert library.most_similar([0, 0], [9, 9], 3).tolist() == [0, 3, 1]  # ties go to the lower index
    assert library.most_similar([0, 0], [9, 9], 99).tolist() == [0, 3, 1, 2]
    assert library.task_distances([0, 0], [9, 9]).tolist() == [0.0, 1.0, math.hypot(4, 4), 0.0]


def test_most_similar__sees_across_the_seam_of_an_angle() -> None:
    paths = [[[0, 0, 0.0], [1, 0, 0]], [[0, 0, -3.1], [1, 0, 0]]]
    library = PathLibrary.from_paths(paths, *RIGID)
    assert library.most_similar([0, 0, 3.1], [1, 0, 0], 1).tolist() == [1]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_most_similar__agrees_with_brute_force(data: st.DataObject) -> None:
    n = data.draw(st.integers(0, 60))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    dimension = data.draw(st.sampled_from([1, 2, 3, 4]))
    weights = rng.uniform(0.2, 2.0, dimension)
    periods = np.where(rng.random(dimension) < 0.5, 0.0, rng.uniform(1.0, 7.0, dimension))
    cells = data.draw(st.sampled_from([None, 1.0]))  # coarse coordinates make ties

    def sample(size: int) -> np.ndarray:
        q = rng.uniform(-5.0, 5.0, (size, dimension))
        return q if cells is None else np.round(q / cells) * cells

    paths = [sample(int(length)) for length in rng.integers(1, 5, n)]
    library = PathLibrary.from_paths(paths, weights, periods)
    start, goal = sample(2)
    k = data.draw(st.integers(1, 10))
    expected = np.argsort(library.task_distances(start, goal), kind="stable")[:k]
    assert library.most_similar(start, goal, k).tolist() == expected.tolist()


def test_subset__keeps_the_first_paths() -> None:
    rng = np.random.default_rng(0)
    paths = [rng.uniform(size=(4, 2)) for _ in range(20)]
    library = PathLibrary.from_paths(paths, *PLANE, seeds=np.arange(20) * 2)
    small = library.subset(7)
    assert small.seeds.tolist() == [0, 2, 4, 6, 8, 10, 12]
    assert all(np.array_equal(small.path(i), paths[i]) for i in range(7))
    assert len(library.subset(99)) == 20
    assert small.most_similar(paths[9][0], paths[9][-1], 7).max() < 7


def test_empty_library() -> None:
    library = PathLibrary.from_paths([], *RIGID)
    assert len(library) == 0
    assert library.most_similar([0, 0, 0], [1, 1, 1], 3).size == 0
    assert library.lengths.size == 0


def test_arrays_are_read_only() -> None:
    library = PathLibrary.from_paths([[[0, 0], [1, 1]]], *PLANE)
    for array in (library.waypoints, library.remaining, library.path(0), library.subset(1).waypoints):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ([[[0, 0, 0]]], r"dimension 2, got shape \(1, 3\)"),
        ([[]], "got shape"),
        ([[[0, 0], [0, math.nan]]], "finite coordinates in a path, got .* at waypoint 1"),
        ([[["a", "b"]]], "of numbers"),
    ],
)
def test_bad_paths_are_refused(paths: list, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        PathLibrary.from_paths(paths, *PLANE)


def test_bad_queries_are_refused() -> None:
    library = PathLibrary.from_paths([[[0, 0], [1, 1]]], *PLANE)
    with pytest.raises(InvalidInputError, match="k >= 1"):
        library.most_similar([0, 0], [1, 1], 0)
    with pytest.raises(InvalidInputError, match="start"):
        library.most_similar([0, 0, 0], [1, 1], 1)
    with pytest.raises(InvalidInputError, match="goal"):
        library.most_similar([0, 0], [1, math.inf], 1)
    with pytest.raises(InvalidInputError, match="path index"):
        library.path(1)
    with pytest.raises(InvalidInputError, match="ascending"):
        PathLibrary.from_paths([[[0, 0]], [[0, 0]]], *PLANE, seeds=[3, 3])
    with pytest.raises(InvalidInputError, match="weights"):
        PathLibrary.from_paths([], [1.0, -1.0], [0.0, 0.0])
