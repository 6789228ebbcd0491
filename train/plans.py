"""Plans on a map: many tasks in one space, prepared for once, and paths that get shorter."""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.inspection import pose_trouble, robot_widths
from guided_gym.checks import integer, number
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.robots import rigid
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.modifications import Disc
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.options import SearchOptions
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.storage.foreign_file import read_text
from guided_gym.storage.preparations import PreparationStore, keeping
from guided_gym.train.protocols import guiding_space
from guided_gym.train.specs import GuidanceSpec
from guided_gym.trajectories import headings, path_clearance, path_length, smooth

FloatArray = NDArray[np.float64]

AUTO: Final = "auto"
"""What guides unless something else is asked for: waves on a grid as fine as the robot is small."""

MAX_SAMPLES: Final = 2000
_FEWEST, _MOST = 56, 160  # cells along the grid
_CELLS_A_ROBOT: Final = 1.0
_TIGHT: Final = 200  # samples without headings for a task that begins or ends in a tight place
_RESTART_SEED: Final = 2**31  # seeds of later searches begin here


@dataclass(frozen=True)
class Answer:
    """A plan for one task.

    Attributes:
        task: The task.
        path: (n, d) certified path; None if none was found.
        length: Length of the path in the space's distance; NaN without one.
        clearance: Least distance to obstacles and bounds along it, never too large; NaN without a path.
        samples: Samples drawn in all.
        searches: Searches that were run: more than one if there was time left after the first path.
        preparation: Seconds before the first search, in which the guiding space got ready.
        seconds: Seconds in all, preparation included.
        history: (k, 3) seconds, samples and length of each path that was shorter than all before.
        no_path: Why there is no path, where the guiding space has proved it; empty elsewhere.
    """

    task: Task
    path: FloatArray | None
    length: float
    clearance: float
    samples: int
    searches: int
    preparation: float
    seconds: float
    history: FloatArray
    no_path: str = ""

    @property
    def solved(self) -> bool:
        """Whether there is a path."""
        return self.path is not None

    def row(self, space: ConfigurationSpace) -> dict[str, Any]:
        """The plan as JSON has it."""
        path = self.path
        return {
            "start": self.task.start.tolist(),
            "goal": self.task.goal.tolist(),
            "solved": self.solved,
            "length": _finite(self.length),
            "clearance": _finite(self.clearance),
            "samples": self.samples,
            "searches": self.searches,
            "preparation_seconds": self.preparation,
            "seconds": self.seconds,
            "history": self.history.tolist(),
            "no_path": self.no_path,
            "waypoints": None if path is None else path.tolist(),
            "headings": None if path is None else headings(space, path).tolist(),
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@doors
class Planner:
    """Plans in one space: what does not depend on the task is prepared once and kept.

    Args:
        problem: It gives robot, environment and metric, and the rule for reaching a goal.
        guidance: Name of a guiding space, with options as on the command line, or `AUTO`.
        step: Radius of an expansion; the `scale` of the space by default.
        max_samples: Samples after which a search gives up.
        smoothing: Attempts to make a path shorter.
        room: Clearance that smoothing keeps (length).
        store: Where what is prepared (rasters, skeletons, roadmaps) is kept on disk for the next time; the
            user's cache folder by default.

    Raises:
        UnknownNameError: No such guidance.
        InvalidInputError: A number out of range.
    """

    def __init__(
        self,
        problem: Problem,
        guidance: str = AUTO,
        *,
        step: float | None = None,
        max_samples: int = MAX_SAMPLES,
        smoothing: int = 0,
        room: float = 0.0,
        store: PreparationStore | None = None,
    ) -> None:
        self.problem = problem
        self.store = store
        self.space = problem.space
        self.guides = chosen_guides(self.space, guidance)
        self.options = SearchOptions(step=step)
        self.max_samples = integer("max_samples", max_samples, least=1)
        self.smoothing = integer("smooth", smoothing, least=0)
        self.room = number("room", room, least=0, what="length")

    def plan(self, task: Task | None = None, *, seed: int = 0, seconds: float = 0.0) -> Answer:
        """A path for a task.

        Args:
            task: The task; None for the problem's own.
            seed: Seed of every random choice. Without a time limit, the same seed gives the same plan.
            seconds: Go on looking for shorter paths until so many have passed; 0 for the first path.

        Raises:
            InvalidInputError: A task that does not fit the space, or a number out of range.
        """
        seed = integer("seed", seed, least=0)
        seconds = number("seconds", seconds, least=0, what="time")
        began = time.perf_counter()
        problem = self.problem if task is None else self.problem.asking(task)
        best: FloatArray | None = None
        history: list[tuple[float, int, float]] = []
        preparation, samples, searches, no_path = 0.0, 0, 0, ""
        while searches == 0 or time.perf_counter() - began < seconds:
            path, drawn, ready, no_path = self._search(
                problem, seed if searches == 0 else _RESTART_SEED + seed + searches
            )
            preparation = ready if searches == 0 else preparation
            samples, searches = samples + drawn, searches + 1
            if no_path and best is None:
                break
            length = math.inf if path is None else path_length(self.space, path)
            if path is not None and (not history or length < history[-1][2]):
                best = path
                history.append((time.perf_counter() - began, samples, length))
            if best is not None and len(best) == 2:
                break  # a straight motion: nothing is shorter
        length, clearance = math.nan, math.nan
        if best is not None:
            length, clearance = path_length(self.space, best), path_clearance(self.space, best)
        passed = time.perf_counter() - began
        rows = np.array(history, np.float64).reshape(-1, 3)
        return Answer(
            problem.task, best, length, clearance, samples, searches, preparation, passed, rows, no_path
        )

    def _search(self, problem: Problem, seed: int) -> tuple[FloatArray | None, int, float, str]:
        """One search: its path, smoothed, samples drawn, how long guides got ready, and why there is none."""
        path, samples, ready, no_path = None, 0, 0.0, ""
        for guide in self.guides:
            _, expansion_rng, guidance_rng = streams(seed)
            began = time.perf_counter()
            search = Search(problem, expansion_rng, guidance_rng, self.options)
            with keeping(self.store):
                search.attach(guide)
            ready += time.perf_counter() - began
            most = self.max_samples if guide is self.guides[-1] else min(self.max_samples, _worth(guide))
            if most == 0:
                continue
            search.run(guide, most)
            path, samples = search.path(), samples + search.samples
            no_path = search.no_path or ""
            if path is not None or search.no_path is not None:
                break
        if path is not None and self.smoothing and len(path) > 1:
            path = smooth(self.space, path, np.random.default_rng(seed), self.smoothing, room=self.room)
        return path, samples, ready, no_path


def chosen_guides(space: ConfigurationSpace, text: str) -> list[GuidingSpace]:
    """The guiding space of a name, or for `AUTO` those that fit the space, in the order in which to try them.

    A wave for the disc that the robot turns in has no headings to look at, so it is some ten times as fast as
    one for the robot itself. It guides where it sees a way for that disc; see `_worth`.

    Raises:
        UnknownNameError: No such guidance or option.
    """
    if text != AUTO:
        return [guiding_space(GuidanceSpec.parse(text).make(), "plan")]
    xmin, ymin, xmax, ymax = space.environment.bounds
    least, turning = robot_widths(rigid(space.robot, AUTO))
    size = max(turning, least) * _CELLS_A_ROBOT
    side = max(xmax - xmin, ymax - ymin)
    wanted = _MOST if size == 0 else side / size
    cells = 8 * math.ceil(min(max(wanted, _FEWEST), _MOST) / 8)
    whole = make_guidance("wavefront", cells=cells)
    if space.dimension == 2:
        return [whole]
    return [make_guidance("wave", robot=Disc(outer=True), cells=cells), whole]


def _worth(guide: GuidingSpace) -> int:
    """Samples that a wave for the disc is worth: all where it sees a way, few where it cannot see one.

    It cannot where start or goal lies so near to an obstacle that the disc has no room there, which says
    nothing of the way between.
    """
    assert isinstance(guide, Composed) and isinstance(guide.solver, Wave)
    if guide.solver.sees_way:
        return sys.maxsize
    query = guide.query
    return 0 if query.space.valid(query.start) and query.space.valid(query.goal) else _TIGHT


# Tasks ------------------------------------------------------------------------------------------------------


def read_tasks(path: Path, problem: Problem) -> list[Task]:
    """The tasks of a CSV file: one per line, start, then goal; a first line of names is skipped.

    Raises:
        StorageError: It cannot be read.
        InvalidInputError: A line that is no task, or one that is in collision; names file and line.
    """
    dimension = problem.space.dimension
    tasks = []
    rows = csv.reader(read_text(path).splitlines())
    try:
        for line, row in enumerate(rows, start=1):
            cells = [cell.strip() for cell in row]
            if not any(cells) or (line == 1 and not _is_number(cells[0])):
                continue
            tasks.append(_task(f"{path}, line {line}", cells, dimension, problem))
    except csv.Error as error:
        raise StorageError(f"{path}: expected comma-separated numbers, got: {error}") from error
    if not tasks:
        raise InvalidInputError(f"{path}: expected at least one task, got none")
    return tasks


def _task(place: str, cells: Sequence[str], dimension: int, problem: Problem) -> Task:
    if len(cells) != 2 * dimension or not all(map(_is_number, cells)):
        raise InvalidInputError(
            f"{place}: expected {2 * dimension} finite numbers (start, then goal), "
            f"got {','.join(cells)[:80]!r}"
        )
    values = [float(cell) for cell in cells]
    start, goal = values[:dimension], values[dimension:]
    for name, q in (("start", start), ("goal", goal)):
        check_heading(f"{place}: {name}", q)
        if not problem.space.valid(q):
            trouble = pose_trouble(problem.space, np.array(q))
            raise InvalidInputError(f"{place}: {name}: expected a free pose, got {trouble}")
    return Task(start, goal, problem.task.tolerance, problem.task.by_edge)


def check_heading(place: str, q: Sequence[float]) -> None:
    """Refuse a heading that can only be meant in degrees.

    Raises:
        InvalidInputError: It is beyond a full turn.
    """
    if len(q) == 3 and abs(q[2]) > 2.0 * math.pi + 1e-9:
        raise InvalidInputError(
            f"{place}: expected a heading of -2 pi to 2 pi in radians, got {q[2]:g} (in degrees?)"
        )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
