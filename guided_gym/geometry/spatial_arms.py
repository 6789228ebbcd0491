"""Arms in space: a chain of joints that turn or slide, with capsules for bodies."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import flag, instance, integer, number
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import LARGEST_LIMIT
from guided_gym.geometry.mechanism import Coordinates, Mechanism
from guided_gym.geometry.solids import (
    VIEW,
    Capsule,
    Matrix,
    SpatialEnvironment,
    Triple,
    triple,
    turned_to,
)
from guided_gym.kernels import packing
from guided_gym.kernels.collision import ENTRY, HEADER, TABLE, Geometry

FloatArray = npt.NDArray[np.float64]

FIXED: Final = -1  # the joint of a body that stays with the base
_READER: Final = "guided_gym.geometry.urdf"
_NO_TURN: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@doors
@dataclass(frozen=True)
class SpatialJoint:
    """A joint of a chain, and the frame that moves with it.

    Attributes:
        offset: Where it is in the frame of the joint before it (length).
        axis: What it turns about or slides along, in its own frame; made to length 1.
        turned: Rotation matrix (3 rows of 3) of its own frame in that of the joint before it, where its value
            is 0; `rotation` makes one from roll, pitch and yaw.
        limits: Smallest and largest value (radians, or length); None where it turns freely.
        slides: Whether it slides.
        name: What messages and columns call it; ``joint<k>`` unless given.
        follows: For a joint that mimics an earlier one: the earlier one's name, a factor and a shift. Its
            value is factor * value + shift, and it has no coordinate of its own.
    """

    offset: Triple = (0.0, 0.0, 0.0)
    axis: Triple = (0.0, 0.0, 1.0)
    turned: Matrix = _NO_TURN
    limits: tuple[float, float] | None = None
    slides: bool = False
    name: str = ""
    follows: tuple[str, float, float] | None = None

    def __post_init__(self) -> None:
        label = f"joint {self.name!r}" if self.name else "a joint"
        object.__setattr__(self, "offset", triple(f"{label}: offset", self.offset))
        axis = np.array(triple(f"{label}: axis", self.axis))
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise InvalidInputError(f"{label}: expected an axis that is not 0, got {self.axis}")
        object.__setattr__(self, "axis", triple("axis", axis / length))
        rows = np.array([triple(f"{label}: turned", row) for row in self.turned])
        if rows.shape != (3, 3) or not np.allclose(rows @ rows.T, np.eye(3), atol=1e-9):
            raise InvalidInputError(f"{label}: expected a rotation matrix, got {self.turned!r}")
        object.__setattr__(self, "turned", tuple(map(tuple, rows.tolist())))
        object.__setattr__(self, "slides", flag(f"{label}: slides", self.slides))
        object.__setattr__(self, "limits", self._checked_limits(label))

    def _checked_limits(self, label: str) -> tuple[float, float] | None:
        if self.limits is None:
            if self.slides and self.follows is None:
                raise InvalidInputError(f"{label} slides: expected limits (low, high), got none")
            return None
        low, high = (
            number(f"{label}: a limit", value, above=-LARGEST_LIMIT, below=LARGEST_LIMIT)
            for value in self.limits
        )
        if not low < high:
            raise InvalidInputError(f"{label}: expected limits low < high, got {low:g} and {high:g}")
        return low, high


@doors
@dataclass(frozen=True)
class SpatialBody:
    """A body that moves with a joint.

    Attributes:
        joint: Index of the joint; `FIXED` for a body that stays with the base, which may touch solids.
        shape: The capsule (or sphere) in the frame of the joint, or of the base.
        link: What messages call it.
    """

    joint: int
    shape: Capsule
    link: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint", integer("a body's joint", self.joint, least=FIXED))
        instance("a body's shape", self.shape, Capsule)


class _Chain:
    """Arrays of a chain whose joints all move along their z axes.

    Attributes:
        aligned: (n, 3, 3) columns are the new axes of each joint's frame in its old one.
        turned: (n, 3, 3) rotation of each frame in the one before it.
        offset: (n, 3) likewise its origin.
        columns: (n,) the coordinate of each joint.
        factors: (n,) of the coordinate, and (n,) shifts.
    """

    def __init__(self, joints: tuple[SpatialJoint, ...]) -> None:
        self.aligned = np.array([turned_to(np.array(joint.axis)) for joint in joints])
        before = np.concatenate([np.eye(3)[None], self.aligned[:-1]]).transpose(0, 2, 1)
        self.turned = before @ np.array([joint.turned for joint in joints]) @ self.aligned
        self.offset = np.einsum("nij,nj->ni", before, np.array([joint.offset for joint in joints]))
        own: dict[str, tuple[int, float, float]] = {}
        for joint in joints:
            if joint.follows is None:
                own[joint.name] = len({column for column, _, _ in own.values()}), 1.0, 0.0
                continue
            name, factor, shift = joint.follows
            if name not in own:
                raise InvalidInputError(
                    f"joint {joint.name!r} follows {name!r}: expected a joint before it, "
                    f"{', '.join(map(repr, own)) or 'of which there is none'}"
                )
            column, f, s = own[name]
            own[joint.name] = column, factor * f, factor * s + shift
        self.columns = np.array([own[joint.name][0] for joint in joints])
        self.factors = np.array([own[joint.name][1] for joint in joints])
        self.shifts = np.array([own[joint.name][2] for joint in joints])


@doors
@dataclass(frozen=True)
class SpatialArm(Mechanism):
    """An arm in space: joints in a row, on a base that stays, and capsules on them.

    Its configuration holds a value for each joint that follows none. The metric weighs the radians of a joint
    by the reach of what the joint carries. `SpatialArm.from_urdf` reads one from a file.

    Attributes:
        joints: The joints, from the base on; the first one stands in the frame of the base.
        bodies: What may collide. Bodies that stay with the base are not checked against the solids.
        tool: The point whose place is the robot's: the index of its joint, and the point there.
        self_collision: Whether bodies must not touch each other. Bodies on one joint or on neighbours always
            may.
        ignored: Pairs of bodies that may touch all the same, by their indices.
        name: A name for people, which is no part of the robot's identity.

    Raises:
        InvalidInputError: There is no joint or no body, an index does not exist, two joints have the same
            name, or a joint follows one that does not come before it.
    """

    in_space: ClassVar[bool] = True
    joints: tuple[SpatialJoint, ...]
    bodies: tuple[SpatialBody, ...]
    tool: tuple[int, Triple]
    self_collision: bool = False
    ignored: frozenset[tuple[int, int]] = frozenset()
    name: str = field(default="arm in space", compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", _named(tuple(self.joints)))
        object.__setattr__(self, "bodies", tuple(self.bodies))
        object.__setattr__(self, "self_collision", flag("self_collision", self.self_collision))
        n = len(self.joints)
        if not n or not any(instance("a body", body, SpatialBody).joint >= 0 for body in self.bodies):
            raise InvalidInputError(
                f"an arm in space needs at least one joint with a body on it, got {n} joints and "
                f"{len(self.bodies)} bodies"
            )
        for body in self.bodies:
            if body.joint >= n:
                raise InvalidInputError(f"a body's joint: expected -1 to {n - 1}, got {body.joint}")
        on, point = self.tool
        if not (isinstance(on, int) and 0 <= on < n):
            raise InvalidInputError(f"tool: expected a joint, 0 to {n - 1}, got {on!r}")
        object.__setattr__(self, "tool", (on, triple("tool", point)))
        pairs = frozenset((min(i, k), max(i, k)) for i, k in self.ignored)
        if pairs and not (min(min(pairs)) >= 0 and max(k for _, k in pairs) < len(self.bodies)):
            raise InvalidInputError(
                f"ignored: expected pairs of bodies 0 to {len(self.bodies) - 1}, got {sorted(pairs)}"
            )
        object.__setattr__(self, "ignored", pairs)
        _ = self._ranges

    @classmethod
    def from_urdf(cls, path: str | Path, tip: str | None = None, **options: object) -> SpatialArm:
        """An arm of a URDF file; see `guided_gym.geometry.urdf.read_arm`, whose arguments these are.

        Raises:
            InvalidInputError: A file, or a part of one, that cannot be used.
            GuidedGymError: The extra ``urdf`` is not installed.
        """
        # By name: the reader makes arms, so it stands above them.
        arm: SpatialArm = importlib.import_module(_READER).read_arm(path, tip, **options)
        return arm

    @cached_property
    def _chain(self) -> _Chain:
        return _Chain(self.joints)

    @cached_property
    def _ranges(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(d,) lower, upper and period of each coordinate: where all joints that it moves are in limits."""
        chain = self._chain
        low, high = np.full(self.dimension, -np.inf), np.full(self.dimension, np.inf)
        for joint, k, factor, shift in zip(
            self.joints, chain.columns, chain.factors, chain.shifts, strict=True
        ):
            if joint.limits is not None and factor != 0.0:
                ends = sorted((limit - shift) / factor for limit in joint.limits)
                low[k], high[k] = max(low[k], ends[0]), min(high[k], ends[1])
            elif joint.limits is None and factor != np.rint(factor) and not joint.slides:
                low[k], high[k] = max(low[k], -math.pi), min(high[k], math.pi)
        for k in np.flatnonzero(~(low < high)):
            raise InvalidInputError(
                f"joint {self.names[k]!r}: expected limits that leave it room, together with those of "
                f"the joints that follow it, got {low[k]:g} to {high[k]:g}"
            )
        free = np.isinf(low) & np.isinf(high)
        return (
            np.where(free, -math.pi, low),
            np.where(free, math.pi, high),
            np.where(free, 2.0 * math.pi, 0.0),
        )

    @property
    def dimension(self) -> int:
        """Number of coordinates: one for each joint that follows no other."""
        return sum(joint.follows is None for joint in self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of those joints."""
        return tuple(joint.name for joint in self.joints if joint.follows is None)

    @cached_property
    def _lengths(self) -> FloatArray:
        """(n,) how far each joint's origin may be from that of the one before it."""
        lower, upper, _ = self._ranges
        chain = self._chain
        lengths: FloatArray = np.linalg.norm(chain.offset, axis=1)
        for j, joint in enumerate(self.joints):
            if joint.slides:
                k = chain.columns[j]
                ends = chain.factors[j] * np.array([lower[k], upper[k]]) + chain.shifts[j]
                lengths[j] += float(np.abs(ends).max())
        return lengths

    @cached_property
    def reaches(self) -> FloatArray:
        """(n,) how far from each joint anything that it carries may be (length)."""
        reaches = np.zeros(len(self.joints))
        joint, point = self.tool
        reaches[joint] = math.hypot(*point)
        for body in self.bodies:
            if body.joint >= 0:
                far = max(math.hypot(*body.shape.start), math.hypot(*body.shape.end)) + body.shape.radius
                reaches[body.joint] = max(reaches[body.joint], far)
        for j in range(len(self.joints) - 1, 0, -1):
            reaches[j - 1] = max(reaches[j - 1], self._lengths[j] + reaches[j])
        return reaches

    @cached_property
    def _moves(self) -> FloatArray:
        """(d,) how far any point moves at most, by each coordinate's unit."""
        moves, chain = np.zeros(self.dimension), self._chain
        for j, joint in enumerate(self.joints):
            moves[chain.columns[j]] += abs(chain.factors[j]) * (1.0 if joint.slides else self.reaches[j])
        return moves

    @property
    def radius(self) -> float:
        """How far from its first joint anything of it may be (length)."""
        return float(self.reaches[0]) + (float(self._lengths[0]) if self.joints[0].slides else 0.0)

    @property
    def size(self) -> float:
        """Its reach: paths of arms are a few times as long."""
        return self.radius

    def coordinates(self, environment: Environment, rotation_weight: float | None = None) -> Coordinates:
        """Values within the limits, or in [-pi, pi); slides count as they are, and turns by their reach."""
        weights = np.maximum(self._moves, 1e-6 * max(self.radius, 1e-300))
        if rotation_weight is not None:
            turns = np.ones(self.dimension, np.bool_)
            turns[[self._chain.columns[j] for j, joint in enumerate(self.joints) if joint.slides]] = False
            weights = np.where(turns, number("rotation_weight", rotation_weight, above=0), weights)
        return Coordinates(self.names, *self._ranges, weights)

    def frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where each joint's frame is: (..., d) -> origins (..., n, 3) and rotations (..., n, 3, 3)."""
        q, chain = self.rows(np.asarray(q, np.float64)), self._chain
        values = chain.factors * q[..., chain.columns] + chain.shifts
        origin, turned = np.zeros((*q.shape[:-1], 3)), np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3))
        origins, rotations = [], []
        for j, joint in enumerate(self.joints):
            offset = np.broadcast_to(chain.offset[j], origin.shape)
            if joint.slides:
                offset = offset + values[..., j, None] * chain.turned[j][:, 2]
            origin = origin + np.einsum("...ij,...j->...i", turned, offset)
            turned = turned @ chain.turned[j]
            if not joint.slides:
                turned = turned @ _turns(values[..., j])
            origins.append(origin)
            rotations.append(turned @ chain.aligned[j].T)
        return np.stack(origins, axis=-2), np.stack(rotations, axis=-3)

    def capsules(self, q: Sequence[float] | FloatArray) -> list[Capsule]:
        """The bodies in space at a configuration, in their order."""
        origins, rotations = self.frames(self.checked(q))
        return [
            body.shape if body.joint < 0 else body.shape.moved(rotations[body.joint], origins[body.joint])
            for body in self.bodies
        ]

    def place(self, q: Sequence[float] | FloatArray) -> tuple[shapely.Geometry, ...]:
        """What pictures show of the bodies (`VIEW`), in their order."""
        return tuple(capsule.shadow() for capsule in self.capsules(q))

    def tool_at(self, q: FloatArray) -> FloatArray:
        """The tool's place in space: (..., d) -> (..., 3)."""
        origins, rotations = self.frames(q)
        joint, point = self.tool
        place: FloatArray = origins[..., joint, :] + rotations[..., joint, :, :] @ np.array(point)
        return place

    def position(self, q: FloatArray) -> FloatArray:
        """Where the tool is in pictures: (..., d) -> (..., 2)."""
        seen: FloatArray = self.tool_at(q) @ VIEW.T
        return seen

    def gaps(self, q: FloatArray, environment: Environment) -> FloatArray:
        """(n,) how far the arm is from each solid; negative where it is in collision."""
        moving = [
            capsule for capsule, body in zip(self.capsules(q), self.bodies, strict=True) if body.joint >= 0
        ]
        return np.array([
            min(solid.gap(np.array(one.start), np.array(one.end)) - one.radius for one in moving)
            for solid in in_space(environment).solids
        ])  # fmt: skip

    def side_gaps(self, q: FloatArray, environment: Environment) -> FloatArray:
        """(6,) how far it is inside the sides of the room."""
        moving = [
            capsule.box()
            for capsule, body in zip(self.capsules(q), self.bodies, strict=True)
            if body.joint >= 0
        ]
        low, high = np.min([a for a, _ in moving], axis=0), np.max([b for _, b in moving], axis=0)
        sides = np.array(in_space(environment).room)
        return np.concatenate([low - sides[:3], sides[3:] - high])

    def own_gaps(self, q: FloatArray) -> FloatArray:
        """How far the bodies of each of `pairs` are apart."""
        capsules = self.capsules(q)
        return np.array([
            capsules[i].gap(np.array(capsules[k].start), np.array(capsules[k].end)) - capsules[k].radius
            for i, k in self.pairs
        ])  # fmt: skip

    def displacement(self, change: FloatArray) -> FloatArray:
        """How far any point moves at most: the sum over the joints of their turns by their reach."""
        moved: FloatArray = np.abs(self.rows(change)) @ self._moves
        return moved

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:  # type: ignore[override]
        """The pairs of bodies that must not touch each other; the second one's joint is the farther out."""
        if not self.self_collision:
            return []
        order = sorted(range(len(self.bodies)), key=lambda k: self.bodies[k].joint)
        return [
            (i, k)
            for place, k in enumerate(order)
            for i in order[:place]
            if self.bodies[k].joint - self.bodies[i].joint > 1 and (min(i, k), max(i, k)) not in self.ignored
        ]

    def shortened(self, links: int, name: str) -> SpatialArm:
        """The arm of the first joints alone; its tool is where the next one is, unless it is before that.

        Raises:
            InvalidInputError: No body is on those joints.
        """
        tool = self.tool if self.tool[0] < links else (links - 1, self.joints[links].offset)
        kept = [k for k, body in enumerate(self.bodies) if body.joint < links]
        place = {k: i for i, k in enumerate(kept)}
        ignored = frozenset((place[i], place[k]) for i, k in self.ignored if i in place and k in place)
        bodies = tuple(self.bodies[k] for k in kept)
        return SpatialArm(self.joints[:links], bodies, tool, self.self_collision, ignored, name)

    @property
    def description(self) -> str:
        """Joints and bodies as text."""
        joints = [(j.offset, j.axis, j.turned, j.limits, j.slides, j.follows) for j in self.joints]
        bodies = [(b.joint, b.shape.start, b.shape.end, b.shape.radius) for b in self.bodies]
        return f"arm in space {joints} {bodies} {self.self_collision} {sorted(self.ignored)}"

    def packed(self, environment: Environment, tolerance: float) -> Geometry:
        """The arrays of `guided_gym.kernels.spatial`.

        Raises:
            InvalidInputError: The environment is a planar one.
        """
        room = in_space(environment)
        solids = [(solid.kind, solid.numbers()) for solid in room.solids]
        solids += [(packing.HALF_SPACE, side) for side in _sides(room.room)]
        bodies, own = [], []
        for _, start, end, radius in self.body_rows():
            far = max(math.hypot(*start), math.hypot(*end))
            bodies.append(np.array([*start, *end, radius, far]))
            own.append(Capsule(triple("start", start), triple("end", end), radius).numbers())
        lower, upper, periods = self._ranges
        parts = [np.array([tolerance, 1.03 * tolerance])]
        chain = list(self.chain_rows())
        joints = [
            np.array([*turned.ravel(), *offset, factor, shift, length])
            for (_, _, factor, shift, turned, offset), length in zip(chain, self._lengths, strict=True)
        ]
        limits, tool = np.column_stack([lower, upper]).ravel(), [*self.aligned_tool()[1], *VIEW.ravel()]
        shapes = [numbers for _, numbers in solids]
        starts = [0, *_put(parts, [*joints, limits, np.array(tool), *shapes, *bodies, *own])]
        n, m, b = len(self.joints), len(solids), len(bodies)
        table = [0] * packing.TABLE_HEADER
        table[packing.JOINTS], table[packing.BODIES], table[packing.PAIRS] = n, b, len(self.pairs)
        table[packing.JOINT_NUMBERS], table[packing.LIMITS] = starts[1], starts[n + 1]
        table[packing.TOOL_NUMBERS], table[packing.TOOL] = starts[n + 2], self.tool[0]
        table[packing.SOLIDS] = m
        at = n + 3
        rows = [(slides, column, periods[column] > 0) for slides, column, *_ in chain]
        rows += [(starts[at + i], kind) for i, (kind, _) in enumerate(solids)]  # type: ignore[misc]
        rows += [(body.joint, starts[at + m + i]) for i, body in enumerate(self.bodies)]  # type: ignore[misc]
        rows += [(i, k, starts[at + m + b + i]) for i, k in self.pairs]  # type: ignore[misc]
        flat = [int(value) for row in rows for value in row]
        index = np.array([*([0] * HEADER), *table, *flat], np.int64)
        index[ENTRY], index[TABLE] = self.entry(), HEADER
        return np.concatenate(parts), index

    def chain_rows(self) -> Iterator[tuple[bool, int, float, float, FloatArray, FloatArray]]:
        """What the kernels and the browser have of each joint, its frame so turned that it moves along z.

        Whether it slides, coordinate, factor, shift, and rotation and offset in the frame before it.
        """
        c = self._chain
        for j, joint in enumerate(self.joints):
            column, factor, shift = int(c.columns[j]), float(c.factors[j]), float(c.shifts[j])
            yield joint.slides, column, factor, shift, c.turned[j], c.offset[j]

    def body_rows(self) -> Iterator[tuple[int, FloatArray, FloatArray, float]]:
        """Of each body: its joint, ends in that frame, and radius."""
        for body in self.bodies:
            turned = self._chain.aligned[body.joint].T if body.joint >= 0 else np.eye(3)
            start, end = turned @ np.array(body.shape.start), turned @ np.array(body.shape.end)
            yield body.joint, start, end, body.shape.radius

    def aligned_tool(self) -> tuple[int, FloatArray]:
        """The tool in that frame of its joint."""
        joint, point = self.tool
        return joint, self._chain.aligned[joint].T @ np.array(point)

    def entry(self) -> int:
        """Address of `guided_gym.kernels.spatial.answer`, which compiles when it is first asked for."""
        from guided_gym.kernels.spatial import answer

        return int(answer.address or 0)

    def identity(self) -> Iterator[bytes]:
        """Joints, bodies and what may collide with what; the tool decides nothing."""
        yield b"arm in space 1"
        lower, upper, periods = self._ranges
        chain = self._chain
        yield np.concatenate([lower, upper, periods]).astype("<f8").tobytes()
        for j, joint in enumerate(self.joints):
            numbers = [*joint.offset, *joint.axis, *np.ravel(joint.turned), chain.factors[j], chain.shifts[j]]
            yield np.array([*numbers, chain.columns[j], joint.slides], "<f8").tobytes()
        for body in self.bodies:
            shape = body.shape
            yield np.array([body.joint, *shape.start, *shape.end, shape.radius], "<f8").tobytes()
        yield np.array(self.pairs, "<i8").tobytes()


def point_in_space(environment: Environment) -> SpatialArm:
    """A point that moves in all of a room: three slides."""
    room = in_space(environment).room
    axes = np.eye(3).tolist()
    joints = tuple(
        SpatialJoint(axis=triple("axis", axes[k]), limits=(room[k], room[k + 3]), slides=True, name="xyz"[k])
        for k in range(3)
    )
    body = SpatialBody(2, Capsule.sphere((0.0, 0.0, 0.0), 0.0))
    return SpatialArm(joints, (body,), (2, (0.0, 0.0, 0.0)), name="point in space")


def in_space(environment: Environment) -> SpatialEnvironment:
    """The environment, if it is one in space: for robots that know no others.

    Raises:
        InvalidInputError: It is a planar one.
    """
    if isinstance(environment, SpatialEnvironment):
        return environment
    raise InvalidInputError(
        f"an arm in space: expected a SpatialEnvironment, got a planar one with bounds {environment.bounds}"
    )


def _turns(values: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations about z."""
    c, s, o = np.cos(values), np.sin(values), np.zeros_like(values)
    rows = [[c, -s, o], [s, c, o], [o, o, o + 1.0]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _sides(room: tuple[float, ...]) -> list[FloatArray]:
    """The numbers of the half-spaces around a room."""
    sides = []
    for k, place in enumerate(room):
        outward, centre = np.zeros(3), np.zeros(3)
        outward[k % 3], centre[k % 3] = (1.0 if k < 3 else -1.0), place
        rows = np.zeros((3, 3))
        rows[0] = outward
        sides.append(np.concatenate([centre, rows.ravel(), np.zeros(5)]))
    return sides


def _put(parts: list[FloatArray], rows: list[FloatArray]) -> list[int]:
    """Append arrays to others; returns where each of them begins."""
    starts, at = [], sum(part.size for part in parts)
    for row in rows:
        starts.append(at)
        at += row.size
    parts.extend(rows)
    return starts


def _named(joints: tuple[SpatialJoint, ...]) -> tuple[SpatialJoint, ...]:
    """The joints, each with a name of its own."""
    named = []
    for k, joint in enumerate(joints):
        instance(f"joint {k}", joint, SpatialJoint)
        named.append(joint if joint.name else replace(joint, name=f"joint{k + 1}"))
    names = [joint.name for joint in named]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInputError(f"joints: expected names that differ, got {twice[0]!r} twice")
    return tuple(named)
