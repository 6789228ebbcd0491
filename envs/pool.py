"""Problems with their oracles, prepared by other processes in advance, so that training need not wait."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from types import TracebackType
from typing import Any, Final, NamedTuple

import numpy as np

from guided_gym.catalogue.distributions import ProblemDistribution
from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import integer
from guided_gym.compute.workers import WORKER_DIED, checked_workers, start_workers, stop_workers
from guided_gym.doors import doors
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.measure.oracle import Oracle, oracle_for, remember
from guided_gym.problems import Problem

AHEAD: Final = 16


class _Prepared(NamedTuple):
    problem: Problem
    oracle: Oracle


class _Source(NamedTuple):
    """What a process needs to prepare problems."""

    distribution: ProblemDistribution
    goal_tolerance: float | None
    goal_edge: bool | None

    def prepare(self, seed: int) -> _Prepared:
        problem = self.distribution.problem(seed, self.goal_tolerance, self.goal_edge)
        return _Prepared(problem, oracle_for(problem.space, problem.task.goal, start=problem.task.start))


@doors
class ProblemPool(ProblemDistribution):
    """The problems of a sequence of seeds, in that order, each with its oracle, prepared in the background.

    Problem by problem it is the same whatever the number of workers: the problem of seed k is that of
    ``env.reset(seed=k)``. A pool is a distribution itself: an environment made with ``distribution=pool``
    takes its next problem at each reset, whatever the seed of the reset. Nobody else sees that problem, so
    environments that share a pool (in one process: a pool can't be sent to another) share out its problems.

        with ProblemPool("RandomMaze@train", workers=2) as pool:
            env = gymnasium.make("guided_gym/RandomMaze-v0", distribution=pool)

    The oracles come through the processes' pipes, so they need no disk cache. Not more than ``ahead``
    problems are prepared and not yet taken: some 1 MB each.

    Args:
        distribution: A name in the catalogue (``"RandomMaze@train"``: of one split) or a distribution that
            can be sent to a process.
        seeds: Seeds of the problems; None for 0, 1, 2, ... without end. To go on where an earlier pool was
            left, start at its `taken`.
        workers: Processes; with 0, this one prepares each problem when it is asked for.
        ahead: How many problems are prepared before anyone asks.
        goal_tolerance: Another rule for reaching a goal than the problems' own, see `Problem.ending`.
        goal_edge: Likewise.

    Attributes:
        taken: Number of problems taken so far.

    Raises:
        UnknownNameError: No distribution of that name.
        InvalidInputError: A value that cannot be used, or a distribution that cannot be sent.
    """

    def __init__(
        self,
        distribution: str | ProblemDistribution,
        seeds: Iterable[int] | None = None,
        *,
        workers: int = 1,
        ahead: int = AHEAD,
        goal_tolerance: float | None = None,
        goal_edge: bool | None = None,
    ) -> None:
        checked_workers(workers, least=0)
        integer("ahead", ahead, least=1)
        if isinstance(distribution, str):
            distribution = make_distribution(distribution)
        self.name = distribution.name
        self.summary, self.angles = distribution.summary, distribution.angles
        self.taken = 0
        self._seeds = itertools.count() if seeds is None else iter(seeds)
        self._ahead = int(ahead)
        self._source = _Source(distribution, goal_tolerance, goal_edge)
        self._waiting: deque[Future[_Prepared]] = deque()
        self._closed = False
        self._workers = start_workers(int(workers), partial(_install, self._source)) if workers else None
        self._order_more()

    def take(self) -> Problem:
        """The next problem; its oracle is in memory, where `oracle_for` finds it.

        Raises:
            GuidedGymError: The seeds have come to an end, the pool is closed, or a worker died.
            NoPathError: The problem of this seed has no path.
        """
        try:
            return next(self)
        except StopIteration:
            raise GuidedGymError(
                f"pool of {self.name}: expected more seeds, but all {self.taken} problems are taken"
            ) from None

    def sample(self, rng: np.random.Generator) -> Problem:
        """The next problem, as `take`; draws nothing from ``rng``."""
        return self.take()

    def draw(
        self, rng: np.random.Generator, tolerance: float | None = None, by_edge: bool | None = None
    ) -> Problem:
        """The next problem; its worker has checked that it can be measured."""
        return self.take().ending(tolerance, by_edge)

    def problem(self, seed: int, tolerance: float | None = None, by_edge: bool | None = None) -> Problem:
        """The next problem, whatever the seed."""
        return self.take().ending(tolerance, by_edge)

    @property
    def ready(self) -> int:
        """Number of problems that could be taken now without waiting."""
        done = itertools.takewhile(lambda future: future.done(), self._waiting)
        return sum(1 for _ in done)

    def close(self) -> None:
        """Stop the workers; may be called again. Problems taken earlier stay what they are."""
        self._closed = True
        self._waiting.clear()
        if self._workers is not None:
            stop_workers(self._workers)
            self._workers = None

    def __iter__(self) -> Iterator[Problem]:
        """The problems that are left, until the seeds end."""
        return self

    def __next__(self) -> Problem:
        """The next problem."""
        if self._closed:
            raise GuidedGymError(f"pool of {self.name}: expected an open pool, got a closed one")
        if self._workers is None:
            problem, oracle = self._source.prepare(next(self._seeds))
        elif self._waiting:
            problem, oracle = self._received(self._waiting[0])
        else:
            raise StopIteration
        remember(oracle, problem.task.start)
        self.taken += 1
        return problem

    def _received(self, future: Future[_Prepared]) -> _Prepared:
        """What a worker prepared. Only then is it off the list: Ctrl-C while waiting loses no problem."""
        try:
            prepared = future.result()
        except BrokenProcessPool as error:
            self.close()
            raise GuidedGymError(f"pool of {self.name}: {WORKER_DIED}") from error
        except Exception:
            self._next_order()
            raise
        self._next_order()
        return prepared

    def _next_order(self) -> None:
        self._waiting.popleft()
        self._order_more()

    def _order_more(self) -> None:
        if self._workers is None:
            return
        try:
            for seed in itertools.islice(self._seeds, self._ahead - len(self._waiting)):
                self._waiting.append(self._workers.submit(_prepare, seed))
        except BrokenProcessPool as error:
            self.close()
            raise GuidedGymError(f"pool of {self.name}: {WORKER_DIED}") from error

    def __enter__(self) -> ProblemPool:
        """This pool."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def __deepcopy__(self, memo: dict[int, Any]) -> ProblemPool:
        """The pool itself: gymnasium copies what an environment was made with."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """A pool stays where its workers are.

        Raises:
            InvalidInputError: Always.
        """
        raise InvalidInputError(
            f"pool of {self.name}: expected to stay in its process; use environments of the same process "
            "(a synchronous vector), or a pool in each"
        )


_source: _Source | None = None  # in a worker: what it prepares


def _install(source: _Source) -> None:
    global _source
    _source = source


def _prepare(seed: int) -> _Prepared:
    assert _source is not None, "a worker starts with _install"
    return _source.prepare(seed)
