"""Solids in space: boxes, cylinders, capsules and spheres, and the room that holds them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import instance, number, vector
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.kernels.packing import BOX, CYLINDER

FloatArray = npt.NDArray[np.float64]
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]

_AZIMUTH, _ELEVATION = math.radians(-62.0), math.radians(18.0)
VIEW: Final = np.array(
    [
        [-math.sin(_AZIMUTH), math.cos(_AZIMUTH), 0.0],
        [
            -math.sin(_ELEVATION) * math.cos(_AZIMUTH),
            -math.sin(_ELEVATION) * math.sin(_AZIMUTH),
            math.cos(_ELEVATION),
        ],
    ]
)
"""(2, 3) the plane of the pictures: what is drawn of a point in space is VIEW @ point (no perspective)."""

_CORNERS: Final = 32  # of a polygon that stands for a circle in pictures


def triple(what: str, value: object) -> Triple:
    """Three finite numbers.

    Raises:
        InvalidInputError: It is something else.
    """
    x, y, z = vector(what, value, 3).tolist()
    return x, y, z


def rotation(rpy: Sequence[float]) -> Matrix:
    """The rotation of URDF's roll, pitch and yaw (radians): about x, y and z in turn, all fixed axes."""
    a, b, c = triple("roll, pitch, yaw", rpy)
    (sa, ca), (sb, cb), (sc, cc) = ((math.sin(t), math.cos(t)) for t in (a, b, c))
    return (
        (cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa),
        (sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa),
        (-sb, cb * sa, cb * ca),
    )


def turned_to(axis: FloatArray) -> FloatArray:
    """(3, 3) a rotation whose third column is that direction; the identity for z."""
    z = axis / np.linalg.norm(axis)
    helper = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = helper - z * (helper @ z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@doors
class Solid:
    """A convex body that does not move."""

    kind: int

    def numbers(self) -> FloatArray:
        """(SOLID_SIZE,) as `guided_gym.kernels.spatial` has them."""
        raise NotImplementedError

    def shadow(self) -> shapely.Polygon:
        """What pictures show of it."""
        raise NotImplementedError

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the box around it."""
        raise NotImplementedError

    def shrunk(self, margin: float) -> Solid | None:
        """The solid, smaller by that margin all around, or a smaller solid; None if nothing is left."""
        raise NotImplementedError

    @property
    def thickness(self) -> float:
        """Diameter of the largest ball in it."""
        raise NotImplementedError

    @property
    def size(self) -> tuple[float, float]:
        """Volume and surface."""
        raise NotImplementedError

    def gap(self, start: FloatArray, end: FloatArray) -> float:
        """Distance from a segment (3,), (3,); -1 where it reaches into the solid's core."""
        from guided_gym.kernels.spatial import gap  # compiles when it is first imported

        found: float = gap(np.concatenate([[1e-9, 0.0], self.numbers()]), self.kind, start, end)
        return found


@doors
@dataclass(frozen=True)
class Box(Solid):
    """A box.

    Attributes:
        centre: Its middle.
        sides: Length along each of its axes.
        rpy: Roll, pitch and yaw by which its axes are turned (radians).
    """

    centre: Triple
    sides: Triple
    rpy: Triple = (0.0, 0.0, 0.0)
    kind = BOX

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", triple("a box's centre", self.centre))
        sides = triple("a box's sides", self.sides)
        object.__setattr__(self, "sides", tuple(number("a box's side", side, above=0) for side in sides))
        object.__setattr__(self, "rpy", triple("a box's rpy", self.rpy))

    @classmethod
    def between(cls, low: Sequence[float] | FloatArray, high: Sequence[float] | FloatArray) -> Box:
        """The box from one corner to the other, its sides along the axes."""
        a, b = np.array(triple("a corner", low)), np.array(triple("a corner", high))
        return cls(triple("centre", 0.5 * (a + b)), triple("sides", b - a))

    def numbers(self) -> FloatArray:
        """As `Solid`."""
        half = 0.5 * np.array(self.sides)
        axes = np.array(rotation(self.rpy)).T
        return np.concatenate([self.centre, axes.ravel(), half, [0.0, np.linalg.norm(half)]])

    def _corners(self) -> FloatArray:
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
        corners: FloatArray = (signs * self.sides) @ np.array(rotation(self.rpy)).T + self.centre
        return corners

    def shadow(self) -> shapely.Polygon:
        """As `Solid`."""
        return shapely.MultiPoint(self._corners() @ VIEW.T).convex_hull

    def box(self) -> tuple[FloatArray, FloatArray]:
        """As `Solid`."""
        corners = self._corners()
        return corners.min(axis=0), corners.max(axis=0)

    def shrunk(self, margin: float) -> Box | None:
        """As `Solid`."""
        x, y, z = (side - 2.0 * margin for side in self.sides)
        return replace(self, sides=(x, y, z)) if min(x, y, z) > 0 else None

    @property
    def thickness(self) -> float:
        """As `Solid`."""
        return min(self.sides)

    @property
    def size(self) -> tuple[float, float]:
        """As `Solid`."""
        x, y, z = self.sides
        return x * y * z, 2.0 * (x * y + y * z + z * x)


@dataclass(frozen=True)
class _Round(Solid):
    """What has an axis and a radius.

    Attributes:
        start: Where its axis begins.
        end: Where it ends.
        radius: Its radius (length).
    """

    start: Triple
    end: Triple
    radius: float

    def __post_init__(self) -> None:
        what = f"a {type(self).__name__.lower()}'s"
        object.__setattr__(self, "start", triple(f"{what} start", self.start))
        object.__setattr__(self, "end", triple(f"{what} end", self.end))
        object.__setattr__(self, "radius", number(f"{what} radius", self.radius, least=0))

    @property
    def length(self) -> float:
        """Length of the axis."""
        return math.dist(self.start, self.end)

    @property
    def _ends(self) -> tuple[FloatArray, FloatArray]:
        return np.array(self.start), np.array(self.end)

    def _axes(self) -> FloatArray:
        a, b = self._ends
        return turned_to(b - a).T if self.length > 0 else np.eye(3)


@doors
@dataclass(frozen=True)
class Capsule(_Round):
    """All points within a radius of a segment; a sphere if the segment is a point."""

    kind = BOX

    @classmethod
    def sphere(cls, centre: Sequence[float], radius: float) -> Capsule:
        """A sphere."""
        return cls(triple("centre", centre), triple("centre", centre), radius)

    def numbers(self) -> FloatArray:
        """As `Solid`."""
        a, b = self._ends
        half = 0.5 * self.length
        sides = [0.0, 0.0, half, self.radius, half + self.radius]
        return np.concatenate([0.5 * (a + b), self._axes().ravel(), sides])

    def shadow(self) -> shapely.Polygon:
        """As `Solid`."""
        return _shadow(self._ends, self.radius)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """As `Solid`."""
        a, b = self._ends
        return np.minimum(a, b) - self.radius, np.maximum(a, b) + self.radius

    def shrunk(self, margin: float) -> Capsule | None:
        """As `Solid`."""
        return replace(self, radius=self.radius - margin) if self.radius > margin else None

    def moved(self, turned: FloatArray, offset: FloatArray) -> Capsule:
        """The capsule turned by a matrix (3, 3), and then moved."""
        a, b = (triple("end", turned @ end + offset) for end in self._ends)
        return Capsule(a, b, self.radius)

    @property
    def thickness(self) -> float:
        """As `Solid`."""
        return 2.0 * self.radius

    @property
    def size(self) -> tuple[float, float]:
        """As `Solid`."""
        r, length = self.radius, self.length
        return math.pi * r * r * (length + 4.0 * r / 3.0), 2.0 * math.pi * r * (length + 2.0 * r)


@doors
@dataclass(frozen=True)
class Cylinder(_Round):
    """A cylinder with flat ends."""

    kind = CYLINDER

    def __post_init__(self) -> None:
        super().__post_init__()
        number("a cylinder's length", self.length, above=0)
        number("a cylinder's radius", self.radius, above=0)

    def numbers(self) -> FloatArray:
        """As `Solid`."""
        a, b = self._ends
        half = 0.5 * self.length
        sides = [self.radius, self.radius, half, 0.0, math.hypot(self.radius, half)]
        return np.concatenate([0.5 * (a + b), self._axes().ravel(), sides])

    def _rims(self) -> FloatArray:
        turns = 2.0 * math.pi * np.arange(_CORNERS) / _CORNERS
        x, y, _ = self._axes()
        rim = self.radius * (np.cos(turns)[:, None] * x + np.sin(turns)[:, None] * y)
        return np.concatenate([rim + end for end in self._ends])

    def shadow(self) -> shapely.Polygon:
        """As `Solid`."""
        return shapely.MultiPoint(self._rims() @ VIEW.T).convex_hull

    def box(self) -> tuple[FloatArray, FloatArray]:
        """As `Solid`."""
        a, b = self._ends
        reach = self.radius * np.sqrt(np.maximum(0.0, 1.0 - self._axes()[2] ** 2))
        return np.minimum(a, b) - reach, np.maximum(a, b) + reach

    def shrunk(self, margin: float) -> Cylinder | None:
        """As `Solid`."""
        if not (self.radius > margin and self.length > 2.0 * margin):
            return None
        a, b = self._ends
        aside = margin * (b - a) / self.length
        return Cylinder(triple("start", a + aside), triple("end", b - aside), self.radius - margin)

    @property
    def thickness(self) -> float:
        """As `Solid`."""
        return min(2.0 * self.radius, self.length)

    @property
    def size(self) -> tuple[float, float]:
        """As `Solid`."""
        r, length = self.radius, self.length
        return math.pi * r * r * length, 2.0 * math.pi * r * (length + r)


def _shadow(ends: tuple[FloatArray, FloatArray], radius: float) -> shapely.Polygon:
    points = np.array(ends) @ VIEW.T
    line = shapely.LineString(points) if np.ptp(points, axis=0).any() else shapely.Point(points[0])
    return line.buffer(radius, quad_segs=_CORNERS // 4)


@doors
@dataclass(frozen=True, init=False)
class SpatialEnvironment(Environment):
    """An environment in space: a room not to leave, solids not to touch.

    Its ``bounds`` and ``obstacles`` are what pictures show of it: the room and each solid as they are seen
    from one side (`VIEW`). Robots in space know the solids.

    Attributes:
        room: (xmin, ymin, zmin, xmax, ymax, zmax).
        solids: Boxes, cylinders, capsules and spheres; they may overlap and stick out of the room.
    """

    in_space: ClassVar[bool] = True
    room: tuple[float, ...] = ()
    solids: tuple[Solid, ...] = ()

    def __init__(self, room: Sequence[float], solids: Sequence[Solid] = ()) -> None:
        """Check room and solids.

        Raises:
            InvalidInputError: A room that is not finite and ordered, what is no solid, or one that lies
                wholly outside.
        """
        sides = vector("room", room, 6)
        low, high = sides[:3], sides[3:]
        if not (low < high).all():
            raise InvalidInputError(
                f"room: expected (xmin, ymin, zmin, xmax, ymax, zmax), each least below its greatest, "
                f"got {sides.tolist()}"
            )
        if isinstance(solids, Solid):
            solids = (solids,)
        for k, solid in enumerate(solids):
            one, two = instance(f"solid {k}", solid, Solid).box()
            if (one > high).any() or (two < low).any():
                raise InvalidInputError(
                    f"solid {k}: expected one that meets the room {sides.tolist()}, got {solid}"
                )
        object.__setattr__(self, "room", tuple(sides.tolist()))
        object.__setattr__(self, "solids", tuple(solids))
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T @ VIEW.T
        object.__setattr__(self, "bounds", (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()))
        object.__setattr__(self, "obstacles", tuple(solid.shadow() for solid in self.solids))

    @property
    def extent(self) -> float:
        """Diagonal of the room (length)."""
        return math.dist(self.room[:3], self.room[3:])

    @property
    def sides(self) -> dict[str, float]:
        """The room's sides by name, the lower ones first."""
        return dict(zip(("xmin", "ymin", "zmin", "xmax", "ymax", "zmax"), self.room, strict=True))

    @cached_property
    def width(self) -> float:
        """Twice the volume of the free space over its surface: the width of a gap between two plates."""
        x, y, z = np.subtract(self.room[3:], self.room[:3]).tolist()
        sizes = np.array([solid.size for solid in self.solids]).reshape(-1, 2)
        volume = x * y * z - float(sizes[:, 0].sum())
        surface = 2.0 * (x * y + y * z + z * x) + float(sizes[:, 1].sum())
        return 2.0 * volume / surface if volume > 0 else 0.05 * self.extent

    @property
    def least_width(self) -> float:
        """`width`, which takes next to nothing."""
        return self.width

    def magnitudes(self) -> tuple[float, float]:
        """The largest coordinate, twice: the kernels' are the caller's."""
        boxes = [np.abs(self.room).max(), *(np.abs(solid.box()).max() for solid in self.solids)]
        return float(max(boxes)), float(max(boxes))

    def keeping(self, kept: Sequence[int]) -> SpatialEnvironment:
        """The same room with some of the solids."""
        return SpatialEnvironment(self.room, [self.solids[i] for i in kept])

    def hulls(self) -> SpatialEnvironment:
        """The environment itself: solids are convex."""
        return self

    def boxes(self) -> SpatialEnvironment:
        """A box in place of each solid, its sides along the axes."""
        return SpatialEnvironment(self.room, [Box.between(*solid.box()) for solid in self.solids])

    def shrunk(self, margin: float) -> SpatialEnvironment:
        """The environment with solids that are smaller by a margin all around; thin ones vanish."""
        smaller = (solid.shrunk(margin) for solid in self.solids)
        return SpatialEnvironment(self.room, [solid for solid in smaller if solid is not None])

    @cached_property
    def thinnest(self) -> float:
        """Diameter of the largest ball in the thinnest solid; 0 without any."""
        return min((solid.thickness for solid in self.solids), default=0.0)

    def identity(self) -> Iterator[bytes]:
        """Room and solids, for fingerprints."""
        yield b"room 1" + np.array(self.room, "<f8").tobytes()
        for solid in self.solids:
            yield bytes([solid.kind]) + solid.numbers().astype("<f8").tobytes()
