"""Robots: outlines, placing, and what the door refuses."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import shapely

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace


@pytest.mark.parametrize(
    ("robot", "dimension", "radius", "pieces"),
    [
        (Robot.point(), 2, 0.0, 1),
        (Robot.segment(2.0), 3, 1.0, 1),
        (Robot.rectangle(1.0, 0.4), 3, math.hypot(0.5, 0.2), 1),
        (Robot.polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]), 3, math.sqrt(5.0), 2),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_robot_facts(robot, dimension, radius, pieces):
    assert robot.dimension == dimension
    assert robot.radius == pytest.approx(radius)
    assert len(robot.pieces) == pieces
    assert pickle.loads(pickle.dumps(robot)) == robot


@pytest.mark.parametrize("dimension", [2.0, True, "2", 4, None])
def test_the_dimension_is_one_of_two_integers(dimension: object) -> None:
    with pytest.raises(InvalidInputError, match="dimension is 2"):
        Robot(shapely.box(0, 0, 1, 1), dimension=dimension)  # type: ignore[arg-type]


def test_placed_turns_counter_clockwise_then_moves():
    placed = Robot.rectangle(2.0, 1.0).placed((3.0, 4.0, math.pi / 2))
    assert placed.equals_exact(
        shapely.box(2.5, 3.0, 3.5, 5.0).normalize(), 1e-9
    ) or placed.symmetric_difference(shapely.box(2.5, 3.0, 3.5, 5.0)).area == pytest.approx(0.0, abs=1e-12)
    corner = Robot.polygon([(0, 0), (2, 0), (0, 1)]).placed(np.array([1.0, 1.0, math.pi / 2]))
    assert corner.bounds == pytest.approx((0.0, 1.0, 1.0, 3.0))


def test_point_is_placed_by_two_numbers():
    assert Robot.point().placed((1.0, 2.0)).coords[0] == (1.0, 2.0)


def test_polygon_orientation_does_not_matter():
    corners = [(0, 0), (1, 0), (1, 1)]
    assert shapely.equals(Robot.polygon(corners).outline, Robot.polygon(corners[::-1]).outline)
    assert Robot.polygon(corners[::-1]).outline.exterior.is_ccw


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Robot.rectangle(-1.0, 1.0), "length: expected a positive"),
        (lambda: Robot.rectangle(1.0, math.nan), "width: expected a positive"),
        (lambda: Robot.segment(0.0), "length: expected a positive"),
        (lambda: Robot.polygon([(0, 0), (1, 1)]), r"V >= 3, got shape \(2, 2\)"),
        (lambda: Robot.polygon([(0, 0), (1, 1), (1, math.inf)]), "finite"),
        (lambda: Robot.polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "Self-intersection"),
        (lambda: Robot.polygon([(0, 0), (1, 1), (2, 2)]), "simple shape"),
        (lambda: Robot.polygon("square"), "numbers"),
        (lambda: Robot(shapely.Polygon()), "empty"),
        (lambda: Robot(shapely.MultiPoint([(0, 0)])), "not MultiPoint"),
        (lambda: Robot(shapely.Point(0, 0), dimension=3), "beyond its reference point"),
        (lambda: Robot(shapely.Point(0, 0), dimension=4), "not 4"),
        (lambda: Robot(shapely.box(0, 0, 4, 4) - shapely.box(1, 1, 2, 2)), "no holes, got 1"),
        (lambda: Robot.rectangle(1, 1).placed((1.0, 2.0)), r"shape \(3,\)"),
        (lambda: Robot.rectangle(1, 1).placed((1.0, 2.0, math.nan)), "finite"),
    ],
)
def test_bad_robots_are_refused(make, message):
    with pytest.raises(InvalidInputError, match=message):
        make()


def test_a_line_with_repeated_points_is_the_line_without_them():
    robot = Robot(shapely.LineString([(0, 0), (0, 0), (1, 0), (1, 0), (1, 1), (1, 1)]))
    assert [piece.tolist() for piece in robot.pieces] == [[[0, 0], [1, 0]], [[1, 0], [1, 1]]]
    room = Environment((0, 0, 10, 10), (shapely.box(4, 4, 6, 6),))
    spaces = [
        ConfigurationSpace(r, room) for r in (robot, Robot(shapely.LineString([(0, 0), (1, 0), (1, 1)])))
    ]
    assert np.isfinite(spaces[0].geometry[0][:-20]).all()
    poses = spaces[0].sample(np.random.default_rng(0), 300)
    np.testing.assert_array_equal(spaces[0].valid(poses), spaces[1].valid(poses))
    assert 50 < spaces[0].valid(poses).sum() < 290
    np.testing.assert_array_equal(*[s.motions_free(poses[1:], poses[:-1]) for s in spaces])


def test_a_collection_stands_for_its_only_polygon():
    spiked = shapely.GeometryCollection([shapely.box(0, 0, 1, 1), shapely.LineString([(1, 1), (2, 2)])])
    assert Robot(spiked).outline.equals(shapely.box(0, 0, 1, 1))
    two = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])
    with pytest.raises(InvalidInputError, match="not MultiPolygon"):
        Robot(two)
