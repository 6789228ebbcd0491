"""Solving problems for a path database: RRT finds a path, shortcuts straighten it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import count, shown
from guided_gym.compute.workers import Workers, executor_of
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.storage.path_build import BuildReport, Progress, build_database
from guided_gym.storage.path_file import DatabaseHeader
from guided_gym.train.specs import import_modules
from guided_gym.trajectories import shortcut

SEED_OFFSET = 1_000_000  # a database's problems are others than the ones that evaluation uses
MAX_SAMPLES = 20_000
_GOAL_BIAS = 0.05
_PATH = 500  # bytes of a path, about
_SHORTCUTS = 100  # attempts a path


def solve_path(
    environment: str, offset: int, imports: tuple[str, ...], seed: int
) -> NDArray[np.float64] | None:
    """The (n, d) path that solves problem ``offset + seed`` of an environment, or None within the budget."""
    from guided_gym.catalogue.table import make_distribution
    from guided_gym.guidance.registry import make_guidance
    from guided_gym.planning import guided_search

    import_modules(imports)
    problem = make_distribution(environment).problem(offset + seed)
    result = guided_search(
        problem,
        make_guidance("rrt", goal_bias=_GOAL_BIAS),
        seed=offset + seed,
        max_samples=MAX_SAMPLES,
        measure=False,
    )
    if result.path is None:
        return None
    return shortcut(problem.space, result.path, np.random.default_rng(offset + seed), _SHORTCUTS)


@door
def build_path_database(
    environment: str,
    path: Path,
    n_paths: int,
    *,
    workers: Workers = 1,
    offset: int = SEED_OFFSET,
    imports: tuple[str, ...] = (),
    progress: Progress | None = None,
) -> BuildReport:
    """Bring a path database of an environment to ``n_paths`` paths; resumable, see `build_database`.

    Args:
        environment: Name from the catalogue.
        path: The file; its folder is made if there is none.
        n_paths: How many paths it is to hold.
        workers: Processes, or another executor, such as `guided_gym.OnRay`.
        offset: Seed of the database's first problem.
        imports: Modules to import first.
        progress: Called with (paths stored, n_paths).

    Raises:
        UnknownNameError: No environment of that name.
        InvalidInputError: A number is out of range.
        StorageError: The file is foreign, damaged or cannot be written.
    """
    from guided_gym.catalogue.table import make_distribution

    count("paths", n_paths, least=1, each=_PATH, what="so many paths")
    executor = executor_of(workers)
    distribution = make_distribution(environment)
    if not 0 <= offset < 2**62:
        raise InvalidInputError(f"seed: expected an integer in [0, 2**62), got {shown(offset)}")
    name = environment if offset == SEED_OFFSET else f"{environment} from seed {offset}"
    header = DatabaseHeader.for_space(name, distribution.problem(offset).space)
    solve = partial(solve_path, environment, offset, imports)
    if not executor.alone:
        solve(0)  # compiles before there are workers: each of them would compile the same
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"expected a folder for a path database at {path.parent}, got: {error}") from error
    return build_database(path, header, solve, n_paths, workers=executor, progress=progress)
