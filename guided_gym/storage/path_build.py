"""Filling a path database from worker processes; stopping and resuming it at any time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType

from numpy.typing import ArrayLike

from guided_gym.compute.workers import Workers, worker_pool
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.storage.path_file import DatabaseHeader, PathDatabase
from guided_gym.storage.path_library import FloatArray, checked_path

Solve = Callable[[int], ArrayLike | None]
Progress = Callable[[int, int], None]

_SECONDS_PER_BATCH = 0.5  # a kill -9 loses at most the work of this long
_PATHS_PER_BATCH = 256
_UNSOLVED_PER_PATH = 10  # a build with more failures than this per path is given up
_UNSOLVED_SPARE = 100


@dataclass(frozen=True)
class BuildReport:
    """What one call of `build_database` found and did."""

    paths: int  # paths in the database now
    solved: int  # paths that this call added
    unsolved: int  # problems that this call tried in vain


def build_database(
    path: str | Path,
    header: DatabaseHeader,
    solve: Solve,
    n_paths: int,
    *,
    workers: Workers = 1,
    progress: Progress | None = None,
) -> BuildReport:
    """Bring the database at `path` to the first `n_paths` solvable problems of its distribution.

    Problems are numbered by seeds 0, 1, 2, ...; what ends up in the file depends on `solve` alone, never on
    the number of workers or on how often the build was stopped. A call continues where the last one stopped:
    after Ctrl-C (`KeyboardInterrupt` is raised again once the finished paths are stored), after kill -9,
    after an error in `solve`. Several builds of one file at once are safe, if wasteful.

    Args:
        path: the file; created when it is not there.
        header: what the paths are for, see `DatabaseHeader.for_space`.
        solve: takes a seed, returns the (n, d) path that solves that problem, or None when it was not solved
            within its budget (noted, and never tried again). Must not depend on anything but the seed. With
            more than one worker it must be importable: a function at the top level of a module, or a
            `functools.partial` of one.
        n_paths: how many paths the database is to hold at least.
        workers: how many processes solve (with 1, this one does), or another executor.
        progress: called with (paths stored, n_paths) after each write.

    Raises:
        InvalidInputError: workers or n_paths is out of range, `solve` cannot be sent to a process or returned
            no path of this dimension, or the file was made for another robot or metric.
        StorageError: the file is foreign, damaged or cannot be written.
        GuidedGymError: a worker process died, or next to no problem gets solved.
    """
    if n_paths < 0:
        raise InvalidInputError(f"expected a number of paths >= 0, got {n_paths}")
    attempt = partial(_attempt, solve)
    with worker_pool(workers) as run, PathDatabase.create_or_open(path, header) as database:
        if database.header.name != header.name:
            raise InvalidInputError(
                f"{path} holds paths of {database.header.name}: expected paths of {header.name}"
            )
        batch = _Batch(database, n_paths, progress)
        batch.report()
        while seeds := database.missing_seeds(n_paths):
            _give_up_if_hopeless(database, n_paths)
            with batch:
                for seed, result in run(attempt, seeds):
                    batch.add(seed, result)
        return BuildReport(len(database), batch.solved, batch.unsolved)


class _Batch:
    """Results on their way into the file; leaving its context writes the rest, also after an error."""

    def __init__(self, database: PathDatabase, n_paths: int, progress: Progress | None) -> None:
        self.solved = 0
        self.unsolved = 0
        self._database = database
        self._n_paths = n_paths
        self._progress = progress
        self._stored = len(database)
        self._paths: list[tuple[int, FloatArray]] = []
        self._failures: list[int] = []
        self._written = time.monotonic()

    def __enter__(self) -> None:
        self._written = time.monotonic()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.write()

    def add(self, seed: int, result: ArrayLike | None) -> None:
        if result is None:
            self._failures.append(seed)
        else:
            where = f"path returned by solve({seed})"
            self._paths.append((seed, checked_path(result, self._database.dimension, where)))
        full = len(self._paths) + len(self._failures) >= _PATHS_PER_BATCH
        if full or time.monotonic() - self._written >= _SECONDS_PER_BATCH:
            self.write()

    def write(self) -> None:
        stored = self._database.record(self._paths, self._failures)
        self._stored += stored
        self.solved += stored
        self.unsolved += len(self._failures)
        self._paths.clear()
        self._failures.clear()
        self._written = time.monotonic()
        self.report()

    def report(self) -> None:
        if self._progress is not None:
            self._progress(min(self._stored, self._n_paths), self._n_paths)


def _attempt(solve: Solve, seed: int) -> tuple[int, ArrayLike | None]:
    return seed, solve(seed)


def _give_up_if_hopeless(database: PathDatabase, n_paths: int) -> None:
    unsolved = len(database.unsolved_seeds())
    limit = _UNSOLVED_PER_PATH * n_paths + _UNSOLVED_SPARE
    if unsolved > limit:
        raise GuidedGymError(
            f"{database.path}: expected at most {limit} unsolved problems on the way to {n_paths} paths, "
            f"got {unsolved} (and {len(database)} paths); raise the solver's budget or look at the problems"
        )
