"""Rasters as polygons: the exact union of cells, and what options may change of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.convex import convex_pieces
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.occupancy import cell_polygons, cell_rectangles, occupied_cells, without_speckles

rasters = arrays(bool, st.tuples(st.integers(1, 8), st.integers(1, 8)))


@given(rasters)
@settings(max_examples=200, deadline=None)
def test_cell_polygons__are_the_union_of_the_cells(cells: np.ndarray) -> None:
    polygons = cell_polygons(cells)
    boxes = [shapely.box(j, i, j + 1, i + 1) for i, j in np.argwhere(cells)]
    union = shapely.union_all(boxes) if boxes else shapely.Polygon()
    assert all(polygon.is_valid for polygon in polygons)
    assert sum(polygon.area for polygon in polygons) == cells.sum()
    assert shapely.union_all(polygons).symmetric_difference(union).area == 0
    from scipy import ndimage

    assert len(polygons) == ndimage.label(cells)[1]


@given(rasters)
@settings(max_examples=200, deadline=None)
def test_cell_rectangles__cover_each_cell_once(cells: np.ndarray) -> None:
    count = np.zeros(cells.shape, int)
    for x0, y0, x1, y1 in cell_rectangles(cells):
        count[y0:y1, x0:x1] += 1
    assert (count == cells).all()


def test_cell_polygons__of_a_ring_that_closes_in_a_corner_only() -> None:
    """By hand: a hole that touches its shell, and cells that meet in a point, are all valid polygons."""
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 0]], bool)
    (polygon,) = cell_polygons(ring)
    assert polygon.is_valid
    assert polygon.area == 7
    assert len(polygon.interiors) == 1
    two = cell_polygons(np.array([[1, 0], [0, 1]], bool))
    assert [one.area for one in two] == [1, 1]
    holes = np.ones((4, 4), bool)
    holes[1, 1] = holes[2, 2] = False
    (polygon,) = cell_polygons(holes)
    assert polygon.is_valid
    assert len(polygon.interiors) == 2


def test_from_occupancy__row_0_is_at_the_bottom_and_pieces_cover_the_obstacles() -> None:
    environment = Environment.from_occupancy(np.array([[True, False], [False, False]]), 0.5, (1.0, 2.0))
    assert environment.bounds == (1.0, 2.0, 2.0, 3.0)
    assert environment.obstacles[0].bounds == (1.0, 2.0, 1.5, 2.5)
    cells = np.random.default_rng(0).random((30, 40)) < 0.3
    environment = Environment.from_occupancy(cells, 0.1, (5.0, -3.0, 0.4))
    pieces = shapely.union_all([shapely.Polygon(piece) for piece in environment.pieces])
    assert pieces.symmetric_difference(environment.obstacle_union).area < 1e-9
    exact = [piece for obstacle in environment.obstacles for piece in convex_pieces(obstacle)]
    assert sum(shapely.Polygon(p).area for p in exact) == pytest.approx(pieces.area)


def test_from_occupancy__a_turned_raster_is_walled_in_unless_unknown_is_free() -> None:
    cells = np.zeros((10, 10), bool)
    turned = Environment.from_occupancy(cells, 1.0, (0.0, 0.0, math.pi / 4))
    assert turned.free_space.area == pytest.approx(100.0)
    assert Environment.from_occupancy(cells, 1.0, (0, 0, math.pi / 4), unknown="free").obstacles == ()


@pytest.mark.parametrize("tolerance", [0.15, 0.4, 1.0])
def test_from_occupancy__simplifying_moves_boundaries_by_half_the_tolerance_at_most(tolerance: float) -> None:
    """So a passage wider than the tolerance stays one, and a wall thicker than it stays closed."""
    cells = np.random.default_rng(1).random((40, 40)) < 0.4
    exact = Environment.from_occupancy(cells, 0.1).obstacle_union
    environment = Environment.from_occupancy(cells, 0.1, simplify=tolerance)
    union = shapely.union_all(environment.obstacles)
    assert exact.buffer(tolerance / 2 + 1e-9).covers(union)
    assert union.buffer(tolerance / 2 + 1e-9).covers(exact)
    assert sum(map(shapely.get_num_coordinates, environment.obstacles)) < sum(
        map(shapely.get_num_coordinates, Environment.from_occupancy(cells, 0.1).obstacles)
    )
    assert all(shapely.get_precision(one) == 0 for one in environment.obstacles)


def test_without_speckles__keeps_what_hangs_together_by_corners() -> None:
    cells = np.array([[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 0]], bool)
    assert without_speckles(cells, 2).tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]
    assert (without_speckles(cells, 1) == cells).all()


def test_occupied_cells__of_each_type() -> None:
    ros = np.array([[-1, 0, 49, 50, 100]])
    assert occupied_cells(ros).tolist() == [[True, False, False, True, True]]
    assert occupied_cells(ros, unknown="free").tolist() == [[False, False, False, True, True]]
    shares = np.array([[np.nan, 0.0, 0.5, 1.0]])
    assert occupied_cells(shares, threshold=0.6).tolist() == [[True, False, False, True]]


@pytest.mark.parametrize(
    "array", [np.zeros((2, 2, 2)), np.zeros((0, 3)), np.array([[200]]), np.array([[1.5]]), np.array([["a"]])]
)
def test_occupied_cells__refuses_what_is_no_raster(array: np.ndarray) -> None:
    with pytest.raises(InvalidInputError, match="occupancy: expected"):
        occupied_cells(array)


def test_from_occupancy__refuses_degrees_and_other_numbers() -> None:
    cells = np.zeros((2, 2), bool)
    with pytest.raises(InvalidInputError, match="yaw"):
        Environment.from_occupancy(cells, 1.0, (0, 0, 90.0))
    for options in (
        {"resolution": 0.0},
        {"resolution": 1.0, "origin": (0,)},
        {"resolution": 1.0, "simplify": -1},
    ):
        with pytest.raises(InvalidInputError):
            Environment.from_occupancy(cells, **options)  # type: ignore[arg-type]
