"""What the field network learns from: problems as it sees them, and the oracle's values of poses in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.distributions import ProblemDistribution
from guided_gym.catalogue.splits import in_split
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned.field import FieldArchitecture
from guided_gym.guidance.solvers.wave import PoseGrid
from guided_gym.kernels import fields
from guided_gym.measure.oracle import oracle_for
from guided_gym.problems import Problem
from guided_gym.train.checkpoints import RunFolder

SHARD: Final = 16  # problems in a file: a few seconds' work
_LABELS: Final = 1024  # poses of the grid whose validity the encoder learns from, of each problem
_NEAR: Final = 1.5  # cells of room within which half of them lie
_ARRAYS: Final = (
    "room", "workspace", "distances", "body", "frame", "poses", "costs", "places", "labels",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Lesson:
    """A problem and the oracle's answers.

    Attributes:
        grid: What the field network sees.
        frame: Where the cells lie, and the goal.
        poses: (m, d) valid configurations from which there is a way.
        costs: (m,) float32 d_C of each.
        places: (k,) flat indices of poses of the grid.
        labels: (k,) uint8, whether they are valid.
    """

    grid: PoseGrid
    frame: NDArray[np.float64]
    poses: NDArray[np.float64]
    costs: NDArray[np.float32]
    places: NDArray[np.int32]
    labels: NDArray[np.uint8]

    @classmethod
    def of(
        cls, problem: Problem, architecture: FieldArchitecture, poses: int, rng: np.random.Generator
    ) -> Lesson:
        """Ask the oracle about random poses of a problem."""
        grid = PoseGrid.of(problem.space, architecture.cells, architecture.headings)
        oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
        q = problem.space.sample(rng, 4 * poses)
        q = q[np.asarray(problem.space.valid(q))]
        costs = np.asarray(oracle.cost_to_go(q))
        some = np.flatnonzero(np.isfinite(costs))[:poses]
        near = np.flatnonzero(np.abs(grid.room.ravel()) < _NEAR)
        places = rng.integers(grid.room.size, size=_LABELS)
        if near.size:
            places[: _LABELS // 2] = near[rng.integers(near.size, size=_LABELS // 2)]
        valid = np.asarray(problem.space.valid(_configurations(grid, places, problem.space.dimension)))
        return cls(
            grid,
            grid.towards(problem.task.goal),
            q[some],
            costs[some].astype(np.float32),
            places.astype(np.int32),
            valid.astype(np.uint8),
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a file keeps of it."""
        values = (
            self.grid.room.astype(np.float16),
            self.grid.workspace.astype(np.float16),
            self.grid.ground.distances.astype(np.float16),
            self.grid.ground.body,
            self.frame,
            self.poses,
            self.costs,
            self.places,
            self.labels,
        )
        return dict(zip(_ARRAYS, values, strict=True))

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> Lesson:
        """The lesson that `arrays` was taken from, its rooms rounded to half precision."""
        room, workspace, distances, body, frame, *rest = (arrays[name] for name in _ARRAYS)
        room, workspace, distances = (half.astype(np.float32) for half in (room, workspace, distances))
        grid = PoseGrid.known(frame, room, workspace, distances, body)
        return cls(grid, frame, *rest)


def _configurations(grid: PoseGrid, places: NDArray[Any], dimension: int) -> NDArray[np.float64]:
    n, _, turns = grid.room.shape
    rows, columns, headings = np.unravel_index(places, (n, n, turns))
    x = grid.frame[fields.ORIGIN_X] + columns * grid.frame[fields.CELL]
    y = grid.frame[fields.ORIGIN_Y] + rows * grid.frame[fields.CELL]
    theta = 2 * np.pi * (headings / turns)
    theta = np.where(theta >= np.pi, theta - 2 * np.pi, theta)
    return np.column_stack([x, y, theta][:dimension])


def mixed_problem(distributions: list[ProblemDistribution], split: str, index: int) -> Problem:
    """Problem number ``index`` of several distributions taken in turns."""
    part = in_split(distributions[index % len(distributions)], split)
    return part.problem(index // len(distributions))


def lessons(
    folder: RunFolder,
    distributions: list[ProblemDistribution],
    architecture: FieldArchitecture,
    *,
    split: str,
    count: int,
    poses: int,
    seed: int,
    progress: Callable[[int], None],
) -> list[Lesson]:
    """The first ``count`` lessons of a split, from the run's files as far as they are there.

    Raises:
        StorageError: A file is damaged.
        NoPathError: No problem with a path could be drawn.
    """
    found: list[Lesson] = []
    for first in range(0, count, SHARD):
        name = f"data/{split}-{first:06d}.safetensors"
        if not (folder.path / name).exists():
            _write_shard(
                folder,
                name,
                distributions,
                architecture,
                split,
                range(first, min(first + SHARD, count)),
                poses,
                seed,
            )
        found.extend(_read_shard(folder.path / name))
        progress(len(found))
    if len(found) != count:
        raise InvalidInputError(f"{folder.path}: expected {count} {split} lessons, got {len(found)}")
    return found


def _write_shard(
    folder: RunFolder,
    name: str,
    distributions: list[ProblemDistribution],
    architecture: FieldArchitecture,
    split: str,
    indices: range,
    poses: int,
    seed: int,
) -> None:
    tensors: dict[str, NDArray[Any]] = {}
    for index in indices:
        problem = mixed_problem(distributions, split, index)
        rng = np.random.default_rng([seed, index])
        lesson = Lesson.of(problem, architecture, poses, rng)
        tensors.update({f"{index:06d}.{key}": array for key, array in lesson.arrays().items()})
    folder.keep(name, {"lessons": len(indices)}, tensors)


def _read_shard(file: Path) -> list[Lesson]:
    _, tensors = RunFolder.read(file)
    numbers = sorted({name.partition(".")[0] for name in tensors})
    return [Lesson.from_arrays({key: tensors[f"{number}.{key}"] for key in _ARRAYS}) for number in numbers]
