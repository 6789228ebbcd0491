"""What a solver is: cost-to-go on an easier problem (r', E'), kept up to date as failures raise its costs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.robots import rigid
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.subspace import Subspace

Floats = NDArray[np.float64]
Valid = Callable[[Floats], NDArray[np.bool_]]


class Doubts(Protocol):
    """What an environment modification believes about motions, where E' has no obstacles to tell.

    Attributes:
        looks: Configurations that it has looked at, in a raster or elsewhere, since it was made.
    """

    looks: int

    def factors(self, starts: Floats, ends: Floats) -> Floats:
        """(n,) factors on the lengths of motions between (n, d) configurations; infinite if never free."""

    def likely(self, starts: Floats, ends: Floats) -> Floats:
        """(n,) p(free) of each motion."""


class Query(NamedTuple):
    """A start and a goal in the guiding space C' = (r', E'); either may be in collision there.

    Attributes:
        space: C', of dimension d'.
        start: (d',) the projection of the start.
        goal: (d',) the projection of the goal.
        doubts: What is believed of motions; None where E' says all there is to know. A class attribute
            ``doubts = True`` of a solver says that it asks them.
    """

    space: ConfigurationSpace
    start: Floats
    goal: Floats
    doubts: Doubts | None = None


class CostToGo(Protocol):
    """A solver: the value h of states of C', the length of the way that it sees from there to the goal.

    `begin` may be called any number of times, each time for a new search. Within a search costs only rise,
    except where a solver that sees no way at all any more begins anew on a finer scale, or finds another way.

    A solver may be able to do more. `Composed` asks whether it has these, and does without where it has not:

    - ``hopeless``: a bool, whether it is sure since `begin` that nothing leads from the start to the goal.
    - ``plausible(node, lengths)``: which of the states asked for last a motion from a node may reach.
    - ``ahead(state)``: (k, d') states that a proposal from there should look at, too.
    - ``choose(state, states)``: which of some states to try from another; needed with ``doubts = True``.
    - ``grow(search, terms, most)``: many samples in one go, as `Composed.burst` wants them.
    - ``drawing(values)``: what a figure shows of it.

    Attributes:
        looks: Poses and motions that it has checked for collision since `begin`. What it finds by looking at
            E' in another way (a raster, an oracle) is no check; a class attribute ``sees = True`` says that
            each state whose h it tells is looked at so.
    """

    looks: int

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
        """Raise the cost of ways near a state.

        Args:
            state: (d',) where a motion failed.
            reach: How far around it (length); 0 for the way that begins at the state itself.
            factor: How many times costlier; infinite forbids.
        """

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Check what ways run through near a state, and forbid what is not valid.

        Args:
            state: (d',) where a motion failed.
            reach: How far around it (length).
            valid: (m, d') states to (m,) whether they are.
        """


class Fixed:
    """Solvers that learn nothing from failures: h of a node is computed once. A subclass says how."""

    looks = 0

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Take note of the query."""
        self._query = query
        self._known = np.zeros(0)
        self._count = 0

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) cost-to-go."""
        raise NotImplementedError

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes; asked for once for each."""
        n, count = len(states), self._count
        if n > len(self._known):
            self._known = np.resize(self._known, 2 * n)
        if n > count:
            self._known[count:n] = self(states[count:n])
            self._count = n
        values: Floats = self._known[:n]
        values.flags.writeable = False
        return values

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Nothing: no cost rises."""

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Nothing: no way is remembered."""


def require_dimensions(solver: str, query: Query, *dimensions: int) -> None:
    """Refuse a guiding space that a solver cannot take.

    Raises:
        InvalidInputError: Another number of dimensions.
    """
    if query.space.dimension not in dimensions:
        expected = " or ".join(map(str, dimensions))
        raise InvalidInputError(
            f"{solver}: expected a guiding space of {expected} dimensions, got {query.space.dimension}; "
            "a robot modification, such as robot=point, changes their number"
        )


def require_rigid(solver: str, query: Query) -> None:
    """Refuse robots with joints: for solvers whose states are places, perhaps with a heading.

    Raises:
        InvalidInputError: The configuration space of a linkage, or a `Subspace`.
    """
    require_body(solver, query)
    rigid(query.space.robot, solver)


def require_body(solver: str, query: Query) -> None:
    """Refuse planes through a configuration space: for solvers whose states are poses of a body.

    Raises:
        InvalidInputError: A `Subspace`.
    """
    if isinstance(query.space, Subspace):
        raise InvalidInputError(
            f"{solver}: expected the configuration space of a body, got a plane of {query.space.dimension} "
            "dimensions through one; roadmap and straight take it"
        )
