"""A search that a wave guides, compiled: the same samples as one by one, up to the first that fails."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from guided_gym.kernels.collision import Geometry
from guided_gym.kernels.extend import (
    FAILED,
    GREW,
    Failures,
    Int32s,
    Nodes,
    add_child,
    add_failure,
    attempt,
)
from guided_gym.kernels.fields import BoolArray, Field, FloatArray, Ground, Joined
from guided_gym.kernels.marching import Front, arrive, values
from guided_gym.kernels.metric import Metric, ball_samples, separation, separations
from guided_gym.kernels.plain import borrowing

ROUGH = 1.1  # lengths: the grid is no more exact than that


class Waves(NamedTuple):
    """The wave of a guiding space, and what it runs over (see `guided_gym.guidance.solvers.wave.Arrivals`).

    Attributes:
        now: The wave.
        floor: It comes no earlier.
        first: The wave before anything was raised.
        first_floor: That one's.
        raised: Whether the two differ.
        ground: The workspace.
        seems: (n, n, T) above 0 where a pose seems free.
        frame: Where the cells lie, and the goal.
        geometry: Of the robot of the guiding space.
    """

    now: Front
    floor: Field
    first: Front
    first_floor: Field
    raised: bool
    ground: Ground
    seems: Field
    frame: FloatArray
    geometry: Geometry


class Terms(NamedTuple):
    """How the guiding space chooses.

    Attributes:
        leading: How many of a configuration's coordinates are its state.
        candidates: Members of N_C(v) that a proposal looks at.
        penalty: What each expansion of a node adds to its h (length).
        detour: Weight of a node's suboptimality.
    """

    leading: int
    candidates: int
    penalty: float
    detour: float


class Known(NamedTuple):
    """How the nodes are joined to the grid, and their cost-to-go, a row each; spare rows included."""

    joined: Joined
    values: FloatArray


class Limits(NamedTuple):
    """What a sample may do: length of a step, and what the task says of the goal; see `extend.attempt`."""

    step: float
    tolerance: float
    by_edge: bool


class Grown(NamedTuple):
    """What came of it: samples used, outcome of the last, nodes in `Known`, and proposals looked at."""

    used: int
    outcome: int
    seen: int
    proposals: int


@njit(cache=True)
def plausible(values: FloatArray, here: float, lengths: FloatArray) -> BoolArray:
    """(m,) which states a free motion of that length from a node can reach, by the wave before any failure.

    No free motion brings the goal nearer than by its length: what seems to lies behind a wall.

    Args:
        values: (m,) cost-to-go of the states.
        here: That of the node.
        lengths: (m,) length of the motion to each.
    """
    return values >= here - ROUGH * lengths


@njit(cache=True)
def _join_nodes(waves: Waves, known: Known, nodes: Nodes, first: int, last: int, leading: int) -> None:
    """Enter the nodes from ``first`` to ``last``."""
    states = nodes.configurations[first:last, :leading].copy()
    joined, found = arrive(
        waves.now, waves.ground, waves.floor, waves.seems, waves.frame, waves.geometry, states
    )
    known.joined.places[first:last] = joined.places
    known.joined.shares[first:last] = joined.shares
    known.joined.lengths[first:last] = joined.lengths
    known.values[first:last] = found


@borrowing
def _least(h: FloatArray, nodes: Nodes, n: int, terms: Terms) -> int:
    """The first of the nodes of least value, as `Composed.values` has it; -1 where all are infinite."""
    best, chosen = np.inf, -1
    for i in range(n):
        value = h[i] + terms.penalty * (nodes.failures[i] + nodes.children[i])
        if terms.detour > 0.0 and h[0] < np.inf:
            value += terms.detour * max(nodes.costs[i] + h[i] - h[0], 0.0)
        if value < best:
            best, chosen = value, i
    return chosen


@njit(cache=True)
def _proposed(
    waves: Waves, known: Known, candidates: FloatArray, node: int, q: FloatArray, leading: int, metric: Metric
) -> FloatArray:
    """The candidate (d,) of least cost-to-go, a plausible one if there is any, as `Composed` has it."""
    states = candidates[:, :leading].copy()
    joined, h = arrive(waves.now, waves.ground, waves.floor, waves.seems, waves.frame, waves.geometry, states)
    places, shares, lengths = known.joined
    rows = Joined(places[node : node + 1], shares[node : node + 1], lengths[node : node + 1])
    here = values(waves.first, waves.ground, waves.first_floor, rows)[0]
    there = values(waves.first, waves.ground, waves.first_floor, joined) if waves.raised else h
    likely = plausible(there, here, separations(candidates, q, metric))
    if np.isfinite(h[likely]).any():
        h = np.where(likely, h, np.inf)
    return candidates[np.argmin(h)].copy()


@njit(cache=True)
def grow_by_wave(
    rng: np.random.Generator,
    waves: Waves,
    known: Known,
    sizes: tuple[int, int, int],
    nodes: Nodes,
    failures: Failures,
    terms: Terms,
    goal: FloatArray,
    limits: Limits,
    geometry: Geometry,
    metric: Metric,
    record: tuple[Int32s, Int32s],
) -> Grown:
    """Select, propose and `attempt`, until the goal is reached, a motion fails or no node has a way.

    Args:
        rng: Source of the candidates.
        waves: The wave.
        known: What it says of the nodes; this and the tree have room for every sample, and are changed.
        sizes: Number of nodes and of failures in the tree, and of nodes in ``known``.
        nodes: Node arrays of the tree.
        failures: Failure arrays of the tree.
        terms: How to choose.
        goal: (d,) the goal t.
        limits: What a sample may do.
        geometry: Of the robot.
        metric: Weights and periods of the distance.
        record: (m,) selected node and (m,) new node (-1 after a failure) of at most m samples, written.
    """
    n, f, seen = sizes
    outcome, proposals = GREW, 0
    for k in range(record[0].size):
        if seen < n:
            _join_nodes(waves, known, nodes, seen, n, terms.leading)
            seen = n
        node = _least(known.values, nodes, n, terms)
        if node < 0:
            return Grown(k, outcome, seen, proposals)
        q, target = nodes.configurations[node], goal
        fresh = nodes.children[node] + nodes.failures[node] == 0
        if limits.by_edge or not fresh or separation(q, goal, metric) > limits.step:
            normals, radii = rng.standard_normal((terms.candidates, q.size)), rng.random(terms.candidates)
            candidates = ball_samples(q, normals, radii, limits.step, metric)
            target = _proposed(waves, known, candidates, node, q, terms.leading, metric)
            proposals += 1
        outcome, length, contact = attempt(
            q, target, goal, limits.tolerance, limits.by_edge, geometry, metric
        )
        record[0][k] = node
        if outcome == FAILED:
            record[1][k] = -1
            add_failure(nodes, failures, f, node, target, contact)
            return Grown(k + 1, outcome, seen, proposals)
        record[1][k] = n
        add_child(nodes, n, node, target, length)
        n += 1
        if outcome != GREW:
            return Grown(k + 1, outcome, seen, proposals)
    return Grown(record[0].size, outcome, seen, proposals)
