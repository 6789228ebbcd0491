"""Motion planning problems M = (r, E, s, t) (paper, Preliminaries)."""

from __future__ import annotations

import copy
import hashlib
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from guided_gym.checks import flag, instance, number, shown, vector
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.space import LARGEST_ANGLE, ConfigurationSpace

# By name: files and pictures stand above problems.
_FILES: Final = "guided_gym.catalogue.files"
_NOTEBOOK: Final = "guided_gym.display.notebook"


@doors
@dataclass(frozen=True, eq=False)
class Task:
    """A task (s, t): where a search starts, where it has to end, and what counts as its end.

    The paper's rule is a valid edge from a node to t. Benchmarks with a goal region have a tolerance, and
    most of them no edge: then the path ends at the first node that is near enough.

    Attributes:
        start: (d,) float64 configuration s.
        goal: (d,) float64 configuration t.
        tolerance: The goal also counts as reached when a node is this near to it (length); 0 for never.
        by_edge: Whether a valid edge from a node to the goal counts as having reached it.

    Raises:
        InvalidInputError: A coordinate is NaN or infinite, the two have different shapes, or there is no
            rule by which to end.
    """

    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    tolerance: float = 0.0
    by_edge: bool = True

    def __init__(
        self, start: ArrayLike, goal: ArrayLike, tolerance: float = 0.0, by_edge: bool = True
    ) -> None:
        for name, value in (("start", start), ("goal", goal)):
            array = vector(name, value)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.start.shape != self.goal.shape:
            raise InvalidInputError(
                f"task: start has {self.start.size} coordinates but goal has {self.goal.size}"
            )
        object.__setattr__(self, "tolerance", number("goal_tolerance", tolerance, least=0, what="length"))
        object.__setattr__(self, "by_edge", flag("goal_edge", by_edge))
        if not by_edge and tolerance == 0:
            raise InvalidInputError("goal_tolerance: expected a length > 0 without goal_edge, got 0")

    def ending(self, tolerance: float | None = None, by_edge: bool | None = None) -> Task:
        """This task with another rule for reaching its goal; None leaves a part of it as it is."""
        return Task(
            self.start,
            self.goal,
            self.tolerance if tolerance is None else tolerance,
            self.by_edge if by_edge is None else by_edge,
        )


@doors
@dataclass(frozen=True, eq=False)
class Problem:
    """A motion planning problem M = (r, E, s, t).

    Attributes:
        robot: The robot r.
        environment: The environment E.
        task: The task (s, t), its angles brought into [-pi, pi).
        name: What tables and figures call it.
        regions: Named parts of the workspace (shapely), for the metric per region (paper, Axes for
            Evaluating Guidance). May be empty; regions may leave gaps.
        rotation_weight: Length per radian in the distance; None for the robot's circumradius.

    Raises:
        InvalidInputError: A part of another type, a rotation weight that is not positive, or a start or goal
            that has the wrong dimension, is out of bounds or touches them, or is in collision.
    """

    robot: Mechanism
    environment: Environment
    task: Task
    name: str = "problem"
    regions: Mapping[str, BaseGeometry] = field(default_factory=dict)
    rotation_weight: float | None = None

    def __post_init__(self) -> None:
        instance("task", self.task, Task)
        _check_regions(self.regions)
        space = self.space
        for label, q in (("start", self.task.start), ("goal", self.task.goal)):
            if q.size != space.dimension:
                raise InvalidInputError(
                    f"{self.name}: {label} needs {space.dimension} coordinates for robot "
                    f"{self.robot.name!r}, got {q.size}"
                )
            self._check_ranges(label, q)
            if not space.valid(q):
                raise InvalidInputError(
                    f"{self.name}: {label} {q.tolist()} is {self._trouble(q)}; expected a free pose"
                )
        task = Task(
            space.wrap(self.task.start), space.wrap(self.task.goal), self.task.tolerance, self.task.by_edge
        )
        object.__setattr__(self, "task", task)

    def _check_ranges(self, label: str, q: NDArray[np.float64]) -> None:
        """Refuse positions out of bounds, joints beyond their limits and angles that are none."""
        space = self.space
        periodic = space.periods > 0
        outside = ((q < space.lower) | (q > space.upper)) & ~periodic
        for k in np.flatnonzero(outside).tolist():
            low, high = float(space.lower[k]), float(space.upper[k])
            if space.names[k] in ("x", "y"):
                raise InvalidInputError(
                    f"{self.name}: {label} {q.tolist()} is out of bounds "
                    f"{space.lower.tolist()} to {space.upper.tolist()}"
                )
            raise InvalidInputError(
                f"{self.name}: {label} has joint {space.names[k]!r} at {q[k]:g}; "
                f"expected it within its limits, {low:g} to {high:g}"
            )
        for k in np.flatnonzero(periodic & (np.abs(q) >= LARGEST_ANGLE)).tolist():
            what = "heading" if space.names[k] == "theta" else f"angle of joint {space.names[k]!r}"
            raise InvalidInputError(
                f"{self.name}: {label} has the {what} {q[k]:g}; expected one below {LARGEST_ANGLE:g}"
            )

    def _trouble(self, q: NDArray[np.float64]) -> str:
        """What is wrong with a pose that is not valid: the bound or obstacle that it comes too near to."""
        robot, tolerance = self.robot, self.space.tolerance
        sides, gaps = self.environment.sides, robot.side_gaps(q, self.environment)
        bounds, k = tuple(sides.values()), int(np.argmin(gaps))
        side, gap = list(sides)[k], float(gaps[k])
        if gap <= 0:
            return f"touching or crossing the bounds {bounds} at {side} = {bounds[k]:g}"
        near = f"away, nearer than the collision tolerance {tolerance:.3g}"
        if gap <= 1.001 * tolerance:
            return f"touching the bounds {bounds}: {side} = {bounds[k]:g} is {gap:.3g} {near}"
        distances = robot.gaps(q, self.environment)
        nearest = int(np.argmin(distances)) if len(distances) else 0
        if len(distances) and distances[nearest] <= 0:
            return f"in collision with obstacle {nearest}"
        for (i, k), gap in zip(robot.pairs, robot.own_gaps(q).tolist(), strict=True):
            if gap <= 1.001 * tolerance:
                away = f": they are {gap:.3g} {near}" if gap > 0 else ""
                return f"in collision with itself, body {i} with body {k}{away}"
        if not len(distances):
            return "in collision"
        return f"in collision: obstacle {nearest} is {distances[nearest]:.3g} {near}"

    @cached_property
    def space(self) -> ConfigurationSpace:
        """The configuration space C = (r, E)."""
        return ConfigurationSpace(self.robot, self.environment, self.rotation_weight)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the problem's content, the same in every process."""
        digest = hashlib.sha256(self.space.fingerprint().encode())
        digest.update(self.task.start.tobytes() + self.task.goal.tobytes())
        if self.task.tolerance > 0 or not self.task.by_edge:
            digest.update(f"{self.task.tolerance!r} {self.task.by_edge}".encode())
        return digest.hexdigest()

    def ending(self, tolerance: float | None = None, by_edge: bool | None = None) -> Problem:
        """This problem with another rule for reaching its goal (see `Task`); the space stays the same.

        Raises:
            InvalidInputError: There would be no rule by which to end.
        """
        if tolerance is None and by_edge is None:
            return self
        other = copy.copy(self)
        other.__dict__.pop("fingerprint", None)
        object.__setattr__(other, "task", self.task.ending(tolerance, by_edge))
        return other

    def asking(self, task: Task, name: str | None = None) -> Problem:
        """This problem with another task, in the same space: nothing of it is built anew.

        Args:
            task: The task.
            name: Another name; None leaves it as it is.

        Raises:
            InvalidInputError: As `Problem`.
        """
        other = copy.copy(self)
        other.__dict__.pop("fingerprint", None)
        object.__setattr__(other, "task", task)
        object.__setattr__(other, "name", self.name if name is None else name)
        _ = self.space, other.__dict__.setdefault("space", self.space)
        other.__post_init__()
        return other

    def save(self, path: str | Path, *, length: str = "m", origin: Sequence[float] = (0.0, 0.0)) -> None:
        """Write the problem into a file from which `load` makes the same one, to the last bit.

        Args:
            path: A ``.toml`` or ``.json`` file (docs/maps.md has the format).
            length: Name of the unit of length, for people.
            origin: Where (0, 0) lies in the world, for people.

        Raises:
            InvalidInputError: Another extension.
            StorageError: The file cannot be written.
        """
        importlib.import_module(_FILES).save_problem(self, path, length=length, origin=origin)

    @staticmethod
    def load(path: str | Path) -> Problem:
        """The problem of a ``.toml`` or ``.json`` problem file (docs/maps.md has the format).

        Raises:
            StorageError: The file cannot be read, or is damaged; names the line.
            InvalidInputError: A field is missing or cannot be used; names line and field.
        """
        problem: Problem = importlib.import_module(_FILES).load_problem(path)
        return problem

    def _repr_html_(self) -> str:
        """A picture, for notebooks."""
        return str(importlib.import_module(_NOTEBOOK).problem_html(self))

    @property
    def begins_solved(self) -> bool:
        """Whether the start already counts as having reached the goal."""
        space, task = self.space, self.task
        near = task.tolerance > 0 and float(space.distance(task.start, task.goal)) <= task.tolerance
        return near or (task.by_edge and space.motion_free(task.start, task.goal))


def _check_regions(regions: object) -> None:
    if not isinstance(regions, Mapping):
        raise InvalidInputError(f"regions: expected names with shapely geometries, got {shown(regions)}")
    for name, region in regions.items():
        if not (isinstance(name, str) and isinstance(region, BaseGeometry)):
            raise InvalidInputError(
                f"regions: expected names with shapely geometries, got {shown(name)}: {region!r}"
            )
