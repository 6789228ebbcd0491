"""A learned cost-to-go as a solver: no roadmap, no grid, one look along the straight line to the goal."""

from __future__ import annotations

import numpy as np

from guided_gym.guidance.learned.motion_agent import MotionAgent, load_motion_agent
from guided_gym.guidance.solvers.base import Floats, Query, Valid, require_body
from guided_gym.guidance.solvers.graph import Taught

_MOST = 1e3  # times that failures may lengthen a way


class Estimated:
    """The cost-to-go that a network estimates from the workspace; longer near failures.

    Args:
        agent: A shipped agent's name, a folder, or a `MotionAgent`.
    """

    looks: int

    def __init__(self, agent: str | MotionAgent = "planar-arm-4") -> None:
        self.agent = agent if isinstance(agent, MotionAgent) else load_motion_agent(agent)

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Rasterise the workspace.

        Raises:
            InvalidInputError: Another robot than the one that the network was trained with.
        """
        require_body("estimated", query)
        self._query = query
        self._estimate = self.agent.estimate(query.space)
        self._taught = Taught(query.space.metric)
        self._h, self._factors, self._nodes = np.zeros(64), np.ones(64), 0
        self.looks = 0

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) cost-to-go (length)."""
        h = self._costs(states)
        return h * self._factors_of(states)

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes, each worked out once."""
        n, first = len(states), self._nodes
        if n > len(self._h):
            self._h, self._factors = (np.resize(a, 2 * n) for a in (self._h, self._factors))
        if n > first:
            self._h[first:n] = self._costs(states[first:n])
            self._factors[first:n] = self._factors_of(states[first:n])
            self._nodes = n
        self._states = states
        return np.asarray(self._h[:n] * self._factors[:n])

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Make the ways of states within ``reach`` longer."""
        self._taught.add(state, reach, factor)
        if self._nodes:
            near = self._query.space.distance(self._states[: self._nodes], state) <= reach
            raised = self._factors[: self._nodes][near] * factor
            self._factors[: self._nodes][near] = np.minimum(raised, _MOST)

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Nothing: no way is remembered."""

    def _costs(self, states: Floats) -> Floats:
        costs = self._estimate.costs(states, self._query.goal)
        self.looks = self._estimate.looks
        return costs

    def _factors_of(self, states: Floats) -> Floats:
        factors = np.ones(len(states))
        for state, reach, factor in zip(*self._taught.arrays, strict=True):
            factors[self._query.space.distance(states, state) <= reach] *= factor
        return np.minimum(factors, _MOST)
