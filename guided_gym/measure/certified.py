"""Certified paths down the oracle's field: d_C is no longer than a free path, whatever the grid says."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.cost_query import OracleState, cost_to_go_one, descend, step_down
from guided_gym.kernels.waypoints import over_sights, slide

FloatArray = NDArray[np.float64]

_DIRECTIONS: Final = {2: 24, 3: 64}
_STRIDES: Final = (1.0, 0.5, 0.25)  # links: each descent comes down another way
_REACHES: Final = (3.0, 1.5, 0.5)  # strides, tried in this order
_AHEAD: Final = 20  # waypoints ahead that one may be joined to
_ROUNDS: Final = ((3.0, 2.0, 0.1), (6.0, 0.5, 0.1))
"""Links between the waypoints of a path, and how far one slides at first and at last."""


def shortest_down(
    space: ConfigurationSpace,
    state: OracleState,
    start: FloatArray,
    goal: FloatArray,
    link: float,
    others: Callable[[FloatArray], FloatArray] | None = None,
) -> FloatArray | None:
    """The shortest of some certified paths down a grid's field, pulled tight: (n, d); None if all stick.

    Args:
        space: The configuration space.
        state: `Oracle.state`.
        start: (d,) where it begins.
        goal: (d,) where it ends.
        link: Length of the grid's links.
        others: Poses (m, d) that may lead on from a pose (d,) where none around it does.
    """
    paths = [_descent(space, state, start, goal, stride * link, others) for stride in _STRIDES]
    tight = [_pulled_tight(space, path, link) for path in paths if path is not None]
    return min(tight, key=partial(_length, space), default=None)


def _descent(
    space: ConfigurationSpace,
    state: OracleState,
    start: FloatArray,
    goal: FloatArray,
    stride: float,
    others: Callable[[FloatArray], FloatArray] | None,
) -> FloatArray | None:
    directions, reaches = _directions(space.dimension) / space.weights, stride * np.array(_REACHES)
    parts: list[FloatArray] = []
    here, cost = start, cost_to_go_one(start, state)
    most = 200 + math.ceil(4.0 * cost / stride) if math.isfinite(cost) else 0
    while most > 0:
        path, arrived = descend(here, goal, reaches, directions, most, state, space.metric)
        parts.append(path)
        if arrived:
            return np.concatenate(parts)
        if others is None:
            return None
        last, here = path[-1], np.empty(space.dimension)
        poses = np.ascontiguousarray(space.wrap(others(last)))
        if step_down(last, cost_to_go_one(last, state), poses, state, space.metric, here) == math.inf:
            return None
        most -= len(path)
    return None


def lengths_left(space: ConfigurationSpace, path: FloatArray) -> FloatArray:
    """(n,) length of the path from each waypoint on."""
    parts = np.atleast_1d(space.distance(path[:-1], path[1:]))
    return np.append(np.cumsum(parts[::-1])[::-1], 0.0)


def divided(space: ConfigurationSpace, path: FloatArray, longest: float) -> FloatArray:
    """The same path with waypoints at most this far apart."""
    lengths = np.atleast_1d(space.distance(path[:-1], path[1:]))
    counts = np.maximum(1, np.ceil(lengths / longest)).astype(np.int64)
    part = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(1, len(part) + 1) - (np.cumsum(counts) - counts)[part]
    between = space.interpolate(path[part], path[part + 1], number / counts[part])
    between[np.cumsum(counts) - 1] = path[1:]  # to the last bit
    return np.ascontiguousarray(np.concatenate([path[:1], between]))


def _pulled_tight(space: ConfigurationSpace, path: FloatArray, link: float) -> FloatArray:
    """Straightened, then its waypoints slide along the obstacles that they touch; and again with others."""
    directions = _directions(space.dimension) / space.weights
    for apart, first, last in _ROUNDS:
        path = _straightened(space, path, apart * link)
        path = slide(path, directions, first * link, last * link, space.geometry, space.metric)
    return path


def _straightened(space: ConfigurationSpace, path: FloatArray, apart: float) -> FloatArray:
    """The shortest way over points along the path that see each other."""
    points = divided(space, path, max(apart, _length(space, path) / 70.0))
    return over_sights(points, _AHEAD, space.geometry, space.metric)


def _length(space: ConfigurationSpace, path: FloatArray) -> float:
    return float(lengths_left(space, path)[0])


def _directions(dimension: int) -> FloatArray:
    """(m, d) unit vectors, evenly spread."""
    m = _DIRECTIONS[dimension]
    if dimension == 2:
        turns = 2.0 * math.pi * np.arange(m) / m
        return np.stack([np.cos(turns), np.sin(turns)], axis=1)
    z = 1.0 - (2.0 * np.arange(m) + 1.0) / m
    angles = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(m)
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angles), flat * np.sin(angles), z], axis=1).astype(np.float64)
