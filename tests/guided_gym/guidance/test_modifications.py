"""What every modification of robot and environment keeps to; one row each in `ROBOTS` and `ENVIRONMENTS`."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.guidance import modifications as m
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.storage.path_library import PathLibrary

CORNER = shapely.Polygon([(3, 2), (7, 2), (7, 8), (6, 8), (6, 3), (3, 3)])  # its hull is no other polygon
BLOCK = shapely.box(1, 7, 2, 9)
E = Environment((0.0, 0.0, 10.0, 10.0), (CORNER, BLOCK))
NOTCHED = Robot.polygon([(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (0.0, -0.1), (-0.4, 0.3)])


def posed(robot: Robot | None = None) -> Problem:
    robot = Robot.rectangle(0.8, 0.3) if robot is None else robot
    turn = () if robot.dimension == 2 else (0.5,)
    return Problem(robot, E, Task((1.5, 1.5, *turn), (8.7, 6.0, *turn)))


def reaching() -> Problem:
    """An arm of four links between the corner and the block."""
    arm = Linkage.arm([0.8] * 4, 0.1, base=(5.0, 5.0), limits=(-3.0, 3.0))
    return Problem(arm, Environment(E.bounds, (BLOCK, shapely.box(7, 6, 8, 8))), Task([0.0] * 4, [2.0] * 4))


def library(problem: Problem) -> PathLibrary:
    rng = np.random.default_rng(0)
    return PathLibrary.from_paths(
        [problem.space.sample(rng, 5) for _ in range(4)], problem.space.weights, problem.space.periods
    )


ROBOTS: dict[str, Callable[[], Any]] = {
    "same": m.SameRobot,
    "point": m.Point,
    "disc": m.Disc,
    "disc(outer=true)": lambda: m.Disc(outer=True),
    "inner": m.Inner,
    "outer": m.Outer,
    "outer(0.1)": lambda: m.Outer(0.1),
    "subset": m.Subset,
    "subset([0, 2])": lambda: m.Subset([0, 2]),
    "subset(1)": lambda: m.Subset(1),
    "principal": lambda: m.Principal(library(posed())),
    "principal of 3": lambda: m.Principal(library(posed()), dimensions=3),
}
ARMS: dict[str, Callable[[], Any]] = {
    "same": m.SameRobot,
    "point": m.Point,
    "inner": m.Inner,
    "outer": lambda: m.Outer(0.05),
    "links": m.Links,
    "links(3)": lambda: m.Links(3),
    "links(4)": lambda: m.Links(4),
    "subset([0, 2])": lambda: m.Subset([0, 2]),
    "principal": lambda: m.Principal(library(reaching())),
}
DIMENSIONS = {
    "same": 3,
    "inner": 3,
    "outer": 3,
    "outer(0.1)": 3,
    "subset(1)": 1,
    "principal of 3": 3,
}  # d', where it is not 2
OF_ARMS = {"same": 4, "inner": 4, "outer": 4, "links(3)": 3, "links(4)": 4}  # likewise
ENVIRONMENTS: dict[str, Callable[[], Any]] = {
    "same": m.SameEnvironment,
    "nothing": m.Nothing,
    "without": lambda: m.Without(1),
    "shrunk": m.Shrunk,
    "hulls": m.Hulls,
    "boxes": m.Boxes,
    "revealed": m.Revealed,
    "predicted": m.Predicted,
}


def test_tables__have_a_row_here() -> None:
    names = [*ROBOTS, *ARMS]
    assert {name.partition("(")[0].partition(" ")[0] for name in names} == set(m.ROBOTS)
    assert set(ENVIRONMENTS) == set(m.ENVIRONMENTS)


@pytest.mark.parametrize(("name", "arm"), [*((n, False) for n in ROBOTS), *((n, True) for n in ARMS)])
def test_project__agrees_on_one_and_many_and_with_the_space(name: str, arm: bool) -> None:
    problem, made = (reaching(), ARMS[name]()) if arm else (posed(), ROBOTS[name]())
    space = made.space(problem.space, problem.environment, problem.task.start)
    assert space.dimension == (OF_ARMS if arm else DIMENSIONS).get(name, 2)
    q = problem.space.sample(np.random.default_rng(0), 30)
    kept = q.copy()
    states = made.project(q)
    assert np.array_equal(q, kept)
    assert states.shape == (30, space.dimension)
    for i in range(30):
        assert np.array_equal(made.project(q[i : i + 1])[0], states[i])
    assert made.project(q[:0]).shape == (0, space.dimension)
    start = made.project(problem.task.start[None])[0]
    assert isinstance(space.valid(start), bool)
    assert space.distance(start, states).shape == (30,)
    assert (space.sample(np.random.default_rng(0), 9) >= space.lower).all()
    # A projection shortens: the metric of C' is that of C as far as it goes. A plane across several
    # coordinates has no period: the angle is unrolled, and goes the long way round across the seam.
    whole = problem.space.distance(q[:15], q[15:])
    if name.startswith("principal"):
        origin = made._slice.origin
        unrolled = problem.space.difference(origin, q[:15]) - problem.space.difference(origin, q[15:])
        whole = np.linalg.norm(unrolled * problem.space.weights, axis=1)
    if arm and name == "point":  # each joint moves the tool by its turn times its reach, and they add up
        whole = np.abs(problem.space.difference(q[:15], q[15:]) * problem.space.weights).sum(axis=1)
    assert (space.distance(states[:15], states[15:]) <= whole * (1 + 1e-9)).all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
@pytest.mark.parametrize("name", ROBOTS)
def test_robot__can_be_copied_in_use(name: str, copied: Callable[[Any], Any]) -> None:
    problem, made = posed(), ROBOTS[name]()
    first = made.space(problem.space, problem.environment, problem.task.start)
    twin = copied(made)
    q = problem.space.sample(np.random.default_rng(0), 5)
    assert np.array_equal(twin.project(q), made.project(q))
    second = twin.space(problem.space, problem.environment, problem.task.start)
    assert second.fingerprint() == first.fingerprint()


@pytest.mark.parametrize("robot", [Robot.rectangle(0.8, 0.3), NOTCHED, Robot.segment(0.7)])
def test_discs__lie_inside_and_outside(robot: Robot) -> None:
    space, start = posed(robot).space, posed(robot).task.start
    inner = m.Disc().space(space, E, start).robot
    outer = m.Disc(outer=True).space(space, E, start).robot
    hollow = robot is NOTCHED  # its reference point lies in the notch: no disc around it is inside
    assert inner.radius == 0 if hollow else robot.outline.buffer(1e-9).covers(inner.outline)
    assert outer.outline.buffer(1e-9).covers(robot.outline)
    assert outer.radius == pytest.approx(robot.radius, rel=0.01)
    for angle in np.linspace(0, 2 * np.pi, 50):  # however it turns
        assert outer.outline.buffer(1e-9).covers(robot.placed((0.0, 0.0, angle)))
        assert hollow or robot.placed((0.0, 0.0, angle)).buffer(1e-9).covers(inner.outline)


def test_inner_and_outer_bodies__are_optimistic_and_conservative() -> None:
    for problem in (posed(), posed(NOTCHED), reaching()):
        q = problem.space.sample(np.random.default_rng(0), 3000)
        valid = problem.space.valid(q)
        inner, outer = (
            made.space(problem.space, problem.environment, problem.task.start).valid(q)
            for made in (m.Inner(), m.Outer(0.05))
        )
        assert valid[outer].all() and inner[valid].all()
        assert outer.sum() < valid.sum() < inner.sum()


def test_links__are_those_of_the_arm_and_optimistic() -> None:
    problem = reaching()
    made = m.Links(2)
    space = made.space(problem.space, problem.environment, problem.task.start)
    q = problem.space.sample(np.random.default_rng(0), 3000)
    states = np.ascontiguousarray(made.project(q))
    for i in range(20):
        whole, first = problem.robot.place(q[i]), space.robot.place(states[i])
        assert all(shapely.equals_exact(a, b, 1e-12) for a, b in zip(whole[:2], first, strict=True))
        assert space.robot.position(states[i]) == pytest.approx(problem.robot.frames(q[i])[0][2])
    valid, easier = problem.space.valid(q), space.valid(states)
    assert easier[valid].all() and easier.sum() > valid.sum()


@pytest.mark.parametrize(("robot", "joints"), [(posed, 0), (reaching, 4)])
def test_links__says_which_robots_it_takes(robot: Callable[[], Problem], joints: int) -> None:
    problem = robot()
    with pytest.raises(InvalidInputError, match=f"links: expected a robot with at least 5 .* with {joints}"):
        m.Links(5).space(problem.space, problem.environment, problem.task.start)


def test_point__of_an_arm_is_its_tool_in_the_workspace() -> None:
    problem, made = reaching(), m.Point()
    assert made.space(problem.space, E, problem.task.start).dimension == 2
    assert made.project(problem.task.start[None]) == pytest.approx(np.array([[8.2, 5.0]]))


def test_subset__of_positions_keeps_the_heading() -> None:
    problem = posed()
    space = m.Subset(2).space(problem.space, E, problem.task.start)
    q = problem.space.sample(np.random.default_rng(0), 200)
    q[:, 2] = problem.task.start[2]
    assert np.array_equal(space.valid(np.ascontiguousarray(q[:, :2])), problem.space.valid(q))
    assert 20 < space.valid(np.ascontiguousarray(q[:, :2])).sum() < 190


@pytest.mark.parametrize("dimensions", [[0, 2], [1, 0], [2]])
def test_subset__is_a_slice_of_c(dimensions: list[int]) -> None:
    problem, made = posed(), m.Subset(dimensions)
    space = made.space(problem.space, E, problem.task.start)
    q = np.repeat(problem.task.start[None], 100, axis=0)
    drawn = problem.space.sample(np.random.default_rng(0), 100)
    q[:, dimensions] = drawn[:, dimensions]
    states = made.project(q)
    assert states == pytest.approx(q[:, dimensions])
    assert np.array_equal(space.valid(states), problem.space.valid(q))
    assert space.distance(states[:50], states[50:]) == pytest.approx(problem.space.distance(q[:50], q[50:]))
    assert np.array_equal(
        space.motions_free(states[:50], states[50:]), problem.space.motions_free(q[:50], q[50:])
    )


def test_principal__finds_the_plane_that_paths_lie_in() -> None:
    problem = posed()
    rng = np.random.default_rng(3)
    directions = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    paths = [np.array([5.0, 5.0, 0.2]) + rng.uniform(-1, 1, (6, 2)) @ directions for _ in range(5)]
    made = m.Principal(PathLibrary.from_paths(paths, problem.space.weights, problem.space.periods))
    space: Any = made.space(problem.space, E, problem.task.start)
    for path in paths:
        assert space.lift(made.project(path)) == pytest.approx(path)
        states = made.project(path)
        assert space.distance(states[:-1], states[1:]) == pytest.approx(
            problem.space.distance(path[:-1], path[1:])
        )


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environment__is_what_it_says(name: str) -> None:
    modified = ENVIRONMENTS[name]()
    found = modified.environment(E)
    assert found.bounds == E.bounds
    before, after = E.obstacle_union, found.obstacle_union
    less = after.is_empty or before.buffer(1e-9).covers(after)
    more = after.buffer(1e-9).covers(before)
    assert modified.optimistic == (less and not more)
    assert {"same": less and more, "hulls": more and not less, "boxes": more and not less}.get(name, less)
    assert modified.environment(E) == found  # again, and the same


def test_shrunk__leaves_something_of_each_and_grows_back() -> None:
    made, space = m.Shrunk(patience=3), posed().space
    areas = [made.environment(E).obstacle_union.area]
    assert len(made.environment(E).obstacles) == len(E.obstacles)
    for _ in range(30):
        revised = made.revised(space, np.zeros(3))
        if revised is not None:
            areas.append(revised.obstacle_union.area)
    assert len(areas) > 5
    assert np.all(np.diff(areas) > 0)
    assert areas[-1] == pytest.approx(E.obstacle_union.area, rel=0.02)
    made.environment(E)
    assert made.revised(space, np.zeros(3)) is None  # as good as new: patience for three failures


@pytest.mark.parametrize("scale", [1e-6, 1e5])
def test_shrunk__has_no_length_of_its_own(scale: float) -> None:
    scaled = Environment(
        tuple(scale * x for x in E.bounds),  # type: ignore[arg-type]
        tuple(shapely.transform(o, lambda p: scale * p) for o in E.obstacles),
    )
    share = m.Shrunk().environment(E).obstacle_union.area / E.obstacle_union.area
    assert m.Shrunk().environment(scaled).obstacle_union.area / scaled.obstacle_union.area == pytest.approx(
        share, rel=1e-3
    )
    assert 0.1 < share < 0.9


def test_revealed__grows_by_what_was_hit() -> None:
    made, space = m.Revealed(), posed().space
    assert made.environment(E).obstacles == ()
    first = made.revised(space, np.array([6.5, 5.0, 0.0]))
    assert first is not None and first.obstacles == (CORNER,)
    assert made.revised(space, np.array([6.5, 4.0, 0.0])) is None  # known
    second = made.revised(space, np.array([1.5, 8.0, 0.0]))
    assert second is not None and second.obstacles == (CORNER, BLOCK)
    made.environment(E)
    assert made.revised(space, np.array([6.5, 5.0, 0.0])) is not None


def test_without__names_what_there_is() -> None:
    assert m.Without(0).environment(E).obstacles == (BLOCK,)
    assert m.Without(0, 1).environment(E).obstacles == ()
    with pytest.raises(InvalidInputError, match=r"without: expected obstacles 0 to 1, got \[2\]"):
        m.Without(2).environment(E)
    for text in ("roadmap(environment=without(0))", "roadmap(environment=without(0, 1))"):
        guided_search(posed(), text, max_samples=3, measure=False)


@pytest.mark.parametrize(
    "solver", ["straight", "exact", "roadmap(vertices=200)", "wave", "searched(goal_distance)", "skeleton"]
)
@pytest.mark.parametrize("end", ["start", "goal"])
def test_collision_in_e__of_start_or_goal_is_survived(solver: str, end: str) -> None:
    """In the hull of a corner it is no state of C': h is infinite, and the search runs."""
    inside, outside = (5.0, 4.0, 0.5), (8.7, 6.0, 0.5)
    task = Task(inside, outside) if end == "start" else Task(outside, inside)
    problem = Problem(Robot.rectangle(0.8, 0.3), E, task)
    guidance = make_guidance(solver, robot="point", environment="hulls")
    assert isinstance(guidance, Composed)
    result = guided_search(problem, guidance, seed=0, max_samples=60, measure=False)
    assert result.samples == 60 or result.solved
    h = guidance.solver(guidance.robot.project(np.array([inside, outside])))
    if solver == "straight":
        assert np.isfinite(h).all()  # sees no obstacles
        return
    assert h[0] == np.inf
    if end == "goal" and solver != "wave":  # a wave begins beside a goal that it cannot stand on
        assert h[1] == np.inf


def test_room__that_is_left_for_nobody_is_survived_or_refused() -> None:
    """A disc around the robot that fits nowhere."""
    walls = tuple(shapely.box(0, y, 10, y + 0.6) for y in np.arange(1, 9, 1.2))
    corridors = Environment((0.0, 0.0, 10.0, 10.0), walls)
    problem = Problem(Robot.rectangle(3.0, 0.1), corridors, Task((2.0, 1.9, 0.0), (8.0, 1.9, 0.0)))
    for solver in ("exact", "roadmap", "wave", "searched(goal_distance)"):
        guidance = make_guidance(solver, robot="disc(outer=true)")
        result = guided_search(problem, guidance, seed=0, max_samples=20, measure=False)
        assert result.solved or result.samples == 20
        assert np.isinf(guidance.values(result.tree)[0])
    full = Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(2, 2, 8, 8), shapely.box(0.1, 9, 9.9, 9.95)))
    around = Problem(Robot.point(), full, Task((1.0, 1.0), (9.0, 1.0)))
    guided_search(around, "skeleton(environment=boxes)", seed=0, max_samples=20, measure=False)


def test_subset__refuses_coordinates_that_a_robot_lacks() -> None:
    with pytest.raises(InvalidInputError, match=r"subset: expected coordinates 0 to 1, got \[0, 1, 2\]"):
        guided_search(posed(Robot.point()), "roadmap(robot=subset(3))", max_samples=3, measure=False)


def bounds_of_h(expression: str, problem: Problem, q: np.ndarray) -> np.ndarray:
    guidance = make_guidance(expression)
    assert isinstance(guidance, Composed)
    environment = guidance.environment.environment(problem.environment)
    space = guidance.robot.space(problem.space, environment, problem.task.start)
    states = np.ascontiguousarray(guidance.robot.project(q))
    goal = np.ascontiguousarray(guidance.robot.project(problem.task.goal[None])[0])
    from guided_gym.guidance.solvers.base import Query

    guidance.solver.begin(Query(space, states[0], goal), np.random.default_rng(0), 0.5)
    return guidance.solver(states)


# The oracle's errors are typically below 1 % (its docstring); that of two solutions on two grids adds up, and
# near the goal a share of a cell counts.
RELATIVE, CELLS = 0.04, 0.15
REMOVING = [
    "exact(robot=point)",
    "exact(robot=disc)",
    "exact(environment=nothing)",
    "exact(environment=without(0))",
    "exact(environment=shrunk)",
    "exact(environment=revealed)",
    "exact(robot=disc, environment=shrunk)",
]
ADDING = ["exact(environment=hulls)", "exact(environment=boxes)"]


@pytest.fixture(scope="module", params=["RandomTrapCup", "RandomClutter", "RandomMaze"])
def solved(request: pytest.FixtureRequest) -> list[tuple[Problem, np.ndarray, np.ndarray]]:
    """Problems with some free configurations, the start first, and their true distances."""
    found = []
    for seed in range(2):
        problem = make_distribution(request.param).problem(seed)
        drawn = problem.space.sample(np.random.default_rng(seed), 300)
        q = np.vstack([problem.task.start, drawn[problem.space.valid(drawn)]])
        found.append((problem, q, bounds_of_h("exact", problem, q)))
    return found


@pytest.mark.parametrize("expression", REMOVING)
def test_removing_constraints__never_overestimates(
    solved: list[tuple[Problem, np.ndarray, np.ndarray]], expression: str
) -> None:
    """Paper, Environment Modification: a subset of the obstacles gives h <= d_C; so does a smaller robot."""
    below = 0
    for problem, q, true in solved:
        h = bounds_of_h(expression, problem, q)
        known = np.isfinite(true)
        assert (h[known] <= true[known] * (1 + RELATIVE) + CELLS).all()
        below += (h[known] < 0.9 * true[known]).sum()
    if expression in ("exact(robot=point)", "exact(environment=nothing)"):
        assert below > 0  # these make every problem easier


@pytest.mark.parametrize("expression", ADDING)
def test_adding_constraints__never_underestimates(
    solved: list[tuple[Problem, np.ndarray, np.ndarray]], expression: str
) -> None:
    for problem, q, true in solved:
        h = bounds_of_h(expression, problem, q)
        known = np.isfinite(true)
        assert (h[known] >= true[known] * (1 - RELATIVE) - CELLS).all()


def test_outer_disc__is_conservative_in_where_it_goes_and_counts_no_turning(
    solved: list[tuple[Problem, np.ndarray, np.ndarray]],
) -> None:
    """A way of the disc is one of the robot, turned as it likes: d_C <= h + the cost of turning to the goal.

    h itself is no upper bound of d_C, since C' has no angle; with the turn at the disc's own states it is.
    """
    for problem, q, true in solved:
        h = bounds_of_h("exact(robot=disc(outer=true))", problem, q)
        known = np.isfinite(h)
        weight = problem.space.weights[2] if problem.space.dimension == 3 else 0.0
        turn = np.abs(problem.space.difference(q, problem.task.goal)[:, -1]) if weight else 0.0
        assert (true <= (h + weight * turn) * (1 + RELATIVE) + CELLS)[known].all()
