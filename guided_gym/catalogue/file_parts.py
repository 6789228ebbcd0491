"""What a problem file says: shapes and planar robots; `guided_gym.catalogue.space_parts` has arms in space.

Each part has the names of what it stands for, so that one function (`Part.of`) writes them all.
"""

from __future__ import annotations

import json
import re
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Final, Literal

import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field, model_validator

from guided_gym.catalogue.map_formats.geojson import geojson_shape
from guided_gym.errors import InvalidInputError, named
from guided_gym.geometry.linkages import Body, Joint, Linkage
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.robots import Robot, rigid

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Size = Annotated[float, Field(allow_inf_nan=False, gt=0, le=1e12)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Ring = Annotated[list[Pair], Field(min_length=3)]
Vector = Annotated[list[Number], Field(min_length=1, max_length=1000)]
Box = Annotated[list[Number], Field(min_length=4, max_length=4)]
Text = Annotated[str, Field(max_length=10_000)]


def plain(value: Any) -> Any:
    """A value as files have it: lists for tuples, GeoJSON for shapes, and dictionaries for dataclasses."""
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    if isinstance(value, shapely.Geometry):
        return json.loads(json.dumps(shapely.geometry.mapping(value)))
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value


class Part(BaseModel):
    """A part of a problem file: no field that it does not know, and none of another type."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Shape(Part):
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

    @classmethod
    def of(cls, polygon: shapely.Polygon) -> Shape:
        """The part from which the same polygon comes back."""
        rings = [
            shapely.get_coordinates(ring)[:-1].tolist() for ring in (polygon.exterior, *polygon.interiors)
        ]
        return cls(polygon=rings[0], holes=rings[1:])


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


class JointPart(Part):
    """A joint of a linkage; see `Joint`."""

    name: Text = ""
    parent: Annotated[int, Field(ge=-1)] = -1
    offset: Pair = [0.0, 0.0]
    heading: Number = 0.0
    limits: Pair | None = None


class BodyPart(Part):
    """A body on a joint of a linkage; see `Body`."""

    joint: Annotated[int, Field(ge=0)]
    outline: dict[str, Any]


class RobotPart(Part):
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
        for name in {name: None for names in _ROBOT_FIELDS.values() for name in names}:
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
            InvalidInputError: It cannot be one; names the field.
        """
        if self.kind == "linkage":
            return self._linkage()
        values = [getattr(self, name) for name in _ROBOT_FIELDS[self.kind]]
        if self.kind == "outline":
            values = [geojson_shape("robot.outline", self.outline), self.dimension or 3, "outline"]
        with named("robot"):
            make = Robot if self.kind == "outline" else getattr(Robot, self.kind)
            made = make(*values)
            dimension = made.dimension if self.dimension is None else self.dimension
            return Robot(made.outline, dimension, made.name if self.name is None else self.name)

    def _linkage(self) -> Linkage:
        joints, bodies = [], []
        for k, joint in enumerate(self.joints or ()):
            with named(f"robot.joints[{k}]"):
                joints.append(Joint(**joint.model_dump()))
        for k, body in enumerate(self.bodies or ()):
            outline = geojson_shape(f"robot.bodies[{k}].outline", body.outline)
            with named(f"robot.bodies[{k}]"):
                bodies.append(Body(body.joint, outline))
        with named("robot"):
            return Linkage(
                tuple(joints),
                tuple(bodies),
                (len(joints) - 1 if self.tool_joint is None else self.tool_joint, self.tool),  # type: ignore[arg-type]
                bool(self.mobile),
                bool(self.self_collision),
                "linkage" if self.name is None else self.name,
            )

    @classmethod
    def of(cls, robot: Mechanism) -> RobotPart:
        """The shortest form from which the same robot comes back.

        Raises:
            InvalidInputError: A robot that a file cannot say.
        """
        if isinstance(robot, Linkage):
            on, tool = robot.tool
            said = {**plain(robot), "tool_joint": on, "tool": plain(tool)}
            return cls.model_validate({"kind": "linkage", **said})
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
        forms.append({"kind": "outline", "outline": plain(outline)})
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
