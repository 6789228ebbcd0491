"""Convex decomposition: exact cover, convex counter-clockwise pieces, no new vertices."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.geometry.convex import convex_pieces, cover_polygons

L_SHAPE = shapely.Polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
WITH_HOLE = shapely.Polygon(
    shapely.box(0, 0, 4, 4).exterior.coords, [shapely.box(1, 1, 2, 3).exterior.coords]
)


def assert_exact_cover(shape):
    pieces = convex_pieces(shape)
    polygons = [shapely.Polygon(piece) for piece in pieces]
    corners = {tuple(c) for c in shapely.get_coordinates(shape)}
    for piece, polygon in zip(pieces, polygons, strict=True):
        assert polygon.is_valid
        assert polygon.exterior.is_ccw
        assert polygon.convex_hull.area == pytest.approx(polygon.area, rel=1e-12)
        assert {tuple(c) for c in piece} <= corners
    assert sum(p.area for p in polygons) == pytest.approx(shape.area, rel=1e-12)
    assert shapely.union_all(polygons).symmetric_difference(shape).area <= 1e-12 * shape.area


@pytest.mark.parametrize("clockwise", [False, True])
def test_convex_polygon_is_one_piece(clockwise):
    box = shapely.box(0, 0, 2, 1, ccw=not clockwise)
    (piece,) = convex_pieces(box)
    assert piece.shape == (4, 2)
    assert_exact_cover(box)


def test_l_shape_is_two_pieces():
    assert len(convex_pieces(L_SHAPE)) == 2
    assert_exact_cover(L_SHAPE)


def test_hole_stays_open():
    assert_exact_cover(WITH_HOLE)
    assert len(convex_pieces(WITH_HOLE)) == 4


def test_collinear_and_repeated_vertices_are_dropped():
    ring = [(0, 0), (1, 0), (1, 0), (2, 0), (2, 1), (0, 1), (0, 0.5)]
    (piece,) = convex_pieces(shapely.Polygon(ring))
    assert len(piece) == 4


def test_point_segment_and_parts():
    assert [p.tolist() for p in convex_pieces(shapely.Point(1, 2))] == [[[1, 2]]]
    assert len(convex_pieces(shapely.LineString([(0, 0), (1, 0), (1, 1)]))) == 2
    assert len(convex_pieces(shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)]))) == 2


@given(st.lists(st.floats(0.05, 1.0), min_size=3, max_size=24))
@settings(max_examples=60, deadline=None)
def test_star_shaped_polygons_are_covered_exactly(radii):
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    polygon = shapely.Polygon(np.array(radii)[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))
    assert polygon.is_valid
    assert_exact_cover(polygon)


def test_by_hand_how_few_pieces_there_are():
    cross = shapely.union(shapely.box(1, 0, 2, 3), shapely.box(0, 1, 3, 2))
    comb = shapely.union_all(
        [shapely.box(0, 0, 9, 1)] + [shapely.box(2 * k, 1, 2 * k + 1, 3) for k in range(5)]
    )
    assert len(convex_pieces(cross)) == 3
    assert len(convex_pieces(comb)) == 6
    for shape in (cross, comb):
        assert_exact_cover(shape)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=40))
@settings(max_examples=60, deadline=None)
def test_unions_of_cells_are_covered_exactly_and_no_two_pieces_could_be_one(cells):
    union = shapely.union_all([shapely.box(x, y, x + 1, y + 1) for x, y in cells])
    assert_exact_cover(union)
    polygons = [shapely.Polygon(piece) for piece in convex_pieces(union)]
    for a, b in itertools.combinations(polygons, 2):
        shared = a.intersection(b)
        if shared.length > 0 and set(shared.coords) <= set(a.exterior.coords) & set(b.exterior.coords):
            both = a.union(b)  # along a whole edge of both: a diagonal that had to stay
            assert both.convex_hull.area > both.area + 1e-9


def test_many_polygons_at_once_are_each_one_alone_in_order():
    rng = np.random.default_rng(0)
    shapes = [L_SHAPE, WITH_HOLE, shapely.box(5, 5, 6, 6), shapely.box(7, 7, 8, 8, ccw=False)]
    for _ in range(30):
        discs = [shapely.Point(*p).buffer(0.3, quad_segs=2) for p in rng.uniform(0, 1, (4, 2))]
        shapes += [part for part in shapely.get_parts(shapely.union_all(discs))]
    together = cover_polygons(shapes).arrays()
    alone = [piece for shape in shapes for piece in convex_pieces(shape)]
    assert len(together) == len(alone)
    for a, b in zip(together, alone, strict=True):
        np.testing.assert_array_equal(a, b)


def test_nothing_is_covered_by_nothing():
    assert cover_polygons([]).arrays() == []


def test_repeated_points_of_a_line_are_one():
    line = shapely.LineString([(0, 0), (0, 0), (1, 0), (1, 0), (1, 0), (1, 1), (1, 1)])
    assert [p.tolist() for p in convex_pieces(line)] == [[[0, 0], [1, 0]], [[1, 0], [1, 1]]]
