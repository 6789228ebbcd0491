"""Planar linkages: bodies on a tree of turning joints, on a base that is fixed or moves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import flag, integer, number, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.convex import Pieces, cover
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Coordinates, Mechanism
from guided_gym.geometry.packing import pack, with_linkage
from guided_gym.geometry.robots import checked_outline
from guided_gym.kernels.collision import Geometry

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Limits = tuple[float, float] | None

LARGEST_LIMIT = 1e3
"""Joints with limits turn by less than this (radians)."""


@doors
@dataclass(frozen=True)
class Joint:
    """A joint that turns, and the frame that turns with it.

    Attributes:
        offset: (x, y) of the joint in its parent's frame (length).
        parent: Index of the joint that carries it; -1 for the base.
        heading: Angle of its frame in its parent's where its coordinate is 0 (radians).
        limits: Smallest and largest angle; None where it turns freely, all the way round.
        name: What messages and columns call it; ``joint<k>`` unless given.

    Raises:
        InvalidInputError: Numbers that are not finite, or limits that leave nothing.
    """

    offset: tuple[float, float] = (0.0, 0.0)
    parent: int = -1
    heading: float = 0.0
    limits: Limits = None
    name: str = ""

    def __post_init__(self) -> None:
        label = f"joint {self.name!r}" if self.name else "a joint"
        object.__setattr__(self, "offset", _point(f"{label}: offset", self.offset))
        object.__setattr__(self, "parent", integer(f"{label}: parent", self.parent, least=-1))
        object.__setattr__(self, "heading", number(f"{label}: heading", self.heading))
        object.__setattr__(self, "limits", _checked_limits(label, self.limits))


@doors
@dataclass(frozen=True)
class Body:
    """A body that moves with a joint.

    Attributes:
        joint: Index of the joint.
        outline: Point, LineString or simple Polygon in the joint's frame, like a `Robot`'s.
    """

    joint: int
    outline: shapely.Point | shapely.LineString | shapely.Polygon

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint", integer("a body's joint", self.joint, least=0))
        object.__setattr__(self, "outline", checked_outline(self.outline))


@doors
@dataclass(frozen=True)
class Linkage(Mechanism):
    """A planar robot with joints: an arm, a snake, a tree of links (a kinematic table).

    Its configuration holds (x, y) of the base first, if that moves, and then the angle of each joint. The
    metric weighs the radians of a joint by the reach of what the joint carries. So d_C is a length, like
    those of the bodies' paths.

    Attributes:
        joints: The joints, parents before those that they carry.
        bodies: What may collide; bodies on one joint move together.
        tool: The point whose place is the robot's `position`: the index of its joint, and (x, y) there.
        mobile: Whether the base moves; else the offsets of joints on the base are places in the workspace.
        self_collision: Whether bodies must not touch each other. Bodies on one joint, or on a joint and its
            parent, always may.
        name: A name for people, which is no part of the robot's identity.

    Raises:
        InvalidInputError: There is no joint or no body, one of them refers to a joint that comes later or
            does not exist, or two joints have the same name.
    """

    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    tool: tuple[int, tuple[float, float]]
    mobile: bool = False
    self_collision: bool = False
    name: str = field(default="linkage", compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", _named(tuple(self.joints)))
        object.__setattr__(self, "bodies", tuple(self.bodies))
        object.__setattr__(self, "mobile", flag("mobile", self.mobile))
        object.__setattr__(self, "self_collision", flag("self_collision", self.self_collision))
        n = len(self.joints)
        if not n or not self.bodies:
            raise InvalidInputError(
                f"a linkage needs at least one joint and one body, got {n} and {len(self.bodies)}"
            )
        for k, joint in enumerate(self.joints):
            if joint.parent >= k:
                raise InvalidInputError(
                    f"joint {joint.name!r}: expected a parent before it, -1 to {k - 1}, got {joint.parent}"
                )
        for body in self.bodies:
            if body.joint >= n:
                raise InvalidInputError(f"a body's joint: expected 0 to {n - 1}, got {body.joint}")
        on, point = self.tool
        if not (isinstance(on, int) and 0 <= on < n):
            raise InvalidInputError(f"tool: expected a joint, 0 to {n - 1}, got {shown(on)}")
        object.__setattr__(self, "tool", (on, _point("tool", point)))

    @classmethod
    def arm(
        cls,
        lengths: Sequence[float],
        width: float | Sequence[float] = 0.0,
        *,
        base: Sequence[float] = (0.0, 0.0),
        limits: float | Limits | Sequence[Limits] = None,
        self_collision: bool = False,
        name: str = "",
    ) -> Linkage:
        """An arm: links in a row from a fixed base, joint to joint, its tool at the end of the last one.

        Args:
            lengths: Length of each link.
            width: Width of the links, or of each; 0 for thin rods.
            base: (x, y) of the first joint.
            limits: (low, high), one angle for both sides, or None for a joint that turns freely: for all
                joints, or a list with one for each. At 0 all links are in line.
            self_collision: Whether links that are not neighbours must not touch each other.
            name: A name for people.

        Raises:
            InvalidInputError: No lengths, or any that is not positive; a negative width; other limits.
        """
        sizes = [number(f"length of link {k}", size, above=0) for k, size in enumerate(_many(lengths))]
        if not sizes:
            raise InvalidInputError("lengths: expected at least one link, got none")
        widths = [
            number(f"width of link {k}", value, least=0)
            for k, value in enumerate(_each("width", width, len(sizes)))
        ]
        ranges = _each_limits(limits, len(sizes))
        offsets = [_point("base", base), *((size, 0.0) for size in sizes[:-1])]
        joints = [
            Joint(offset, k - 1, 0.0, limit)
            for k, (offset, limit) in enumerate(zip(offsets, ranges, strict=True))
        ]
        bodies = [Body(k, _bar(size, wide)) for k, (size, wide) in enumerate(zip(sizes, widths, strict=True))]
        tool = (len(sizes) - 1, (sizes[-1], 0.0))
        return cls(
            tuple(joints),
            tuple(bodies),
            tool,
            self_collision=self_collision,
            name=name or f"arm of {len(sizes)} links",
        )

    @classmethod
    def snake(
        cls,
        lengths: Sequence[float],
        width: float | Sequence[float] = 0.0,
        *,
        limits: float | Limits | Sequence[Limits] = None,
        self_collision: bool = False,
        name: str = "",
    ) -> Linkage:
        """An arm on a base that moves: (x, y) of its first joint, its angle, and those of the others.

        The arguments are those of `arm`; its position is that of the base. ``limits`` leave out the first
        joint, which turns freely.
        """
        count = len(_many(lengths))
        ranges = [None, *_each_limits(limits, count - 1)] if count > 1 else None
        arm = cls.arm(lengths, width, limits=ranges, self_collision=self_collision)
        return cls(
            arm.joints,
            arm.bodies,
            (0, (0.0, 0.0)),
            mobile=True,
            self_collision=self_collision,
            name=name or f"snake of {count} links",
        )

    @property
    def dimension(self) -> int:
        """Number of coordinates: two for a base that moves, and one for each joint."""
        return len(self.joints) + 2 * self.mobile

    @cached_property
    def reaches(self) -> FloatArray:
        """(joints,) how far from each joint anything that it carries may be (length)."""
        reaches = np.zeros(len(self.joints))
        for body in self.bodies:
            reaches[body.joint] = max(reaches[body.joint], _norms(body.outline).max())
        joint, point = self.tool
        reaches[joint] = max(reaches[joint], math.hypot(*point))
        for k in range(len(self.joints) - 1, -1, -1):
            parent = self.joints[k].parent
            if parent >= 0:
                reaches[parent] = max(reaches[parent], math.hypot(*self.joints[k].offset) + reaches[k])
        return reaches

    @property
    def radius(self) -> float:
        """How far from the base anything of the robot may be (length)."""
        roots = [k for k, joint in enumerate(self.joints) if joint.parent < 0]
        offsets = [math.hypot(*self.joints[k].offset) if self.mobile else 0.0 for k in roots]
        return float(max(self.reaches[k] + offset for k, offset in zip(roots, offsets, strict=True)))

    @property
    def size(self) -> float:
        """Its reach: paths of arms are a few times as long."""
        return self.radius

    @property
    def names(self) -> tuple[str, ...]:
        """X and y of a base that moves, and the joints' names."""
        base = ("x", "y") if self.mobile else ()
        return (*base, *(joint.name for joint in self.joints))

    @property
    def straight(self) -> bool:
        """Whether the position moves on a straight line: it does if it is that of a moving base."""
        root = self.joints[0]
        return self.mobile and self.tool == (0, (0.0, 0.0)) and (root.offset, root.parent) == ((0.0, 0.0), -1)

    def coordinates(self, environment: Environment, rotation_weight: float | None = None) -> Coordinates:
        """(x, y) of a base that moves in the bounds; angles within their limits, or in [-pi, pi)."""
        xmin, ymin, xmax, ymax = environment.bounds
        free = np.array([joint.limits is None for joint in self.joints])
        low = [-math.pi if joint.limits is None else joint.limits[0] for joint in self.joints]
        high = [math.pi if joint.limits is None else joint.limits[1] for joint in self.joints]
        weights = np.maximum(self.reaches, 1e-6 * self.radius)
        if rotation_weight is not None:
            weights = np.full(len(self.joints), number("rotation_weight", rotation_weight, above=0))
        base = slice(0, 2 if self.mobile else 0)
        return Coordinates(
            self.names,
            np.array([xmin, ymin][base] + low),
            np.array([xmax, ymax][base] + high),
            np.concatenate([np.zeros(2)[base], np.where(free, 2.0 * math.pi, 0.0)]),
            np.concatenate([np.ones(2)[base], weights]),
        )

    def frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where each joint's frame is: (..., d) -> origins (..., joints, 2) and headings (..., joints)."""
        q = self.rows(np.asarray(q, np.float64))
        base, angles = (q[..., :2], q[..., 2:]) if self.mobile else (np.zeros(2), q)
        headings, origins = np.empty(angles.shape), np.empty((*angles.shape, 2))
        for k, joint in enumerate(self.joints):
            x, y = joint.offset
            if joint.parent < 0:
                heading: Any = 0.0
                origins[..., k, :] = base + np.array([x, y])
            else:
                heading = headings[..., joint.parent]
                c, s = np.cos(heading), np.sin(heading)
                moved = np.stack([c * x - s * y, s * x + c * y], axis=-1)
                origins[..., k, :] = origins[..., joint.parent, :] + moved
            headings[..., k] = heading + joint.heading + angles[..., k]
        return origins, headings

    def place(self, q: Sequence[float] | FloatArray) -> tuple[shapely.Geometry, ...]:
        """The bodies in the workspace, in their order."""
        origins, headings = self.frames(self.checked(q))
        return tuple(
            _moved(body.outline, origins[body.joint], float(headings[body.joint])) for body in self.bodies
        )

    def position(self, q: FloatArray) -> FloatArray:
        """The tool's place in the workspace: (..., d) -> (..., 2)."""
        q = self.rows(q)
        if self.straight:
            return q[..., :2]
        origins, headings = self.frames(q)
        joint, (x, y) = self.tool
        c, s = np.cos(headings[..., joint]), np.sin(headings[..., joint])
        place: FloatArray = origins[..., joint, :] + np.stack([c * x - s * y, s * x + c * y], axis=-1)
        return place

    def displacement(self, change: FloatArray) -> FloatArray:
        """How far any point can move at most, in the workspace or relative to a body not to touch.

        The sum of the base's motion and, for each joint, its turn times the reach of what it carries. Twice
        as much where bodies on different branches must not touch each other.
        """
        change = self.rows(change)
        turns = np.abs(change[..., 2:] if self.mobile else change)
        moved: FloatArray = turns @ self.reaches
        if self.mobile:
            moved = moved + np.hypot(change[..., 0], change[..., 1])
        chain = all(joint.parent == k - 1 for k, joint in enumerate(self.joints))
        return moved if chain or not self.self_collision else 2.0 * moved

    @property
    def description(self) -> str:
        """Joints and bodies as text."""
        joints = [(joint.offset, joint.parent, joint.heading, joint.limits) for joint in self.joints]
        bodies = [(body.joint, shapely.to_wkt(body.outline, rounding_precision=12)) for body in self.bodies]
        return f"linkage {joints} {bodies} {self.mobile} {self.self_collision}"

    def packed(self, environment: Environment, tolerance: float) -> Geometry:
        """The arrays of `guided_gym.kernels.linkage`."""
        pieces = [cover(body.outline) for body in self.bodies]
        counts = np.array([len(part.ends) for part in pieces])
        vertices = np.concatenate([part.vertices for part in pieces])
        sizes = np.concatenate([np.diff(part.ends, prepend=0) for part in pieces])
        whole = pack(Pieces(vertices, np.cumsum(sizes)), environment.cover, environment.bounds, tolerance)
        coordinates = self.coordinates(environment)
        circles = np.array([_circle(body.outline) for body in self.bodies])
        joints = np.array(
            [(*joint.offset, joint.heading, math.hypot(*joint.offset)) for joint in self.joints]
        )
        first = 2 * self.mobile
        rows = [(joint.parent, first + k, joint.limits is None) for k, joint in enumerate(self.joints)]
        limits = np.column_stack([coordinates.lower, coordinates.upper])
        return with_linkage(
            whole,
            self.entry(),
            self.mobile,
            (joints, np.array(rows, np.int64)),
            (circles, np.array([body.joint for body in self.bodies]), np.cumsum(counts)),
            limits,
            self.tool,
            np.array(self.pairs, np.int64).reshape(-1, 2),
        )

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of bodies that must not touch each other."""
        if not self.self_collision:
            return []
        parents = [joint.parent for joint in self.joints]
        return [
            (i, k)
            for k, two in enumerate(self.bodies)
            for i, one in enumerate(self.bodies[:k])
            if one.joint != two.joint and one.joint != parents[two.joint] and two.joint != parents[one.joint]
        ]

    def entry(self) -> int:
        """Address of `guided_gym.kernels.linkage.answer`, which compiles when it is first asked for."""
        from guided_gym.kernels.linkage import answer

        return int(answer.address or 0)

    def identity(self) -> Iterator[bytes]:
        """Joints, bodies and what may collide with what; the tool decides nothing."""
        yield b"linkage 1"
        for joint in self.joints:
            limits = (math.nan, math.nan) if joint.limits is None else joint.limits
            yield np.array([*joint.offset, joint.parent, joint.heading, *limits], "<f8").tobytes()
        for body in self.bodies:
            yield np.array([body.joint], "<i8").tobytes()
            yield shapely.to_wkb(body.outline, byte_order=1, include_srid=False)
        yield bytes([self.mobile, self.self_collision])


def _norms(outline: shapely.Geometry) -> FloatArray:
    norms: FloatArray = np.hypot(*shapely.get_coordinates(outline).T)
    return norms


def _circle(outline: shapely.Geometry) -> tuple[float, float, float]:
    """A circle around an outline, about the middle of its box: x, y, radius."""
    xmin, ymin, xmax, ymax = outline.bounds
    x, y = 0.5 * (xmin + xmax), 0.5 * (ymin + ymax)
    away = np.hypot(*(shapely.get_coordinates(outline) - [x, y]).T)
    return x, y, float(away.max()) * (1.0 + 1e-12)


def _bar(length: float, width: float) -> shapely.LineString | shapely.Polygon:
    """A link from (0, 0) to (length, 0)."""
    if width == 0.0:
        return shapely.LineString([(0.0, 0.0), (length, 0.0)])
    return shapely.box(0.0, -0.5 * width, length, 0.5 * width)


def _moved(outline: shapely.Geometry, origin: FloatArray, heading: float) -> shapely.Geometry:
    c, s = math.cos(heading), math.sin(heading)
    rotation = np.array([[c, s], [-s, c]])
    return shapely.transform(outline, lambda points: points @ rotation + origin)


def _point(what: str, value: object) -> tuple[float, float]:
    values = _many(value)
    if len(values) != 2:
        raise InvalidInputError(f"{what}: expected (x, y), got {shown(value)}")
    return number(f"{what} x", values[0]), number(f"{what} y", values[1])


def _many(values: object) -> list[Any]:
    try:
        return list(values)  # type: ignore[call-overload, no-any-return]
    except TypeError:
        raise InvalidInputError(f"expected a sequence of numbers, got {shown(values)}") from None


def _each(what: str, value: object, count: int) -> list[Any]:
    """One value for each link: the same for all, or a sequence of as many."""
    if isinstance(value, int | float | np.integer | np.floating):
        return [value] * count
    values = _many(value)
    if len(values) != count:
        raise InvalidInputError(f"{what}: expected one value or {count}, got {len(values)}")
    return values


def _each_limits(limits: object, count: int) -> list[Limits]:
    """Limits for each joint: the same for all, or a sequence of as many."""
    if limits is None or isinstance(limits, int | float | np.integer | np.floating):
        return [_checked_limits("limits", limits)] * count
    values = _many(limits)
    if len(values) == 2 and not any(value is None or np.ndim(value) for value in values):
        return [_checked_limits("limits", limits)] * count
    if len(values) != count:
        raise InvalidInputError(f"limits: expected (low, high), or {count} of them, got {len(values)}")
    return [_checked_limits(f"limits of joint {k}", value) for k, value in enumerate(values)]


def _checked_limits(what: str, limits: object) -> Limits:
    if limits is None:
        return None
    pair = [-limits, limits] if isinstance(limits, int | float) else _many(limits)
    if len(pair) != 2:
        raise InvalidInputError(f"{what}: expected limits (low, high), got {shown(limits)}")
    low, high = (
        number(f"{what}: a limit", value, above=-LARGEST_LIMIT, below=LARGEST_LIMIT) for value in pair
    )
    if not low < high:
        raise InvalidInputError(f"{what}: expected limits low < high, got {low:g} and {high:g}")
    return low, high


def _named(joints: tuple[Joint, ...]) -> tuple[Joint, ...]:
    """The joints, each with a name of its own."""
    named = tuple(
        joint
        if joint.name
        else Joint(joint.offset, joint.parent, joint.heading, joint.limits, f"joint{k + 1}")
        for k, joint in enumerate(joints)
    )
    names = [joint.name for joint in named]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInputError(f"joints: expected names that differ, got {twice[0]!r} twice")
    return named
