"""What every robot offers, rigid or jointed: its coordinates, its place, and its packed form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.kernels.collision import Geometry

FloatArray = npt.NDArray[np.float64]


class Coordinates(NamedTuple):
    """The coordinates of a configuration space, one entry each."""

    names: tuple[str, ...]
    lower: FloatArray  # (d,) smallest value
    upper: FloatArray  # (d,) largest value; that of a whole turn is exclusive
    periods: FloatArray  # (d,) 0 where there is none
    weights: FloatArray  # (d,) length per unit, in the metric


@doors
class Mechanism(ABC):
    """A robot r (paper, section "Preliminaries"), as configuration spaces, searches and pictures see it.

    Attributes:
        name: A name for people, which is no part of the robot's identity.
        self_collision: Whether some of its bodies must not touch each other.
        in_space: Whether it moves in space, among the solids of a `SpatialEnvironment`.
    """

    name: str
    self_collision: bool = False
    in_space: ClassVar[bool] = False

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of bodies, by their place in `place`, that must not touch each other."""
        return []

    @property
    @abstractmethod
    def dimension(self) -> int:
        """Number of coordinates of a configuration."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates: x and y are positions, all others are angles."""

    @property
    @abstractmethod
    def radius(self) -> float:
        """How far from its reference point, or from its base, the robot reaches at most (length)."""

    @property
    def size(self) -> float:
        """The least distance at which pictures show two configurations as two (length)."""
        return 2.0 * self.radius

    @property
    def straight(self) -> bool:
        """Whether its position moves on a straight line along a straight motion."""
        return False

    @abstractmethod
    def coordinates(self, environment: Environment, rotation_weight: float | None = None) -> Coordinates:
        """Names, ranges and weights of the coordinates in an environment.

        Args:
            environment: Where positions range over its bounds.
            rotation_weight: Length per radian of everything that turns; None for what the robot suggests.
        """

    @abstractmethod
    def place(self, q: Sequence[float] | FloatArray) -> tuple[shapely.Geometry, ...]:
        """The robot's bodies in the workspace at configuration q.

        Raises:
            InvalidInputError: q is not a finite array of shape (dimension,).
        """

    def gaps(self, q: FloatArray, environment: Environment) -> FloatArray:
        """(n,) how far the robot is from each obstacle of an environment (length)."""
        placed = shapely.union_all(self.place(q))
        gaps: FloatArray = shapely.distance(placed, np.array(environment.obstacles, dtype=object))
        return gaps

    def side_gaps(self, q: FloatArray, environment: Environment) -> FloatArray:
        """How far it is inside each of `Environment.sides`; negative beyond (length)."""
        xmin, ymin, xmax, ymax = environment.bounds
        left, bottom, right, top = shapely.union_all(self.place(q)).bounds
        return np.array([left - xmin, bottom - ymin, xmax - right, ymax - top])

    def own_gaps(self, q: FloatArray) -> FloatArray:
        """How far the bodies of each of `pairs` are apart (length)."""
        bodies = self.place(q)
        return np.array([shapely.distance(bodies[i], bodies[k]) for i, k in self.pairs])

    @abstractmethod
    def position(self, q: FloatArray) -> FloatArray:
        """Where the robot is: its reference point, or an arm's tool: (..., d) -> (..., 2)."""

    @abstractmethod
    def displacement(self, change: FloatArray) -> FloatArray:
        """How far any point moves at most when the coordinates change by so much: (..., d) -> (...)."""

    @property
    @abstractmethod
    def description(self) -> str:
        """Everything that decides where the robot's bodies are, as text; the same in every process."""

    @abstractmethod
    def packed(self, environment: Environment, tolerance: float) -> Geometry:
        """What the collision kernels take, for this robot in an environment."""

    @abstractmethod
    def entry(self) -> int:
        """Address of the kernel that answers for this robot in this process; 0 for a rigid body."""

    @abstractmethod
    def identity(self) -> Iterator[bytes]:
        """All that decides where the robot's bodies are, for fingerprints."""

    def rows(self, q: FloatArray) -> FloatArray:
        """Configurations (..., d), or changes of them.

        Raises:
            InvalidInputError: They have another shape.
        """
        if q.ndim < 1 or q.shape[-1] != self.dimension:
            raise InvalidInputError(f"expected an array of shape (..., {self.dimension}), got {q.shape}")
        return q

    def checked(self, q: Sequence[float] | FloatArray) -> FloatArray:
        """One finite configuration.

        Raises:
            InvalidInputError: It is not one.
        """
        pose = np.asarray(q, dtype=np.float64)
        if pose.shape != (self.dimension,) or not np.isfinite(pose).all():
            raise InvalidInputError(
                f"expected a finite configuration of shape ({self.dimension},), got {shown(q)}"
            )
        return pose
