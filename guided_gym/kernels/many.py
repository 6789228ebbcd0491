"""One sample of each of many searches: choice, motion, tree, cost-to-go and observation, compiled as one."""
# mypy: disable-error-code="misc,no-any-return,no-untyped-call,call-arg"

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry
from guided_gym.kernels.cost_query import OracleState, cost_to_go_one
from guided_gym.kernels.extend import FAILED, REACHED_TOLERANCE, attempt
from guided_gym.kernels.metric import ball_samples
from guided_gym.kernels.observe import UNIT, observe_configuration, observe_place
from guided_gym.kernels.plain import borrowing, copy_row
from guided_gym.kernels.softmin import choice_efficiency, energy_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]

NUMBERS, INDEX, FIELD, LINKS, FRAME, WEIGHTS, PERIODS = range(0, 14, 2)
WORLD: Final = 14
"""A row of addresses and sizes: the geometry, the oracle's grid and the metric of one search's space."""

SIZE, FAILURES, INVALID, SAMPLES, CHECKS, DRAWN = range(6)
COUNTS: Final = 6
"""Nodes, failures, invalid actions, samples, collision checks; which of the numbers drawn ahead is next."""

STEP, TOLERANCE, BY_EDGE, OPTIMUM, SCALE = range(5)
RULES: Final = 5
"""Radius of the local planner's ball, the rule of the goal, d_C(s, t), and what energies are divided by."""

ENDED, REFUSED = -2, -1
"""Outcomes beside those of `attempt`: the episode is over; there is no such node."""


class Trees(NamedTuple):
    """The trees of n searches of d dimensions, m rows each; `extend.Nodes` and `extend.Failures`, stacked."""

    configurations: Floats  # [n, m, d]
    parents: Int32s  # [n, m]
    costs: Floats  # [n, m]
    depths: Int32s  # [n, m]
    children: Int32s  # [n, m]
    failures: Int32s  # [n, m]
    failed_nodes: Int32s  # [n, m]
    failed_targets: Floats  # [n, m, d]
    contacts: Floats  # [n, m, d]
    goals: Floats  # [n, d]
    normals: Floats  # [n, k, d] drawn ahead
    radii: Floats  # [n, k] likewise


class Episodes(NamedTuple):
    """What n episodes are about, whatever the dimension."""

    counts: Ints  # [n, COUNTS]
    rules: Floats  # [n, RULES]
    scales: Floats  # [n, SCALES] of the observation
    worlds: Ints  # [n, WORLD]
    tau: Floats  # [n, m] work remaining, a length
    energy: Floats  # [n, m] delta_v/delta + tau_v/tau
    nodes: NDArray[np.float32]  # [n, m * F] observed features
    parents: Int32s  # [n, m] observed
    mask: NDArray[np.int8]  # [n, m] observed
    efficiency: Floats  # [n] SE of this step
    best: Floats  # [n] the best possible
    outcome: NDArray[np.int8]  # [n] of this step
    lost: NDArray[np.bool_]  # [n] whether the grid knows no way from the new node


class Parameters(NamedTuple):
    """What all the searches have in common."""

    delta: float
    tau: float
    epsilon: float
    features: int
    highest: float  # cost shown
    logarithms: Floats  # counts shown


@intrinsic
def _pointer(typingctx: Any, address: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(address), codegen


@njit(cache=True)
def _floats(world: Ints, which: int) -> Floats:
    return carray(_pointer(world[which]), (world[which + 1],), np.float64)


@njit(cache=True)
def _geometry(world: Ints) -> Geometry:
    return _floats(world, NUMBERS), carray(_pointer(world[INDEX]), (world[INDEX + 1],), np.int64)


@njit(cache=True)
def _oracle(world: Ints) -> OracleState:
    field = carray(_pointer(world[FIELD]), (world[FIELD + 1],), np.float32)
    links = carray(_pointer(world[LINKS]), (world[LINKS + 1],), np.uint8)
    return field, links, _floats(world, FRAME), _geometry(world)


@njit(cache=True)
def refill(rng: np.random.Generator, normals: Floats, radii: Floats) -> None:
    """Draw ahead what so many random expansions need, in the order in which they would draw it.

    Args:
        rng: The source of one search's random expansions.
        normals: (k, d) standard normal numbers, written.
        radii: (k,) uniform numbers, written.
    """
    for i in range(normals.shape[0]):
        for j in range(normals.shape[1]):
            normals[i, j] = rng.standard_normal()
        radii[i] = rng.random()


@njit(cache=True)
def step_many(actions: Ints, rows: Ints, trees: Trees, episodes: Episodes, shared: Parameters) -> None:
    """One step of each of some environments: expand a node, measure the choice, observe.

    Args:
        actions: (n,) the node to expand in each environment.
        rows: (k,) the environments to step; none of them may have run out of numbers drawn ahead.
        trees: Changed in place, as are ``episodes``.
        episodes: The outcome is -2 where the episode had ended before.
        shared: Parameters of the target and of the observation.
    """
    for k in range(rows.size):
        i = rows[k]
        if episodes.outcome[i] == ENDED:
            episodes.efficiency[i] = episodes.best[i] = 0.0
            continue
        counts = episodes.counts[i]
        n, node = counts[SIZE], actions[i]
        valid = 0 <= node < n
        measured = choice_efficiency(episodes.energy[i], n, node if valid else 0, shared.epsilon)
        episodes.efficiency[i], episodes.best[i] = measured
        if valid:
            _expand(i, node, trees, episodes, shared)
        else:
            episodes.efficiency[i] = -np.log(shared.epsilon)
            counts[INVALID] += 1
            episodes.outcome[i] = REFUSED


@njit(cache=True)
def _expand(i: int, node: int, trees: Trees, episodes: Episodes, shared: Parameters) -> None:
    """The sample itself: what `Search.expand` does."""
    counts, rules, world = episodes.counts[i], episodes.rules[i], episodes.worlds[i]
    geometry = _geometry(world)
    metric = (_floats(world, WEIGHTS), _floats(world, PERIODS))
    q, goal = trees.configurations[i, node], trees.goals[i]
    drawn = counts[DRAWN]
    counts[DRAWN] += 1
    normals, radii = trees.normals[i, drawn : drawn + 1], trees.radii[i, drawn : drawn + 1]
    target = ball_samples(q, normals, radii, rules[STEP], metric)[0]
    by_edge = rules[BY_EDGE] > 0.0
    outcome, length, contact = attempt(q, target, goal, rules[TOLERANCE], by_edge, geometry, metric)
    counts[SAMPLES] += 1
    counts[CHECKS] += 2 if by_edge and outcome != FAILED and outcome != REACHED_TOLERANCE else 1
    episodes.outcome[i] = outcome
    if outcome == FAILED:
        f = counts[FAILURES]
        trees.failed_nodes[i, f] = node
        copy_row(target, trees.failed_targets[i, f])
        copy_row(contact, trees.contacts[i, f])
        trees.failures[i, node] += 1
        counts[FAILURES] = f + 1
    else:
        n = counts[SIZE]
        copy_row(target, trees.configurations[i, n])
        trees.parents[i, n] = node
        trees.costs[i, n] = trees.costs[i, node] + length
        trees.depths[i, n] = trees.depths[i, node] + 1
        trees.children[i, node] += 1
        counts[SIZE] = n + 1
        _measure(i, n, node, trees, episodes, shared)
        observe_node(i, n, trees, episodes, shared)
    _observe_place(i, node, trees, episodes, shared)


@njit(cache=True)
def _measure(i: int, n: int, parent: int, trees: Trees, episodes: Episodes, shared: Parameters) -> None:
    """Work remaining and energy of a new node: what `Measure` does."""
    tau = cost_to_go_one(trees.configurations[i, n], _oracle(episodes.worlds[i]))
    episodes.lost[i] = tau == np.inf
    settle(i, n, parent, tau, trees, episodes, shared)


@borrowing
def settle(
    i: int, n: int, parent: int, tau: float, trees: Trees, episodes: Episodes, shared: Parameters
) -> None:
    """Write down what the oracle says of node n of environment i; ``parent`` is -1 for the root."""
    rules = episodes.rules[i]
    if parent >= 0:
        # The edge is free, so d_C can't change by more than its length.
        tau = min(tau, episodes.tau[i, parent] + (trees.costs[i, n] - trees.costs[i, parent]))
    episodes.tau[i, n] = tau
    temperatures = shared.delta, shared.tau
    episodes.energy[i, n] = energy_of(trees.costs[i, n], tau, rules[OPTIMUM], rules[SCALE], temperatures)


@njit(cache=True)
def observe_node(i: int, n: int, trees: Trees, episodes: Episodes, shared: Parameters) -> None:
    """Show node n of environment i for the first time."""
    row = episodes.nodes[i, n * shared.features : (n + 1) * shared.features]
    geometry = _geometry(episodes.worlds[i])
    observe_configuration(row, trees.configurations[i, n], trees.goals[i], episodes.scales[i], geometry)
    _observe_place(i, n, trees, episodes, shared)
    episodes.parents[i, n] = trees.parents[i, n]
    episodes.mask[i, n] = 1


@borrowing
def _observe_place(i: int, n: int, trees: Trees, episodes: Episodes, shared: Parameters) -> None:
    row = episodes.nodes[i, n * shared.features : (n + 1) * shared.features]
    counts = int(trees.depths[i, n]), int(trees.children[i, n]), int(trees.failures[i, n])
    unit = episodes.scales[i, UNIT]
    observe_place(row, trees.costs[i, n], counts, unit, shared.highest, shared.logarithms)
