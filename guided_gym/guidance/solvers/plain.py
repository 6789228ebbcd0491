"""Solvers that need no search: the straight line."""

from __future__ import annotations

import numpy as np

from guided_gym.guidance.solvers.base import Floats, Query, Valid


class Straight:
    """The distance to the goal, obstacles ignored: d_X(x, t). Failures teach it nothing."""

    looks = 0

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Take note of the goal."""
        self._query = query

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) distances."""
        return np.asarray(self._query.space.distance(states, self._query.goal))

    def follow(self, states: Floats) -> Floats:
        """(n,) distances of the nodes."""
        return self(states)

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Nothing: a straight line has no cost that could rise."""

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Nothing runs through anywhere."""
