"""Our configuration spaces as OMPL's state spaces, with the same coordinates, bounds and weights.

OMPL adds up the distances of the parts of a compound space; ours is the root of the sum of their squares.
Coordinates without a period become one real vector, scaled by their weights, whose distance is ours. Each
angle becomes a circle of its own, so that a turn costs as much as in our metric, and one that also moves
costs more: |dp| + w |dtheta| for a robot that turns. With ``cut`` angles are numbers between their limits,
OMPL's metric is ours, and nothing grows across the cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.search.watch import State

_TURN: Final = 2.0 * math.pi


class StateSpace:
    """A configuration space in OMPL's terms.

    Args:
        base: The module `ompl.base`.
        space: The configuration space.
        cut: Whether angles are plain numbers.

    Attributes:
        ompl: OMPL's space.
        read: A state of it as a tuple of numbers.
    """

    def __init__(self, base: Any, space: ConfigurationSpace, cut: bool) -> None:
        self._base, self.space = base, space
        periodic = np.array(space.periods) > 0 if not cut else np.zeros(space.dimension, bool)
        self._straight, self._round = np.flatnonzero(~periodic), np.flatnonzero(periodic)
        self._order = np.concatenate([self._straight, self._round])
        self._scale = np.array(space.weights, np.float64)
        self._scale[self._round] = _TURN / np.array(space.periods)[self._round]
        self._turn_weights = (np.array(space.weights)[self._round] / self._scale[self._round]).tolist()
        self._planar = bool(
            (periodic.tolist() == [False, False, True]) and self._scale.tolist() == [1.0, 1.0, 1.0]
        )
        self._plain = bool((self._scale == 1.0).all() and (np.diff(self._order) == 1).all())
        self.ompl: Any = (
            self._se2() if self._planar else self._vector() if not periodic.any() else self._many()
        )
        self.ompl.setup()  # before any state is filled
        self.read = self._reader()

    def _bounds(self) -> Any:
        low = (self.space.lower * self._scale)[self._straight].tolist()
        high = (self.space.upper * self._scale)[self._straight].tolist()
        bounds = self._base.RealVectorBounds(len(low))
        for i, (least, most) in enumerate(zip(low, high, strict=True)):
            bounds.setLow(i, least)
            bounds.setHigh(i, most)
        self._extent = math.dist(low, high)
        return bounds

    def _se2(self) -> Any:
        """OMPL's own space of a robot that moves and turns, which all its planners know."""
        space = self._base.SE2StateSpace()
        space.setBounds(self._bounds())
        space.setSubspaceWeight(1, self._turn_weights[0])
        return space

    def _vector(self) -> Any:
        space = self._base.RealVectorStateSpace(len(self._straight))
        space.setBounds(self._bounds())
        return space

    def _many(self) -> Any:
        """A compound space; planners that discretise use its first part, since it has no projection."""
        space = self._base.CompoundStateSpace()
        self._extent = 0.0
        if len(self._straight):
            space.addSubspace(self._vector(), 1.0)
        for weight in self._turn_weights:
            space.addSubspace(self._base.SO2StateSpace(), weight)
        space.registerDefaultProjection(self._base.SubspaceProjectionEvaluator(space, 0))
        return space

    def _reader(self) -> Callable[[Any], State]:
        n, m = len(self._straight), len(self._round)
        if self._planar:
            return lambda state: (state.getX(), state.getY(), state.getYaw())
        if not m:
            return lambda state: tuple([state[i] for i in range(n)])
        if not n:
            return lambda state: tuple([state[i].value for i in range(m)])

        def read(state: Any) -> State:
            vector = state[0]
            return (*[vector[i] for i in range(n)], *[state[1 + i].value for i in range(m)])

        return read

    def configuration(self, state: State) -> NDArray[np.float64]:
        """(d,) the configuration that a state stands for."""
        if self._plain:
            return np.array(state)
        q = np.empty(len(state))
        q[self._order] = state
        q /= self._scale
        return q

    def state(self, q: NDArray[np.float64]) -> Any:
        """A state of OMPL's; it belongs to the caller, who frees it."""
        values = (q * self._scale)[self._order].tolist()
        state = self.ompl.allocState()
        self.ompl.copyFromReals(state, values)
        return state

    def length(self, a: State, b: State) -> float:
        """Distance of two states in OMPL's metric, added up as OMPL does."""
        n = len(self._straight)
        total = math.sqrt(sum((x - y) ** 2 for x, y in zip(a[:n], b[:n], strict=True)))
        for weight, x, y in zip(self._turn_weights, a[n:], b[n:], strict=True):
            turn = abs(x - y)
            total += weight * (_TURN - turn if turn > math.pi else turn)
        return total

    def pieces(self, a: NDArray[np.float64], b: NDArray[np.float64], resolution: float) -> int:
        """Into how many pieces OMPL's own check cuts a motion, at a resolution relative to the extent.

        The most that one of the parts of its space asks for; a circle's extent is half a turn.
        """
        change = (b - a) * self._scale
        turns = np.abs(change[self._round])
        lengths = [*np.minimum(turns, _TURN - turns) / math.pi]
        if len(self._straight):
            lengths.append(np.linalg.norm(change[self._straight]) / self._extent)
        return math.ceil(float(max(lengths)) / resolution)

    def sampled_check(self, resolution: float) -> Callable[[NDArray[np.float64], NDArray[np.float64]], bool]:
        """OMPL's check of a motion, in one call for all its states: the end, then what lies between."""
        space, pieces = self.space, self.pieces

        def check(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
            if not space.valid(b):
                return False
            count = pieces(a, b, resolution)
            return count < 2 or bool(
                np.all(space.valid(space.interpolate(a, b, np.arange(1, count) / count)))
            )

        return check
