"""A plane through a configuration space, seen as a space of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.space import BoolArray, Configurations, ConfigurationSpace
from guided_gym.kernels.collision import Geometry

Floats = NDArray[np.float64]


class Subspace(ConfigurationSpace):
    """The configurations ``origin + z @ basis``: a slice of C along some coordinates or directions.

    A state z is valid where the configuration is. The metric is that of C: the directions are orthogonal in
    it, and each coordinate's weight is the length of its direction.

    Args:
        space: C.
        origin: (d,) a configuration of the plane.
        basis: (d', d) its directions, orthogonal in the metric of C.
    """

    def __init__(self, space: ConfigurationSpace, origin: Floats, basis: Floats) -> None:
        self.whole, self.origin, self.basis = space, origin, basis
        self.environment = space.environment
        self.extent, self.tolerance = space.extent, space.tolerance
        self.dimension, self.rotation_weight = len(basis), space.rotation_weight
        scaled = basis * space.weights
        lengths = np.sqrt((scaled**2).sum(axis=1))
        self._dual = (scaled / lengths[:, None] ** 2) * space.weights
        # A coordinate that is one of C keeps its period; a direction across several has none.
        alone = (basis != 0).sum(axis=1) == 1
        axis = np.argmax(basis != 0, axis=1)
        self.periods = np.where(alone, space.periods[axis], 0.0)
        self.weights = lengths
        self.metric = self.weights, self.periods
        corners = np.array(np.meshgrid(*zip(space.lower, space.upper, strict=True))).reshape(
            space.dimension, -1
        )
        z = (corners.T - origin) @ self._dual.T
        shift = np.where(alone, origin[axis], 0.0)
        self._shift = shift  # coordinates of C keep their values
        self.lower, self.upper = z.min(axis=0) + shift, z.max(axis=0) + shift
        for array in (self.lower, self.upper, self.weights, self.periods):
            array.flags.writeable = False

    @property
    def robot(self) -> Mechanism:  # type: ignore[override]
        """None, and no geometry for kernels: callers would take a state for the pose of a body.

        Raises:
            InvalidInputError: Always.
        """
        raise self._no_body()

    @property
    def geometry(self) -> Geometry:  # type: ignore[override]
        """None; see `robot`."""
        raise self._no_body()

    def _no_body(self) -> InvalidInputError:
        return InvalidInputError(
            f"expected the configuration space of a body, got a plane of {self.dimension} dimensions through "
            "one, whose states are no poses; roadmap and straight take it"
        )

    def __repr__(self) -> str:
        return f"Subspace({self.whole!r}, d'={self.dimension})"

    def project(self, q: Floats) -> Floats:
        """(n, d) configurations to (n, d') states: the nearest of the plane."""
        # Not by a matrix product, whose last bits depend on how many rows there are.
        along = np.einsum("...d,kd->...k", self.whole.difference(self.origin, q), self._dual)
        return self.wrap(along + self._shift)

    def lift(self, states: Configurations) -> Floats:
        """States (..., d') to the configurations (..., d) that they stand for."""
        z = np.asarray(states, np.float64) - self._shift
        return self.whole.wrap(self.origin + z @ self.basis)

    def difference(self, a: Configurations, b: Configurations) -> Floats:
        """Return b - a, the short way round in periodic coordinates."""
        change: Floats = np.asarray(b, np.float64) - np.asarray(a, np.float64)
        turns = np.where(self.periods > 0, self.periods, np.inf)
        shorter: Floats = change - np.where(self.periods > 0, self.periods, 0.0) * np.rint(change / turns)
        return shorter

    def wrap(self, q: Configurations) -> Floats:
        """A copy with periodic coordinates in half a period around 0."""
        z = np.array(q, np.float64)
        turns = np.where(self.periods > 0, self.periods, np.inf)
        wrapped: Floats = z - np.where(self.periods > 0, self.periods, 0.0) * np.floor(z / turns + 0.5)
        return wrapped

    def valid(self, q: Configurations) -> BoolArray | bool:
        """Whether the configurations are valid."""
        return self.whole.valid(self.lift(q))

    def clearance(self, q: Configurations) -> Floats | float:
        """Clearance of the configurations."""
        return self.whole.clearance(self.lift(q))

    def motion_free(self, a: Configurations, b: Configurations) -> bool:
        """Whether the straight motion is free."""
        return self.whole.motion_free(self.lift(a), self.lift(b))

    def motions_free(self, starts: Configurations, ends: Configurations) -> BoolArray:
        """`motion_free` for each pair of rows."""
        return self.whole.motions_free(self.lift(starts), self.lift(ends))

    def fingerprint(self) -> str:
        """That of C, and the plane."""
        plane = np.concatenate([self.origin.ravel(), self.basis.ravel()]).tobytes().hex()
        return f"{self.whole.fingerprint()} {plane}"
