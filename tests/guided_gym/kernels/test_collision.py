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


# Broad phase --------------------


def brute(geometry):
    """The same pieces, in the same order, without the tree: all are looked at."""
    numbers, index = geometry
    flat = index.copy()
    flat[3] = flat[6] = 0
    return numbers, flat


def large_world(seed, n=400, side=40.0, origin=(0.0, 0.0)):
    """Many stars, blocks and long thin walls, of very different sizes."""
    rng = np.random.default_rng(seed)
    shapes = []
    for _ in range(n):
        centre, kind = rng.uniform(0, side, 2), rng.random()
        if kind < 0.1:
            size = rng.choice([rng.uniform(2, 0.4 * side), 0.05], 2, replace=False)
            shapes.append(shapely.box(*(centre - size / 2), *(centre + size / 2)))
        else:
            m = int(rng.integers(3, 8))
            angles = 2 * np.pi * (np.arange(m) + rng.uniform(0.1, 0.9, m)) / m
            radii = rng.choice([0.05, 0.3, 0.8]) * rng.uniform(0.3, 1.0, m)
            shapes.append(
                shapely.Polygon(centre + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))
            )
    inside = [s for s in shapes if s.is_valid and s.intersects(shapely.box(0, 0, side, side))]
    moved = tuple(shapely.transform(s, lambda xy: xy + origin) for s in inside)
    return Environment((*origin, origin[0] + side, origin[1] + side), moved)


LARGE = {robot.name: ConfigurationSpace(robot, large_world(k)) for k, robot in enumerate(ROBOTS)}


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_tree_holds_each_piece_once_and_nodes_hold_what_is_below(robot):
    numbers, index = LARGE[robot.name].geometry
    n, row, boxes, rest = index[3], index[4], index[5], index[6]
    rows = index[row : row + 3 * n].reshape(-1, 3)
    assert rest == index[1] - 4 > 64
    leaves = rows[rows[:, 2] > 0]
    assert leaves[0, 1] == 0 and leaves[-1, 2] == rest
    assert (leaves[1:, 1] == leaves[:-1, 2]).all()
    for node, (after, _, last) in enumerate(rows):
        box = numbers[boxes + 4 * node : boxes + 4 * node + 4]
        below = [rows[k] for k in range(node, after) if rows[k, 2] > 0]
        pieces = numbers[index[2] + 4 * below[0][1] : index[2] + 4 * below[-1][2]].reshape(-1, 4)
        np.testing.assert_array_equal(box, [*pieces[:, :2].min(axis=0), *pieces[:, 2:].max(axis=0)])
        assert (last > 0) == (after == node + 1)


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.01, 1.0, 8.0, 60.0]))
@settings(max_examples=40, deadline=None)
def test_tree_changes_no_answer(robot, seed, reach):
    space = LARGE[robot.name]
    rng = np.random.default_rng(seed)
    a = space.lower + rng.uniform(-0.05, 1.05, (60, space.dimension)) * (space.upper - space.lower)
    step = rng.normal(size=a.shape) * rng.choice([0.0, 1.0, 1.0], a.shape)
    b = a + reach * step / np.maximum(np.linalg.norm(step, axis=1), 1e-9)[:, None]
    fast, slow = space.geometry, brute(space.geometry)
    np.testing.assert_array_equal(collision.poses_free(a, fast), collision.poses_free(a, slow))
    np.testing.assert_array_equal(collision.motions_free(a, b, fast), collision.motions_free(a, b, slow))
    np.testing.assert_allclose(
        collision.motion_fractions(a, b, fast), collision.motion_fractions(a, b, slow), atol=1e-9
    )
    np.testing.assert_allclose(
        collision.pose_clearances(a, fast), collision.pose_clearances(a, slow), atol=1e-12
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, 1e13])
def test_what_is_not_finite_is_not_free_in_a_tree_either(bad):
    space = LARGE["rectangle"]
    free = space.sample(np.random.default_rng(0), 200)
    free = free[space.valid(free)][0]
    for k in range(3):
        wrong = free.copy()
        wrong[k] = bad
        assert not collision.pose_free(wrong, space.geometry)
        assert collision.pose_clearance(wrong, space.geometry) == 0.0
        assert not collision.motion_free(free, wrong, space.geometry)
        assert collision.motion_fraction(wrong, free, space.geometry) == 0.0


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_no_certified_motion_of_a_large_world_collides(robot, reference):
    dense = reference("dense_reference")
    space = LARGE[robot.name]
    scene = dense.scene_of(robot, space.environment)
    rng = np.random.default_rng(5)
    starts = space.sample(rng, 3000)
    starts = starts[space.valid(starts)][:300]
    ends = starts + rng.normal(size=starts.shape)
    collides = dense.motions_collide(starts, ends, 1e-3, scene) >= 0
    certified = space.motions_free(starts, ends)
    assert 30 < certified.sum() < len(starts)
    assert not (certified & collides).any()
    assert (~certified & ~collides).sum() <= 5
