"""One sample of a tree search, and RRT's whole loop: the same steps, so that both grow the same tree."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, motion_fraction, motion_free
from guided_gym.kernels.metric import Metric, interpolate, separation, steer
from guided_gym.kernels.nearest import State, insert, nearest
from guided_gym.kernels.plain import borrowing, copy_row

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]


class Nodes(NamedTuple):
    """The nodes of a search tree, a row each; rows beyond its size are room to grow."""

    configurations: Floats  # [n, d] float64, lengths and radians
    parents: Int32s  # [n] int32, NO_PARENT at the root
    costs: Floats  # [n] float64, d_T(s, v), a length
    depths: Int32s  # [n] int32, edges from the root
    children: Int32s  # [n] int32, number of children
    failures: Int32s  # [n] int32, failed expansions from v


class Failures(NamedTuple):
    """The failed expansions of a search tree, a row each, likewise."""

    nodes: Int32s  # [f] int32, x_min
    targets: Floats  # [f, d] float64, x_new
    contacts: Floats  # [f, d] float64, where the motion stopped being free


FAILED, GREW, REACHED_TOLERANCE, REACHED = 0, 1, 2, 3


@njit(cache=True)
def attempt(
    q: Floats,
    target: Floats,
    goal: Floats,
    tolerance: float,
    by_edge: bool,
    geometry: Geometry,
    metric: Metric,
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
    free = motion_fraction(q, target, geometry)
    if free < 1.0:
        return FAILED, 0.0, interpolate(q, target, free, metric)
    length = separation(q, target, metric)
    if tolerance > 0.0 and separation(target, goal, metric) <= tolerance:
        return REACHED_TOLERANCE, length, target
    if by_edge and motion_free(target, goal, geometry):
        return REACHED, length, target
    return GREW, length, target


@borrowing
def add_child(nodes: Nodes, n: int, parent: int, q: Floats, length: float) -> None:
    """Enter q (d,) as the n-th node, at the end of an edge of that length."""
    copy_row(q, nodes.configurations[n])
    nodes.parents[n] = parent
    nodes.costs[n] = nodes.costs[parent] + length
    nodes.depths[n] = nodes.depths[parent] + 1
    nodes.children[parent] += 1


@borrowing
def add_failure(nodes: Nodes, failures: Failures, f: int, node: int, target: Floats, contact: Floats) -> None:
    """Enter the f-th failure: from a node towards a target (d,), free up to a contact (d,)."""
    failures.nodes[f] = node
    copy_row(target, failures.targets[f])
    copy_row(contact, failures.contacts[f])
    nodes.failures[node] += 1


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
    metric: Metric,
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
    n, f = sizes
    step, tolerance, by_edge = limits
    outcome = FAILED
    for k in range(samples.shape[0]):
        node, _ = nearest(index, samples[k])
        target = steer(nodes.configurations[node], samples[k], step, metric)
        q = nodes.configurations[node]
        outcome, length, contact = attempt(q, target, goal, tolerance, by_edge, geometry, metric)
        record[0][k] = node
        if outcome == FAILED:
            record[1][k] = -1
            add_failure(nodes, failures, f, node, target, contact)
            f += 1
            continue
        record[1][k] = n
        add_child(nodes, n, node, target, length)
        insert(index, target)
        n += 1
        if outcome != GREW:
            return k + 1, outcome
    return samples.shape[0], outcome
