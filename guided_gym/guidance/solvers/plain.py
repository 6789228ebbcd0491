"""Solvers that need no search: the straight line."""

from __future__ import annotations

import numpy as np

from guided_gym.guidance.solvers.base import Fixed, Floats


class Straight(Fixed):
    """The distance to the goal, obstacles ignored: d_X(x, t). Failures teach it nothing."""

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) distances."""
        return np.asarray(self._query.space.distance(states, self._query.goal))
