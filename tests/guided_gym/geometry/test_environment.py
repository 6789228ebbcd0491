"""Environments: free space, raster, clearance, and what the door refuses."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import shapely

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment

BOUNDS = (0.0, 0.0, 4.0, 2.0)


@pytest.fixture
def room():
    return Environment(BOUNDS, (shapely.box(1, 0, 2, 1),))


def test_free_space_is_bounds_minus_obstacles(room):
    assert room.free_space.area == pytest.approx(7.0)
    assert not room.free_space.contains(shapely.Point(1.5, 0.5))
    assert room.extent == pytest.approx(math.sqrt(20.0))


def test_empty_room_is_all_free():
    room = Environment(BOUNDS)
    assert room.free_space.area == pytest.approx(8.0)
    assert room.raster(3).sum() == 0
    assert room.clearance(np.array([1.0, 0.5])) == pytest.approx(0.5)


def test_raster_row_is_y_from_the_bottom_column_is_x(room):
    raster = room.raster(4)
    assert raster.dtype == np.uint8
    expected = np.zeros((4, 4), dtype=np.uint8)
    expected[:2, 1] = 1
    np.testing.assert_array_equal(raster, expected)


def test_raster_is_each_cell_asked_alone():
    rng = np.random.default_rng(0)
    discs = [
        shapely.Point(*p).buffer(r)
        for p, r in zip(rng.uniform(0, 4, (12, 2)), rng.uniform(0.01, 0.5, 12), strict=True)
    ]
    inside = [d for d in discs if d.intersects(shapely.box(*BOUNDS))]
    room = Environment(BOUNDS, (*inside, shapely.box(0.25, 0.25, 0.75, 0.75), shapely.box(3.9, -1, 9, 0.125)))
    raster = room.raster(16)
    for row, column in np.ndindex(16, 16):
        centre = shapely.Point((column + 0.5) / 4, (row + 0.5) / 8)
        assert raster[row, column] == room.obstacle_union.intersects(centre)
    assert 20 < raster.sum() < 200


def test_the_union_of_no_obstacles_is_empty_and_of_the_type_that_unions_have():
    assert Environment(BOUNDS).obstacle_union.equals(shapely.MultiPolygon())
    assert Environment(BOUNDS).obstacle_union.geom_type == "MultiPolygon"


def test_clearance_against_shapely(room):
    points = np.random.default_rng(0).uniform((0, 0), (4, 2), (5, 40, 2))
    edges = room.free_space.boundary
    expected = [
        edges.distance(shapely.Point(p)) if room.free_space.contains(shapely.Point(p)) else 0.0
        for p in points.reshape(-1, 2)
    ]
    np.testing.assert_allclose(room.clearance(points).ravel(), expected, atol=1e-8)


def test_multipolygons_and_third_coordinates_are_flattened():
    parts = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])
    high = shapely.Polygon([(0, 0, 5), (1, 0, 5), (1, 1, 5)])
    room = Environment(BOUNDS, (parts, high))
    assert len(room.obstacles) == 3
    assert not any(obstacle.has_z for obstacle in room.obstacles)


def test_from_polygons_equals_shapely_obstacles_and_pickles(room):
    again = Environment.from_polygons([0, 0, 4, 2], [[(2, 0), (2, 1), (1, 1), (1, 0)]])
    assert shapely.equals(again.obstacle_union, room.obstacle_union)
    assert pickle.loads(pickle.dumps(room)) == room


@pytest.mark.parametrize(
    "bounds",
    [(0, 0, 0, 1), (0, 0, 1), (0, 0, math.nan, 1), (0, 0, 1, math.inf), "none", "0123", (1, 0, 0, 1), None],
)
def test_bad_bounds_are_refused(bounds):
    with pytest.raises(InvalidInputError, match="bounds: expected"):
        Environment(bounds)


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        (shapely.Polygon(), "empty"),
        (shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "Self-intersection"),
        (shapely.Polygon([(0, 0), (1, math.inf), (1, 1)]), "NaN or infinity"),
        (shapely.Point(0, 0), "got Point"),
        ("box", "got str"),
        (shapely.box(5, 5, 6, 6), "meets the bounds"),
    ],
)
def test_bad_obstacles_are_refused_and_numbered(obstacle, message):
    with pytest.raises(InvalidInputError, match=f"obstacle 1: .*{message}"):
        Environment(BOUNDS, (shapely.box(1, 0, 2, 1), obstacle))


@pytest.mark.parametrize(
    "ring", [[(0, 0), (1, 1)], [0, 1, 2], [("a", "b")] * 3, [[(0, 0)], [(1, 1), (2, 2)]]]
)
def test_bad_rings_are_refused(ring):
    with pytest.raises(InvalidInputError, match="obstacle 0"):
        Environment.from_polygons(BOUNDS, [ring])


def test_of_a_collection_the_polygons_count():
    bow = shapely.Polygon([(1, 0), (2, 1), (2, 0), (1, 1), (1, 0), (0.5, 0.5), (1, 0)])
    mended = shapely.make_valid(bow)
    assert mended.geom_type == "GeometryCollection"
    room = Environment(BOUNDS, (mended,))
    assert room.obstacle_union.area == pytest.approx(0.5)
    nested = shapely.GeometryCollection([mended, shapely.Point(3, 1), shapely.box(3, 0, 4, 1, ccw=False)])
    assert Environment(BOUNDS, nested).obstacle_union.area == pytest.approx(1.5)
    overlapping = shapely.GeometryCollection([shapely.box(0, 0, 2, 1), shapely.box(1, 0, 3, 1)])
    assert Environment(BOUNDS, overlapping).obstacle_union.area == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            [shapely.LineString([(0, 0), (1, 1)]), shapely.Point(1, 1)],
            "a collection of LineString and Point only",
        ),
        ([], "an empty one"),
        ([shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])], "Self-intersection"),
        ([shapely.box(5, 5, 6, 6), shapely.LineString([(0, 0), (1, 1)])], "meets the bounds"),
    ],
)
def test_collections_without_good_polygons_are_refused(parts, message):
    with pytest.raises(InvalidInputError, match=f"obstacle 0: .*{message}"):
        Environment(BOUNDS, (shapely.GeometryCollection(parts),))


def test_one_polygon_is_one_obstacle():
    block = shapely.box(1, 0, 2, 1)
    assert Environment(BOUNDS, block) == Environment(BOUNDS, (block,))


def test_obstacles_that_are_none_are_refused():
    with pytest.raises(InvalidInputError, match="rings: expected a sequence"):
        Environment.from_polygons(BOUNDS, None)
    with pytest.raises(InvalidInputError, match="obstacles: expected a sequence"):
        Environment(BOUNDS, 3)
    with pytest.raises(InvalidInputError, match="bounds: expected 4 finite"):
        Environment.from_polygons(None, [])


def test_corners_that_are_not_finite_are_refused_without_a_warning(recwarn):
    with pytest.raises(InvalidInputError, match="obstacle 0: expected finite corners"):
        Environment.from_polygons(BOUNDS, [[(0, 0), (1, np.nan), (1, 1)]])
    assert not recwarn.list


def test_raster_needs_a_cell(room):
    with pytest.raises(InvalidInputError, match="raster: expected an integer, at least 1"):
        room.raster(0)


def test_least_width__is_no_more_than_the_width_and_equal_where_obstacles_touch_nothing():
    apart = [shapely.box(1, 1, 2, 3), shapely.box(5, 5, 6, 6)]
    alone = Environment((0, 0, 10, 10), apart)
    assert alone.least_width == pytest.approx(alone.width) == pytest.approx(2 * 97 / 50)
    crossing = Environment((0, 0, 10, 10), [*apart, shapely.box(1.5, 2, 12, 4)])
    assert 0 < crossing.least_width < crossing.width
    full = Environment((0, 0, 10, 10), [shapely.box(-1, -1, 11, 11)])
    assert full.least_width <= 0 < full.width


def test_magnitudes__are_the_largest_coordinates_of_obstacles_and_bounds():
    assert Environment((-3, 0, 10, 10)).magnitudes() == (10, 10)
    assert Environment((0, 0, 10, 10), [shapely.box(-30, 4, 5, 5)]).magnitudes() == (30, 10)
    far = Environment((1000, 2000, 1010, 2010), [shapely.box(995, 2001, 1001, 2013)])
    assert far.magnitudes() == (13, 2010)
