"""Rigid planar robots: an outline in the body frame, and whether it may turn."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import number, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.convex import Pieces, cover
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Coordinates, Mechanism
from guided_gym.geometry.packing import pack
from guided_gym.kernels.collision import Geometry

FloatArray = npt.NDArray[np.float64]


@doors
@dataclass(frozen=True)
class Robot(Mechanism):
    """A rigid robot r (paper, section "Preliminaries") that moves in the plane.

    Its configuration is (x, y) of the reference point if `dimension` is 2, and (x, y, theta) if it is 3. The
    reference point is the origin of the body frame.

    Attributes:
        outline: Point, LineString or simple Polygon without holes, in the body frame. A collection, as from
            `shapely.make_valid`, stands for its polygon if it has just one.
        dimension: 2 (translates only) or 3 (translates and turns).
        name: A name for people, which is no part of the robot's identity.

    Raises:
        InvalidInputError: The outline is empty, non-finite, self-intersecting, has holes or is of another
            kind, or the dimension is neither 2 nor 3.
    """

    outline: shapely.Point | shapely.LineString | shapely.Polygon
    dimension: int = 3  # type: ignore[override,unused-ignore]
    name: str = field(default="robot", compare=False)

    def __post_init__(self) -> None:
        if type(self.dimension) is not int or self.dimension not in (2, 3):
            raise InvalidInputError(
                f"a planar robot's dimension is 2 (x, y) or 3 (x, y, theta), not {shown(self.dimension)}"
            )
        object.__setattr__(self, "outline", checked_outline(self.outline))
        if self.dimension == 3 and self.radius == 0.0:
            raise InvalidInputError(
                "a robot that turns (dimension 3) needs an outline beyond its reference point"
            )

    @classmethod
    def point(cls) -> Robot:
        """The point robot: configurations (x, y)."""
        return cls(shapely.Point(0.0, 0.0), dimension=2, name="point")

    @classmethod
    def segment(cls, length: float) -> Robot:
        """A thin rod of this length along the body's x axis, its reference point in the middle."""
        half = 0.5 * _positive("length", length)
        return cls(shapely.LineString([(-half, 0.0), (half, 0.0)]), name="segment")

    @classmethod
    def rectangle(cls, length: float, width: float) -> Robot:
        """A rectangle, `length` along the body's x axis, its reference point in the middle."""
        half_x, half_y = 0.5 * _positive("length", length), 0.5 * _positive("width", width)
        return cls(shapely.box(-half_x, -half_y, half_x, half_y), name="rectangle")

    @classmethod
    def polygon(cls, coords: Sequence[Sequence[float]] | FloatArray, *, name: str = "polygon") -> Robot:
        """A simple polygon, convex or not, given by its corners (V, 2) about the reference point (0, 0)."""
        return cls(_polygon_of(coords), name=name)

    @cached_property
    def radius(self) -> float:
        """Circumradius about the reference point (length)."""
        return float(np.hypot(*shapely.get_coordinates(self.outline).T).max())

    @cached_property
    def inner_radius(self) -> float:
        """Radius of the largest disc about the reference point in the outline (length); 0 outside."""
        outline, reference = self.outline, shapely.Point(0.0, 0.0)
        if not (isinstance(outline, shapely.Polygon) and outline.contains(reference)):
            return 0.0
        return float(outline.boundary.distance(reference))

    @cached_property
    def cover(self) -> Pieces:
        """Convex pieces that cover the outline exactly, in one array, in the body frame."""
        return cover(self.outline)

    @property
    def pieces(self) -> list[FloatArray]:
        """Convex pieces (V, 2) of the outline in the body frame."""
        return self.cover.arrays()

    def placed(self, q: Sequence[float] | FloatArray) -> shapely.Point | shapely.LineString | shapely.Polygon:
        """The robot's outline in the workspace at configuration q.

        Raises:
            InvalidInputError: q is not a finite array of shape (dimension,).
        """
        pose = self.checked(q)
        theta = float(pose[2]) if self.dimension == 3 else 0.0
        c, s = np.cos(theta), np.sin(theta)
        rotation = np.array([[c, s], [-s, c]])
        return shapely.transform(self.outline, lambda points: points @ rotation + pose[:2])

    def place(self, q: Sequence[float] | FloatArray) -> tuple[shapely.Geometry, ...]:
        """The robot's outline in the workspace, as its only body."""
        return (self.placed(q),)

    def position(self, q: FloatArray) -> FloatArray:
        """The reference point: (..., d) -> (..., 2)."""
        return self.rows(q)[..., :2]

    @property
    def names(self) -> tuple[str, ...]:
        """x, y and theta."""
        return ("x", "y", "theta")[: self.dimension]

    @property
    def straight(self) -> bool:
        """True: the reference point moves on a straight line."""
        return True

    def coordinates(self, environment: Environment, rotation_weight: float | None = None) -> Coordinates:
        """(x, y) in the bounds, and (theta) in a turn; w is the robot's circumradius by default."""
        xmin, ymin, xmax, ymax = environment.bounds
        weight = self.radius if rotation_weight is None else rotation_weight
        if self.dimension == 3:
            weight = number("rotation_weight", weight, above=0)
        n = self.dimension
        return Coordinates(
            self.names,
            np.array([xmin, ymin, -math.pi][:n]),
            np.array([xmax, ymax, math.pi][:n]),
            np.array([0.0, 0.0, 2.0 * math.pi][:n]),
            np.array([1.0, 1.0, float(weight)][:n]),
        )

    def displacement(self, change: FloatArray) -> FloatArray:
        """How far any point of the body moves at most: (..., d) -> (...)."""
        change = self.rows(change)
        moved: FloatArray = np.hypot(change[..., 0], change[..., 1])
        return moved + self.radius * np.abs(change[..., 2]) if self.dimension == 3 else moved

    @property
    def description(self) -> str:
        """The outline as text."""
        text: str = shapely.to_wkt(shapely.normalize(self.outline), rounding_precision=12)
        return text

    def packed(self, environment: Environment, tolerance: float) -> Geometry:
        """Robot, obstacles and bounds in the arrays of `guided_gym.kernels.collision`."""
        return pack(self.cover, environment.cover, environment.bounds, tolerance, self.radius)

    def entry(self) -> int:
        """0: the kernels of `guided_gym.kernels.collision` are those of a rigid body."""
        return 0

    def identity(self) -> Iterator[bytes]:
        """The outline."""
        yield shapely.to_wkb(self.outline, byte_order=1, include_srid=False)


def rigid(robot: Mechanism, who: str) -> Robot:
    """The robot, if it is rigid and planar: for callers that know no others.

    Args:
        robot: Any robot.
        who: Who asks for it, for the message.

    Raises:
        InvalidInputError: A robot of another kind.
    """
    if isinstance(robot, Robot):
        return robot
    raise InvalidInputError(
        f"{who}: expected a rigid planar robot, got {shown(robot.name)} of {robot.dimension} coordinates"
    )


def checked_outline(outline: object) -> Any:
    """An outline as robots keep it: in two dimensions, polygons counter-clockwise.

    Raises:
        InvalidInputError: It is empty, non-finite, self-intersecting, has holes or is of another kind.
    """
    outline = _only_polygon(outline)
    _check_outline(outline)
    outline = shapely.force_2d(outline)
    return shapely.orient_polygons(outline) if isinstance(outline, shapely.Polygon) else outline


def _positive(what: str, value: float) -> float:
    return number(f"a robot's {what}", value, above=0)


def _polygon_of(coords: Sequence[Sequence[float]] | FloatArray) -> shapely.Polygon:
    try:
        corners = np.asarray(coords, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"a polygon's corners must be numbers of shape (V, 2): {error}") from None
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InvalidInputError(
            f"a polygon needs corners of shape (V, 2) with V >= 3, got shape {corners.shape}"
        )
    if not np.isfinite(corners).all():
        raise InvalidInputError("a polygon's corners must be finite, got NaN or infinity")
    return shapely.Polygon(corners)


def _only_polygon(outline: object) -> Any:
    """The polygon of a collection that has just one; anything else as it is."""
    if isinstance(outline, shapely.MultiPolygon | shapely.GeometryCollection):
        polygons = [part for part in outline.geoms if isinstance(part, shapely.Polygon) and not part.is_empty]
        return polygons[0] if len(polygons) == 1 else outline
    return outline


def _check_outline(outline: object) -> None:
    if not isinstance(outline, shapely.Point | shapely.LineString | shapely.Polygon):
        kind = getattr(outline, "geom_type", type(outline).__name__)
        raise InvalidInputError(f"a robot's outline is a Point, LineString or Polygon, not {kind}")
    if outline.is_empty:
        raise InvalidInputError("a robot's outline must not be empty")
    if not np.isfinite(shapely.get_coordinates(outline)).all():
        raise InvalidInputError("a robot's outline must have finite coordinates, got NaN or infinity")
    if not outline.is_valid:
        raise InvalidInputError(
            f"a robot's outline must be a simple shape: {shapely.is_valid_reason(outline)}"
        )
    if isinstance(outline, shapely.Polygon) and len(outline.interiors):
        raise InvalidInputError(f"a robot's outline must have no holes, got {len(outline.interiors)}")
