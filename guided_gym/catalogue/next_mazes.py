"""The published maze benchmark of NEXT (Chen et al., ICLR 2020): its files, its distance, its goal region."""

from __future__ import annotations

import math
import os
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.distributions import ProblemList
from guided_gym.catalogue.mazes import LATTICE, lattice_environment, lattice_problem, lattice_robot
from guided_gym.checks import affordable, shown
from guided_gym.doors import door
from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.problems import Problem, Task

ENVIRONMENT_VARIABLE: Final = "GUIDED_GYM_NEXT_DATA"
"""Names the folder in which `next_mazes` looks for the files."""
FILES: Final = {"point": "mazes_15_2_train.npz", "stick": "mazes_15_3_train.npz"}
KEYS: Final = ("maps", "init_states", "goal_states")
HALF_TURN: Final = 0.4
"""The benchmark's third coordinate s is an angle: theta = s / 0.4 * pi."""
GOAL_RADIUS: Final = math.nextafter(0.05, 0.0)
"""The benchmark's goal region is open (distance < 0.05), a search's tolerance is closed."""
VALIDATION_SIZE: Final = 300

Array = NDArray[np.float64]


class NextMazes(ProblemList):
    """Problems of the NEXT benchmark, in the order of their file.

    They end as for the benchmark's own planners: at a free node less than 0.05 from the goal, by a free last
    edge; a goal in sight ends nothing. ``problem.ending(0.0, by_edge=True)`` has the paper's rule instead.

    Args:
        maps: (n, 15, 15) 1 for obstacle cells, 0 for free ones; the first index is x.
        starts: (n, 2) positions (x, y), or (n, 3) poses of the stick (x, y, s) in the benchmark's angle.
        goals: Likewise.
        name: Name of the distribution; ``NextPoint`` or ``NextStick`` unless given.

    Attributes:
        robot: ``"point"`` or ``"stick"``.
        maps: (n, 15, 15) bool.

    Raises:
        InvalidInputError: Arrays of other shapes or values, or a start or goal in an obstacle.
    """

    def __init__(self, maps: object, starts: object, goals: object, name: str = "") -> None:
        self.maps = _checked_maps(maps)
        self._starts = _checked_states("init_states", starts, self.maps)
        self._goals = _checked_states("goal_states", goals, self.maps)
        if self._starts.shape != self._goals.shape:
            raise InvalidInputError(
                f"goal_states: expected shape {self._starts.shape}, got {self._goals.shape}"
            )
        self.robot = "point" if self._starts.shape[1] == 2 else "stick"
        self.name = name or ("NextPoint" if self.robot == "point" else "NextStick")
        self.summary = f"{len(self.maps)} mazes of the NEXT benchmark, {self.robot} robot"

    def __len__(self) -> int:
        """Number of problems."""
        return len(self.maps)

    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``.

        Raises:
            InvalidInputError: There is no such problem.
        """
        if not 0 <= index < len(self):
            raise InvalidInputError(
                f"{self.name}: expected an index 0 to {len(self) - 1}, got {shown(index)}"
            )
        task = Task(self._starts[index], self._goals[index], GOAL_RADIUS, by_edge=False)
        return lattice_problem(
            lattice_environment(self.maps[index]), lattice_robot(self.robot), task, self.name
        )

    def part(self, split: str) -> NextMazes:
        """The training problems, or the validation problems: the last 300.

        Raises:
            InvalidInputError: Another split (the benchmark keeps its test problems in a file of their own:
                load that whole), or too few problems for two parts.
        """
        if split not in ("train", "validation"):
            raise InvalidInputError(
                f"{self.name}: expected 'train' or 'validation', got {shown(split)}; "
                "test problems come in a file of their own"
            )
        if len(self) <= VALIDATION_SIZE:
            raise InvalidInputError(
                f"{self.name}: expected more than {VALIDATION_SIZE} problems to split, got {len(self)}"
            )
        rows = slice(-VALIDATION_SIZE) if split == "train" else slice(-VALIDATION_SIZE, None)
        chosen = NextMazes.__new__(NextMazes)
        chosen.maps, chosen._starts, chosen._goals = self.maps[rows], self._starts[rows], self._goals[rows]
        chosen.robot, chosen.name = self.robot, f"{self.name}@{split}"
        chosen.summary = f"{self.summary} ({split} problems: {len(chosen.maps)})"
        return chosen


@door
def load_next_mazes(file: str | Path, name: str = "") -> NextMazes:
    """The problems of a file of the benchmark; nothing in it is unpickled.

    Args:
        file: An ``.npz`` with `KEYS`; maps may be integers or floating-point numbers.
        name: As for `NextMazes`.

    Raises:
        StorageError: No such file, or it is truncated, foreign or holds other values.
    """
    path = Path(file).expanduser()
    try:
        with zipfile.ZipFile(path) as archive:
            maps, starts, goals = (_array(archive, key, path) for key in KEYS)
        return NextMazes(maps, starts, goals, name)
    except FileNotFoundError:
        raise StorageError(f"{path}: expected a file of NEXT mazes, found none") from None
    except InvalidInputError as error:
        raise StorageError(f"{path}: {error}") from error
    except GuidedGymError:
        raise
    # The readers of archives and of arrays raise what they like on damaged files, tokenize's errors included.
    except Exception as error:
        raise StorageError(f"{path}: expected an npz file of NEXT mazes: {error}") from error


def _array(archive: zipfile.ZipFile, key: str, path: Path) -> NDArray[Any]:
    """An array of an npz file: of the size that its header says, before anything is made of that size.

    Raises:
        StorageError: There is none, or it says another size than the archive does.
    """
    name = f"{key}.npy"
    if name not in archive.namelist():
        raise StorageError(f"{path}: expected an npz file with {', '.join(KEYS)}, got one without {key}")
    size = archive.getinfo(name).file_size
    affordable(key, path.name, 3 * size, "the array")
    with archive.open(name) as stream:
        version = np.lib.format.read_magic(stream)  # type: ignore[arg-type]
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(stream)  # type: ignore[arg-type]
        if dtype.hasobject or math.prod(shape) * dtype.itemsize > size:
            raise StorageError(
                f"{path}: expected an npz file of numbers, got {key} of shape {shape} and {dtype} in "
                f"{size} bytes"
            )
    with archive.open(name) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)  # type: ignore[arg-type]


def next_mazes(robot: str, folder: str | Path | None = None) -> NextMazes:
    """The training file of a robot, from a folder or from the one that GUIDED_GYM_NEXT_DATA names.

    Raises:
        InvalidInputError: Another robot than ``"point"`` and ``"stick"``.
        StorageError: No folder is named, or the file in it cannot be read.
    """
    lattice_robot(robot)
    folder = os.environ.get(ENVIRONMENT_VARIABLE, "") if folder is None else folder
    if not str(folder):
        raise StorageError(
            f"NEXT mazes: expected the environment variable {ENVIRONMENT_VARIABLE} to name the folder of "
            f"{FILES[robot]}, but it is not set"
        )
    return load_next_mazes(Path(folder) / FILES[robot])


def next_point() -> NextMazes:
    """`next_mazes` for the point robot."""
    return next_mazes("point")


def next_stick() -> NextMazes:
    """`next_mazes` for the stick robot."""
    return next_mazes("stick")


def _checked_maps(maps: object) -> NDArray[np.bool_]:
    array = np.asarray(maps)
    if array.ndim != 3 or array.shape[1:] != (LATTICE, LATTICE) or not len(array):
        raise InvalidInputError(f"maps: expected shape (n, {LATTICE}, {LATTICE}), got {array.shape}")
    if array.dtype.kind not in "biuf" or not np.isin(array, (0, 1)).all():
        raise InvalidInputError("maps: expected 1 for obstacle cells and 0 for free ones, got other values")
    walls: NDArray[np.bool_] = array.astype(np.bool_)
    border = np.ones((LATTICE, LATTICE), np.bool_)
    border[1:-1, 1:-1] = False
    open_maps = np.flatnonzero(~walls[:, border].all(axis=1))
    if open_maps.size:
        raise InvalidInputError(
            f"maps: expected obstacles all along the border, but map {open_maps[0]} is open"
        )
    return walls


def _checked_states(key: str, states: object, walls: NDArray[np.bool_]) -> Array:
    """States in our coordinates: the third one an angle in radians."""
    array = np.array(states)
    if array.dtype.kind not in "iuf":
        raise InvalidInputError(f"{key}: expected numbers, got dtype {array.dtype}")
    array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] not in (2, 3) or len(array) != len(walls):
        raise InvalidInputError(f"{key}: expected shape ({len(walls)}, 2) or (.., 3), got {array.shape}")
    limits = np.array([1.0, 1.0, HALF_TURN + 1e-9])[: array.shape[1]]
    wrong = np.flatnonzero(~(np.isfinite(array) & (np.abs(array) <= limits)).all(axis=1))
    if wrong.size:
        raise InvalidInputError(
            f"{key}: expected states within {limits.tolist()}, got {array[wrong[0]].tolist()} "
            f"in row {wrong[0]}"
        )
    cells = np.minimum((array[:, :2] + 1.0) * (LATTICE / 2), LATTICE - 1).astype(np.int64)
    blocked = np.flatnonzero(walls[np.arange(len(walls)), cells[:, 0], cells[:, 1]])
    if blocked.size:
        raise InvalidInputError(f"{key}: expected free states, but row {blocked[0]} is in an obstacle cell")
    if array.shape[1] == 3:
        array[:, 2] *= math.pi / HALF_TURN
    return array
