"""The configuration space: metric, wrapping, validity, certified motions, fingerprint."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace

BOUNDS = (0.0, 0.0, 10.0, 10.0)
STEP = 1e-3  # 1e-4 of the workspace's side
L_SHAPE = [(-0.2, -0.2), (0.8, -0.2), (0.8, 0.1), (0.1, 0.1), (0.1, 0.8), (-0.2, 0.8)]
ROBOTS = {
    "rectangle": Robot.rectangle(1.0, 0.4),
    "l": Robot.polygon(L_SHAPE),
    "segment": Robot.segment(1.0),
    "point": Robot.point(),
    "off-centre": Robot.polygon([(1, 0), (2, 0), (1.5, 0.5)]),
}
WALL = Environment(BOUNDS, (shapely.box(4.5, 0, 5.5, 4.6), shapely.box(4.5, 5.4, 5.5, 10)))


def clutter(seed):
    """Random star-shaped polygons, most of them not convex; some overlap."""
    rng = np.random.default_rng(seed)
    rings = []
    for _ in range(25):
        n = int(rng.integers(3, 9))
        angles = 2 * math.pi * (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n
        radii = rng.uniform(0.2, 0.9) * rng.uniform(0.4, 1.0, n)
        rings.append(
            rng.uniform(0, 10, 2) + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        )
    return Environment(BOUNDS, tuple(p for p in map(shapely.Polygon, rings) if p.is_valid))


def moved(space, rng, starts, longest):
    direction = rng.normal(size=starts.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return space.wrap(starts + direction / space.weights * rng.uniform(0, longest, (len(starts), 1)))


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


@pytest.fixture
def space(robot):
    return ConfigurationSpace(robot, WALL)


# Metric --------------------


def test_distance_wraps_the_angle_and_weighs_it():
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL, rotation_weight=2.0)
    a, b = [1.0, 1.0, 3.0], [4.0, 5.0, -3.0]
    assert space.distance(a, b) == pytest.approx(math.sqrt(25 + (2 * (2 * math.pi - 6)) ** 2))
    assert space.difference(a, b) == pytest.approx([3, 4, 2 * math.pi - 6])


def test_default_weight_is_the_circumradius(space, robot):
    assert space.weights[:2].tolist() == [1, 1]
    assert space.weights[2:].tolist() == [robot.radius] * (space.dimension - 2)
    assert space.extent == pytest.approx(10 * math.sqrt(2))


def test_distance_broadcasts(space):
    q = space.sample(np.random.default_rng(0), 6)
    assert space.distance(q[:, None], q[None, :]).shape == (6, 6)
    assert space.distance(q[0], q).shape == (6,)
    np.testing.assert_array_equal(space.distance(q[:, None], q), space.distance(q[:, None], q).T)


angles = st.floats(-math.pi, math.pi, exclude_max=True)


@given(angles, angles, st.floats(0, 1))
@settings(max_examples=100, deadline=None)
def test_interpolation_goes_the_short_way_round_in_proportion(theta, other, t):
    space = ConfigurationSpace(ROBOTS["segment"], WALL)
    a, b = np.array([1.0, 2.0, theta]), np.array([3.0, 1.0, other])
    q = space.interpolate(a, b, t)
    assert -math.pi <= q[2] < math.pi
    whole = space.distance(a, b)
    assert space.distance(a, q) == pytest.approx(t * whole, abs=1e-9)
    assert space.distance(q, b) == pytest.approx((1 - t) * whole, abs=1e-9)
    np.testing.assert_array_equal(space.difference(a, b), -space.difference(b, a))


@given(st.floats(-1e6, 1e6))
@settings(max_examples=200, deadline=None)
def test_wrap_lands_in_the_half_open_circle(theta):
    space = ConfigurationSpace(ROBOTS["segment"], WALL)
    wrapped = space.wrap([1.0, 1.0, theta])[2]
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(theta), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(theta), abs=1e-9)
    if -math.pi <= theta < math.pi:
        assert wrapped == theta


def test_wrap_of_pi_and_of_a_hair_below_minus_pi():
    space = ConfigurationSpace(ROBOTS["segment"], WALL)
    below = np.nextafter(-math.pi, -4)
    wrapped = space.wrap([[0, 0, math.pi], [0, 0, below], [0, 0, -math.pi]])[:, 2]
    assert ((wrapped >= -math.pi) & (wrapped < math.pi)).all()


def test_interpolate_shapes(space):
    q = space.sample(np.random.default_rng(0), 2)
    line = space.interpolate(q[0], q[1], np.linspace(0, 1, 7))
    assert line.shape == (7, space.dimension)
    np.testing.assert_allclose(line[0], q[0])


def test_samples_fill_the_space_and_follow_the_seed(space):
    q = space.sample(np.random.default_rng(1), 2000)
    assert ((q >= space.lower) & (q < space.upper)).all()
    np.testing.assert_allclose(q.mean(axis=0), (space.lower + space.upper) / 2, atol=0.5)
    np.testing.assert_array_equal(q, space.sample(np.random.default_rng(1), 2000))


# Poses --------------------


def test_valid_by_hand():
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    cases = [
        ((2.0, 2.0, 0.0), True),
        ((5.0, 5.0, 0.0), True),  # along the passage of 0.8
        ((5.0, 5.0, math.pi / 2), False),  # across it
        ((5.0, 2.0, 0.0), False),  # inside the wall, no edge crossed
        ((0.49, 2.0, 0.0), False),  # out of bounds by 0.01
        ((0.51, 2.0, 0.0), True),
        ((0.21, 2.0, math.pi / 2), True),
        ((-5.0, 2.0, 0.0), False),
        ((1e9, 1e9, 0.0), False),
        ((math.nan, 2.0, 0.0), False),
        ((2.0, 2.0, math.inf), False),
    ]
    poses = np.array([q for q, _ in cases])
    np.testing.assert_array_equal(space.valid(poses), [expected for _, expected in cases])
    assert [space.valid(q) for q in poses] == [expected for _, expected in cases]
    assert all(type(space.valid(q)) is bool for q in poses)


@pytest.mark.parametrize("seed", range(3))
def test_poses_and_clearance_agree_with_shapely(robot, seed):
    environment = clutter(seed)
    space = ConfigurationSpace(robot, environment)
    workspace, union = shapely.box(*BOUNDS), environment.obstacle_union
    poses = space.sample(np.random.default_rng(seed), 600)
    placed = np.array([robot.placed(q) for q in poses])
    free = ~shapely.intersects(placed, union) & shapely.contains_properly(workspace, placed)
    gap = np.where(
        free, np.minimum(shapely.distance(placed, union), shapely.distance(placed, workspace.exterior)), 0
    )
    # Vertex against vertex the separating gap may be some ten times less than the distance.
    decided = ~free | (gap > 100 * space.tolerance)
    np.testing.assert_array_equal(space.valid(poses)[decided], free[decided])
    np.testing.assert_allclose(space.clearance(poses)[decided], gap[decided], atol=1e-9)


def test_clearance_of_one_pose_by_hand():
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    assert space.clearance([2.0, 5.0, 0.0]) == pytest.approx(1.5)
    assert space.clearance([5.0, 5.0, 0.0]) == pytest.approx(0.2)
    assert space.clearance([2.0, 5.0, math.pi / 2]) == pytest.approx(1.8)
    assert space.clearance([5.0, 1.0, 0.0]) == 0.0


def test_read_only_and_strided_input_is_fine(space):
    q = np.asfortranarray(space.sample(np.random.default_rng(0), 10))
    q.flags.writeable = False
    expected = space.valid(q.copy(order="C"))
    np.testing.assert_array_equal(space.valid(q), expected)
    assert [space.valid(row) for row in q] == expected.tolist()
    assert space.motion_free(q[0], q[0]) == space.valid(q[0])


# Motions --------------------


def test_motions_by_hand():
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    assert space.motion_free([1, 5, 0], [9, 5, 0])  # through the passage
    assert not space.motion_free([1, 5, math.pi / 2], [9, 5, math.pi / 2])
    assert not space.motion_free([1, 5, 0], [9, 5, 3.0])  # turns in the passage
    assert not space.motion_free([1, 2, 0], [9, 2, 0])
    assert space.motion_free([1, 5, 3.0], [1, 5, -3.0])
    # Straight at the wall: the front edge, 0.5 ahead, meets x = 4.5 after 3 of 8.
    assert space.first_contact([1, 2, 0], [9, 2, 0]) == pytest.approx(3 / 8, abs=1e-5)
    assert space.first_contact([1, 5, 0], [9, 5, 0]) == 1.0
    assert space.first_contact([5, 2, 0], [9, 2, 0]) == 0.0
    # A quarter turn beside the wall: a corner meets it where |corner| cos(theta - corner's angle) = 0.45.
    angle = math.acos(0.45 / math.hypot(0.5, 0.2)) + math.atan2(0.2, 0.5)
    turned = space.first_contact([4.05, 2, math.pi / 2], [4.05, 2, 0.0]) * math.pi / 2
    assert turned == pytest.approx(math.pi / 2 - angle, abs=1e-4)


def test_thin_wall_between_dense_samples_is_seen():
    sliver = Environment(BOUNDS, (shapely.box(5, 0, 5 + 1e-7, 10),))
    assert not ConfigurationSpace(Robot.point(), sliver).motion_free([1, 1], [9, 1])
    assert not ConfigurationSpace(ROBOTS["rectangle"], sliver).motion_free([1, 1, 0], [9, 1, 1])


def test_concave_robot_straddles_an_obstacle_that_its_hull_would_hit():
    robot = Robot.polygon(
        [(-1, -1), (1, -1), (1, 1), (0.8, 1), (0.8, -0.8), (-0.8, -0.8), (-0.8, 1), (-1, 1)]
    )
    space = ConfigurationSpace(robot, Environment(BOUNDS, (shapely.box(4.9, 4.5, 5.1, 10),)))
    assert space.motion_free([5, 2, 0], [5, 5, 0])
    assert not space.motion_free([5, 2, 0], [5, 5.5, 0])
    assert not space.motion_free([5, 5, 0], [7, 5, 0])


@pytest.mark.parametrize("seed", range(3))
def test_no_certified_motion_collides_and_hardly_a_free_one_is_refused(robot, seed, reference):
    dense = reference("dense_reference")
    space = ConfigurationSpace(robot, clutter(10 + seed))
    scene = dense.scene_of(robot, space.environment)
    rng = np.random.default_rng(seed)
    poses = space.sample(rng, 4000)
    starts = poses[space.valid(poses)][:500]
    ends = moved(space, rng, starts, 2.0)
    collides = dense.motions_collide(starts, ends, STEP, scene) >= 0
    certified = space.motions_free(starts, ends)
    assert 50 < certified.sum() < len(starts)
    assert not (certified & collides).any()
    # The reference misses corners clipped between its steps: a few refusals are right.
    assert (~certified & ~collides).sum() <= 3


@pytest.mark.parametrize("seed", range(2))
def test_motions_agree_with_poses_and_with_their_reverse(robot, seed):
    space = ConfigurationSpace(robot, clutter(20 + seed))
    rng = np.random.default_rng(seed)
    starts = space.sample(rng, 1500)
    ends = moved(space, rng, starts, 3.0)
    free = space.motions_free(starts, ends)
    np.testing.assert_array_equal(free, space.motions_free(ends, starts))
    fractions = space.first_contacts(starts, ends)
    np.testing.assert_array_equal(free, fractions == 1.0)
    assert space.valid(starts)[free].all()
    assert space.valid(ends)[free].all()
    assert (fractions[~space.valid(starts)] == 0.0).all()
    np.testing.assert_array_equal(space.motions_free(starts, starts), space.valid(starts))
    # All of the certified part is free, and just behind its end (1e-4 of the side) there is a collision.
    started = (fractions > 0) & ~free
    assert started.sum() > 30
    a, b, part = starts[started], ends[started], fractions[started]
    for t in rng.random(8):
        assert space.valid(space.interpolate(a, b, part * t)).all()
    assert space.valid(space.interpolate(a, b, part)).all()
    touching = part + 1e-3 / np.maximum(space.distance(a, b), 1e-3)
    behind = [space.interpolate(a, b, np.minimum(1.0, part + k * (touching - part) / 50)) for k in range(51)]
    blocked = ~np.array([space.valid(q) for q in behind]).all(axis=0)
    assert blocked.mean() > 0.97


def test_motions_free_within_are_free_in_parts(robot):
    space = ConfigurationSpace(robot, clutter(30))
    rng = np.random.default_rng(0)
    starts = space.sample(rng, 800)
    ends = moved(space, rng, starts, 2.0)
    free = space.motions_free(starts, ends)
    middle = space.interpolate(starts, ends, rng.random(len(starts)))
    assert space.motions_free(starts[free], middle[free]).all()
    assert space.motions_free(middle[free], ends[free]).all()


coordinate = st.floats(0.0, 10.0)
turn = st.floats(-math.pi, math.pi, exclude_max=True)
pose = st.tuples(coordinate, coordinate, turn)


@given(pose, pose, st.lists(st.floats(0, 1), min_size=1, max_size=5))
@settings(max_examples=150, deadline=None)
def test_every_pose_of_a_certified_motion_is_valid(a, b, parts):
    space = ConfigurationSpace(ROBOTS["l"], clutter(40))
    fraction = space.first_contact(a, b)
    assert (fraction == 1.0) == space.motion_free(a, b) == space.motion_free(b, a)
    if fraction > 0:
        poses = space.interpolate(a, b, fraction * np.array(parts))
        assert space.valid(poses).all()


def test_half_a_turn_has_one_way_round():
    pole = Environment(BOUNDS, (shapely.box(4.9, 5.4, 5.1, 5.6),))  # beside the rod when it points up
    space = ConfigurationSpace(Robot.segment(1.0), pole)
    up, down = [5.0, 5.0, 0.0], [5.0, 5.0, -math.pi]
    assert space.motion_free(up, down) == space.motion_free(down, up)
    quarter = space.interpolate(up, down, 0.5)
    assert quarter[2] == pytest.approx(-math.pi / 2)
    assert space.interpolate(down, up, 0.5) == pytest.approx(quarter)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
def test_non_finite_motions_are_never_free(space, bad):
    good = np.full(space.dimension, 2.0)
    for i in range(space.dimension):
        wrong = good.copy()
        wrong[i] = bad
        assert not space.motion_free(good, wrong)
        assert not space.motion_free(wrong, good)
        assert space.first_contact(wrong, good) < 1.0
        assert not space.valid(wrong)


# Door and identity --------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rotation_weight": 0.0}, "rotation_weight"),
        ({"rotation_weight": math.nan}, "rotation_weight"),
        ({"tolerance": 0.0}, "tolerance must be"),
        ({"tolerance": math.nan}, "tolerance must be"),
        ({"tolerance": 1e-12}, "at least"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        ConfigurationSpace(ROBOTS["rectangle"], WALL, **options)


# Needle tips --------------------


def needle(angle, length=4.0):
    """A triangle whose tip at (5, 5) points up."""
    half = length * math.tan(0.5 * angle)
    return Environment(BOUNDS, (shapely.Polygon([(5, 5), (5 - half, 5 - length), (5 + half, 5 - length)]),))


@pytest.mark.parametrize("angle", [1e-5, 1e-3, 0.1, 1.0])
def test_a_point_may_pass_a_tip_as_near_as_the_tolerance(angle):
    space = ConfigurationSpace(Robot.point(), needle(angle))
    for gap, free in ((1.01, True), (1.5, True), (0.99, False), (0.0, False)):
        y = 5.0 + gap * space.tolerance
        assert space.valid([5.0, y]) == free
        assert space.motion_free([3.0, y], [7.0, y]) == free
        assert space.motion_free([3.0, y - 1.0], [7.0, y + 1.0]) == (gap > 1.2)
        assert (space.first_contact([5.0, 9.0], [5.0, y]) == 1.0) == free
    touch = (4.0 - space.tolerance) / 5.0
    assert space.first_contact([5.0, 9.0], [5.0, 4.0]) == pytest.approx(touch, abs=1e-8)
    assert space.clearance([5.0, 5.01]) == pytest.approx(0.01)


def test_the_tip_of_a_rod_may_come_as_near_to_a_needle():
    space = ConfigurationSpace(Robot.segment(1.0), needle(1e-3))
    near = 5.0 + 1.1 * space.tolerance
    assert space.motion_free([3.0, near + 0.5, math.pi / 2], [7.0, near + 0.5, math.pi / 2])
    assert not space.motion_free([3.0, near + 0.499, math.pi / 2], [7.0, near + 0.499, math.pi / 2])
    # A turn about the rod's middle sweeps its end over the tip.
    assert space.motion_free([5.0, near + 0.5, -math.pi / 2 - 1.0], [5.0, near + 0.5, -math.pi / 2 + 1.0])
    assert not space.motion_free([5.0, 5.49, -math.pi / 2 - 1.0], [5.0, 5.49, -math.pi / 2 + 1.0])


@given(
    st.floats(-4, 0),
    st.floats(-math.pi, math.pi),
    st.floats(0.05, 2.0),
    st.floats(1.02, 1e4),
    st.floats(0.0, 1.0),
)
@settings(max_examples=200, deadline=None)
def test_motions_that_keep_clear_of_a_tip_are_free_and_others_are_not(log_angle, way, reach, gap, part):
    angle = 10.0**log_angle
    space = ConfigurationSpace(Robot.point(), needle(angle))
    tip, direction = np.array([5.0, 5.0]), np.array([math.cos(way), math.sin(way)])
    side = np.array([-direction[1], direction[0]])
    for beside in (gap * space.tolerance * side, -gap * space.tolerance * side):
        a, b = tip + beside - part * reach * direction, tip + beside + (1 - part) * reach * direction
        distance = shapely.distance(shapely.LineString([a, b]), space.environment.obstacles[0])
        free = space.motion_free(a, b)
        assert free or distance < 1.02 * space.tolerance
        assert not free or distance > space.tolerance


@pytest.mark.parametrize("robot", ["point", "segment", "rectangle", "l", "off-centre"])
def test_poses_beyond_one_and_a_half_tolerances_are_valid(robot):
    rng = np.random.default_rng(3)
    needles = []
    for _ in range(25):
        tip, way = rng.uniform(1, 9, 2), rng.uniform(0, 2 * math.pi)
        side = 10.0 ** rng.uniform(-4, -1) * np.array([-math.sin(way), math.cos(way)])
        end = tip + rng.uniform(0.3, 1.5) * np.array([math.cos(way), math.sin(way)])
        needles.append(shapely.Polygon([tip, end + side, end - side]))
    environment = Environment(BOUNDS, tuple(needles))
    space = ConfigurationSpace(ROBOTS[robot], environment, tolerance=1e-2)
    poses = space.sample(rng, 4000)
    placed = np.array([space.robot.placed(q) for q in poses])
    obstacles = shapely.distance(placed, environment.obstacle_union)
    walls = np.where(
        shapely.within(placed, shapely.box(*BOUNDS)),
        shapely.distance(placed, shapely.box(*BOUNDS).exterior),
        0,
    )
    gap, valid = np.minimum(obstacles, walls), space.valid(poses)
    assert not valid[gap < 0.999e-2].any()
    assert valid[gap > 1.5e-2].all()
    assert ((gap > 1e-2) & (gap < 0.1)).sum() > 50


# Headings and places far out --------------------


@pytest.mark.parametrize("turns", [1, 1000, 2000, 10**6, 10**10])
def test_a_heading_means_the_same_after_many_turns(turns):
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    rng = np.random.default_rng(0)
    poses = space.sample(rng, 200)
    turned = poses + np.array([0.0, 0.0, 2 * math.pi * turns])
    turned[::2, 2] *= -1
    expected = poses.copy()
    expected[:, 2] = np.arctan2(np.sin(turned[:, 2]), np.cos(turned[:, 2]))
    np.testing.assert_array_equal(space.valid(turned), space.valid(expected))
    assert [space.valid(q) for q in turned] == space.valid(expected).tolist()
    np.testing.assert_allclose(space.clearance(turned), space.clearance(expected), atol=1e-9)
    np.testing.assert_allclose(space.wrap(turned)[:, 2], expected[:, 2], atol=1e-9)
    a, b = turned[:-1], turned[1:]
    np.testing.assert_array_equal(space.motions_free(a, b), space.motions_free(expected[:-1], expected[1:]))
    np.testing.assert_allclose(space.distance(a, b), space.distance(expected[:-1], expected[1:]), atol=1e-8)
    assert space.valid([5.0, 5.0, 0.0]) and not space.valid([5.0, 5.0, 1e13])


@pytest.mark.parametrize("side", [1.0, 10.0, 540.0])
@pytest.mark.parametrize("robot", ["point", "segment", "l"])
def test_a_site_in_utm_coordinates_is_the_same_as_at_the_origin(robot, side):
    here, far = clutter(50), np.array([448262.0, 5411932.0])
    scale = side / 10.0
    robot = Robot(
        shapely.affinity.scale(ROBOTS[robot].outline, scale, scale, origin=(0, 0)), ROBOTS[robot].dimension
    )
    near = Environment(
        (0, 0, side, side), tuple(shapely.transform(o, lambda xy: xy * scale) for o in here.obstacles)
    )
    site = Environment(
        (*far, *(far + side)), tuple(shapely.transform(o, lambda xy: xy + far) for o in near.obstacles)
    )
    space, moved = ConfigurationSpace(robot, near, tolerance=1e-5 * side), ConfigurationSpace(robot, site)
    assert moved.tolerance < 1e-5 * side
    moved = ConfigurationSpace(robot, site, tolerance=1e-5 * side)
    poses = space.sample(np.random.default_rng(0), 500)
    shift = np.zeros(space.dimension)
    shift[:2] = far
    decided = np.abs(space.clearance(poses)) > 3e-5 * side
    decided |= ~ConfigurationSpace(robot, near, tolerance=3e-5 * side).valid(poses)
    a, b = poses[:-1], poses[1:]
    agree = space.valid(poses) == moved.valid(poses + shift)
    assert agree[decided].all() and agree.mean() > 0.99
    assert (space.motions_free(a, b) == moved.motions_free(a + shift, b + shift)).mean() > 0.99
    np.testing.assert_allclose(
        space.clearance(poses)[agree], moved.clearance(poses + shift)[agree], atol=1e-8
    )
    points = poses[:, :2]
    np.testing.assert_allclose(near.clearance(points), site.clearance(points + far), atol=1e-8)


def test_coordinates_too_far_out_for_the_size_are_refused():
    assert ConfigurationSpace(Robot.point(), Environment((1e9, 0, 1e9 + 10, 10))).tolerance == pytest.approx(
        1e-3
    )
    with pytest.raises(InvalidInputError, match="tolerance must be"):
        ConfigurationSpace(Robot.point(), Environment((1e15, 0, 1e15 + 1, 1)))
    with pytest.raises(InvalidInputError, match="tolerance must be"):
        ConfigurationSpace(Robot.point(), Environment((1e9, 0, 1e9 + 10, 10)), tolerance=1e-5)


@pytest.mark.parametrize("call", ["valid", "clearance", "wrap", "distance"])
def test_wrong_shapes_are_refused(call):
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    bad = np.zeros((4, 2))
    with pytest.raises(InvalidInputError, match="shape"):
        getattr(space, call)(*([bad, bad] if call == "distance" else [bad]))


def test_wrong_shapes_of_motions_are_refused():
    space = ConfigurationSpace(ROBOTS["rectangle"], WALL)
    with pytest.raises(InvalidInputError, match=r"shape \(3,\)"):
        space.motion_free([1, 2], [1, 2, 3])
    with pytest.raises(InvalidInputError, match="as many starts as ends"):
        space.motions_free(np.zeros((2, 3)), np.zeros((3, 3)))


def test_fingerprint_tells_contents_apart():
    rectangle = ROBOTS["rectangle"]
    other_wall = Environment(BOUNDS, (shapely.box(4.5, 0, 5.5, 4.6), shapely.box(4.5, 5.4, 5.5, 9.999)))
    spaces = [
        ConfigurationSpace(rectangle, WALL),
        ConfigurationSpace(Robot.rectangle(1.0, 0.41), WALL),
        ConfigurationSpace(rectangle, other_wall),
        ConfigurationSpace(rectangle, Environment((0, 0, 10, 10.5), WALL.obstacles)),
        ConfigurationSpace(rectangle, WALL, rotation_weight=1.0),
        ConfigurationSpace(rectangle, WALL, tolerance=1e-4),
        ConfigurationSpace(Robot(rectangle.outline, dimension=2), WALL),
    ]
    prints = [space.fingerprint() for space in spaces]
    assert len(set(prints)) == len(prints)
    renamed = Robot(rectangle.outline, name="another name")
    assert ConfigurationSpace(renamed, WALL).fingerprint() == prints[0]


def test_fingerprint_is_the_same_in_another_process():
    code = (
        "import shapely; from guided_gym import Environment, Robot;"
        "from guided_gym.geometry.space import ConfigurationSpace as C;"
        "e = Environment((0, 0, 10, 10), (shapely.box(4.5, 0, 5.5, 4.6), shapely.box(4.5, 5.4, 5.5, 10)));"
        "print(C(Robot.rectangle(1.0, 0.4), e).fingerprint())"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ConfigurationSpace(ROBOTS["rectangle"], WALL).fingerprint()


def test_translating_polygon_robot_moves_in_the_plane():
    space = ConfigurationSpace(Robot(shapely.box(-0.5, -0.2, 0.5, 0.2), dimension=2), WALL)
    assert space.dimension == 2
    assert space.motion_free([1, 5], [9, 5])
    assert not space.motion_free([1, 4.7], [9, 4.7])
