"""Drawing problems that a search can be measured on."""

from __future__ import annotations

from typing import Final

import numpy as np

from guided_gym.errors import NoPathError
from guided_gym.oracle import oracle_for
from guided_gym.problems import Problem, ProblemDistribution

TRIES: Final = 100


def draw_problem(
    distribution: ProblemDistribution, rng: np.random.Generator, goal_tolerance: float = 0.0
) -> Problem:
    """The next problem of a distribution that has a path, and that is not solved before it begins.

    A fixed problem is returned as it is. The environment calls this with the first of the generators of
    `guided_gym.search.streams`, so ``draw_problem(distribution, streams(k)[0])`` is the problem of
    ``env.reset(seed=k)``.

    Args:
        distribution: Where to draw from.
        rng: Source of the draws.
        goal_tolerance: As in `SearchOptions`.

    Raises:
        NoPathError: None of `TRIES` draws was fit.
    """
    if distribution.fixed:
        return distribution.sample(rng)
    cause: NoPathError | None = None
    for _ in range(TRIES):
        problem = distribution.sample(rng)
        if _solved_at_once(problem, goal_tolerance):
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


def _solved_at_once(problem: Problem, goal_tolerance: float) -> bool:
    space, task = problem.space, problem.task
    return space.motion_free(task.start, task.goal) or (
        goal_tolerance > 0 and float(space.distance(task.start, task.goal)) <= goal_tolerance
    )
