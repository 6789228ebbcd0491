"""What a problem file says of arms in space, and of the room that they are in."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.solids import Box, Capsule, Cylinder, Solid, SpatialEnvironment
from guided_gym.geometry.spatial_arms import SpatialArm, SpatialBody, SpatialJoint

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
Rows = Annotated[list[Triple], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Name = Annotated[str, Field(max_length=10_000)]
_AXIS: Any = [0.0, 0.0, 1.0]
_ZERO: Any = [0.0, 0.0, 0.0]
_NO_TURN: Any = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class SolidPart(_Model):
    """A solid: a box by its centre and sides, or a solid with a start, an end and a radius.

    Attributes:
        kind: ``box``, ``cylinder`` or ``capsule`` (a sphere, where start and end are one).
        centre: Of a box.
        sides: Of a box.
        rpy: Roll, pitch and yaw of a box (radians).
        start: Where the axis begins.
        end: Where it ends.
        radius: Around the axis.
    """

    kind: Annotated[str, Field(pattern="^(box|cylinder|capsule)$")]
    centre: Triple | None = None
    sides: Triple | None = None
    rpy: Triple = _ZERO
    start: Triple | None = None
    end: Triple | None = None
    radius: Number | None = None

    def solid(self, place: str) -> Solid:
        """The solid; ``place`` is what messages call it."""
        wanted = ("centre", "sides") if self.kind == "box" else ("start", "end", "radius")
        for name in ("centre", "sides", "start", "end", "radius"):
            if (getattr(self, name) is not None) != (name in wanted):
                what = "needs" if name in wanted else "takes no"
                raise InvalidInputError(f"{place}: a {self.kind} {what} {name}")
        values = [getattr(self, name) for name in wanted]
        try:
            if self.kind == "box":
                return Box(values[0], values[1], self.rpy)  # type: ignore[arg-type]
            return Cylinder(*values) if self.kind == "cylinder" else Capsule(*values)
        except InvalidInputError as error:
            raise InvalidInputError(f"{place}: {error}") from None

    @classmethod
    def of(cls, solid: Solid) -> SolidPart:
        """The part from which the same solid comes back."""
        if isinstance(solid, Box):
            return cls(kind="box", centre=[*solid.centre], sides=[*solid.sides], rpy=[*solid.rpy])
        if isinstance(solid, Capsule | Cylinder):
            kind = type(solid).__name__.lower()
            return cls(kind=kind, start=[*solid.start], end=[*solid.end], radius=solid.radius)
        raise InvalidInputError(f"solid: expected a box, cylinder or capsule, got {solid!r}")


class RoomPart(_Model):
    """A room.

    Attributes:
        sides: xmin, ymin, zmin, xmax, ymax, zmax.
        solids: What is in it.
    """

    sides: Annotated[list[Number], Field(min_length=6, max_length=6)]
    solids: Annotated[list[SolidPart], Field(max_length=100_000)] = []

    def environment(self) -> SpatialEnvironment:
        """The room.

        Raises:
            InvalidInputError: It, or a solid in it, cannot be used.
        """
        solids = [part.solid(f"room.solids[{k}]") for k, part in enumerate(self.solids)]
        return SpatialEnvironment(self.sides, solids)

    @classmethod
    def of(cls, room: SpatialEnvironment) -> RoomPart:
        """The part from which the same room comes back."""
        return cls(sides=[*room.room], solids=[SolidPart.of(solid) for solid in room.solids])


class SpatialJointPart(_Model):
    """A joint of an arm in space; see `SpatialJoint`."""

    name: Name = ""
    offset: Triple = _ZERO
    axis: Triple = _AXIS
    turned: Rows = _NO_TURN
    limits: Pair | None = None
    slides: bool = False
    follows: Name | None = None
    factor: Number = 1.0
    shift: Number = 0.0

    def joint(self) -> SpatialJoint:
        """The joint."""
        return SpatialJoint(
            self.offset,  # type: ignore[arg-type]
            self.axis,  # type: ignore[arg-type]
            self.turned,  # type: ignore[arg-type]
            self.limits,  # type: ignore[arg-type]
            self.slides,
            self.name,
            None if self.follows is None else (self.follows, self.factor, self.shift),
        )

    @classmethod
    def of(cls, joint: SpatialJoint) -> SpatialJointPart:
        """The part from which the same joint comes back."""
        follows, factor, shift = joint.follows or (None, 1.0, 0.0)
        return cls(
            name=joint.name,
            offset=[*joint.offset],
            axis=[*joint.axis],
            turned=[[*row] for row in joint.turned],
            limits=None if joint.limits is None else [*joint.limits],
            slides=joint.slides,
            follows=follows,
            factor=factor,
            shift=shift,
        )


class SpatialBodyPart(_Model):
    """A body of an arm in space; see `SpatialBody`."""

    joint: Annotated[int, Field(ge=-1)]
    start: Triple
    end: Triple
    radius: Number
    link: Name = ""


class ArmPart(_Model):
    """An arm in space; see `SpatialArm`.

    Attributes:
        name: For people.
        joints: From the base on; angles in radians.
        bodies: Capsules on the joints; joint -1 is the base.
        tool: The point in the frame of the last joint, or of ``tool_joint``.
        tool_joint: Another joint.
        self_collision: Whether bodies must not touch each other.
        ignored: Pairs of bodies that may touch all the same.
    """

    name: Name = "arm in space"
    joints: Annotated[list[SpatialJointPart], Field(min_length=1, max_length=1000)]
    bodies: Annotated[list[SpatialBodyPart], Field(min_length=1, max_length=1000)]
    tool: Triple
    tool_joint: Annotated[int, Field(ge=0)] | None = None
    self_collision: bool = False
    ignored: list[Annotated[list[int], Field(min_length=2, max_length=2)]] = []

    def arm(self) -> SpatialArm:
        """The arm.

        Raises:
            InvalidInputError: It cannot be one.
        """
        bodies = [
            SpatialBody(part.joint, Capsule(part.start, part.end, part.radius), part.link)  # type: ignore[arg-type]
            for part in self.bodies
        ]
        last = len(self.joints) - 1 if self.tool_joint is None else self.tool_joint
        return SpatialArm(
            tuple(part.joint() for part in self.joints),
            tuple(bodies),
            (last, self.tool),  # type: ignore[arg-type]
            self.self_collision,
            frozenset((i, k) for i, k in self.ignored),
            self.name,
        )

    @classmethod
    def of(cls, arm: SpatialArm) -> ArmPart:
        """The part from which the same arm comes back."""
        return cls(
            name=arm.name,
            joints=[SpatialJointPart.of(joint) for joint in arm.joints],
            bodies=[
                SpatialBodyPart(
                    joint=body.joint,
                    start=[*body.shape.start],
                    end=[*body.shape.end],
                    radius=body.shape.radius,
                    link=body.link,
                )
                for body in arm.bodies
            ],
            tool=[*arm.tool[1]],
            tool_joint=arm.tool[0],
            self_collision=arm.self_collision,
            ignored=[[i, k] for i, k in sorted(arm.ignored)],
        )
