"""The exact solver, d_C itself. Nobody else in this folder may know the truth (see the architecture test)."""

from __future__ import annotations

import numpy as np

from guided_gym.errors import NoPathError
from guided_gym.guidance.solvers.base import Fixed, Floats, Query, require_body
from guided_gym.measure.oracle import Oracle, oracle_for


class Exact(Fixed):
    """The true cost-to-go d_{C'}(x, t) (paper, Simple Examples: S = C and h = d_C), from the oracle.

    With nothing modified it is the guidance that perfect knowledge gives, failures not foreseen; on a
    modified problem it is what the modification alone costs.
    """

    sees = True  # poses in collision have no way

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Solve, or load, the oracle; without a valid goal no state has a way.

        Raises:
            InvalidInputError: No space of a body.
        """
        require_body("exact", query)
        super().begin(query, rng, step)
        self._oracle: Oracle | None = None
        space = query.space
        if space.valid(query.goal):
            start = query.start if space.valid(query.start) else None
            try:
                self._oracle = oracle_for(space, query.goal, start=start)
            except NoPathError:  # not even on a finer grid: others may have a way where the start has none
                self._oracle = oracle_for(space, query.goal)

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) true cost-to-go; infinite in collision."""
        if self._oracle is None:
            return np.full(len(states), np.inf)
        costs = self._oracle.cost_to_go(np.ascontiguousarray(states))
        return np.where(self._query.space.valid(states), costs, np.inf)
