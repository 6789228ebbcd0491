"""Planar linkages: where their bodies are, which configurations are valid, and which motions are free."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.display.scene import robot_table
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Body, Joint, Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

Floats = npt.NDArray[np.float64]

BOUNDS = (0.0, 0.0, 10.0, 10.0)
EMPTY = Environment(BOUNDS)


def clutter(seed: int, count: int = 25, near: float = 1.0) -> Environment:
    """Random triangles and quadrangles that leave the middle free."""
    rng = np.random.default_rng(seed)
    obstacles: list[shapely.Polygon] = []
    while len(obstacles) < count:
        corners = int(rng.integers(3, 5))
        angles = np.sort(rng.uniform(0, 2 * math.pi, corners))
        ring = rng.uniform(0.3, 9.7, 2) + rng.uniform(0.2, 0.6) * np.stack(
            [np.cos(angles), np.sin(angles)], 1
        )
        polygon = shapely.Polygon(ring)
        if polygon.is_valid and polygon.distance(shapely.Point(5, 5)) > near and polygon.area > 1e-3:
            obstacles.append(polygon)
    return Environment(BOUNDS, tuple(obstacles))


CLUTTER = clutter(0)
TREE = Linkage(
    (
        Joint((5.0, 5.0)),
        Joint((1.0, 0.1), 0, 0.3),
        Joint((1.2, -0.2), 0, -0.5, (-2.0, 2.0)),
        Joint((0.9, 0.0), 1),
    ),
    (
        Body(0, shapely.box(0, -0.1, 1.1, 0.1)),
        Body(1, shapely.Polygon([(0, 0), (1, -0.2), (0.9, 0.3)])),
        Body(2, shapely.Polygon([(0, -0.1), (1, -0.1), (1, 0.6), (0.8, 0.6), (0.8, 0.1), (0, 0.1)])),
        Body(3, shapely.LineString([(0, 0), (0.7, 0.2)])),
    ),
    (3, (0.7, 0.2)),
    self_collision=True,
    name="tree",
)
ROBOTS: dict[str, Linkage] = {
    "two links": Linkage.arm([2.0, 1.5], 0.2, base=(5, 5)),
    "thin": Linkage.arm([1.0, 0.8, 0.7, 0.6], base=(5, 5), limits=2.5),
    "seven links": Linkage.arm([0.6] * 7, 0.1, base=(5, 5), self_collision=True),
    "snake": Linkage.snake([0.7] * 4, 0.1, limits=2.0, self_collision=True),
    "tree": TREE,
    "nine links": Linkage.arm([0.5] * 9, 0.08, base=(5, 5), limits=(-2.5, 3.0)),
}


def truly_free(robot: Linkage, environment: Environment, q: Floats, gap: float = 0.0) -> bool:
    """What shapely says of one configuration, and its joints."""
    angles = q[2:] if robot.mobile else q
    limits = [joint.limits or (-math.inf, math.inf) for joint in robot.joints]
    if not all(low <= angle <= high for angle, (low, high) in zip(angles.tolist(), limits, strict=True)):
        return False
    bodies = robot.place(q)
    whole = shapely.union_all(bodies)
    inside = shapely.box(*environment.bounds).contains_properly(whole)
    off = environment.obstacle_union.is_empty or whole.distance(environment.obstacle_union) > gap
    return bool(inside and off and all(bodies[i].distance(bodies[k]) > gap for i, k in robot.pairs))


def motions(
    space: ConfigurationSpace, rng: np.random.Generator, count: int, length: float
) -> tuple[Floats, Floats]:
    """Motions of up to a length from valid configurations."""
    starts = space.sample(rng, 40 * count)
    starts = starts[np.asarray(space.valid(starts))][:count]
    steps = rng.standard_normal(starts.shape) / space.weights
    steps *= (length * rng.random(len(starts)) / np.linalg.norm(steps * space.weights, axis=1))[:, None]
    return starts, space.wrap(starts + steps)


# Where the bodies are ---------------------------------------------------------------------------------------


def test_a_two_link_arm_by_hand() -> None:
    arm = Linkage.arm([2.0, 1.0], 0.2, base=(5.0, 4.0))
    q = np.array([math.pi / 2, -math.pi / 2])
    np.testing.assert_allclose(arm.position(q), [6.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(
        arm.position(np.array([[0.0, 0.0], [math.pi, 0.0]])), [[8, 4], [2, 4]], atol=1e-12
    )
    upper, fore = arm.place(q)
    assert upper.equals_exact(shapely.box(4.9, 4.0, 5.1, 6.0), 1e-9, normalize=True)
    assert fore.equals_exact(shapely.box(5.0, 5.9, 6.0, 6.1), 1e-9, normalize=True)
    assert arm.dimension == 2
    assert arm.radius == pytest.approx(2.0 + math.hypot(1.0, 0.1))


def test_coordinates_of_an_arm_and_of_a_snake() -> None:
    arm = ConfigurationSpace(Linkage.arm([1, 1, 1], base=(5, 5), limits=[None, 2.0, (-1.0, 0.5)]), EMPTY)
    assert arm.names == ("joint1", "joint2", "joint3")
    np.testing.assert_array_equal(arm.lower, [-math.pi, -2.0, -1.0])
    np.testing.assert_array_equal(arm.upper, [math.pi, 2.0, 0.5])
    np.testing.assert_array_equal(arm.periods, [2 * math.pi, 0, 0])
    np.testing.assert_allclose(arm.weights, [3.0, 2.0, 1.0])  # how far what each joint carries reaches
    snake = ConfigurationSpace(Linkage.snake([1, 1, 1], limits=1.0), EMPTY, rotation_weight=0.5)
    assert snake.names == ("x", "y", "joint1", "joint2", "joint3")
    np.testing.assert_array_equal(snake.upper, [10, 10, math.pi, 1.0, 1.0])
    np.testing.assert_array_equal(snake.weights, [1, 1, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(snake.robot.position(np.array([3.0, 4.0, 1.0, 1.0, 1.0])), [3.0, 4.0])


@pytest.mark.parametrize("name", ROBOTS)
def test_places_agree_with_frames(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, EMPTY)
    q = space.sample(np.random.default_rng(1), 1)[0]
    origins, headings = robot.frames(q)
    for body, placed in zip(robot.bodies, robot.place(q), strict=True):
        turned = shapely.affinity.rotate(body.outline, headings[body.joint], (0, 0), use_radians=True)
        moved = shapely.affinity.translate(turned, *origins[body.joint])
        assert placed.equals_exact(moved, 1e-9)


def placed_by_table(table: dict[str, Any], q: Floats) -> list[Floats]:
    """Where the corners of a table's bodies are, as `view.js` places them."""
    frames: list[tuple[Floats, float]] = [(np.zeros(2), 0.0)]
    for joint in table["joints"]:
        at, heading = frames[joint["parent"] + 1]
        value = q[joint["coordinate"]] if joint["coordinate"] >= 0 else joint["value"]
        offset = np.array(joint["offset"]) + value * np.array([joint["kind"] == "x", joint["kind"] == "y"])
        turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        frames.append((at + turn @ offset, heading + value * (joint["kind"] == "turn")))
    corners = []
    for body in table["bodies"]:
        at, heading = frames[body["joint"] + 1]
        turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        corners.append(at + np.reshape(body["ring"], (-1, 2)) @ turn.T)
    return corners


@pytest.mark.parametrize("name", ROBOTS)
def test_the_browser_places_bodies_where_they_are(name: str) -> None:
    robot = ROBOTS[name]
    q = ConfigurationSpace(robot, EMPTY).sample(np.random.default_rng(1), 1)[0]
    for ours, theirs in zip(robot.place(q), placed_by_table(robot_table(robot), q), strict=True):
        np.testing.assert_allclose(shapely.get_coordinates(ours)[: len(theirs)], theirs, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_point_moves_farther_than_the_displacement(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, EMPTY)
    rng = np.random.default_rng(2)
    for _ in range(50):
        q, change = space.sample(rng, 1)[0], rng.normal(size=space.dimension)
        before = shapely.get_coordinates(robot.place(q))
        after = shapely.get_coordinates(robot.place(q + change))
        assert np.hypot(*(after - before).T).max() <= robot.displacement(change) + 1e-9


# Poses ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_valid_is_what_shapely_says(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, CLUTTER)
    q = space.sample(np.random.default_rng(3), 400)
    valid = np.asarray(space.valid(q))
    assert 20 < valid.sum() < 380
    assert valid.tolist() == [truly_free(robot, CLUTTER, one) for one in q]
    assert valid.tolist() == [space.valid(one) for one in q]


@pytest.mark.parametrize("name", ROBOTS)
def test_clearance_is_the_distance_to_what_is_nearest(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, CLUTTER)
    q = space.sample(np.random.default_rng(4), 300)
    around = shapely.box(*BOUNDS).exterior
    for one, clearance in zip(q, np.asarray(space.clearance(q)), strict=True):
        bodies = robot.place(one)
        whole = shapely.union_all(bodies)
        gaps = [whole.distance(CLUTTER.obstacle_union), whole.distance(around)]
        gaps += [bodies[i].distance(bodies[k]) for i, k in robot.pairs]
        expected = min(gaps) if truly_free(robot, CLUTTER, one) else 0.0
        assert clearance == pytest.approx(expected, abs=1e-9)


def test_a_gap_at_the_tolerance() -> None:
    arm = Linkage.arm([2.0, 1.0], base=(5.0, 5.0))
    for gap, free in ((1e-3, False), (1.01e-3, True)):
        wall = Environment(BOUNDS, (shapely.box(8.0 + gap, 0, 9, 10),))
        assert ConfigurationSpace(arm, wall, tolerance=1e-3).valid([0.0, 0.0]) is free


def test_limits_hold_and_free_joints_turn_round() -> None:
    arm = Linkage.arm([1.0, 1.0], base=(5, 5), limits=[None, (-1.0, 2.0)])
    space = ConfigurationSpace(arm, EMPTY)
    assert space.valid([100.0, 2.0])
    assert not space.valid([0.0, 2.001])
    assert not space.valid([0.0, -1.001])
    assert not space.valid([0.0, 2.0 * math.pi])
    assert not space.valid([math.nan, 0.0])
    assert not space.valid([0.0, math.inf])
    assert space.first_contact([0.0, 0.0], [0.0, 4.0]) == pytest.approx(0.5)
    assert space.first_contact([0.0, 0.5], [0.0, -2.5]) == pytest.approx(0.5)
    assert space.motion_free([3.0, 0.0], [-3.0, 0.0])  # the short way round
    assert float(space.distance([3.0, 0.0], [-3.0, 0.0])) == pytest.approx(2.0 * (2 * math.pi - 6.0))


def test_a_folded_arm_collides_with_itself_only_if_asked() -> None:
    lengths, folded = [1.0, 0.5, 1.0], [0.0, math.pi * 0.75, math.pi * 0.75]
    for asked in (False, True):
        arm = Linkage.arm(lengths, 0.05, base=(5, 5), self_collision=asked)
        assert arm.pairs == ([(0, 2)] if asked else [])
        space = ConfigurationSpace(arm, EMPTY)
        assert space.valid(folded) is not asked
        assert space.valid([0.0, 0.0, 0.0])
        assert space.motion_free([0.0, 0.0, 0.0], folded) is not asked


# Motions ----------------------------------------------------------------------------------------------------


def test_a_link_that_turns_meets_a_needle_where_it_stands() -> None:
    """A thin link of length 2 turns from 0 to 90 degrees; a needle's tip lies at 45 degrees, 1 away."""
    tip = 5.0 + math.sqrt(0.5)
    needle = shapely.Polygon([(tip, tip), (tip + 0.01, tip + 1.0), (tip - 0.01, tip + 1.0)])
    space = ConfigurationSpace(
        Linkage.arm([2.0], base=(5, 5)), Environment(BOUNDS, (needle,)), tolerance=1e-6
    )
    assert space.first_contact([0.0], [math.pi / 2]) == pytest.approx(0.5, abs=2e-6)
    assert not space.motion_free([0.0], [math.pi / 2])
    assert space.motion_free([0.0], [math.pi / 4 - 1e-5])
    assert not space.motion_free([0.0], [math.pi / 4 - 1e-7])


@pytest.mark.parametrize("name", ROBOTS)
def test_no_motion_is_wrongly_free(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, clutter(7))
    rng = np.random.default_rng(5)
    starts, ends = motions(space, rng, 400, 3.0)
    free, part = space.motions_free(starts, ends), space.first_contacts(starts, ends)
    assert 0.05 < free.mean() < 0.98
    np.testing.assert_array_equal(free, space.motions_free(ends, starts))
    np.testing.assert_array_equal(free, part == 1.0)
    for a, b, t in zip(starts, ends, part, strict=True):
        along = np.linspace(0.0, t, 400)
        assert np.asarray(space.valid(np.ascontiguousarray(space.interpolate(a, b, along)))).all()
    # And few are refused that shapely finds no fault with, just beyond where they end.
    stopped = np.flatnonzero(part < 1.0)[:60]
    hits = 0
    for k in stopped:
        beyond = space.interpolate(starts[k], ends[k], np.minimum(part[k] + np.linspace(0, 1e-4, 50), 1.0))
        hits += not all(truly_free(robot, space.environment, q, space.tolerance) for q in beyond)
    assert hits >= 0.95 * len(stopped)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_any_pose_of_a_free_motion_is_valid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    robot = Linkage.arm(
        rng.uniform(0.2, 1.5, count),
        float(rng.choice([0.0, 0.02, 0.2])),
        base=rng.uniform(3, 7, 2),
        limits=None if rng.random() < 0.5 else float(rng.uniform(0.5, 7.0)),
        self_collision=bool(rng.random() < 0.5),
    )
    space = ConfigurationSpace(robot, clutter(int(rng.integers(50)), near=0.0))
    starts, ends = motions(space, rng, 20, 6.0)
    for a, b, t in zip(starts, ends, space.first_contacts(starts, ends), strict=True):
        poses = space.interpolate(a, b, np.append(rng.random(60) * t, t))
        assert np.asarray(space.valid(np.ascontiguousarray(poses))).all()


def test_a_snake_of_one_link_is_a_rigid_body() -> None:
    """The kernels of linkages and those of rigid bodies say the same of the same body."""
    snake = ConfigurationSpace(Linkage.snake([0.9], 0.3), CLUTTER, rotation_weight=0.5)
    body = Robot(shapely.box(0.0, -0.15, 0.9, 0.15))
    rigid = ConfigurationSpace(body, CLUTTER, rotation_weight=0.5)
    rng = np.random.default_rng(6)
    q = snake.sample(rng, 2000)
    np.testing.assert_array_equal(snake.valid(q), rigid.valid(q))
    np.testing.assert_allclose(snake.clearance(q), rigid.clearance(q), atol=1e-12)
    starts, ends = motions(rigid, rng, 1000, 1.5)
    np.testing.assert_array_equal(snake.distance(starts, ends), rigid.distance(starts, ends))
    np.testing.assert_array_equal(snake.motions_free(starts, ends), rigid.motions_free(starts, ends))
    ours, theirs = snake.first_contacts(starts, ends), rigid.first_contacts(starts, ends)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_many_obstacles_hang_in_a_tree() -> None:
    """More pieces than are looked at one by one: the same answers as of few at a time."""
    many = clutter(9, 150)
    robot = ROBOTS["seven links"]
    space = ConfigurationSpace(robot, many)
    parts = [ConfigurationSpace(robot, Environment(BOUNDS, many.obstacles[k : k + 50])) for k in (0, 50, 100)]
    rng = np.random.default_rng(8)
    q = space.sample(rng, 3000)
    each = np.stack([np.asarray(part.clearance(q)) for part in parts])
    np.testing.assert_array_equal(space.valid(q), (each > 0).all(axis=0))
    np.testing.assert_allclose(space.clearance(q), each.min(axis=0), atol=1e-12)
    starts, ends = motions(space, rng, 300, 2.0)
    free = np.stack([part.motions_free(starts, ends) for part in parts]).all(axis=0)
    np.testing.assert_array_equal(space.motions_free(starts, ends), free)


# Searches ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("guidance", ["rrt", "uninformed", "goal_distance", "lazy_prm", "prm"])
def test_searches_find_certified_paths(guidance: str) -> None:
    space = ConfigurationSpace(Linkage.arm([1.0] * 4, 0.1, base=(5, 5), self_collision=True), CLUTTER)
    q = space.sample(np.random.default_rng(0), 200)
    q = q[np.asarray(space.valid(q))]
    problem = Problem(space.robot, CLUTTER, Task(q[0], q[2]))
    one, two = (guided_search(problem, guidance, seed=1, max_samples=500, measure=False) for _ in range(2))
    nodes = one.tree.configurations
    np.testing.assert_array_equal(nodes, two.tree.configurations)
    assert space.motions_free(np.ascontiguousarray(nodes[one.tree.parents[1:]]), np.array(nodes[1:])).all()
    if guidance in ("rrt", "prm"):
        assert one.path is not None
        assert space.motions_free(one.path[:-1], one.path[1:]).all()


def test_a_space_survives_pickling() -> None:
    space = ConfigurationSpace(ROBOTS["tree"], CLUTTER)
    again = pickle.loads(pickle.dumps(space))
    q = space.sample(np.random.default_rng(0), 50)
    np.testing.assert_array_equal(space.valid(q), again.valid(q))
    assert again.fingerprint() == space.fingerprint()
    assert again.robot == space.robot
    assert hash(again.robot) == hash(space.robot)


def test_what_decides_collisions_decides_the_fingerprint() -> None:
    def fingerprint(**options: Any) -> str:
        return ConfigurationSpace(Linkage.arm([1.0, 1.0], base=(5, 5), **options), CLUTTER).fingerprint()

    kinds = [{}, {"width": 0.1}, {"limits": 2.0}, {"self_collision": True}]
    assert len({fingerprint(**options) for options in kinds}) == len(kinds)
    assert fingerprint(name="another") == fingerprint()


# Bad input --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Linkage.arm([]), "at least one link"),
        (lambda: Linkage.arm([1.0, -1.0]), "length of link 1: expected a positive"),
        (lambda: Linkage.arm([1.0, math.nan]), "length of link 1"),
        (lambda: Linkage.arm([1.0], -0.1), "width of link 0"),
        (lambda: Linkage.arm([1.0, 1.0], [0.1]), "expected one value or 2, got 1"),
        (lambda: Linkage.arm([1.0, 1.0], limits=[(2.0, 1.0), None]), "low < high, got 2 and 1"),
        (lambda: Linkage.arm([1.0], limits=(0.0, math.inf)), "a limit"),
        (lambda: Linkage.arm([1.0], base=(1.0, 2.0, 3.0)), r"base: expected \(x, y\)"),
        (lambda: Joint(parent=-2), "parent: expected an integer, at least -1"),
        (lambda: Linkage((Joint(parent=0),), TREE.bodies[:1], (0, (0, 0))), "a parent before it"),
        (lambda: Linkage((Joint(),), (), (0, (0, 0))), "one joint and one body"),
        (lambda: Linkage((Joint(),), (Body(1, shapely.Point(0, 0)),), (0, (0, 0))), "a body's joint"),
        (lambda: Linkage((Joint(),), (Body(0, shapely.Point(0, 0)),), (1, (0, 0))), "tool: expected a joint"),
        (lambda: Linkage((Joint(name="a"), Joint(name="a")), TREE.bodies[:1], (0, (0, 0))), "twice"),
        (lambda: Body(0, shapely.Polygon()), "must not be empty"),
    ],
)  # fmt: skip
def test_what_is_no_linkage_is_refused(make: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ([0.0, 2.5], "start has joint 'joint2' at 2.5; expected it within its limits, -2 to 2"),
        ([0.0], "start needs 2 coordinates"),
        ([1e13, 0.0], "the angle of joint 'joint1' 1e\\+13"),
        ([math.pi / 2, 0.0], "in collision with obstacle 0"),
    ],
)
def test_a_task_that_is_none_says_why(start: list[float], message: str) -> None:
    arm = Linkage.arm([1.0, 1.0], base=(5, 5), limits=[None, 2.0])
    environment = Environment(BOUNDS, (shapely.box(4, 6, 6, 7),))
    with pytest.raises(InvalidInputError, match=message):
        Problem(arm, environment, Task(start, np.zeros(len(start))))


def test_a_start_that_collides_with_itself_says_so() -> None:
    arm = Linkage.arm([1.0, 0.5, 1.0], 0.05, base=(5, 5), self_collision=True)
    with pytest.raises(InvalidInputError, match="in collision with itself, body 0 with body 2"):
        Problem(arm, EMPTY, Task([0.0, math.pi * 0.75, math.pi * 0.75], [0.0, 0.0, 0.0]))


@pytest.mark.parametrize("guidance", ["wavefront", "medial_axis(robot=same)", "skeleton(robot=same)"])
def test_guidance_for_rigid_bodies_refuses_arms(guidance: str) -> None:
    arm = Linkage.arm([1.0, 1.0], base=(5, 5))
    problem = Problem(arm, CLUTTER, Task([0.0, 0.0], [2.0, 0.0]))
    with pytest.raises(
        InvalidInputError, match=r"expected a (rigid planar robot, got 'arm|guiding space of)"
    ):
        guided_search(problem, guidance, seed=0, measure=False)
