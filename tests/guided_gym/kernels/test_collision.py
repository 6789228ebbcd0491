"""The collision kernels as other kernels use them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit, typeof

from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import collision

ROOM = Environment((0, 0, 10, 10), (shapely.box(4, 4, 6, 6),))
ROBOTS = [
    Robot.point(),
    Robot.segment(1.0),
    Robot.rectangle(1.0, 0.4),
    Robot.polygon([(0, 0), (1, 0), (0.2, 0.2), (0, 1)]),
]


@njit
def steps_taken(q, step, geometry):
    """A fused kernel: how often a step can be repeated."""
    count = 0
    at = q.copy()
    while count < 1000 and collision.motion_fraction(at, at + step, geometry) == 1.0:
        at += step
        count += 1
    return count


def test_geometry_has_one_type_for_all_robots():
    spaces = [ConfigurationSpace(robot, ROOM) for robot in ROBOTS]
    assert len({typeof(space.geometry) for space in spaces}) == 1


def test_kernels_fuse_with_others():
    geometry = ConfigurationSpace(Robot.point(), ROOM).geometry
    assert steps_taken(np.array([1.0, 5.0]), np.array([0.5, 0.0]), geometry) == 5
    geometry = ConfigurationSpace(Robot.rectangle(1.0, 0.4), ROOM).geometry
    assert steps_taken(np.array([1.0, 5.0, 0.0]), np.array([0.5, 0.0, 0.0]), geometry) == 4


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_batches_equal_single_calls(robot):
    space = ConfigurationSpace(robot, ROOM)
    q = space.sample(np.random.default_rng(0), 60)
    a, b = q[:30].copy(), q[30:].copy()
    g = space.geometry
    assert collision.poses_free(q, g).tolist() == [collision.pose_free(x, g) for x in q]
    assert collision.pose_clearances(q, g).tolist() == [collision.pose_clearance(x, g) for x in q]
    pairs = list(zip(a, b, strict=True))
    assert collision.motions_free(a, b, g).tolist() == [collision.motion_free(x, y, g) for x, y in pairs]
    assert collision.motion_fractions(a, b, g).tolist() == [
        collision.motion_fraction(x, y, g) for x, y in pairs
    ]


@given(st.floats(1e-9, 10), st.floats(-10, 10), st.floats(1e-6, 100))
@settings(max_examples=100, deadline=None)
def test_first_root_is_a_root_and_the_first(gap, rate, bend):
    t = collision._first_root(gap, rate, bend)
    assert t > 0
    assert gap + rate * t - bend * t * t == pytest.approx(
        0.0, abs=1e-9 * (gap + abs(rate) * t + bend * t * t)
    )
    half = t * 0.5
    assert gap + rate * half - bend * half * half > 0


def test_clearance_shrinks_no_faster_than_the_robot_moves():
    space = ConfigurationSpace(ROBOTS[3], ROOM)
    rng = np.random.default_rng(1)
    a = space.sample(rng, 500)
    b = space.wrap(a + rng.normal(scale=0.05, size=a.shape))
    change = np.abs(space.clearance(a) - space.clearance(b))
    moved = np.abs(space.difference(a, b))
    both = np.asarray(space.valid(a)) & np.asarray(space.valid(b))
    bound = np.hypot(moved[:, 0], moved[:, 1]) + ROBOTS[3].radius * moved[:, 2]
    assert (change[both] <= bound[both] + 1e-9).all()
