"""Distributions over problems: a seed is one problem, everywhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from guided_gym.checks import integer
from guided_gym.doors import doors
from guided_gym.errors import NoPathError
from guided_gym.geometry.robots import Robot
from guided_gym.measure.oracle import check_path, oracle_for
from guided_gym.options import OracleOptions
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams

TRIES: Final = 100
ROADMAP: Final = 1000  # vertices of the roadmap that says whether a robot with joints has a path


@doors
class ProblemDistribution(ABC):
    """A distribution D over problems, indexed by seed: the same seed is the same problem everywhere.

    A subclass writes `sample`; `draw` and `problem` skip problems that cannot be measured.

    Attributes:
        name: What tables, databases and figures call it.
        fixed: True when every seed gives one and the same problem.
        summary: One line for lists of problems.
        angles: How many angles its robots have at most: observations have columns for as many.
    """

    name: str
    fixed: bool = False
    summary: str = ""
    angles: int = 1

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> Problem:
        """Draw one problem M ~ D, whether it has a path or not."""

    def draw(
        self, rng: np.random.Generator, tolerance: float | None = None, by_edge: bool | None = None
    ) -> Problem:
        """The next problem that has a path, and that is not solved before it begins.

        Args:
            rng: Source of the draws.
            tolerance: When the goal counts as reached, in place of the problem's own rule; see
                `Problem.ending`.
            by_edge: Likewise.

        Raises:
            NoPathError: None of `TRIES` draws has a path and needs a search.
        """
        cause: NoPathError | None = None
        for _ in range(TRIES):
            problem = self.sample(rng).ending(tolerance, by_edge)
            if problem.begins_solved:
                continue
            try:
                _check_path(problem)
            except NoPathError as error:
                cause = error
                continue
            return problem
        raise NoPathError(
            f"{self.name}: expected a problem that has a path and needs a search, got none in {TRIES} draws"
        ) from cause

    def problem(self, seed: int, tolerance: float | None = None, by_edge: bool | None = None) -> Problem:
        """The problem of one seed: the one that ``env.reset(seed=seed)`` poses, with the same rule of ending.

        Raises:
            InvalidInputError: The seed is not an integer >= 0.
            NoPathError: No problem with a path could be drawn.
        """
        return self.draw(streams(integer("seed", seed, least=0))[0], tolerance, by_edge)


def _check_path(problem: Problem) -> None:
    """Refuse a problem without a path; what is asked of the oracle that measures it changes nothing.

    Raises:
        NoPathError: There is none, as far as the first grid or a roadmap can tell.
    """
    space, task = problem.space, problem.task
    if isinstance(problem.robot, Robot):
        check_path(space, task.goal, task.start)
    else:
        oracle_for(space, task.goal, task.start, OracleOptions(resolution=(ROADMAP,)))


@doors
class FixedProblem(ProblemDistribution):
    """The distribution that always gives one problem."""

    fixed = True

    def __init__(self, problem: Problem, summary: str = "") -> None:
        self.name = problem.name
        self.summary = summary
        self.angles = max(1, sum(name not in ("x", "y") for name in problem.robot.names))
        self._problem = problem

    def sample(self, rng: np.random.Generator) -> Problem:
        """The problem; draws nothing from ``rng``."""
        return self._problem

    def draw(
        self, rng: np.random.Generator, tolerance: float | None = None, by_edge: bool | None = None
    ) -> Problem:
        """The problem, whether or not it has a path."""
        return self._problem.ending(tolerance, by_edge)


class OtherTasks(ProblemDistribution):
    """The spaces of a distribution's problems with other tasks: one map, many starts and goals.

    A draw is a problem of the distribution, with one of the starts and one of the goals in place of its own,
    whatever that task is like.

    Args:
        distribution: Where the spaces come from.
        starts: Configurations (d,), one of which is the start; None for the problem's own.
        goals: Likewise.
    """

    def __init__(
        self,
        distribution: ProblemDistribution,
        starts: Sequence[ArrayLike] | None = None,
        goals: Sequence[ArrayLike] | None = None,
    ) -> None:
        self.name, self.summary = distribution.name, distribution.summary
        self.fixed = distribution.fixed and max(len(starts or ()), len(goals or ())) <= 1
        self._distribution, self._starts, self._goals = distribution, starts, goals

    def sample(self, rng: np.random.Generator) -> Problem:
        """A problem in which one of the tasks is posed."""
        return self._posed(self._distribution.sample(rng), rng)

    def draw(
        self, rng: np.random.Generator, tolerance: float | None = None, by_edge: bool | None = None
    ) -> Problem:
        """A problem of the distribution in which one of the tasks is posed."""
        return self._posed(self._distribution.draw(rng, tolerance, by_edge), rng)

    def problem(self, seed: int, tolerance: float | None = None, by_edge: bool | None = None) -> Problem:
        """The problem of a seed, in which the task of that seed is posed."""
        return self._posed(self._distribution.problem(seed, tolerance, by_edge), streams(seed)[0])

    def _posed(self, problem: Problem, rng: np.random.Generator) -> Problem:
        own = problem.task
        start, goal = (
            one if several is None else several[int(rng.integers(len(several)))]
            for one, several in ((own.start, self._starts), (own.goal, self._goals))
        )
        return problem.asking(Task(start, goal, own.tolerance, own.by_edge))


@doors
class ProblemList(ProblemDistribution):
    """A distribution over a numbered list of problems: seed k is problem k, modulo their number.

    The problem with a number stays the same, even if it has no path: benchmarks are such lists.
    """

    @abstractmethod
    def __len__(self) -> int:
        """Number of problems."""

    @abstractmethod
    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``, 0 to ``len(self) - 1``."""

    def sample(self, rng: np.random.Generator) -> Problem:
        """One of the problems, all equally likely."""
        return self[int(rng.integers(len(self)))]

    def problem(self, seed: int, tolerance: float | None = None, by_edge: bool | None = None) -> Problem:
        """Problem number ``seed``, modulo their number."""
        return self[integer("seed", seed, least=0) % len(self)].ending(tolerance, by_edge)


@doors
class SampledProblems(ProblemDistribution):
    """A distribution given by a function from a random generator to a problem."""

    def __init__(
        self,
        name: str,
        draw: Callable[[np.random.Generator], Problem],
        summary: str = "",
        angles: int = 1,
    ) -> None:
        self.name = name
        self.summary = summary
        self.angles = angles
        self._draw = draw

    def sample(self, rng: np.random.Generator) -> Problem:
        """Draw one problem with ``draw``."""
        return self._draw(rng)
