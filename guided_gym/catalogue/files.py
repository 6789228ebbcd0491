"""Problem files: one model of a problem, written as TOML or JSON (docs/maps.md has the format).

What is written is read back exactly: coordinates are written as Python's shortest floats that give the same
number again. Messages name file, line and field.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import tomllib
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from guided_gym.catalogue.distributions import FixedProblem, ProblemDistribution, ProblemList
from guided_gym.catalogue.inspection import hit_obstacles, nearest_free_pose
from guided_gym.catalogue.maps import (
    DEFAULT_OPTIONS,
    MAP_SUFFIXES,
    MOST_NESTED,
    MapOptions,
    check_nesting,
    geojson_shape,
    inside_folder,
    obstacle_polygons,
    parsed_json,
    read_map,
    read_scenario,
    read_text,
    reason,
)
from guided_gym.catalogue.space_parts import ArmPart, RoomPart
from guided_gym.checks import shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Body, Joint, Linkage
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.robots import Robot, rigid
from guided_gym.geometry.solids import SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm
from guided_gym.problems import Problem, Task
from guided_gym.storage.whole_file import write_whole

FORMAT: Final = "guided-gym problem 1"
PROBLEM_SUFFIXES: Final = (".toml", ".json")
FILE_SUFFIXES: Final = (*PROBLEM_SUFFIXES, ".scen", *MAP_SUFFIXES)

_LARGEST: Final = {".toml": 2**24, ".json": 2**27}  # bytes; TOML is read some twenty times more slowly
_FULL_TURN: Final = 2.0 * math.pi + 1e-9

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Size = Annotated[float, Field(allow_inf_nan=False, gt=0, le=1e12)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Ring = Annotated[list[Pair], Field(min_length=3)]
Vector = Annotated[list[Number], Field(min_length=1, max_length=1000)]
Box = Annotated[list[Number], Field(min_length=4, max_length=4)]
Text = Annotated[str, Field(max_length=10_000)]


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Shape(_Model):
    """An obstacle or region, in one of four forms.

    Attributes:
        name: What messages call it.
        box: xmin, ymin, xmax, ymax.
        polygon: Its corners.
        holes: Corners of the holes of the polygon.
        wkt: Well-known text.
        geojson: A GeoJSON geometry.
    """

    name: Text | None = None
    box: Box | None = None
    polygon: Ring | None = None
    holes: list[Ring] = []
    wkt: str | None = None
    geojson: dict[str, Any] | None = None

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {"wkt": value}
        if isinstance(value, list):
            return {"polygon": value}
        if isinstance(value, dict) and "type" in value:
            return {"geojson": value}
        return value

    @model_validator(mode="after")
    def _one_form(self) -> Shape:
        forms = [name for name in ("box", "polygon", "wkt", "geojson") if getattr(self, name) is not None]
        if len(forms) != 1:
            got = " and ".join(forms) or "none"
            raise ValueError(f"expected one of box, polygon, wkt and geojson, got {got}")
        if self.holes and self.polygon is None:
            raise ValueError("expected holes only beside a polygon, got them beside another shape")
        return self

    def shape(self, place: str) -> shapely.Geometry:
        """The geometry; ``place`` is what messages call it.

        Raises:
            InvalidInputError: It is none.
        """
        if self.box is not None:
            xmin, ymin, xmax, ymax = self.box
            if not (xmin < xmax and ymin < ymax):
                raise InvalidInputError(f"{place}: box: expected xmin < xmax and ymin < ymax, got {self.box}")
            return shapely.box(*self.box)
        if self.polygon is not None:
            return shapely.Polygon(self.polygon, self.holes)
        if self.geojson is not None:
            return geojson_shape(place, self.geojson)
        return _from_wkt(place, self.wkt or "")


def _from_wkt(place: str, text: str) -> shapely.Geometry:
    if re.search(r"\([^()]*\([^()]*\([^()]*\([^()]*\([^()]*\(", text):
        raise InvalidInputError(f"{place}: wkt: expected brackets nested at most 5 deep, got more")
    try:
        shape = shapely.from_wkt(text)
    except (shapely.errors.ShapelyError, ValueError, TypeError) as error:
        raise InvalidInputError(f"{place}: wkt: expected well-known text, got: {str(error)[:100]}") from None
    numbers = shapely.get_coordinates(shape)
    if shape is None or not (np.isfinite(numbers) & (np.abs(numbers) <= 1e12)).all():
        raise InvalidInputError(f"{place}: wkt: expected finite numbers up to 1e12, got {text[:60]!r}")
    return shape


class JointPart(_Model):
    """A joint of a linkage; see `Joint`."""

    name: Text = ""
    parent: Annotated[int, Field(ge=-1)] = -1
    offset: Pair = [0.0, 0.0]
    heading: Number = 0.0
    limits: Pair | None = None


class BodyPart(_Model):
    """A body on a joint of a linkage; see `Body`."""

    joint: Annotated[int, Field(ge=0)]
    outline: dict[str, Any]


class RobotPart(_Model):
    """A robot.

    Attributes:
        kind: ``point``, ``segment`` (length), ``rectangle`` (length, width), ``polygon`` (corners),
            ``outline`` (any GeoJSON Point, LineString or Polygon) or ``linkage`` (joints, bodies, tool).
        length: Along the body's x axis.
        width: Across it.
        corners: Of a polygon, in the body frame.
        outline: GeoJSON geometry in the body frame.
        joints: Of a linkage, parents first; angles in radians.
        bodies: Of a linkage.
        tool: Of a linkage: x, y in the frame of the joint ``tool_joint``.
        tool_joint: The last joint by default.
        mobile: Whether a linkage's base moves.
        self_collision: Whether a linkage's bodies must not touch each other.
        dimension: 2 (translates only) or 3 (turns too); a linkage has as many as its joints say.
        name: For people.
    """

    kind: Literal["point", "segment", "rectangle", "polygon", "outline", "linkage"]
    length: Size | None = None
    width: Size | None = None
    corners: Ring | None = None
    outline: dict[str, Any] | None = None
    joints: Annotated[list[JointPart], Field(min_length=1, max_length=1000)] | None = None
    bodies: Annotated[list[BodyPart], Field(min_length=1, max_length=1000)] | None = None
    tool: Pair | None = None
    tool_joint: Annotated[int, Field(ge=0)] | None = None
    mobile: bool | None = None
    self_collision: bool | None = None
    dimension: Literal[2, 3] | None = None
    name: Text | None = None

    @model_validator(mode="after")
    def _fields_of_kind(self) -> RobotPart:
        wanted = _ROBOT_FIELDS[self.kind]
        for name in ("length", "width", "corners", "outline", "joints", "bodies", "tool"):
            if (getattr(self, name) is not None) != (name in wanted):
                what = "needs" if name in wanted else "takes no"
                raise ValueError(f"a robot of kind {self.kind!r} {what} {name}")
        for name in ("tool_joint", "mobile", "self_collision"):
            if getattr(self, name) is not None and self.kind != "linkage":
                raise ValueError(f"a robot of kind {self.kind!r} takes no {name}")
        if self.kind == "linkage" and self.dimension is not None:
            raise ValueError("a robot of kind 'linkage' takes no dimension")
        return self

    @property
    def first_angle(self) -> int:
        """The first of the coordinates of a configuration that are angles."""
        return 0 if self.kind == "linkage" and not self.mobile else 2

    def robot(self) -> Mechanism:
        """The robot.

        Raises:
            InvalidInputError: An outline that cannot be one.
        """
        if self.kind == "linkage":
            return self._linkage()
        if self.kind == "point":
            made = Robot.point()
        elif self.kind == "segment":
            made = Robot.segment(self.length or 0.0)
        elif self.kind == "rectangle":
            made = Robot.rectangle(self.length or 0.0, self.width or 0.0)
        elif self.kind == "polygon":
            made = Robot.polygon(self.corners or [])
        else:
            made = Robot(geojson_shape("outline", self.outline), self.dimension or 3, "outline")
        dimension = made.dimension if self.dimension is None else self.dimension
        return Robot(made.outline, dimension, made.name if self.name is None else self.name)

    def _linkage(self) -> Linkage:
        joints = self.joints or []
        last = len(joints) - 1 if self.tool_joint is None else self.tool_joint
        x, y = self.tool or (0.0, 0.0)
        return Linkage(
            tuple(
                Joint(
                    (joint.offset[0], joint.offset[1]),
                    joint.parent,
                    joint.heading,
                    None if joint.limits is None else (joint.limits[0], joint.limits[1]),
                    joint.name,
                )
                for joint in joints
            ),
            tuple(
                Body(body.joint, geojson_shape(f"robot.bodies[{k}]", body.outline))
                for k, body in enumerate(self.bodies or [])
            ),
            (last, (x, y)),
            bool(self.mobile),
            bool(self.self_collision),
            "linkage" if self.name is None else self.name,
        )

    @classmethod
    def _of_linkage(cls, robot: Linkage) -> RobotPart:
        return cls.model_validate(
            {
                "kind": "linkage",
                "name": robot.name,
                "joints": [
                    {
                        "name": joint.name,
                        "parent": joint.parent,
                        "offset": list(joint.offset),
                        "heading": joint.heading,
                        "limits": None if joint.limits is None else list(joint.limits),
                    }
                    for joint in robot.joints
                ],
                "bodies": [{"joint": body.joint, "outline": _geojson(body.outline)} for body in robot.bodies],
                "tool_joint": robot.tool[0],
                "tool": list(robot.tool[1]),
                "mobile": robot.mobile,
                "self_collision": robot.self_collision,
            }
        )

    @classmethod
    def of(cls, robot: Mechanism) -> RobotPart:
        """The shortest form from which the same robot comes back.

        Raises:
            InvalidInputError: A robot that a file cannot say.
        """
        if isinstance(robot, Linkage):
            return cls._of_linkage(robot)
        outline = rigid(robot, "problem file").outline
        forms: list[dict[str, Any]] = []
        if isinstance(outline, shapely.Point):
            forms.append({"kind": "point"})
        _, _, xmax, ymax = outline.bounds
        if isinstance(outline, shapely.LineString) and xmax > 0:
            forms.append({"kind": "segment", "length": 2.0 * xmax})
        if isinstance(outline, shapely.Polygon):
            if min(xmax, ymax) > 0:
                forms.append({"kind": "rectangle", "length": 2.0 * xmax, "width": 2.0 * ymax})
            forms.append({"kind": "polygon", "corners": shapely.get_coordinates(outline)[:-1].tolist()})
        forms.append({"kind": "outline", "outline": _geojson(outline)})
        for form in forms:
            part = cls.model_validate({**form, "dimension": robot.dimension, "name": robot.name})
            try:
                again = rigid(part.robot(), "problem file")
                same = shapely.to_wkb(again.outline) == shapely.to_wkb(outline)
            except InvalidInputError:
                continue
            if same:
                return part
        raise InvalidInputError(f"robot: expected an outline that can be written, got {outline}")


_ROBOT_FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "point": (),
    "segment": ("length",),
    "rectangle": ("length", "width"),
    "polygon": ("corners",),
    "outline": ("outline",),
    "linkage": ("joints", "bodies", "tool"),
}


class GoalRule(_Model):
    """When the goal counts as reached; see `Task`."""

    tolerance: Annotated[float, Field(allow_inf_nan=False, ge=0)] = 0.0
    by_edge: bool = True


class Metric(_Model):
    """Weights of the distance."""

    rotation_weight: Size | None = None


class Units(_Model):
    """Units of lengths and angles. Lengths are only named; angles in degrees become radians."""

    length: Text = "m"
    angle: Literal["rad", "deg"] = "rad"


class MapPart(_Model):
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


class ProblemFile(_Model):
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

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise InvalidInputError(_message(error.errors(include_url=False)[0])) from None

    # `model_validate` goes its own way, past this constructor: whoever calls it says where in a file it is.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    format: Literal["guided-gym problem 1"]
    name: Text = "problem"
    units: Units = Units()
    origin: Pair = [0.0, 0.0]
    bounds: Box | None = None
    start: Vector | None = None
    goal: Vector | None = None
    goals: Annotated[list[Vector], Field(min_length=1, max_length=10_000)] | None = None
    goal_rule: GoalRule = GoalRule()
    metric: Metric = Metric()
    robot: RobotPart | None = None
    map: MapPart | None = None
    obstacles: list[Shape] = []
    regions: dict[Text, Shape] = {}
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
            file = inside_folder(folder, self.map.file, folder)
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


def pose_trouble(space: ConfigurationSpace, q: np.ndarray[Any, Any], names: Sequence[str] = ()) -> str:
    """Why a pose is not free, and the nearest one that is.

    Args:
        space: The configuration space.
        q: (d,) a configuration that is not valid.
        names: What to call the first of the obstacles; the others get their number.
    """
    placed = shapely.union_all(space.robot.place(q))
    hits = hit_obstacles(space.environment, placed)
    called = [names[i] if i < len(names) else f"obstacle {i}" for i in hits]
    if called:
        what = "in collision with " + ", ".join(dict.fromkeys(called[:4]))
        what += f" and {len(called) - 4} more" if len(called) > 4 else ""
    elif shapely.box(*space.environment.bounds).contains_properly(placed):
        what = f"nearer to an obstacle or the bounds than the tolerance {space.tolerance:.3g}"
    else:
        what = f"touching or crossing the bounds {space.environment.bounds}"
    near = nearest_free_pose(space, q)
    hint = "none was found near it" if near is None else f"{[round(v, 6) for v in near.tolist()]} is free"
    return f"{q.tolist()}, {what}; {hint}"


# Reading ----------------------------------------------------------------------------------------------------


def read_problem_file(path: str | Path) -> ProblemFile:
    """The model of a problem file.

    Raises:
        StorageError: It cannot be read, or is no TOML or JSON; names the line.
        InvalidInputError: A field is missing, unknown, of the wrong type or out of range.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in PROBLEM_SUFFIXES:
        raise InvalidInputError(f"{path}: expected a problem file (.toml or .json), got {shown(path.suffix)}")
    text = read_text(path, _LARGEST[suffix])
    return _validated(path, text, _parsed(path, text))


def _parsed(path: Path, text: str) -> Any:
    check_nesting(path, text)
    return parsed_json(path, text) if path.suffix.lower() == ".json" else parsed_toml(path, text)


def parsed_toml(path: Path, text: str) -> dict[str, Any]:
    """The content of a TOML text.

    Raises:
        StorageError: It is none, or nested deeper than any honest file; names the line where it can.
    """
    check_nesting(path, text)
    deepest = max((part.count(".") for part in re.split(r"[=,\[\]{}\n]", text)), default=0)
    if deepest > MOST_NESTED:  # Python's reader takes the square of that
        raise StorageError(f"{path}: expected keys of at most {MOST_NESTED} parts, got {deepest + 1}")
    if re.search(r"[0-9_]{5000}", text):  # Python's reader takes a hundred times the memory
        raise StorageError(f"{path}: expected TOML, got an integer of thousands of digits")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = re.search(r"line (\d+)", str(error))
        place = f", line {match[1]}" if match else ", at its end"
        what = re.sub(r" \(at .*\)$", "", str(error))
        raise StorageError(f"{path}{place}: expected TOML, got: {what}") from error
    except (ValueError, RecursionError, OverflowError) as error:
        raise StorageError(f"{path}: expected TOML, got: {reason(error)}") from error


def _validated(path: Path, text: str, content: Any) -> ProblemFile:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        got = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise InvalidInputError(f"{path}: format: expected {FORMAT!r}, got {str(got)[:60]!r}")
    try:
        return ProblemFile.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = first["loc"]
        named = re.match(r"Value error, ([a-z_]+)(?:\[(\d+)\])?:", str(first["msg"]))
        if not place and named:
            place = (named[1],) if named[2] is None else (named[1], int(named[2]))
        line = _line_of(path, text, place)
        raise InvalidInputError(f"{path}, line {line}: {_message(first)}") from None
    except OverflowError as error:
        raise InvalidInputError(f"{path}: expected numbers up to 1e12, got: {error}") from None


def _message(error: Any) -> str:
    """One line of ours for an error of pydantic's."""
    loc = error["loc"]
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")
    before = f"{field}: " if field else ""
    if error["type"] == "missing":
        return f"{before}expected this field, got none"
    if error["type"] == "extra_forbidden":
        known = _fields_at(loc[:-1])
        close = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"{before}unknown field{hint} (known: {', '.join(known)})"
    text = str(error["msg"])
    if error["type"] == "value_error":
        return before + text.removeprefix("Value error, ")
    text = re.sub(r"^Input should be |^(List|String|Dictionary) should ", "expected ", text)
    got = error["input"]
    if isinstance(got, list | dict | str) and len(got) > 8:
        got = f"{type(got).__name__} of {len(got)}"
        return f"{before}{text}, got a {got}"
    said = shown(got)
    return f"{before}{text}, got {said if len(said) <= 60 else said[:57] + '...'}"


def _fields_at(loc: Sequence[int | str]) -> list[str]:
    """Names of the fields of the model at a place of the file."""
    models: dict[str, type[_Model]] = {
        "units": Units, "goal_rule": GoalRule, "metric": Metric, "robot": RobotPart, "map": MapPart,
        "obstacles": Shape, "regions": Shape,
    }  # fmt: skip
    return list(models.get(str(loc[0]), ProblemFile).model_fields) if loc else list(ProblemFile.model_fields)


_TOKEN: Final = re.compile(r'"(?:\\.|[^"\\\n])*"|#[^\n]*|[\[\]{}:=,]|[^\s\[\]{}:=,"#]+')


def _line_of(path: Path, text: str, place: tuple[int | str, ...]) -> int:
    """The line of a field, or of what it would stand in."""
    if path.suffix.lower() == ".json":
        return _json_line(text, place, 1)
    return _toml_line(text, place)


def _json_line(text: str, place: tuple[int | str, ...], first: int) -> int:
    """The line where the value at a place begins, as deep as it is found; ``first`` is the first line."""
    best_depth, best = -1, first
    path: list[int | str] = []
    objects: list[bool] = []
    wants_key = False
    line, counted = first, 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token == ",":
            if objects and objects[-1]:
                wants_key = True
            elif path and isinstance(path[-1], int):
                path[-1] += 1
        elif token in ":=" or token[0] == "#":
            continue
        elif token in "]}":
            if objects:
                objects.pop()
                path.pop()
            wants_key = False
            if not objects:
                break
        elif wants_key:
            path[-1] = token.strip('"')
            wants_key = False
        else:
            if len(path) > best_depth and place[: len(path)] == tuple(path):
                line += text.count("\n", counted, match.start())
                counted = match.start()
                best_depth, best = len(path), line
                if best_depth == len(place):
                    break
            if token in "[{":
                objects.append(token == "{")
                wants_key = token == "{"
                path.append("" if wants_key else 0)
    return best


def _toml_line(text: str, place: tuple[int | str, ...]) -> int:
    """The line of a field of a TOML file, as deep as it is found."""
    best_depth, best = 0, 1
    table: tuple[int | str, ...] = ()
    counts: dict[tuple[int | str, ...], int] = {}
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        header = re.match(r"\s*(\[\[?)\s*([A-Za-z_\"'][^\[\],]*?)\s*\]\]?\s*(#.*)?$", line)
        key = re.match(r"\s*([A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')\s*(?:\.\s*[A-Za-z0-9_-]+\s*)?=", line)
        if header:
            table = tuple(part.strip().strip("\"'") for part in header[2].split("."))
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
            here = table
        elif key:
            here = (*table, key[1].strip("\"'"))
        else:
            continue
        if len(here) > best_depth and place[: len(here)] == here:
            best_depth, best = len(here), number
            if key and len(place) > len(here):
                rest = line[key.end() :] + "\n" + "\n".join(lines[number:])
                return _json_line(rest, place[len(here) :], number)
    return best


# Loading and saving -----------------------------------------------------------------------------------------


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
    problems: list[Problem] = _built(path, lambda: model.problems(path.parent))
    return problems


@door
def load_environment(path: str | Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a problem file or of a map in any format that is read; errors as `load_problem`."""
    path = Path(path)
    if path.suffix.lower() not in PROBLEM_SUFFIXES:
        return read_map(path, options)
    model = read_problem_file(path)
    environment: Environment = _built(path, lambda: model.environment(path.parent))
    return environment


def _built(path: Path, build: Any) -> Any:
    """What ``build`` makes of a problem file; its errors with file and line."""
    try:
        return build()
    except InvalidInputError as error:
        message = str(error)
        match = re.match(r"([a-z_]+)(?:\[(\d+)\])?(?:\.([^:]+))?", message)
        if str(path.parent / "") in message.split(": ")[0] or match is None:
            raise
        place = tuple(part for part in (match[1], match[2] and int(match[2]), match[3]) if part is not None)
        line = _line_of(path, read_text(path), place)
        raise InvalidInputError(f"{path}, line {line}: {message}") from None


def file_of(problem: Problem, *, length: str = "m", origin: Sequence[float] = (0.0, 0.0)) -> ProblemFile:
    """The model of a problem, for `write_problem_file`.

    Raises:
        InvalidInputError: A number beyond what a file may have.
    """
    space = problem.environment
    room = RoomPart.of(space) if isinstance(space, SpatialEnvironment) else None
    try:
        return ProblemFile(
            format=FORMAT,
            name=problem.name,
            units=Units(length=length),
            origin=[float(v) for v in origin],
            bounds=None if room else list(problem.environment.bounds),
            start=problem.task.start.tolist(),
            goal=problem.task.goal.tolist(),
            goal_rule=GoalRule(tolerance=problem.task.tolerance, by_edge=problem.task.by_edge),
            metric=Metric(
                rotation_weight=None if problem.rotation_weight is None else float(problem.rotation_weight)
            ),
            robot=None if room else RobotPart.of(problem.robot),
            obstacles=[] if room else [_polygon_part(one) for one in problem.environment.obstacles],
            room=room,
            arm=ArmPart.of(problem.robot) if isinstance(problem.robot, SpatialArm) else None,
            regions={name: Shape(geojson=_geojson(shape)) for name, shape in problem.regions.items()},
        )
    except ValidationError as error:
        raise InvalidInputError(_message(error.errors(include_url=False)[0])) from None


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
    try:
        return ProblemFile(
            **fields,
            bounds=list(environment.bounds),
            start=list(poses["start"]) if "start" in poses else None,
            goal=list(poses["goal"]) if "goal" in poses else None,
            goals=[list(q) for name, q in poses.items() if name.startswith("goals[")] or None,
            metric=Metric(rotation_weight=rotation_weight),
            robot=None if robot is None else RobotPart.of(robot),
            obstacles=[_polygon_part(one) for one in environment.obstacles],
        )
    except ValidationError as error:
        raise InvalidInputError(_message(error.errors(include_url=False)[0])) from None


def _polygon_part(polygon: shapely.Polygon) -> Shape:
    rings = [shapely.get_coordinates(ring)[:-1].tolist() for ring in (polygon.exterior, *polygon.interiors)]
    return Shape(polygon=rings[0], holes=rings[1:])


def _geojson(shape: shapely.Geometry) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(json.dumps(shapely.geometry.mapping(shape)))
    return content


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
    content = _content(model)
    writers = {".toml": _toml, ".json": _json}
    if path.suffix.lower() not in writers:
        raise InvalidInputError(f"{path}: expected a problem file (.toml or .json), got {shown(path.suffix)}")
    write_whole(path, writers[path.suffix.lower()](content))


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
    try:
        model = ProblemFile.model_validate(content)
    except ValidationError as error:
        raise InvalidInputError(f"{where}: {_message(error.errors(include_url=False)[0])}") from None
    if model.map is not None:
        raise InvalidInputError(f"{where}: expected a problem that needs no other file, got one with a map")
    if model.goals is not None:
        raise InvalidInputError(f"{where}: goals: expected one goal, got {len(model.goals)} in a list")
    try:
        (problem,) = model.problems(where.parent)
        return problem
    except InvalidInputError as error:
        raise InvalidInputError(f"{where}: {error}") from None


def _json(content: Mapping[str, Any]) -> str:
    """JSON with a line for each field, obstacle and region."""
    rows = []
    for name, value in content.items():
        if name == "obstacles":
            body = ",\n".join("    " + json.dumps(part, ensure_ascii=False) for part in value)
            rows.append(f"  {json.dumps(name)}: [\n{body}\n  ]")
        elif name == "regions":
            body = ",\n".join(
                f"    {json.dumps(key, ensure_ascii=False)}: {json.dumps(part, ensure_ascii=False)}"
                for key, part in value.items()
            )
            rows.append(f"  {json.dumps(name)}: {{\n{body}\n  }}")
        else:
            rows.append(f"  {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}")
    return "{\n" + ",\n".join(rows) + "\n}\n"


def _toml(content: Mapping[str, Any]) -> str:
    """TOML with tables for the parts of the model."""
    plain = [f"{name} = {_toml_value(v)}" for name, v in content.items() if not isinstance(v, dict | list)]
    plain += [
        f"{name} = {_toml_value(v)}"
        for name, v in content.items()
        if isinstance(v, list) and name != "obstacles"
    ]
    rows = plain
    for name, value in content.items():
        if not isinstance(value, dict):
            continue
        if name == "regions":
            for key, part in value.items():
                rows += ["", f"[regions.{_toml_value(key)}]", *_toml_rows(part)]
        else:
            rows += ["", f"[{name}]", *_toml_rows(value)]
    for part in content.get("obstacles", ()):
        rows += ["", "[[obstacles]]", *_toml_rows(part)]
    return "\n".join(rows) + "\n"


def _toml_rows(part: Mapping[str, Any]) -> list[str]:
    return [f"{name} = {_toml_value(value)}" for name, value in part.items() if value is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml_value(k)} = {_toml_value(v)}" for k, v in value.items()) + " }"
    return repr(value)


# As distributions -------------------------------------------------------------------------------------------


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
        self.environment = read_map(inside_folder(path.parent, name, path))
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
