"""Distances to a goal over a certified roadmap: ways pulled tight, vertex by vertex, as they are asked for.

A roadmap's own paths run from vertex to vertex, and are too long by that. So the way from a vertex is pulled
tight: straight to the farthest place that it sees on the way of the next vertex, over the places where that
straight line touches an obstacle. The way of a vertex depends on the roadmap and the goal alone, so it does
not matter who asks first.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, motion_fraction, motion_free
from guided_gym.kernels.metric import Metric, interpolate, separation
from guided_gym.kernels.nearest import State, k_nearest
from guided_gym.kernels.plain import borrowing

Floats: TypeAlias = NDArray[np.float64]
Int32s: TypeAlias = NDArray[np.int32]
Ints: TypeAlias = NDArray[np.int64]

TURNS: Final = 3
"""Places at most where a way turns before it joins the one that it is pulled from."""
_BISECTIONS: Final = 5
"""Steps to the farthest place that is seen between two waypoints."""


class Ways(NamedTuple):
    """The ways known so far, as waypoints that lead on to others; the goal is the first."""

    points: Floats  # [m, d] waypoints, with room for (TURNS + 1) a vertex
    following: Int32s  # [m] the next waypoint, -1 at the goal
    left: Floats  # [m] length of the way from each
    first: Int32s  # [v] where the way of each vertex begins, -1 while nobody has asked
    used: Ints  # [1] waypoints so far


class Roads(NamedTuple):
    """A roadmap with the shortest paths along its edges to one goal, its last vertex."""

    vertices: Floats  # [v, d] those of the index, some of this task's own, the goal
    distance: Floats  # [v] along edges
    parent: Int32s  # [v] the next vertex on the way, -1 at the goal and where there is none
    nearest: State  # index over the first vertices


@borrowing
def _farthest(x: Floats, at: int, ways: Ways, geometry: Geometry) -> int:
    """The last of the waypoints from `at` on that x sees, one after the other; it sees `at`."""
    while ways.following[at] >= 0 and motion_free(x, ways.points[ways.following[at]], geometry):
        at = ways.following[at]
    return at


@njit(cache=True)
def _pull(
    x: Floats, at: int, ways: Ways, corners: Floats, geometry: Geometry, metric: Metric
) -> tuple[int, int, float]:
    """Pull the way from x over a waypoint that it sees tight.

    Args:
        x: (d,) where it begins.
        at: The waypoint.
        ways: The ways that it may join.
        corners: (TURNS, d) where it turns, written.
        geometry: What the collision kernels take.
        metric: Weights and periods of the distance.

    Returns:
        How often it turns; the waypoint that it joins after that; its length.
    """
    here, turns, walked = x, 0, 0.0
    for _ in range(TURNS):
        at = _farthest(here, at, ways, geometry)
        after = ways.following[at]
        if after < 0:
            break
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if motion_free(here, interpolate(ways.points[at], ways.points[after], middle, metric), geometry):
                low = middle
            else:
                high = middle
        # Straight on would meet an obstacle; where it does, a tight way turns.
        seen = interpolate(ways.points[at], ways.points[after], low, metric)
        beyond = interpolate(ways.points[at], ways.points[after], high, metric)
        corner = interpolate(here, seen, motion_fraction(here, beyond, geometry), metric)
        tight = motion_free(here, corner, geometry) and motion_free(corner, ways.points[after], geometry)
        if not tight and low == 0.0:
            break
        corners[turns] = corner if tight else seen
        walked += separation(here, corners[turns], metric)
        here, at = corners[turns], after
        turns += 1
        if not tight:
            break
    return turns, at, walked + separation(here, ways.points[at], metric) + ways.left[at]


@njit(cache=True)
def _append(x: Floats, after: int, ways: Ways, metric: Metric) -> int:
    """Write down a waypoint that leads on to another."""
    i = ways.used[0]
    ways.points[i], ways.following[i] = x, after
    ways.left[i] = separation(x, ways.points[after], metric) + ways.left[after]
    ways.used[0] = i + 1
    return i


@njit(cache=True)
def _way_of(v: int, roads: Roads, ways: Ways, geometry: Geometry, metric: Metric) -> int:
    """Where the way of a vertex begins; worked out, with the ways that it rests on, if it has to be."""
    corners = np.empty((TURNS, roads.vertices.shape[1]))
    while ways.first[v] < 0:
        u = v
        while ways.first[roads.parent[u]] < 0:
            u = roads.parent[u]
        q = roads.vertices[u]
        turns, at, _ = _pull(q, ways.first[roads.parent[u]], ways, corners, geometry, metric)
        for t in range(turns - 1, -1, -1):
            at = _append(corners[t], at, ways, metric)
        ways.first[u] = _append(q, at, ways, metric)
    return ways.first[v]


@njit(cache=True)
def _chances(q: Floats, near: int, roads: Roads, metric: Metric) -> tuple[Ints, Floats]:
    """The nearest vertices and the task's own: numbers, and lengths of the ways over them along edges."""
    ids, away = k_nearest(roads.nearest, q, near)
    own = roads.nearest[4][0]
    count = ids.size + roads.vertices.shape[0] - 1 - own
    chances, through = np.empty(count, np.int64), np.empty(count)
    for i in range(count):
        if i < ids.size:
            v, far = ids[i], away[i]
        else:
            v = own + i - ids.size
            far = separation(q, roads.vertices[v], metric)
        chances[i], through[i] = v, far + roads.distance[v]
    return chances, through


@njit(cache=True)
def cost_by_roadmap(
    q: Floats, roads: Roads, ways: Ways, looks: tuple[int, int], geometry: Geometry, metric: Metric
) -> float:
    """Length of a tight certified way from a configuration to the goal; infinite where none is seen.

    Args:
        q: (d,) configuration.
        roads: The roadmap.
        ways: The ways of its vertices; more are worked out as they are needed.
        looks: How many of the nearest vertices are looked at, and how many ways are pulled tight.
        geometry: What the collision kernels take.
        metric: Weights and periods of the distance.
    """
    goal = roads.vertices[roads.vertices.shape[0] - 1]
    if motion_free(q, goal, geometry):
        return separation(q, goal, metric)
    chances, through = _chances(q, looks[0], roads, metric)
    corners = np.empty((TURNS, q.size))
    best, pulled = np.inf, 0
    while pulled < looks[1]:
        i = 0
        for j in range(through.size):
            if through[j] < through[i]:
                i = j
        if through.size == 0 or through[i] == np.inf:
            break
        through[i] = np.inf
        if motion_free(q, roads.vertices[chances[i]], geometry):
            at = _way_of(chances[i], roads, ways, geometry, metric)
            best = min(best, _pull(q, at, ways, corners, geometry, metric)[2])
            pulled += 1
    return best


@njit(cache=True)
def costs_by_roadmap(
    qs: Floats, roads: Roads, ways: Ways, looks: tuple[int, int], geometry: Geometry, metric: Metric
) -> Floats:
    """`cost_by_roadmap` for each row of qs (n, d): float64 array (n,)."""
    costs = np.empty(qs.shape[0])
    for i in range(qs.shape[0]):
        costs[i] = cost_by_roadmap(qs[i], roads, ways, looks, geometry, metric)
    return costs
