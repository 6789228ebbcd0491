"""Motion planning problems M = (r, E, s, t) and distributions over them (paper, Preliminaries)."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from guided_gym.checks import instance, integer
from guided_gym.environment import Environment
from guided_gym.errors import InvalidInputError
from guided_gym.robots import Robot
from guided_gym.space import ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Task:
    """A task (s, t): where a search starts and where it has to end.

    Attributes:
        start: (d,) float64 configuration s.
        goal: (d,) float64 configuration t.

    Raises:
        InvalidInputError: A coordinate is NaN or infinite, or the two have different shapes.
    """

    start: NDArray[np.float64]
    goal: NDArray[np.float64]

    def __init__(self, start: ArrayLike, goal: ArrayLike) -> None:
        for name, value in (("start", start), ("goal", goal)):
            try:
                array = np.array(value, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InvalidInputError(f"{name}: expected a vector of numbers, got {value!r}") from error
            if array.ndim != 1 or not np.isfinite(array).all():
                raise InvalidInputError(f"{name}: expected a vector of finite numbers, got {value!r}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.start.shape != self.goal.shape:
            raise InvalidInputError(
                f"task: start has {self.start.size} coordinates but goal has {self.goal.size}"
            )


@dataclass(frozen=True, eq=False)
class Problem:
    """A motion planning problem M = (r, E, s, t).

    Attributes:
        robot: The robot r.
        environment: The environment E.
        task: The task (s, t), its angles brought into [-pi, pi).
        name: What tables and figures call it.
        regions: Named parts of the workspace (shapely), for the metric per region (paper, Axes for
            Evaluating Guidance). May be empty; regions may leave gaps.
        rotation_weight: Length per radian in the distance; None for the robot's circumradius.

    Raises:
        InvalidInputError: A part of another type, a rotation weight that is not positive, or a start or goal
            that has the wrong dimension, is out of bounds or touches them, or is in collision.
    """

    robot: Robot
    environment: Environment
    task: Task
    name: str = "problem"
    regions: Mapping[str, BaseGeometry] = field(default_factory=dict)
    rotation_weight: float | None = None

    def __post_init__(self) -> None:
        instance("task", self.task, Task)
        _check_regions(self.regions)
        space = self.space
        for label, q in (("start", self.task.start), ("goal", self.task.goal)):
            if q.size != space.dimension:
                raise InvalidInputError(
                    f"{self.name}: {label} needs {space.dimension} coordinates for robot "
                    f"{self.robot.name!r}, got {q.size}"
                )
            outside = (q < space.lower) | (q > space.upper)
            if (outside & (space.periods == 0)).any():
                raise InvalidInputError(
                    f"{self.name}: {label} {q.tolist()} is out of bounds "
                    f"{space.lower.tolist()} to {space.upper.tolist()}"
                )
            if not space.valid(q):
                raise InvalidInputError(
                    f"{self.name}: {label} {q.tolist()} is {self._trouble(q)}; expected a free pose"
                )
        task = Task(space.wrap(self.task.start), space.wrap(self.task.goal))
        object.__setattr__(self, "task", task)

    def _trouble(self, q: NDArray[np.float64]) -> str:
        """Whether a pose that is not valid hits an obstacle or the bounds."""
        bounds = shapely.box(*self.environment.bounds)
        inside = bounds.contains_properly(self.robot.placed(q))
        return "in collision" if inside else f"touching or crossing the bounds {self.environment.bounds}"

    @cached_property
    def space(self) -> ConfigurationSpace:
        """The configuration space C = (r, E)."""
        return ConfigurationSpace(self.robot, self.environment, self.rotation_weight)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the problem's content, the same in every process."""
        digest = hashlib.sha256(self.space.fingerprint().encode())
        digest.update(self.task.start.tobytes() + self.task.goal.tobytes())
        return digest.hexdigest()


def _check_regions(regions: object) -> None:
    if not isinstance(regions, Mapping):
        raise InvalidInputError(f"regions: expected names with shapely geometries, got {regions!r}")
    for name, region in regions.items():
        if not (isinstance(name, str) and isinstance(region, BaseGeometry)):
            raise InvalidInputError(
                f"regions: expected names with shapely geometries, got {name!r}: {region!r}"
            )


class ProblemDistribution(ABC):
    """A distribution D over problems, indexed by seed: the same seed is the same problem everywhere.

    Attributes:
        name: What tables, databases and figures call it.
        fixed: True when every seed gives one and the same problem.
        summary: One line for lists of problems.
    """

    name: str
    fixed: bool = False
    summary: str = ""

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> Problem:
        """Draw one problem M ~ D."""

    def problem(self, seed: int) -> Problem:
        """The problem of one seed.

        Raises:
            InvalidInputError: The seed is no integer >= 0.
        """
        return self.sample(np.random.default_rng(integer("seed", seed, least=0)))


class FixedProblem(ProblemDistribution):
    """The distribution that always gives one problem."""

    fixed = True

    def __init__(self, problem: Problem, summary: str = "") -> None:
        self.name = problem.name
        self.summary = summary
        self._problem = problem

    def sample(self, rng: np.random.Generator) -> Problem:
        """The problem; draws nothing from ``rng``."""
        return self._problem


class ProblemList(ProblemDistribution):
    """A distribution over a numbered list of problems: seed k is problem k, modulo their number.

    A problem asked for by its number is never drawn again, whatever it is like: benchmarks are such lists.
    """

    @abstractmethod
    def __len__(self) -> int:
        """Number of problems."""

    @abstractmethod
    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``, 0 to ``len(self) - 1``."""

    def sample(self, rng: np.random.Generator) -> Problem:
        """One of the problems, each as likely."""
        return self[int(rng.integers(len(self)))]

    def problem(self, seed: int) -> Problem:
        """Problem number ``seed``, modulo their number."""
        return self[integer("seed", seed, least=0) % len(self)]


class SampledProblems(ProblemDistribution):
    """A distribution given by a function from a random generator to a problem."""

    def __init__(self, name: str, draw: Callable[[np.random.Generator], Problem], summary: str = "") -> None:
        self.name = name
        self.summary = summary
        self._draw = draw

    def sample(self, rng: np.random.Generator) -> Problem:
        """Draw one problem with ``draw``."""
        return self._draw(rng)
