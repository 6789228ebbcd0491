"""What a problem file says of arms in space, and of the room that they are in."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field

from guided_gym.catalogue.file_parts import Number, Pair, Part, Text, plain
from guided_gym.errors import InvalidInputError, named
from guided_gym.geometry.solids import Box, Capsule, Cylinder, Solid, SpatialEnvironment
from guided_gym.geometry.spatial_arms import SpatialArm, SpatialBody, SpatialJoint

Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
Rows = Annotated[list[Triple], Field(min_length=3, max_length=3)]
_AXIS: Any = [0.0, 0.0, 1.0]
_ZERO: Any = [0.0, 0.0, 0.0]
_NO_TURN: Any = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class SolidPart(Part):
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

    kind: Literal["box", "cylinder", "capsule"]
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
        with named(place):
            return _SOLIDS[self.kind](*values, *([self.rpy] if self.kind == "box" else []))

    @classmethod
    def of(cls, solid: Solid) -> SolidPart:
        """The part from which the same solid comes back."""
        kind = type(solid).__name__.lower()
        if _SOLIDS.get(kind) is not type(solid):
            raise InvalidInputError(f"solid: expected a box, cylinder or capsule, got {solid!r}")
        return cls(kind=kind, **plain(solid))  # type: ignore[arg-type]


_SOLIDS: Final[dict[str, type[Solid]]] = {"box": Box, "cylinder": Cylinder, "capsule": Capsule}


class RoomPart(Part):
    """A room.

    Attributes:
        sides: xmin, ymin, zmin, xmax, ymax, zmax.
        solids: What is in it.
    """

    sides: Annotated[list[Number], Field(min_length=6, max_length=6)]
    solids: Annotated[list[SolidPart], Field(max_length=100_000)] = Field([])

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


class SpatialJointPart(Part):
    """A joint of an arm in space; see `SpatialJoint`."""

    name: Text = ""
    offset: Triple = _ZERO
    axis: Triple = _AXIS
    turned: Rows = _NO_TURN
    limits: Pair | None = None
    slides: bool = False
    follows: Text | None = None
    factor: Number = 1.0
    shift: Number = 0.0

    def joint(self) -> SpatialJoint:
        """The joint."""
        said = self.model_dump(exclude={"factor", "shift"})
        follows = None if self.follows is None else (self.follows, self.factor, self.shift)
        return SpatialJoint(**{**said, "follows": follows})

    @classmethod
    def of(cls, joint: SpatialJoint) -> SpatialJointPart:
        """The part from which the same joint comes back."""
        follows, factor, shift = joint.follows or (None, 1.0, 0.0)
        return cls(**{**plain(joint), "follows": follows, "factor": factor, "shift": shift})


class SpatialBodyPart(Part):
    """A body of an arm in space; see `SpatialBody`."""

    joint: Annotated[int, Field(ge=-1)]
    start: Triple
    end: Triple
    radius: Number
    link: Text = ""


class ArmPart(Part):
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

    name: Text = "arm in space"
    joints: Annotated[list[SpatialJointPart], Field(min_length=1, max_length=1000)]
    bodies: Annotated[list[SpatialBodyPart], Field(min_length=1, max_length=1000)]
    tool: Triple
    tool_joint: Annotated[int, Field(ge=0)] | None = None
    self_collision: bool = False
    ignored: list[Annotated[list[int], Field(min_length=2, max_length=2)]] = Field([])

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
                SpatialBodyPart(joint=body.joint, link=body.link, **plain(body.shape)) for body in arm.bodies
            ],
            tool=plain(arm.tool[1]),
            tool_joint=arm.tool[0],
            self_collision=arm.self_collision,
            ignored=plain(sorted(arm.ignored)),
        )
