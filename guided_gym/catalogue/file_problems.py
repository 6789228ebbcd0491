"""Files as distributions: a problem file, whose goals may be several, or the tasks of a scenario."""

from __future__ import annotations

from collections import OrderedDict
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from guided_gym.catalogue.distributions import FixedProblem, ProblemDistribution, ProblemList
from guided_gym.catalogue.files import PROBLEM_SUFFIXES, load_problems
from guided_gym.catalogue.maps import MAP_SUFFIXES, read_map, read_scenario
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.robots import Robot
from guided_gym.problems import Problem, Task
from guided_gym.storage.foreign_file import inside_folder

FILE_SUFFIXES: Final = (*PROBLEM_SUFFIXES, ".scen", *MAP_SUFFIXES)


class ScenarioProblems(ProblemList):
    """The tasks of a MovingAI scenario for a point robot: problem k is its task k.

    Args:
        path: The ``.scen`` file; the map that it names lies beside it.

    Attributes:
        lengths: Length of the shortest path of each over the grid's eight directions, as the file has it.
    """

    def __init__(self, path: Path) -> None:
        self.tasks = read_scenario(path)
        if not self.tasks:
            raise StorageError(f"{path}: expected at least one task, got none")
        self.name = path.stem
        self.summary = f"Tasks of {path.name}"
        self.lengths = np.array([task.length for task in self.tasks])
        name = Path(self.tasks[0].map_name.replace("\\", "/")).name
        self.environment = read_map(inside_folder(path.parent, name, path, "map"))
        self._kept: OrderedDict[int, Problem] = OrderedDict()

    def __len__(self) -> int:
        """Number of tasks."""
        return len(self.tasks)

    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``."""
        if index not in self._kept:
            task = self.tasks[index]
            self._kept[index] = Problem(
                Robot.point(), self.environment, Task(task.start, task.goal), f"{self.name}-{index}"
            )
            while len(self._kept) > 16:
                self._kept.popitem(last=False)
        return self._kept[index]


class FileProblems(ProblemList):
    """The problems of a problem file with several goals: problem k goes to goal k.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._problems = load_problems(path)
        self.name = path.stem
        self.summary = f"The goals of {path.name}"

    def __len__(self) -> int:
        """Number of goals."""
        return len(self._problems)

    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``."""
        return self._problems[index]


def is_file_name(name: str) -> bool:
    """Whether a name is that of a problem file or map rather than one of the catalogue."""
    return Path(name).suffix.lower() in FILE_SUFFIXES


def file_distribution(name: str) -> ProblemDistribution:
    """The problem of a file, as a distribution: a problem file, or a MovingAI scenario.

    Raises:
        StorageError: It cannot be read or is damaged.
        InvalidInputError: It is a map without a task.
    """
    path = Path(name)
    try:
        stamp = path.stat()
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot read {path}: {error}") from error
    return _distribution(path.resolve(), stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=16)
def _distribution(path: Path, changed: int, size: int) -> ProblemDistribution:
    suffix = path.suffix.lower()
    if suffix == ".scen":
        return ScenarioProblems(path)
    if suffix in MAP_SUFFIXES:
        raise InvalidInputError(
            f"{path}: expected a problem, got a map, which has no robot, start or goal; "
            f"guided-gym convert {path.name} problem.toml --robot ... --start ... --goal ... adds them"
        )
    several = FileProblems(path)
    return several if len(several) > 1 else FixedProblem(several[0], f"The problem of {path.name}")
