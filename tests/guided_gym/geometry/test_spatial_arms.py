"""Arms in space: where their bodies are, which configurations are valid, and which motions are free."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.fitting import capsule_around, capsule_of_cylinder, capsules_around
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.solids import VIEW, Box, Capsule, Cylinder, Solid, SpatialEnvironment, rotation
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm, SpatialBody, SpatialJoint, point_in_space
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

Floats = npt.NDArray[np.float64]

ROOM = (-1.6, -1.6, -0.2, 1.6, 1.6, 1.9)
EMPTY = SpatialEnvironment(ROOM)


def solids(seed: int, count: int = 24) -> SpatialEnvironment:
    """Random solids of each kind that leave the axis of the arms free."""
    rng = np.random.default_rng(seed)
    found: list[Solid] = []
    while len(found) < count:
        x, y, z = rng.uniform([-1.4, -1.4, 0.0], [1.4, 1.4, 1.7])
        if math.hypot(x, y) < 0.45:
            continue
        end = (x + rng.uniform(-0.3, 0.3), y + rng.uniform(-0.3, 0.3), z + rng.uniform(-0.3, 0.3))
        radius = float(rng.uniform(0.03, 0.15))
        made: list[Solid] = [
            Box((x, y, z), tuple(rng.uniform(0.05, 0.4, 3).tolist()), tuple(rng.uniform(-3, 3, 3).tolist())),
            Cylinder((x, y, z), end, radius),
            Capsule((x, y, z), end, radius),
            Capsule.sphere((x, y, z), radius),
        ]
        found.append(made[len(found) % 4])
    return SpatialEnvironment(ROOM, found)


CLUTTER = solids(0)


def chain(joints: list[SpatialJoint], length: float = 0.2, **options: Any) -> SpatialArm:
    """An arm with a capsule on each joint, and a foot."""
    bodies = [SpatialBody(-1, Capsule((0, 0, 0), (0, 0, 0.2), 0.1))]
    bodies += [SpatialBody(k, Capsule((0, 0, 0), (0.02, 0, length), 0.05)) for k in range(len(joints))]
    return SpatialArm(tuple(joints), tuple(bodies), (len(joints) - 1, (0.0, 0.0, 0.1)), **options)


def row(count: int, **options: Any) -> SpatialArm:
    """Joints about z and y in turn."""
    axes = [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]
    joints = [
        SpatialJoint(
            (0, 0, 0.3 if k == 0 else 1.2 / count), axes[k % 2], limits=None if k % 2 == 0 else (-2, 2)
        )
        for k in range(count)
    ]
    return chain(joints, **options)


ROBOTS: dict[str, SpatialArm] = {
    "two joints": row(2, length=0.9),
    "seven joints": row(7, self_collision=True),
    "nine joints": row(9, length=0.08, self_collision=True),
    "odd axes, a slide and one that follows": chain(
        [
            SpatialJoint((0, 0, 0.3), (0, 0, 2)),
            SpatialJoint((0, 0, 0.25), (0.3, 1, 0), rotation((0.1, 0.2, -0.3)), (-2, 2), name="b"),
            SpatialJoint((0.05, 0, 0.2), (0, 0, 1), limits=(-0.1, 0.3), slides=True),
            SpatialJoint((0, 0, 0.25), (0, -1, 0), rotation((0, 0, 1)), follows=("b", -0.5, 0.2)),
            SpatialJoint((0, 0.02, 0.25), (1, 0, 0.2)),
        ],
        self_collision=True,
    ),
    "point": point_in_space(CLUTTER),
}


# What everything is held against: nothing of it is shared with the kernels ----------------------------------


def reference_bodies(robot: SpatialArm, q: Floats) -> list[tuple[int, Floats, Floats, float]]:
    """Joint, ends and radius of each body, by rotations of scipy."""
    values: dict[str, float] = {}
    turned, at = Rotation.identity(), np.zeros(3)
    frames, k = [], 0
    for joint in robot.joints:
        if joint.follows is None:
            values[joint.name], k = float(q[k]), k + 1
        else:
            name, factor, shift = joint.follows
            values[joint.name] = factor * values[name] + shift
        at = at + turned.apply(joint.offset)
        turned = turned * Rotation.from_matrix(np.array(joint.turned))
        if joint.slides:
            at = at + turned.apply(np.array(joint.axis) * values[joint.name])
        else:
            turned = turned * Rotation.from_rotvec(np.array(joint.axis) * values[joint.name])
        frames.append((turned, at))
    placed = []
    for body in robot.bodies:
        ends = [np.array(body.shape.start), np.array(body.shape.end)]
        if body.joint >= 0:
            turned, at = frames[body.joint]
            ends = [turned.apply(end) + at for end in ends]
        placed.append((body.joint, ends[0], ends[1], body.shape.radius))
    return placed


def reference_distance(solid: Solid, points: Floats) -> Floats:
    """Distances of points (n, 3) from a solid, 0 inside."""
    if isinstance(solid, Box):
        local = Rotation.from_euler("xyz", solid.rpy).inv().apply(points - np.array(solid.centre))
        return np.linalg.norm(np.maximum(np.abs(local) - 0.5 * np.array(solid.sides), 0.0), axis=-1)
    assert isinstance(solid, Capsule | Cylinder)
    a, b = np.array(solid.start), np.array(solid.end)
    length = np.linalg.norm(b - a)
    if isinstance(solid, Capsule):
        part = ((points - a) @ (b - a) / max(length**2, 1e-300)).clip(0, 1)
        away = np.linalg.norm(points - a - part[:, None] * (b - a), axis=-1)
        return np.maximum(away - solid.radius, 0.0)
    axis = (b - a) / length
    along = (points - 0.5 * (a + b)) @ axis
    aside = np.linalg.norm(points - 0.5 * (a + b) - along[:, None] * axis, axis=-1)
    return np.hypot(np.maximum(aside - solid.radius, 0.0), np.maximum(np.abs(along) - 0.5 * length, 0.0))


def from_segment(solid: Solid, a: Floats, b: Floats) -> float:
    """The least distance along a segment, looked at ever closer: the distance from a convex set is convex."""
    low, high = 0.0, 1.0
    for _ in range(6):
        parts = np.linspace(low, high, 65)
        near = reference_distance(solid, a + parts[:, None] * (b - a))
        k = int(np.argmin(near))
        low, high = parts[max(k - 1, 0)], parts[min(k + 1, 64)]
    return float(near.min())


def reference_clearance(robot: SpatialArm, environment: SpatialEnvironment, q: Floats) -> float:
    """The least gap; 0 or less in collision."""
    placed = reference_bodies(robot, q)
    room = np.array(environment.room)
    gaps = []
    for joint, a, b, radius in placed:
        if joint < 0:
            continue
        for end in (a, b):
            gaps += [*(end - room[:3] - radius), *(room[3:] - end - radius)]
        for solid in environment.solids:
            low, high = solid.box()  # what is far away cannot be the nearest
            apart = np.maximum(low - np.maximum(a, b), np.minimum(a, b) - high).max() - radius
            if apart < min(gaps):
                gaps.append(from_segment(solid, a, b) - radius)
    for i, k in robot.pairs:
        one, two = placed[i], placed[k]
        core = Capsule(tuple(one[1].tolist()), tuple(one[2].tolist()), one[3])  # type: ignore[arg-type]
        gaps.append(from_segment(core, two[1], two[2]) - two[3])
    return min(gaps)


# Where the bodies are ---------------------------------------------------------------------------------------


def test_an_arm_of_two_joints_by_hand() -> None:
    arm = SpatialArm(
        (SpatialJoint((0, 0, 1)), SpatialJoint((1, 0, 0), (0, 1, 0))),
        (
            SpatialBody(0, Capsule((0, 0, 0), (1, 0, 0), 0.1)),
            SpatialBody(1, Capsule((0, 0, 0), (0.5, 0, 0), 0.1)),
        ),
        (1, (0.5, 0.0, 0.0)),
    )
    np.testing.assert_allclose(arm.tool_at(np.array([0.0, 0.0])), [1.5, 0, 1], atol=1e-12)
    # A quarter turn to the left, and half a right angle down: y is turned about by the right hand.
    np.testing.assert_allclose(arm.tool_at(np.array([math.pi / 2, math.pi / 2])), [0, 1, 0.5], atol=1e-12)
    np.testing.assert_allclose(arm.reaches, [1.6, 0.6])
    upper, fore = arm.capsules([math.pi / 2, math.pi / 2])
    np.testing.assert_allclose(upper.end, [0, 1, 1], atol=1e-12)
    np.testing.assert_allclose(fore.end, [0, 1, 0.5], atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_bodies_are_where_scipy_turns_them(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, EMPTY)
    for q in space.sample(np.random.default_rng(1), 5):
        for capsule, (_, a, b, _) in zip(robot.capsules(q), reference_bodies(robot, q), strict=True):
            np.testing.assert_allclose([capsule.start, capsule.end], [a, b], atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_point_moves_farther_than_the_displacement(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, EMPTY)
    rng = np.random.default_rng(2)
    for _ in range(20):
        q, change = space.sample(rng, 1)[0], 0.5 * rng.normal(size=space.dimension)
        after = np.clip(q + change, space.lower, space.upper)
        before = [end for _, a, b, _ in reference_bodies(robot, q) for end in (a, b)]
        moved = [end for _, a, b, _ in reference_bodies(robot, after) for end in (a, b)]
        most = np.linalg.norm(np.array(moved) - before, axis=1).max()
        assert most <= robot.displacement(after - q) + 1e-9


def test_coordinates_follow_and_turn_freely() -> None:
    robot = ROBOTS["odd axes, a slide and one that follows"]
    space = ConfigurationSpace(robot, EMPTY)
    assert space.names == ("joint1", "b", "joint3", "joint5")
    np.testing.assert_allclose(space.periods, [2 * math.pi, 0, 0, 2 * math.pi])
    assert space.weights[2] == 1.0  # a slide counts as it is
    limited = chain(
        [SpatialJoint(limits=(-2, 2), name="a"), SpatialJoint((0, 0, 1), limits=(-1, 3), follows=("a", 2, 0))]
    )
    np.testing.assert_allclose(ConfigurationSpace(limited, EMPTY).lower, [-0.5])
    np.testing.assert_allclose(ConfigurationSpace(limited, EMPTY).upper, [1.5])


def test_pictures_are_projections() -> None:
    np.testing.assert_allclose(VIEW @ VIEW.T, np.eye(2), atol=1e-12)
    robot = ROBOTS["seven joints"]
    q = np.full(7, 0.3)
    for shape, (_, a, b, radius) in zip(robot.place(q), reference_bodies(robot, q), strict=True):
        line = shapely.LineString(np.array([a, b]) @ VIEW.T)
        assert shape.hausdorff_distance(line.buffer(radius)) < 0.05 * radius
    np.testing.assert_allclose(robot.position(q), VIEW @ robot.tool_at(q))
    for solid, shadow in zip(CLUTTER.solids, CLUTTER.obstacles, strict=True):
        low, high = solid.box()
        points = np.random.default_rng(0).uniform(low, high, (400, 3))
        inside = points[reference_distance(solid, points) == 0]
        assert len(inside) > 20
        assert shapely.contains_xy(shadow.buffer(0.01), inside @ VIEW.T).all()


# Poses ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_valid_and_clearance_are_those_of_the_reference(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, CLUTTER)
    qs = space.sample(np.random.default_rng(3), 40)
    expected = np.array([reference_clearance(robot, CLUTTER, q) for q in qs])
    valid = np.asarray(space.valid(qs))
    assert 3 < valid.sum() < 40 or name == "point"
    assert valid.tolist() == (expected > space.tolerance).tolist()
    np.testing.assert_allclose(space.clearance(qs), np.where(valid, expected, 0.0), atol=1e-6)


@pytest.mark.parametrize("solid", CLUTTER.solids[:4], ids=["box", "cylinder", "capsule", "sphere"])
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=3807)  # a long segment that almost touches the cylinder
@settings(max_examples=60, deadline=None)
def test_the_gap_of_a_segment_is_its_distance(solid: Solid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle = np.mean(solid.box(), axis=0)
    a = middle + rng.normal(size=3) * rng.choice([0.1, 0.3, 2.0])
    b = a + rng.normal(size=3) * rng.choice([0.0, 1e-6, 0.3, 3.0])
    expected = from_segment(solid, a, b)
    found = solid.gap(a, b)
    if expected > 1e-6:
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert found <= expected + 1e-12
    else:
        assert found <= 2e-6


def test_limits_and_numbers_that_are_none() -> None:
    space = ConfigurationSpace(ROBOTS["two joints"], EMPTY)
    assert space.valid([100.0, 2.0])
    assert not space.valid([0.0, 2.001])
    assert not space.valid([0.0, math.nan])
    assert not space.valid([math.inf, 0.0])
    assert space.first_contact([0.0, 0.0], [0.0, 4.0]) == pytest.approx(0.5)
    assert space.motion_free([3.0, 0.0], [-3.0, 0.0])  # the short way round


def test_what_stays_with_the_base_may_touch_the_world() -> None:
    table = SpatialEnvironment(ROOM, [Box.between((-0.5, -0.5, -0.1), (0.5, 0.5, 0.0))])
    assert ConfigurationSpace(ROBOTS["two joints"], table).valid([0.0, 0.0])


# Motions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_no_motion_is_wrongly_free(name: str) -> None:
    robot = ROBOTS[name]
    space = ConfigurationSpace(robot, CLUTTER)
    rng = np.random.default_rng(4)
    starts = space.sample(rng, 800)
    starts = starts[np.asarray(space.valid(starts))][:30]
    steps = rng.normal(size=starts.shape) * rng.choice([0.1, 0.6], (len(starts), 1))
    ends = space.wrap(
        np.where(space.periods > 0, starts + steps, np.clip(starts + steps, space.lower, space.upper))
    )
    free, parts = space.motions_free(starts, ends), space.first_contacts(starts, ends)
    back = space.motions_free(ends, starts)
    assert free.tolist() == back.tolist()
    assert 5 < free.sum() < len(starts)
    for a, b, whole, part in zip(starts, ends, free, parts, strict=True):
        on = space.interpolate(a, b, np.linspace(0.0, part, 8))
        assert min(reference_clearance(robot, CLUTTER, q) for q in on) > space.tolerance * (1 - 1e-9)
        if not whole:  # what is refused does collide, or nearly so
            beyond = space.interpolate(a, b, min(1.0, part + 1e-4) * np.ones(1))
            assert reference_clearance(robot, CLUTTER, beyond[0]) < 1e-2


def test_a_grazing_motion() -> None:
    """A link swings past a ball, at gaps on either side of the tolerance."""
    arm = SpatialArm(
        (SpatialJoint(),), (SpatialBody(0, Capsule((0.2, 0, 0), (1, 0, 0), 0.0)),), (0, (1.0, 0.0, 0.0))
    )
    for gap, free in ((-1e-6, False), (0.9e-4, False), (1.1e-4, True)):
        ball = Capsule.sphere((0.0, 1.2 + gap, 0.0), 0.2)
        space = ConfigurationSpace(arm, SpatialEnvironment((-2, -2, -2, 2, 2, 2), [ball]), tolerance=1e-4)
        assert space.motion_free([0.3], [2.9]) is free


# Searches ---------------------------------------------------------------------------------------------------


SHELF = SpatialEnvironment(
    ROOM,
    [Box.between((0.35, -0.8, z), (0.9, 0.8, z + 0.03)) for z in (0.2, 0.75)]
    + [Capsule.sphere((0, 0, 1.75), 0.1)],
)


def shelf_problem() -> Problem:
    """From above the upper board to between the two."""
    return Problem(row(4), SHELF, Task((0.6, 0.9, 0.0, 0.4), (0.27, 1.74, 1.98, -1.99)), "shelf")


@pytest.mark.parametrize(
    "guidance",
    [
        "rrt",
        "roadmap(robot=inner)",
        "roadmap(robot=outer(margin=0.01))",
        "roadmap(robot=point, vertices=200)",
        "roadmap(robot=links(3))",
        "roadmap(environment=without(1))",
        "roadmap(environment=shrunk)",
        "roadmap(environment=boxes)",
        "roadmap(environment=revealed)",
        "lazy_prm",
    ],
)
def test_guided_searches_run(guidance: str) -> None:
    problem = shelf_problem()
    result = guided_search(problem, guidance, seed=0, max_samples=60, measure=False)
    assert len(result.tree) > 1
    again = guided_search(problem, guidance, seed=0, max_samples=60, measure=False)
    np.testing.assert_array_equal(result.tree.configurations, again.tree.configurations)


def test_what_the_plane_knows_is_refused() -> None:
    for guidance in ("wavefront", "roadmap(robot=disc)"):
        with pytest.raises(InvalidInputError):
            guided_search(shelf_problem(), guidance, seed=0, max_samples=10, measure=False)


def test_pickled_spaces_answer_alike() -> None:
    space = ConfigurationSpace(ROBOTS["seven joints"], CLUTTER)
    again = pickle.loads(pickle.dumps(space))
    qs = space.sample(np.random.default_rng(0), 50)
    assert space.valid(qs).tolist() == again.valid(qs).tolist()
    assert space.fingerprint() == again.fingerprint()
    assert space.fingerprint() != ConfigurationSpace(ROBOTS["seven joints"], solids(1)).fingerprint()


# Bodies that are fitted -------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_fitted_capsules_hold_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = (
        rng.normal(size=(30, 3)) * rng.uniform(0.01, 1.0, 3) @ Rotation.random(random_state=seed).as_matrix()
    )
    assert (reference_distance(capsule_around(points), points) <= 1e-12).all()
    triangles = points.reshape(-1, 3, 3)
    parts = capsules_around(triangles, 3)
    inside = np.min([reference_distance(part, points) for part in parts], axis=0)
    assert (inside <= 1e-12).all()


def test_a_fitted_capsule_of_a_rod_is_as_thin() -> None:
    ring = [(0.1 * math.cos(t), 0.1 * math.sin(t)) for t in np.linspace(0, 2 * math.pi, 24, endpoint=False)]
    rod = np.array([(x, y, z) for x, y in ring for z in (-1.0, 1.0)])
    fitted = capsule_around(rod @ np.array(rotation((0.5, 0.3, 0.2))).T)
    exact = capsule_of_cylinder(0.1, 2.0)
    assert fitted.size[0] < 1.05 * exact.size[0]
    assert exact.radius < 0.14
    assert (reference_distance(exact, rod) <= 1e-9).all()


# Bad input --------------------------------------------------------------------------------------------------


def test_what_is_no_arm_is_refused() -> None:
    body = SpatialBody(0, Capsule.sphere((0, 0, 0), 0.1))
    joint = SpatialJoint(name="a")
    for joints, bodies, what in [
        ((), (body,), "needs at least one joint"),
        ((joint,), (SpatialBody(-1, body.shape),), "a body on it"),
        ((joint,), (SpatialBody(1, body.shape), body), "a body's joint"),
        ((joint, SpatialJoint(name="a")), (body,), "twice"),
        ((joint, SpatialJoint(follows=("b", 1, 0))), (body,), "follows 'b'"),
        (
            (SpatialJoint(limits=(0, 1), name="a"), SpatialJoint(limits=(5, 6), follows=("a", 1, 0))),
            (body,),
            "room",
        ),
    ]:
        with pytest.raises(InvalidInputError, match=what):
            SpatialArm(joints, bodies, (0, (0.0, 0.0, 0.0)))
    for wrong in (
        {"axis": (0, 0, 0)},
        {"limits": (1.0, 1.0)},
        {"slides": True},
        {"offset": (0, 0)},
        {"turned": ((1, 0, 0), (0, 2, 0), (0, 0, 1))},
    ):
        with pytest.raises(InvalidInputError):
            SpatialJoint(**wrong)  # type: ignore[arg-type]


def test_what_is_no_room_is_refused() -> None:
    for room, made in [
        ((0, 0, 0, 1, 1, 0), ()),
        ((0, 0, 1, 1), ()),
        ((0, 0, 0, 1, 1, math.nan), ()),
        ((0, 0, 0, 1, 1, 1), (Box((5, 5, 5), (1, 1, 1)),)),
        ((0, 0, 0, 1, 1, 1), (shapely.box(0, 0, 1, 1),)),
    ]:
        with pytest.raises(InvalidInputError):
            SpatialEnvironment(room, made)  # type: ignore[arg-type]
    for make in (
        lambda: Box((0, 0, 0), (1, 0, 1)),
        lambda: Cylinder((0, 0, 0), (0, 0, 0), 1),
        lambda: Capsule((0, 0, 0), (0, 0, 1), -1),
    ):
        with pytest.raises(InvalidInputError):
            make()
    with pytest.raises(InvalidInputError, match="SpatialEnvironment"):
        ConfigurationSpace(ROBOTS["two joints"], Environment((0, 0, 1, 1)))
    with pytest.raises(InvalidInputError):
        ConfigurationSpace(Robot.point(), EMPTY)


def test_a_start_that_is_not_free_says_why() -> None:
    def problem(start: tuple[float, float, float, float]) -> Problem:
        return Problem(row(4), SHELF, Task(start, (0.6, 0.9, 0.0, 0.4)))

    for start, what in [
        ((0.0, 2.5, 0.0, 0.0), "joint 'joint2' at 2.5; expected it within its limits, -2 to 2"),
        ((0.0, 1.2, 0.0, 0.5), "in collision with obstacle 1"),
    ]:
        with pytest.raises(InvalidInputError, match=what):
            problem(start)
    narrow = SpatialEnvironment((-0.7, -0.7, -0.2, 0.7, 0.7, 1.9))
    with pytest.raises(InvalidInputError, match=r"crossing the bounds .* at xmax = 0\.7"):
        Problem(row(4), narrow, Task((0.0, 1.5, 0.0, 0.0), (0.0, 0.1, 0.0, 0.0)))
    with pytest.raises(InvalidInputError, match="in collision with itself, body"):
        joints = [SpatialJoint((0, 0, 0.3), (0, 1, 0), limits=(-2, 2)) for _ in range(3)]
        folded = chain(joints, 0.3, self_collision=True)
        Problem(folded, EMPTY, Task((0.0, 2.0, 2.0), (0.0, 0.1, 0.0)))
