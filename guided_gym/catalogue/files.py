"""Problem files: one model of a problem, written as TOML or JSON (docs/maps.md has the format).

What is written is read back exactly: coordinates are written as Python's shortest floats that give the same
number again. Messages name file, line and field.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import shapely
from pydantic import Field, ValidationError, model_validator

from guided_gym.catalogue.file_parts import (
    Box,
    Pair,
    Part,
    RobotPart,
    Shape,
    Size,
    Text,
    Vector,
    plain,
)
from guided_gym.catalogue.file_text import json_text, line_of, message_of, place_of, toml_text
from guided_gym.catalogue.inspection import pose_trouble
from guided_gym.catalogue.map_formats.geojson import obstacle_polygons
from guided_gym.catalogue.maps import DEFAULT_OPTIONS, MapOptions, read_map
from guided_gym.catalogue.space_parts import ArmPart, RoomPart
from guided_gym.checks import shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, named
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.solids import SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm
from guided_gym.problems import Problem, Task
from guided_gym.storage.foreign_file import inside_folder, parsed_json, parsed_toml, read_text
from guided_gym.storage.whole_file import write_whole

FORMAT: Final = "guided-gym problem 1"
PROBLEM_SUFFIXES: Final = (".toml", ".json")

_LARGEST: Final = {".toml": 2**24, ".json": 2**27}  # bytes; TOML is read some twenty times more slowly
_FULL_TURN: Final = 2.0 * math.pi + 1e-9
_PARSERS: Final = {".toml": parsed_toml, ".json": parsed_json}
_WRITERS: Final = {".toml": toml_text, ".json": json_text}


class GoalRule(Part):
    """When the goal counts as reached; see `Task`."""

    tolerance: Annotated[float, Field(allow_inf_nan=False, ge=0)] = 0.0
    by_edge: bool = True


class Metric(Part):
    """Weights of the distance."""

    rotation_weight: Size | None = None


class Units(Part):
    """Units of lengths and angles. Lengths are only named; angles in degrees become radians."""

    length: Text = "m"
    angle: Literal["rad", "deg"] = "rad"


class MapPart(Part):
    """A map file in the same folder or below, and how it is read; see `MapOptions`."""

    file: Annotated[str, Field(min_length=1, max_length=1000)]
    unknown: Literal["occupied", "free"] = "occupied"
    threshold: Annotated[float, Field(allow_inf_nan=False, gt=0, le=1)] = 0.5
    simplify: Annotated[float, Field(allow_inf_nan=False, ge=0)] = 0.0
    speckles: Annotated[int, Field(ge=1)] = 1
    resolution: Size | None = None
    geographic: bool = False
    repair: bool = False

    def options(self, bounds: list[float] | None) -> MapOptions:
        """How the map is read."""
        box = None if bounds is None else (bounds[0], bounds[1], bounds[2], bounds[3])
        fields = self.model_dump(exclude={"file"})
        return MapOptions(**fields, bounds=box)


class ProblemFile(Part):
    """A problem file: everything but `format` and the workspace may be missing, as in a map.

    Attributes:
        format: "guided-gym problem 1".
        name: What tables and figures call the problem.
        units: Units of lengths and angles.
        origin: Where (0, 0) lies in the world (x, y, in the file's unit); kept, never applied.
        bounds: xmin, ymin, xmax, ymax; those of the map by default.
        start: Configuration s: x, y and, for a robot that turns, its heading.
        goal: Configuration t.
        goals: Several goals in place of one: a task for each, all from the same start.
        goal_rule: When the goal counts as reached.
        metric: Weights of the distance.
        robot: The robot.
        map: A map file, whose obstacles are added.
        obstacles: Polygons.
        regions: Named parts of the workspace.
        room: The room of an arm in space, instead of bounds, map and obstacles.
        arm: An arm in space, instead of a robot.
    """

    def __init__(self, /, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise InvalidInputError(message_of(error.errors(include_url=False)[0], ProblemFile)) from None
        except OverflowError as error:
            raise InvalidInputError(f"expected numbers up to 1e12, got: {error}") from None

    # `model_validate` goes its own way, past this constructor.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    format: Literal["guided-gym problem 1"]
    name: Text = "problem"
    units: Units = Units()
    origin: Pair = Field([0.0, 0.0])
    bounds: Box | None = None
    start: Vector | None = None
    goal: Vector | None = None
    goals: Annotated[list[Vector], Field(min_length=1, max_length=10_000)] | None = None
    goal_rule: GoalRule = GoalRule()
    metric: Metric = Metric()
    robot: RobotPart | None = None
    map: MapPart | None = None
    obstacles: list[Shape] = Field([])
    regions: dict[Text, Shape] = Field({})
    room: RoomPart | None = None
    arm: ArmPart | None = None

    @model_validator(mode="after")
    def _in_space_or_not(self) -> ProblemFile:
        if self.room is None and self.arm is None:
            return self
        planar = ("bounds", "robot", "map", "obstacles")
        got = [name for name in planar if getattr(self, name)]
        if got or self.room is None:
            raise ValueError(
                f"expected a room and an arm in space, got {' and '.join(got) or 'an arm alone'}"
            )
        if self.units.angle != "rad":
            raise ValueError("units.angle: expected 'rad' for an arm in space, got 'deg'")
        return self

    @model_validator(mode="after")
    def _angles_in_range(self) -> ProblemFile:
        if self.bounds is None and self.map is None and self.room is None:
            raise ValueError("expected bounds, a map or a room, got none of them")
        if self.goal is not None and self.goals is not None:
            raise ValueError("goals: expected goal or goals, got both")
        most = _FULL_TURN if self.units.angle == "rad" else 360.0
        for name, q in self._poses():
            if self._rigid and len(q) == 3 and abs(q[2]) > most:
                hint = " (degrees? units.angle = 'deg' says so)" if self.units.angle == "rad" else ""
                raise ValueError(
                    f"{name}: expected a heading of -{most:.6g} to {most:.6g} {self.units.angle}, "
                    f"got {q[2]:g}{hint}"
                )
        return self

    def _poses(self) -> list[tuple[str, list[float]]]:
        """Start and goals as they stand in the file, with the names of their fields."""
        poses = [("start", self.start), ("goal", self.goal)]
        return [(name, q) for name, q in poses if q is not None] + [
            (f"goals[{k}]", q) for k, q in enumerate(self.goals or ())
        ]

    @property
    def _rigid(self) -> bool:
        return self.arm is None and (self.robot is None or self.robot.kind != "linkage")

    def configurations(self) -> dict[str, list[float]]:
        """Start and goals, as far as the file has them, by the names of their fields; angles in radians."""
        if self.units.angle == "rad":
            return {name: list(q) for name, q in self._poses()}
        first = 2 if self.robot is None else self.robot.first_angle
        return {name: [*q[:first], *map(math.radians, q[first:])] for name, q in self._poses()}

    def environment(self, folder: Path) -> Environment:
        """The workspace; a map is looked for in ``folder``.

        Raises:
            InvalidInputError: An obstacle or the bounds cannot be used.
            StorageError: The map cannot be read.
        """
        if self.room is not None:
            return self.room.environment()
        polygons: list[shapely.Polygon] = []
        for number, part in enumerate(self.obstacles):
            place = _place(number, part)
            found = obstacle_polygons(place, part.shape(place), repair=False)
            if not found:
                raise InvalidInputError(f"{place}: expected a polygon with an area, got an empty one")
            if self.bounds is not None and not any(
                one.intersects(shapely.box(*self.bounds)) for one in found
            ):
                raise InvalidInputError(
                    f"{place}: expected a polygon that meets the bounds {self.bounds}, got {found[0].bounds}"
                )
            polygons += found
        base = None
        if self.map is not None:
            file = inside_folder(folder, self.map.file, folder, "map.file")
            with named("map"):
                base = read_map(file, self.map.options(self.bounds))
        return _joined(base, self.bounds, polygons)

    def problems(self, folder: Path) -> list[Problem]:
        """The problem, or one for each of the goals; a map is looked for in ``folder``.

        Raises:
            InvalidInputError: A part is missing or cannot be used.
            StorageError: The map cannot be read.
        """
        if self.robot is None and self.arm is None:
            raise InvalidInputError("robot: a problem needs this field, got none")
        poses = self.configurations()
        for name in ("start", "goal"):
            if name not in poses and not (name == "goal" and self.goals):
                raise InvalidInputError(f"{name}: a problem needs this field, got none")
        robot: Mechanism = self.arm.arm() if self.robot is None else self.robot.robot()  # type: ignore[union-attr]
        environment = self.environment(folder)
        if self.arm is None:  # in space, the problem says what is wrong
            self._check_poses(robot, environment, poses)
        regions = {name: part.shape(f"regions.{name}") for name, part in self.regions.items()}
        rule, start = (self.goal_rule.tolerance, self.goal_rule.by_edge), poses.pop("start")
        tasks = [Task(start, goal, *rule) for goal in poses.values()]
        first = Problem(robot, environment, tasks[0], self.name, regions, self.metric.rotation_weight)
        if self.goals is None:
            return [first]
        return [first.asking(task, f"{self.name}-{k}") for k, task in enumerate(tasks)]

    def _check_poses(
        self, robot: Mechanism, environment: Environment, poses: Mapping[str, list[float]]
    ) -> None:
        space = ConfigurationSpace(robot, environment, self.metric.rotation_weight)
        names = self.obstacle_names()
        for label, values in poses.items():
            q = np.array(values)
            if q.size != space.dimension:
                raise InvalidInputError(
                    f"{label}: expected {space.dimension} numbers for a robot of dimension "
                    f"{space.dimension}, got {q.size}"
                )
            if not space.valid(q):
                raise InvalidInputError(f"{label}: expected a free pose, got {pose_trouble(space, q, names)}")

    def obstacle_names(self) -> list[str]:
        """What messages call the polygons of `environment`, as far as they come from this file."""
        names = []
        for number, part in enumerate(self.obstacles):
            place = _place(number, part)
            count = len(obstacle_polygons(place, part.shape(place), repair=False))
            names += [place] * count
        return names


def _joined(
    base: Environment | None, bounds: Sequence[float] | None, polygons: list[shapely.Polygon]
) -> Environment:
    """A map's environment with other bounds and more obstacles."""
    if base is None:
        return Environment(tuple(bounds or ()), tuple(polygons))  # type: ignore[arg-type]
    if bounds is None and not polygons:
        return base
    box = shapely.box(*(bounds or base.bounds))
    shapely.prepare(box)
    kept = [one for one in base.obstacles if box.intersects(one)]
    return Environment(tuple(bounds or base.bounds), (*polygons, *kept))  # type: ignore[arg-type]


def _place(number: int, part: Shape) -> str:
    return f"obstacles[{number}]" if part.name is None else f"obstacles[{number}] ({part.name!r})"


# Loading and saving -----------------------------------------------------------------------------------------


def read_problem_file(path: str | Path) -> ProblemFile:
    """The model of a problem file.

    Raises:
        StorageError: It cannot be read, or is no TOML or JSON; names the line.
        InvalidInputError: A field is missing, unknown, of the wrong type or out of range.
    """
    path = Path(path)
    suffix = _problem_suffix(path)
    content = _PARSERS[suffix](path, read_text(path, _LARGEST[suffix]))
    with _said_of(path):
        return _model_of(content)


def _model_of(content: Any) -> ProblemFile:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        got = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise InvalidInputError(f"format: expected {FORMAT!r}, got {str(got)[:60]!r}")
    return ProblemFile(**content)


@contextmanager
def _said_of(path: Path) -> Iterator[None]:
    """Put a problem file, and the line of the field that it names, before the message of an error."""
    try:
        yield
    except InvalidInputError as error:
        place = place_of(str(error))
        line = f", line {line_of(path, read_text(path), place)}" if place else ""
        raise InvalidInputError(f"{path}{line}: {error}") from None


@door
def load_problem(path: str | Path) -> Problem:
    """The problem of a problem file.

    Args:
        path: A ``.toml`` or ``.json`` file.

    Raises:
        StorageError: It cannot be read, or is damaged; names the line.
        InvalidInputError: A field is missing or cannot be used; names the field, and its line.
    """
    problems = load_problems(path)
    if len(problems) > 1:
        raise InvalidInputError(
            f"{path}: goals: expected one goal for one problem, got {len(problems)}: "
            "make_distribution(path) and `guided-gym plan` take them all"
        )
    return problems[0]


def load_problems(path: str | Path) -> list[Problem]:
    """The problems of a problem file, one for each of its goals; errors as `load_problem`."""
    path = Path(path)
    model = read_problem_file(path)
    with _said_of(path):
        return model.problems(path.parent)


@door
def load_environment(path: str | Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a problem file or of a map in any format that is read; errors as `load_problem`."""
    path = Path(path)
    if path.suffix.lower() not in PROBLEM_SUFFIXES:
        return read_map(path, options)
    model = read_problem_file(path)
    with _said_of(path):
        return model.environment(path.parent)


def file_of(problem: Problem, *, length: str = "m", origin: Sequence[float] = (0.0, 0.0)) -> ProblemFile:
    """The model of a problem, for `write_problem_file`.

    Raises:
        InvalidInputError: A number beyond what a file may have.
    """
    space = problem.environment
    room = RoomPart.of(space) if isinstance(space, SpatialEnvironment) else None
    weight = problem.rotation_weight
    with _parts_checked():
        return ProblemFile(
            format=FORMAT,
            name=problem.name,
            units=Units(length=length),
            origin=[float(v) for v in origin],
            bounds=None if room else list(space.bounds),
            start=problem.task.start.tolist(),
            goal=problem.task.goal.tolist(),
            goal_rule=GoalRule(tolerance=problem.task.tolerance, by_edge=problem.task.by_edge),
            metric=Metric(rotation_weight=None if weight is None else float(weight)),
            robot=None if room else RobotPart.of(problem.robot),
            obstacles=[] if room else [Shape.of(one) for one in space.obstacles],
            room=room,
            arm=ArmPart.of(problem.robot) if isinstance(problem.robot, SpatialArm) else None,
            regions={name: Shape(geojson=plain(shape)) for name, shape in problem.regions.items()},
        )


@contextmanager
def _parts_checked() -> Iterator[None]:
    """Errors of the parts of a model in words of ours; `ProblemFile` itself sees to its own."""
    try:
        yield
    except ValidationError as error:
        raise InvalidInputError(message_of(error.errors(include_url=False)[0], ProblemFile)) from None


def map_file(
    source: Path,
    environment: Environment,
    robot: Mechanism | None,
    poses: Mapping[str, Sequence[float]],
    rotation_weight: float | None = None,
) -> ProblemFile:
    """The model of a workspace, and of a problem in it as far as it is known.

    Where ``source`` is a problem file, all that it says besides stays.

    Raises:
        InvalidInputError: A number beyond what a file may have.
    """
    fields: dict[str, Any] = {"format": FORMAT, "name": source.stem}
    if source.suffix.lower() in PROBLEM_SUFFIXES:
        model = read_problem_file(source)
        kept = ("name", "origin", "goal_rule", "regions")
        fields |= {name: getattr(model, name) for name in kept}
        fields["units"] = Units(length=model.units.length)
    with _parts_checked():
        return ProblemFile(
            **fields,
            bounds=list(environment.bounds),
            start=list(poses["start"]) if "start" in poses else None,
            goal=list(poses["goal"]) if "goal" in poses else None,
            goals=[list(q) for name, q in poses.items() if name.startswith("goals[")] or None,
            metric=Metric(rotation_weight=rotation_weight),
            robot=None if robot is None else RobotPart.of(robot),
            obstacles=[Shape.of(one) for one in environment.obstacles],
        )


@door
def save_problem(
    problem: Problem, path: str | Path, *, length: str = "m", origin: Sequence[float] = (0.0, 0.0)
) -> None:
    """Write a problem into a file from which `load_problem` makes the same problem, to the last bit.

    Args:
        problem: The problem.
        path: A ``.toml`` or ``.json`` file; it is replaced at once, or not at all.
        length: Name of the unit of length, for people.
        origin: Where (0, 0) lies in the world, for people.

    Raises:
        InvalidInputError: Another extension.
        StorageError: The file cannot be written.
    """
    write_problem_file(file_of(problem, length=length, origin=origin), path)


def write_problem_file(model: ProblemFile, path: str | Path) -> None:
    """Write the model of a problem file; errors as `save_problem`."""
    path = Path(path)
    write_whole(path, _WRITERS[_problem_suffix(path)](_content(model)))


def _problem_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in PROBLEM_SUFFIXES:
        raise InvalidInputError(f"{path}: expected a problem file (.toml or .json), got {shown(path.suffix)}")
    return suffix


def _content(model: ProblemFile) -> dict[str, Any]:
    """What a file says, in the order in which people read it."""
    content = model.model_dump(exclude_defaults=True) | {"format": FORMAT}
    return {name: content[name] for name in ProblemFile.model_fields if name in content}


def problem_content(problem: Problem) -> dict[str, Any]:
    """The content of a problem file as a dictionary, from which `problem_of` makes the same problem.

    Raises:
        InvalidInputError: A number beyond what a file may have.
    """
    return _content(file_of(problem))


def problem_of(content: Any, where: Path) -> Problem:
    """The problem of the content of a problem file.

    Args:
        content: What was parsed.
        where: The file that holds it, for messages.

    Raises:
        InvalidInputError: A field is missing or cannot be used; names file and field.
    """
    with named(where):
        model = _model_of(content)
        if model.map is not None:
            raise InvalidInputError("expected a problem that needs no other file, got one with a map")
        if model.goals is not None:
            raise InvalidInputError(f"goals: expected one goal, got {len(model.goals)} in a list")
        (problem,) = model.problems(where.parent)
        return problem
