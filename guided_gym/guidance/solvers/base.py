"""What a solver is: cost-to-go on an easier problem (r', E'), kept up to date as failures raise its costs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.geometry.space import ConfigurationSpace

Floats = NDArray[np.float64]


class Query(NamedTuple):
    """A start and a goal in the guiding space C' = (r', E'); either may be in collision there.

    Attributes:
        space: C', of dimension d'.
        start: (d',) the projection of the start.
        goal: (d',) the projection of the goal.
    """

    space: ConfigurationSpace
    start: Floats
    goal: Floats


class CostToGo(Protocol):
    """A solver: the value h of states of C', the length of the way that it sees from there to the goal.

    `begin` may be called any number of times, each time for a new search. Costs only ever rise within a
    search, so a guiding space can't fall into a cycle of forgetting.
    """

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Solve for a query.

        Args:
            query: Start and goal in C'.
            rng: Source of all of the solver's randomness.
            step: Radius of the local planner's ball (length): the scale on which the search moves.

        Raises:
            InvalidInputError: A space that this solver cannot take, such as one of too many dimensions.
        """

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) cost-to-go (length); infinite where there is no way."""

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes of a growing tree, kept up to date as costs rise.

        Args:
            states: (n, d') states of all nodes; rows that were there in an earlier call stay what they were.
        """

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Make ways near a state costlier.

        Args:
            state: (d',) where a motion failed.
            reach: How far around it (length); 0 for what lies at the state itself.
            factor: How many times costlier; infinite forbids.
        """

    def landmarks(self, state: Floats, reach: float) -> Floats:
        """(m, d') states near ``state`` that ways run through and that nobody has validated; may be none."""
