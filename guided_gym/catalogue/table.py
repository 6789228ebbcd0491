"""The catalogue: the paper's four problems and its distribution (paper, Experiments), and more to learn from.

The paper's move a 0.8 x 0.3 rectangle through a 10 x 10 workspace. Each is a `ProblemDistribution`; the fixed
ones give one problem for every seed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry

from guided_gym.catalogue import arms, spatial
from guided_gym.catalogue.buildings import building, random_building
from guided_gym.catalogue.clutter import random_clutter
from guided_gym.catalogue.distributions import FixedProblem, ProblemDistribution, SampledProblems
from guided_gym.catalogue.file_problems import file_distribution, is_file_name
from guided_gym.catalogue.mazes import (
    hard_point_maze,
    hard_stick_maze,
    random_maze,
    random_point_maze,
    snake_maze,
)
from guided_gym.catalogue.next_mazes import next_point, next_stick
from guided_gym.catalogue.shapes import SIZE, columns, cup, rectangle_robot, wall
from guided_gym.catalogue.splits import in_split
from guided_gym.catalogue.trap_cups import random_trap_cup
from guided_gym.checks import same_place, shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.geometry.environment import Environment
from guided_gym.problems import Problem, Task

PASSAGE_WIDTH = 0.9  # the robot fits with 0.3 to spare on either side
DETOUR_WIDTH = 1.4  # the way round a trap is not narrow
TRAP_WIDTH = 0.2  # a point fits, the robot never does


def _problem(
    name: str,
    obstacles: list[Polygon],
    start: tuple[float, float, float],
    goal: tuple[float, float, float],
    regions: dict[str, BaseGeometry],
) -> Problem:
    environment = Environment((0.0, 0.0, SIZE, SIZE), tuple(obstacles))
    return Problem(rectangle_robot(), environment, Task(start, goal), name, regions)


def simple_passage() -> Problem:
    """Two rooms joined by one narrow passage, on the straight way from start to goal."""
    obstacles = wall(4.7, 5.3, (5.0, PASSAGE_WIDTH))
    regions = columns(start_room=4.7, passage=5.3, goal_room=SIZE)
    return _problem("SimplePassage", obstacles, (1.5, 2.0, 0.0), (8.5, 8.0, 0.0), regions)


def cup_problem() -> Problem:
    """A C-shaped dead end on the straight way: it misleads planners that ignore obstacles."""
    obstacles = cup(3.5, 7.0, 2.5, 7.5, 0.5)
    regions: dict[str, BaseGeometry] = {"cup": box(3.5, 2.5, 7.0, 7.5)}
    regions["around"] = box(0, 0, SIZE, SIZE).difference(regions["cup"])
    return _problem("Cup", obstacles, (1.5, 5.0, 0.0), (8.5, 5.0, 0.0), regions)


def trap() -> Problem:
    """Two passages: the first, on the straight way, fits a point but never the robot."""
    obstacles = wall(4.5, 5.5, (5.0, TRAP_WIDTH), (8.5, DETOUR_WIDTH))
    regions = columns(trap=4.5, passage=5.5, goal_room=SIZE)
    return _problem("Trap", obstacles, (1.5, 5.0, 0.0), (8.5, 5.0, 0.0), regions)


def trap_cup() -> Problem:
    """First the trap, then the cup, from centre-left to centre-right.

    The cup hangs from the ceiling: who took the valid passage, at the top, has to come down around it.
    """
    obstacles = wall(2.6, 3.4, (5.0, TRAP_WIDTH), (8.8, DETOUR_WIDTH))
    obstacles += [*cup(5.4, 8.2, 2.4, 7.6, 0.4), box(7.8, 7.6, 8.2, SIZE)]
    inside = box(4.4, 2.0, 8.2, SIZE)
    regions: dict[str, BaseGeometry] = {"trap": box(0, 0, 3.4, SIZE), "cup": inside}
    regions["beyond"] = box(3.4, 0, SIZE, SIZE).difference(inside)
    return _problem("TrapCup", obstacles, (1.0, 5.0, 0.0), (9.2, 5.0, 0.0), regions)


def random_simple_passage(rng: np.random.Generator) -> Problem:
    """Two rooms joined by a narrow passage at a random height; start and goal anywhere in their rooms."""
    gap = rng.uniform(1.0, 9.0)
    start = (rng.uniform(0.8, 3.6), rng.uniform(0.8, 9.2), rng.uniform(-np.pi, np.pi))
    goal = (rng.uniform(6.4, 9.2), rng.uniform(0.8, 9.2), rng.uniform(-np.pi, np.pi))
    obstacles = wall(4.7, 5.3, (gap, PASSAGE_WIDTH))
    regions = columns(start_room=4.7, passage=5.3, goal_room=SIZE)
    return _problem("RandomSimplePassage", obstacles, start, goal, regions)


def _summary(function: Callable[..., Problem]) -> str:
    return (function.__doc__ or "").partition("\n")[0]


def _fixed(build: Callable[[], Problem]) -> Callable[[], ProblemDistribution]:
    return lambda: FixedProblem(build(), _summary(build))


def _drawn(
    name: str, draw: Callable[[np.random.Generator], Problem], angles: int = 1
) -> Callable[[], ProblemDistribution]:
    return lambda: SampledProblems(name, draw, _summary(draw), angles)


# One row per problem or distribution: a new one joins by adding a row, here or by `register_distribution`.
_CATALOGUE: dict[str, Callable[[], ProblemDistribution]] = {
    "SimplePassage": _fixed(simple_passage),
    "Cup": _fixed(cup_problem),
    "Trap": _fixed(trap),
    "TrapCup": _fixed(trap_cup),
    "RandomSimplePassage": _drawn("RandomSimplePassage", random_simple_passage),
    "RandomTrapCup": _drawn("RandomTrapCup", random_trap_cup),
    "RandomClutter": _drawn("RandomClutter", random_clutter),
    "RandomMaze": _drawn("RandomMaze", random_maze),
    "RandomPointMaze": _drawn("RandomPointMaze", random_point_maze),
    "HardPointMaze": _drawn("HardPointMaze", hard_point_maze),
    "HardStickMaze": _drawn("HardStickMaze", hard_stick_maze),
    "Building": _fixed(building),
    "RandomBuilding": _drawn("RandomBuilding", random_building),
    "PlanarArm2": _fixed(arms.planar_arm_2),
    "PlanarArm4": _fixed(arms.planar_arm_4),
    "PlanarArm7": _fixed(arms.planar_arm_7),
    "RandomPlanarArm4": _drawn("RandomPlanarArm4", arms.random_planar_arm_4, angles=4),
    "RandomPlanarArm7": _drawn("RandomPlanarArm7", arms.random_planar_arm_7, angles=7),
    "Snake7": _drawn("Snake7", snake_maze, angles=5),
    "SpatialArm": _fixed(spatial.spatial_arm),
    "RandomSpatialArm": _drawn("RandomSpatialArm", spatial.random_spatial_arm, angles=7),
}

# Known by name but not listed: they need files that do not come with the package.
_FROM_FILES: dict[str, Callable[[], ProblemDistribution]] = {
    "NextPoint": next_point,
    "NextStick": next_stick,
}


@door
def register_distribution(
    name: str, factory: Callable[[], ProblemDistribution], *, replace: bool = False
) -> None:
    """Add a distribution under a name, for `make_distribution`, the command line and `gym.make` options.

    Args:
        name: A word without ``@``, commas or blanks.
        factory: Makes the distribution. Registering the same function again changes nothing.
        replace: Whether it may replace another distribution of that name.

    Raises:
        InvalidInputError: The name is not a word, or is taken, or the factory is not a function.
    """
    if not isinstance(name, str) or not name or set(name) & set("@, "):
        raise InvalidInputError(f"name: expected a word without '@', ',' or blanks, got {shown(name)}")
    if not callable(factory):
        raise InvalidInputError(f"factory: expected a function without arguments, got {shown(factory)}")
    taken = (_FROM_FILES | _CATALOGUE).get(name)
    if not replace and taken is not None and not same_place(taken, factory):
        raise InvalidInputError(
            f"environment {name!r}: expected a name that is free, got one that is taken; "
            "replace=True replaces it"
        )
    _CATALOGUE[name] = factory
    named_distribution.cache_clear()


@door
def distribution_names() -> list[str]:
    """Names of the catalogue, in order of appearance."""
    return list(_CATALOGUE)


@door
def make_distribution(name: str) -> ProblemDistribution:
    """The distribution of that name, or with ``name@split`` its train, validation or test problems.

    Args:
        name: A name of the catalogue, or a problem file (``.toml``, ``.json``) or MovingAI ``.scen``.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
        StorageError: The distribution's file cannot be read.
        InvalidInputError: A problem file whose problem cannot be used.
    """
    if name not in _CATALOGUE and is_file_name(name):
        return file_distribution(name)
    return named_distribution(name)


@cache
def named_distribution(name: str) -> ProblemDistribution:
    """`make_distribution` for names; it keeps what it has made."""
    if "@" in name and name not in _CATALOGUE:
        whole, _, split = name.rpartition("@")
        return in_split(make_distribution(whole), split)
    known = _FROM_FILES | _CATALOGUE
    if name not in known:
        raise UnknownNameError("environment", name, known)
    return known[name]()
