"""The configuration space of a robot in an environment."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from guided_gym.checks import count, instance, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.kernels import collision
from guided_gym.kernels.metric import Metric

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
Configurations = FloatArray | Sequence[float] | Sequence[Sequence[float]]

RELATIVE_TOLERANCE = 1e-6
"""Default collision tolerance, relative to the diagonal of the bounds."""

_SMALLEST_TOLERANCE = 1e-10
"""Tolerance relative to the largest coordinate below which rounding could turn a contact into "free"."""

_SMALLEST_OUTER_TOLERANCE = 1e-12
"""The same for the caller's coordinates, from which the kernels subtract an origin that lies near by."""

_LARGEST_TOLERANCE = 1e-3
"""Largest default tolerance, relative to the diagonal, where coordinates are so large that they need one."""

_FLOAT64: Final = np.dtype(np.float64)  # to compare with a type takes thrice as long

_MANY_TURNS = 5e3
"""Angles beyond this are wrapped by their sine and cosine, since rounding of many turns would add up."""

LARGEST_ANGLE = 1e12
"""Angles from here on are none: beside such numbers a radian is hardly more than rounding."""


@doors
class ConfigurationSpace:
    """The configuration space C of a robot in an environment, with its metric and its collision checks.

    Configurations are float64 arrays (d,), or (n, d) in batches: (x, y) or (x, y, theta) of a rigid robot,
    theta in [-pi, pi) and periodic; the coordinates of its joints for a `Linkage`, of which those that turn
    freely are periodic. The metric is d(a, b)^2 = sum of (w_i * difference_i)^2, with angles of periodic
    coordinates the short way round: |dp|^2 + (w dtheta)^2 for a rigid robot.

    A pose is valid iff the robot is more than `tolerance` away from all obstacles and inside the bounds by as
    much, its joints are within their limits, and, if it is asked for, its own bodies are more than
    `tolerance` apart. Motions are certified, never sampled: a motion that comes as near anywhere is never
    called free.

    Attributes:
        robot: The robot r.
        environment: The environment E.
        dimension: d.
        rotation_weight: w as it was given; None for the default.
        names: (d,) names of the coordinates.
        lower: (d,) smallest value of each coordinate.
        upper: (d,) largest value (exclusive for the angle).
        periods: (d,) period of each coordinate, 0 where it has none.
        weights: (d,) factor of each coordinate in the metric: 1 for positions, w (length per radian) for an
            angle.
        metric: Weights and periods, as the kernels take them.
        extent: Diagonal of the bounds (length).
        tolerance: Gap up to which poses count as colliding (length).
        geometry: What the kernels in `guided_gym.kernels.collision` take.
    """

    def __init__(
        self,
        robot: Mechanism,
        environment: Environment,
        rotation_weight: float | None = None,
        tolerance: float | None = None,
    ) -> None:
        """Build the space.

        Args:
            robot: The robot: a `Robot` or a `Linkage`.
            environment: The environment.
            rotation_weight: w, length per radian of all that turns; by default a rigid robot's circumradius,
                and for each joint of a linkage how far what it carries reaches.
            tolerance: Collision tolerance (length); by default 1e-6 of the diagonal of the bounds, or as much
                as the rounding of the coordinates asks for: 1e-12 of those of the bounds, 1e-10 of those
                relative to a corner of the bounds (to the origin where that is near).

        Raises:
            InvalidInputError: No robot or environment, a weight or tolerance that is not positive and finite,
                or a tolerance so small beside the coordinates that rounding would matter.
        """
        instance("robot", robot, Mechanism, "Robot")  # type: ignore[type-abstract]
        instance("environment", environment, Environment)
        if robot.in_space != environment.in_space:
            kinds = ("planar", "SpatialEnvironment") if robot.in_space else ("SpatialEnvironment", "planar")
            raise InvalidInputError(
                f"environment: expected a {kinds[1]} one for robot {robot.name!r}, got a {kinds[0]} one"
            )
        self.robot = robot
        self.environment = environment
        self.rotation_weight = rotation_weight
        self._fingerprint: str | None = None
        self.dimension = robot.dimension
        self.extent = environment.extent
        self.names, *ranges = robot.coordinates(environment, rotation_weight)
        self.lower, self.upper, self.periods, self.weights = map(_frozen, ranges)
        self._angles = tuple(i for i, period in enumerate(self.periods.tolist()) if period)
        self._turning = _in_row(self._angles)
        self.metric: Metric = (self.weights, self.periods)
        self.tolerance = _checked_tolerance(tolerance, robot, environment)
        self.geometry: collision.Geometry = robot.packed(environment, self.tolerance)

    @cached_property
    def room(self) -> float:
        """The longest step that suits the free space between the obstacles (length).

        Twice the area of the free space over the length of its boundary: the width of a corridor, or half the
        side of a square room. For a robot of some size as much less as it is wide, but not less than three of
        its radii where the width allows them: longer motions than these rarely fit through a door.
        """
        return self._room(self.environment.width)

    def _room(self, width: float) -> float:
        return float(min(width, max(width - 2.0 * self.robot.radius, 3.0 * self.robot.radius)))

    @cached_property
    def scale(self) -> float:
        """A length that is natural here: 5 % of the diagonal of the bounds, or `room` where that is less.

        It is the default step. Guiding spaces use it as the unit of what a failure teaches, whatever the
        step.
        """
        longest = 0.05 * self.extent
        # Mostly there is room enough, and what is known at once of the width says so.
        return longest if self._room(self.environment.least_width) >= longest else min(longest, self.room)

    def __setstate__(self, state: dict[str, object]) -> None:
        """Unpickled arrays are writable; ours are not, and the kernels would compile for both."""
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            setattr(self, name, value)
        self.metric = (self.weights, self.periods)
        if "geometry" in state:  # addresses are those of one process
            self.geometry[1][collision.ENTRY] = self.robot.entry()

    def __repr__(self) -> str:
        obstacles = len(self.environment.obstacles)
        return f"ConfigurationSpace({self.robot.name}, {obstacles} obstacles, d={self.dimension})"

    def difference(self, a: Configurations, b: Configurations) -> FloatArray:
        """Return b - a, the short way round in periodic coordinates: broadcasts over leading axes, (..., d).

        Antisymmetric to the last bit; half a turn keeps the sign of b - a.
        """
        change: FloatArray = self._many(b) - self._many(a)
        if self._turning is not None:
            turns = change[..., self._turning]
            if np.abs(turns).max(initial=0.0) > _MANY_TURNS:  # many turns would add up rounding
                turns = (self.wrap(b) - self.wrap(a))[..., self._turning]
            change[..., self._turning] = turns - 2.0 * math.pi * np.rint(turns / (2.0 * math.pi))
        return change

    def distance(self, a: Configurations, b: Configurations) -> FloatArray:
        """Distance d_C of the metric, broadcasting over leading axes (length)."""
        change = self.difference(a, b) * self.weights
        lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", change, change))
        return lengths

    def interpolate(self, a: Configurations, b: Configurations, t: float | FloatArray) -> FloatArray:
        """Configurations at fractions t of the straight motion a -> b: leading axes of t, a, b, then (d,)."""
        fractions = np.asarray(t, dtype=np.float64)[..., None]
        return self.wrap(self._many(a) + fractions * self.difference(a, b))

    def wrap(self, q: Configurations) -> FloatArray:
        """A copy of q with the angles of periodic coordinates in [-pi, pi)."""
        wrapped = self._many(q).copy()
        if self._turning is not None:
            angle = wrapped[..., self._turning]
            turned = angle - 2.0 * math.pi * np.floor((angle + math.pi) / (2.0 * math.pi))
            inside = (angle >= -math.pi) & (angle < math.pi)
            if not np.abs(angle).max(initial=0.0) <= _MANY_TURNS:
                turned = np.where(
                    np.abs(angle) > _MANY_TURNS, np.arctan2(np.sin(angle), np.cos(angle)), turned
                )
            # Rounding may leave the turned angle a hair outside: put it on the closed end.
            turned = np.where((turned >= math.pi) | (turned < -math.pi), -math.pi, turned)
            wrapped[..., self._turning] = np.where(inside, angle, turned)
        return wrapped

    def sample(self, rng: np.random.Generator, n: int) -> FloatArray:
        """Draw n configurations (n, d), uniform over all coordinates' ranges; not checked for validity.

        Raises:
            InvalidInputError: ``n`` is negative, or would take more memory than is allowed.
        """
        n = count("n", n, least=0, each=8 * self.dimension, what="so many configurations")
        return self.lower + rng.random((n, self.dimension)) * (self.upper - self.lower)

    def valid(self, q: Configurations) -> BoolArray | bool:
        """Whether configurations are collision-free and within bounds: (n, d) -> (n,), one (d,) -> bool.

        Any angle will do. Configurations that are not finite, or beyond 1e12, are not valid.
        """
        if np.ndim(q) == 1:
            return bool(collision.pose_free(self.configuration(q), self.geometry))
        return collision.poses_free(self.batch(q), self.geometry)

    def clearance(self, q: Configurations) -> FloatArray | float:
        """Distance from the robot to the nearest obstacle or bound, 0 where invalid: (n, d) -> (n,).

        Where its own bodies must not touch each other, their distances count, too.
        """
        if np.ndim(q) == 1:
            return float(collision.pose_clearance(self.configuration(q), self.geometry))
        return collision.pose_clearances(self.batch(q), self.geometry)

    def motion_free(self, a: Configurations, b: Configurations) -> bool:
        """Whether the straight motion a -> b is certified free: never wrongly True; the same as b -> a."""
        return bool(collision.motion_free(self.configuration(a), self.configuration(b), self.geometry))

    def motions_free(self, starts: Configurations, ends: Configurations) -> BoolArray:
        """`motion_free` for each pair of rows: (n, d), (n, d) -> (n,)."""
        starts, ends = self._pairs(starts, ends)
        return collision.motions_free(starts, ends, self.geometry)

    def first_contact(self, a: Configurations, b: Configurations) -> float:
        """Certified free fraction of the motion a -> b: every pose up to it is valid; 1.0 = all of it."""
        return float(collision.motion_fraction(self.configuration(a), self.configuration(b), self.geometry))

    def first_contacts(self, starts: Configurations, ends: Configurations) -> FloatArray:
        """`first_contact` for each pair of rows: (n, d), (n, d) -> (n,)."""
        starts, ends = self._pairs(starts, ends)
        return collision.motion_fractions(starts, ends, self.geometry)

    def fingerprint(self) -> str:
        """SHA-256 (hex) of all that decides distances and collisions (not names), stable across processes."""
        if self._fingerprint is None:
            self._fingerprint = self._hashed()
        return self._fingerprint

    def _hashed(self) -> str:
        digest = hashlib.sha256(b"guided-gym configuration space 1\n")
        numbers = [self.dimension, self.tolerance, *self.environment.bounds, *self.weights]
        digest.update(np.array(numbers, dtype="<f8").tobytes())
        for body in (*self.robot.identity(), *self.environment.identity()):
            digest.update(len(body).to_bytes(8, "little") + body)
        return digest.hexdigest()

    def configuration(self, q: Configurations) -> FloatArray:
        """One configuration (d,) for the kernels: a writable C array, since others would recompile them.

        Raises:
            InvalidInputError: It has another shape.
        """
        if not (type(q) is np.ndarray and q.dtype == _FLOAT64 and q.flags.carray):
            q = np.array(q, dtype=np.float64)
        if q.shape != (self.dimension,):
            raise InvalidInputError(
                f"expected a configuration of shape ({self.dimension},), got shape {q.shape}"
            )
        for i in self._angles:
            if _MANY_TURNS < abs(q.item(i)) < LARGEST_ANGLE:  # of many turns, but still an angle
                return self.wrap(q)
        return q

    def batch(self, q: Configurations) -> FloatArray:
        """Configurations (n, d) for the kernels.

        Raises:
            InvalidInputError: They have another shape.
        """
        batch = q
        if not (type(batch) is np.ndarray and batch.dtype == _FLOAT64 and batch.flags.carray):
            batch = np.require(q, dtype=np.float64, requirements=["C", "W"])
        if batch.ndim != 2 or batch.shape[1] != self.dimension:
            raise InvalidInputError(
                f"expected configurations of shape (n, {self.dimension}), got shape {batch.shape}"
            )
        if self._turning is not None and len(batch):
            angles = np.abs(batch[:, self._turning])
            if not angles.max() <= _MANY_TURNS:
                large = ((angles > _MANY_TURNS) & (angles < LARGEST_ANGLE)).any(axis=1)
                batch = batch.copy()
                batch[large] = self.wrap(batch[large])
        return batch

    def _pairs(self, starts: Configurations, ends: Configurations) -> tuple[FloatArray, FloatArray]:
        starts, ends = self.batch(starts), self.batch(ends)
        if len(starts) != len(ends):
            raise InvalidInputError(f"expected as many starts as ends, got {len(starts)} and {len(ends)}")
        return starts, ends

    def _many(self, q: Configurations) -> FloatArray:
        many = np.asarray(q, dtype=np.float64)
        if many.ndim < 1 or many.shape[-1] != self.dimension:
            raise InvalidInputError(
                f"expected configurations of shape (..., {self.dimension}), got shape {many.shape}"
            )
        return many


def _in_row(turning: tuple[int, ...]) -> slice | IntArray | None:
    """Coordinates as an index: a slice where they are in a row; None where there are none."""
    if not turning:
        return None
    first, last = turning[0], turning[-1] + 1
    return slice(first, last) if last - first == len(turning) else np.array(turning)


def _frozen(values: npt.ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _checked_tolerance(tolerance: float | None, robot: Mechanism, environment: Environment) -> float:
    """The tolerance, large enough for rounding: in the kernels' coordinates and in the caller's."""
    local, outer = environment.magnitudes()
    local = max(local, robot.radius)
    smallest = max(_SMALLEST_TOLERANCE * local, _SMALLEST_OUTER_TOLERANCE * outer)
    limit = _LARGEST_TOLERANCE * environment.extent
    if tolerance is None and smallest <= limit:
        return max(RELATIVE_TOLERANCE * environment.extent, smallest)
    value = RELATIVE_TOLERANCE * environment.extent if tolerance is None else float(tolerance)
    if not (math.isfinite(value) and value >= smallest):
        raise InvalidInputError(
            f"the tolerance must be finite and at least {smallest:.3g} (for coordinates up to "
            f"{max(local, outer):.6g}), got {shown(value)}"
        )
    return value
