"""Drawing problems that a search can be measured on."""

from __future__ import annotations

from typing import Final

import numpy as np

from guided_gym.errors import NoPathError
from guided_gym.oracle import oracle_for
from guided_gym.problems import Problem, ProblemDistribution, ProblemList
from guided_gym.search import streams

TRIES: Final = 100


def draw_problem(
    distribution: ProblemDistribution,
    rng: np.random.Generator,
    goal_tolerance: float = 0.0,
    *,
    goal_edge: bool = True,
    seed: int | None = None,
) -> Problem:
    """The next problem of a distribution that has a path, and that is not solved before it begins.

    A fixed problem is returned as it is, and so is problem ``seed`` of a list. The environment calls this
    with the first of the generators of `guided_gym.search.streams`; see `problem_of_seed`.

    Args:
        distribution: Where to draw from.
        rng: Source of the draws.
        goal_tolerance: As in `SearchOptions`.
        goal_edge: As in `SearchOptions`.
        seed: What ``rng`` was made from, if it is fresh: it numbers the problems of a `ProblemList`.

    Raises:
        NoPathError: None of `TRIES` draws was fit.
    """
    if distribution.fixed:
        return distribution.sample(rng)
    if seed is not None and isinstance(distribution, ProblemList):
        return distribution.problem(seed)
    cause: NoPathError | None = None
    for _ in range(TRIES):
        problem = distribution.sample(rng)
        if _solved_at_once(problem, goal_tolerance, goal_edge):
            continue
        try:
            oracle_for(problem.space, problem.task.goal, start=problem.task.start)
        except NoPathError as error:
            cause = error
            continue
        return problem
    raise NoPathError(
        f"{distribution.name}: expected a problem that has a path and needs a search, "
        f"got none in {TRIES} draws"
    ) from cause


def _solved_at_once(problem: Problem, goal_tolerance: float, goal_edge: bool) -> bool:
    space, task = problem.space, problem.task
    return (goal_edge and space.motion_free(task.start, task.goal)) or (
        goal_tolerance > 0 and float(space.distance(task.start, task.goal)) <= goal_tolerance
    )


def problem_of_seed(
    distribution: ProblemDistribution, seed: int, goal_tolerance: float = 0.0, *, goal_edge: bool = True
) -> Problem:
    """The problem that ``env.reset(seed=seed)`` poses.

    Raises:
        InvalidInputError: The seed is no integer >= 0.
        NoPathError: No problem with a path could be drawn.
    """
    rng = streams(seed)[0]
    return draw_problem(distribution, rng, goal_tolerance, goal_edge=goal_edge, seed=seed)
