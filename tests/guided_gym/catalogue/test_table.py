"""The catalogue's problems pose what they say."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import shapely

from guided_gym.catalogue import table as catalogue
from guided_gym.catalogue.distributions import FixedProblem
from guided_gym.catalogue.table import (
    distribution_names,
    make_distribution,
    named_distribution,
    register_distribution,
)
from guided_gym.errors import InvalidInputError, NoPathError, UnknownNameError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.measure.oracle import Oracle, oracle_for
from guided_gym.options import OracleOptions
from guided_gym.problems import Problem, Task

FIXED = ["SimplePassage", "Cup", "Trap", "TrapCup"]
PAPER = [*FIXED, "RandomSimplePassage"]


@pytest.fixture(scope="module", autouse=True)
def oracle_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GUIDED_GYM_CACHE", str(tmp_path_factory.mktemp("oracle")))
        yield


def plugged(problem: Problem, *plugs: tuple[float, float, float, float]) -> Environment:
    """The problem's environment with more obstacles."""
    environment = problem.environment
    return Environment(environment.bounds, (*environment.obstacles, *(shapely.box(*p) for p in plugs)))


def test_catalogue__has_the_papers_problems() -> None:
    assert distribution_names()[: len(PAPER)] == PAPER
    assert [name for name in PAPER if make_distribution(name).fixed] == FIXED


@pytest.mark.parametrize("name", distribution_names())
def test_distribution__is_one_problem_per_seed(name: str) -> None:
    distribution = make_distribution(name)
    assert distribution.name == name
    assert distribution.summary
    problem = distribution.problem(3)
    assert problem.name == name
    assert problem.fingerprint == distribution.problem(3).fingerprint
    assert (problem.fingerprint == distribution.problem(4).fingerprint) == distribution.fixed


@pytest.mark.parametrize("name", distribution_names())
def test_problem__has_a_path(name: str) -> None:
    problem = make_distribution(name).problem(0)
    space, task = problem.space, problem.task
    quick = None if isinstance(problem.robot, Robot) else OracleOptions(resolution=(1000,))
    optimum = oracle_for(space, task.goal, task.start, quick).cost_to_go(task.start)
    assert np.isfinite(optimum)
    if name in FIXED:  # and not the straight one
        assert not space.motion_free(task.start, task.goal)
        assert optimum > space.distance(task.start, task.goal)


@pytest.mark.parametrize("name", PAPER)
def test_regions__are_disjoint_parts_of_the_workspace(name: str) -> None:
    problem = make_distribution(name).problem(0)
    regions = list(problem.regions.values())
    whole = shapely.box(*problem.environment.bounds)
    assert shapely.union_all(regions).area == pytest.approx(whole.area)
    assert sum(region.area for region in regions) == pytest.approx(whole.area)


def test_simple_passage__is_passed_by_the_robot_and_by_no_other_way() -> None:
    problem = make_distribution("SimplePassage").problem(0)
    space, task = problem.space, problem.task
    assert space.motion_free(np.array([4.0, 5, 0]), np.array([6.0, 5, 0]))
    assert not space.valid(np.array([5.0, 5.2, np.pi / 4]))
    without = ConfigurationSpace(problem.robot, plugged(problem, (4.7, 4.4, 5.3, 5.6)))
    with pytest.raises(NoPathError):
        Oracle(without, task.goal, start=task.start, cache=False)


def test_cup__is_a_dead_end_on_the_straight_way() -> None:
    problem = make_distribution("Cup").problem(0)
    space, task = problem.space, problem.task
    contact = space.interpolate(task.start, task.goal, space.first_contact(task.start, task.goal))
    cup = problem.regions["cup"]
    assert cup.contains(shapely.Point(contact[:2]))
    # Shut in at the mouth of the cup, the robot cannot get anywhere.
    x0, y0, _, y1 = cup.bounds
    shut = ConfigurationSpace(problem.robot, plugged(problem, (x0 - 0.1, y0, x0, y1)))
    with pytest.raises(NoPathError):
        Oracle(shut, task.goal, start=contact - [0.1, 0, 0], cache=False)
    # And from inside the cup, the way to the goal is longer than from its mouth.
    oracle = oracle_for(space, task.goal, start=task.start)
    assert oracle.cost_to_go(contact - [0.1, 0, 0]) > oracle.cost_to_go(np.array([x0 - 0.5, 5.0, 0.0])) + 1


@pytest.mark.parametrize(
    ("name", "x0", "x1", "detour"), [("Trap", 4.5, 5.5, (7.5, 9.5)), ("TrapCup", 2.6, 3.4, (7.8, 9.8))]
)
def test_trap__lets_a_point_through_but_never_the_robot(
    name: str, x0: float, x1: float, detour: tuple[float, float]
) -> None:
    problem = make_distribution(name).problem(0)
    space, task = problem.space, problem.task
    left, right = np.array([x0 - 0.5, 5.0]), np.array([x1 + 0.5, 5.0])
    point = ConfigurationSpace(Robot.point(), problem.environment)
    assert point.motion_free(left, right)
    assert not space.motion_free(task.start, task.goal)  # the trap lies on the straight way
    only_the_trap = plugged(problem, (x0, detour[0], x1, detour[1]))
    assert ConfigurationSpace(Robot.point(), only_the_trap).motion_free(left, right)
    with pytest.raises(NoPathError):
        Oracle(ConfigurationSpace(problem.robot, only_the_trap), task.goal, start=task.start, cache=False)
    # For the point, the way through the trap is the shorter one; the robot has to go round.
    open_way = Oracle(point, task.goal[:2], start=task.start[:2], cache=False).cost_to_go(task.start[:2])
    shut = ConfigurationSpace(Robot.point(), plugged(problem, (x0, 4.5, x1, 5.5)))
    round_it = Oracle(shut, task.goal[:2], start=task.start[:2], cache=False).cost_to_go(task.start[:2])
    optimum = oracle_for(space, task.goal, start=task.start).cost_to_go(task.start)
    assert open_way < round_it - 0.5
    assert optimum > open_way + 0.5


def test_trap_cup__meets_the_cup_beyond_the_trap() -> None:
    problem = make_distribution("TrapCup").problem(0)
    trap, cup = problem.regions["trap"], problem.regions["cup"]
    assert trap.contains(shapely.Point(problem.task.start[:2]))
    assert trap.bounds[2] < cup.bounds[2]
    straight = shapely.LineString([problem.task.start[:2], problem.task.goal[:2]])
    assert straight.intersects(cup)
    assert not cup.contains(shapely.Point(problem.task.goal[:2]))


def test_random_simple_passage__gives_problems_that_can_be_solved() -> None:
    distribution = make_distribution("RandomSimplePassage")
    gaps = set()
    for seed in range(30):
        problem = distribution.problem(seed)
        task = problem.task
        assert np.isfinite(
            Oracle(problem.space, task.goal, start=task.start, cache=False).cost_to_go(task.start)
        )
        assert task.start[0] < 4.7
        assert task.goal[0] > 5.3
        gaps.add(round(float(problem.environment.obstacles[0].bounds[3]), 6))
    assert len(gaps) == 30


def test_make_distribution__suggests_names() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'TrapCup'"):
        make_distribution("TrapCop")


def test_register_distribution__adds_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "_CATALOGUE", dict(catalogue._CATALOGUE))
    empty = Problem(Robot.point(), Environment((0.0, 0.0, 1.0, 1.0)), Task((0.1, 0.1), (0.9, 0.9)), "Empty")
    register_distribution("Empty", lambda: FixedProblem(empty))
    assert distribution_names()[-1] == "Empty"
    assert make_distribution("Empty").problem(0) is empty
    named_distribution.cache_clear()


def test_register_distribution__keeps_what_has_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "_CATALOGUE", dict(catalogue._CATALOGUE))
    cup = make_distribution("Cup")
    with pytest.raises(InvalidInputError, match="replace=True"):
        register_distribution("Cup", lambda: make_distribution("Trap"))
    assert make_distribution("Cup") is cup
    register_distribution("Cup", lambda: make_distribution("Trap"), replace=True)
    assert make_distribution("Cup").name == "Trap"
    for name, factory in (("", dict), ("a@b", dict), (3, dict), ("Free", cup.problem(0))):
        with pytest.raises(InvalidInputError, match="expected"):
            register_distribution(name, factory)  # type: ignore[arg-type]
    named_distribution.cache_clear()
