"""One sample of a tree search, and RRT's whole loop: the same steps, so that both grow the same tree."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, motion_fraction, motion_free
from guided_gym.kernels.metric import interpolate, separation, steer
from guided_gym.kernels.nearest import State, insert, nearest

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Nodes = tuple[Floats, Int32s, Floats, Int32s, Int32s, Int32s]
"""configurations, parents, cost to come, depths, children, failures: the node arrays of a `SearchTree`."""
Failures = tuple[Int32s, Floats, Floats]
"""nodes, targets, contacts: the failure arrays of a `SearchTree`."""

FAILED, GREW, REACHED_TOLERANCE, REACHED = 0, 1, 2, 3


@njit(cache=True)
def attempt(
    q: Floats,
    target: Floats,
    goal: Floats,
    tolerance: float,
    by_edge: bool,
    geometry: Geometry,
    metric: tuple[Floats, Floats],
) -> tuple[int, float, Floats]:
    """Try the motion from ``q`` to ``target``, and the goal from there.

    Args:
        q: (d,) configuration of the node.
        target: (d,) x_new.
        goal: (d,) the goal t.
        tolerance: The goal also counts as reached when it is this near; 0 for never.
        by_edge: Whether a free motion to the goal counts as having reached it.
        geometry: What the collision kernels take.
        metric: Weights and periods of the distance.

    Returns:
        FAILED and the colliding configuration; GREW; REACHED_TOLERANCE; or REACHED, when the motion to the
        goal is free. With the length of the motion.
    """
    weights, periods = metric
    free = motion_fraction(q, target, geometry)
    if free < 1.0:
        return FAILED, 0.0, interpolate(q, target, free, periods)
    length = separation(q, target, weights, periods)
    if tolerance > 0.0 and separation(target, goal, weights, periods) <= tolerance:
        return REACHED_TOLERANCE, length, target
    if by_edge and motion_free(target, goal, geometry):
        return REACHED, length, target
    return GREW, length, target


@njit(cache=True)
def grow_rrt(
    samples: Floats,
    sizes: tuple[int, int],
    nodes: Nodes,
    failures: Failures,
    index: State,
    goal: Floats,
    limits: tuple[float, float, bool],
    geometry: Geometry,
    metric: tuple[Floats, Floats],
    record: tuple[Int32s, Int32s],
) -> tuple[int, int]:
    """RRT's loop over ``samples``: nearest node, one step towards the sample, `attempt`.

    The arrays of the tree and the index must have room for every sample; they are changed in place.

    Args:
        samples: (m, d) uniform samples of C.
        sizes: Number of nodes and of failures in the tree.
        nodes: Node arrays of the tree.
        failures: Failure arrays of the tree.
        index: Nearest-neighbour index over the nodes.
        goal: (d,) the goal t.
        limits: Step of the local planner; tolerance at the goal; whether a free motion to it is enough.
        geometry: What the collision kernels take.
        metric: Weights and periods of the distance.
        record: (m,) selected node and (m,) new node (-1 after a failure) of each sample, written.

    Returns:
        Number of samples used, and the outcome of the last; stops early when the goal is reached.
    """
    configurations, parents, costs, depths, children, failed = nodes
    failed_nodes, failed_targets, contacts = failures
    n, f = sizes
    step, tolerance, by_edge = limits
    outcome = FAILED
    for k in range(samples.shape[0]):
        node, _ = nearest(index, samples[k])
        target = steer(configurations[node], samples[k], step, metric[0], metric[1])
        q = configurations[node]
        outcome, length, contact = attempt(q, target, goal, tolerance, by_edge, geometry, metric)
        record[0][k] = node
        if outcome == FAILED:
            record[1][k] = -1
            failed_nodes[f] = node
            failed_targets[f] = target
            contacts[f] = contact
            failed[node] += 1
            f += 1
            continue
        record[1][k] = n
        configurations[n] = target
        parents[n] = node
        costs[n] = costs[node] + length
        depths[n] = depths[node] + 1
        children[node] += 1
        insert(index, target)
        n += 1
        if outcome != GREW:
            return k + 1, outcome
    return samples.shape[0], outcome
