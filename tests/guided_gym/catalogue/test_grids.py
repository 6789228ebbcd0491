"""Mazes on grids are mazes, and few rectangles cover exactly their walls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from guided_gym.catalogue.grids import carved, covering, way


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 7), st.integers(1, 7), st.floats(0, 1))
def test_carved__joins_all_rooms_in_one_way(seed, columns, rows, newest):
    walls = carved(np.random.default_rng(seed), columns, rows, newest)
    assert walls.shape == (2 * columns + 1, 2 * rows + 1)
    assert walls[[0, -1]].all() and walls[:, [0, -1]].all() and walls[::2, ::2].all()
    assert not walls[1::2, 1::2].any()
    rooms = columns * rows
    assert (~walls).sum() == 2 * rooms - 1  # a tree: one passage fewer than rooms
    assert all(way(walls, (1, 1), (2 * i + 1, 2 * j + 1)) for i in range(columns) for j in range(rows))


def test_carved__follows_the_seed():
    one, same, other = (carved(np.random.default_rng(seed), 6, 6, 0.5) for seed in (1, 1, 2))
    assert (one == same).all() and (one != other).any()


def test_way__is_a_shortest_one():
    walls = np.array([[0, 0, 0], [1, 1, 0], [0, 0, 0]], bool)
    assert way(walls, (0, 0), (2, 0)) == [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0)]
    assert way(walls, (0, 0), (0, 0)) == [(0, 0)]
    walls[1, 2] = True
    assert way(walls, (0, 0), (2, 0)) == []


@settings(max_examples=60, deadline=None)
@given(arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_covering__has_exactly_the_cells(cells):
    covered = np.zeros_like(cells)
    rectangles = covering(cells)
    for i0, j0, i1, j1 in rectangles:
        assert cells[i0:i1, j0:j1].all()
        covered[i0:i1, j0:j1] = True
    assert (covered == cells).all()
    assert len(rectangles) <= cells.sum()


@pytest.mark.parametrize(("cells", "count"), [(np.ones((4, 5)), 1), (np.zeros((3, 3)), 0), (np.eye(4), 4)])
def test_covering__uses_few(cells, count):
    assert len(covering(cells.astype(bool))) == count
    frame = np.ones((15, 15), bool)
    frame[1:-1, 1:-1] = False
    assert len(covering(frame)) == 4
