"""Certified paths down the oracle's field: d_C is no longer than a free path, whatever the grid says."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.geometry.space import ConfigurationSpace

FloatArray = NDArray[np.float64]

_DIRECTIONS: Final = {2: 24, 3: 64}
_REACHES: Final = (3.0, 1.5, 0.5)  # links, tried in this order
_BEST: Final = 12  # candidates whose motions are checked
_AHEAD: Final = 40  # waypoints ahead that one may be joined to
_PASSES: Final = 3


def descent(
    space: ConfigurationSpace,
    costs: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    goal: FloatArray,
    link: float,
) -> FloatArray | None:
    """A certified path (n, d) from start to goal, down a field and pulled tight; None if it sticks.

    Args:
        space: The configuration space.
        costs: The field at configurations (m, d): (m,).
        start: (d,) where it begins.
        goal: (d,) where it ends.
        link: Length of the grid's links.
    """
    directions = _directions(space.dimension) / space.weights
    path, here = [start], float(costs(start[None])[0])
    for _ in range(200 + math.ceil(4.0 * here / link) if math.isfinite(here) else 0):
        if space.motion_free(path[-1], goal):
            return _tight(space, np.array([*path, goal]), link)
        step = _next(space, costs, path[-1], here, link * directions)
        if step is None:
            return None
        path.append(step[0])
        here = step[1]
    return None


def lengths_left(space: ConfigurationSpace, path: FloatArray) -> FloatArray:
    """(n,) length of the path from each waypoint on."""
    parts = np.atleast_1d(space.distance(path[:-1], path[1:]))
    return np.append(np.cumsum(parts[::-1])[::-1], 0.0)


def divided(space: ConfigurationSpace, path: FloatArray, longest: float) -> FloatArray:
    """The same path with waypoints at most this far apart."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, math.ceil(float(space.distance(a, b)) / longest))
        parts.append(space.interpolate(a, b, np.arange(1, count + 1) / count))
    return np.ascontiguousarray(np.concatenate(parts))


def _next(
    space: ConfigurationSpace,
    costs: Callable[[FloatArray], FloatArray],
    here: FloatArray,
    cost: float,
    directions: FloatArray,
) -> tuple[FloatArray, float] | None:
    """A pose in sight from which the way left is shortest, and its cost."""
    for reach in _REACHES:
        poses = np.ascontiguousarray(space.wrap(here + reach * directions))
        left = costs(poses)
        through = left + space.distance(here[None], poses)
        best = np.argsort(through, kind="stable")[:_BEST]
        best = best[left[best] < cost]
        if not best.size:
            continue
        seen = best[np.asarray(space.motions_free(np.repeat(here[None], best.size, axis=0), poses[best]))]
        if seen.size:
            return poses[seen[0]].copy(), float(left[seen[0]])
    return None


def _tight(space: ConfigurationSpace, path: FloatArray, link: float) -> FloatArray:
    """The shortest way over the waypoints that see each other, then over points between those, and again."""
    spread = max(link, float(lengths_left(space, path)[0]) / 200.0)
    for k in range(_PASSES):
        path = divided(space, path, spread * (2.0 if k == 0 else 1.0 + 0.37 * k))
        path = _over_sights(space, path)
    return path


def _over_sights(space: ConfigurationSpace, path: FloatArray) -> FloatArray:
    n = len(path)
    i, j = np.triu_indices(n, 1)
    near = j - i <= _AHEAD
    i, j = i[near], j[near]
    free = np.asarray(space.motions_free(path[i], path[j])) | (j == i + 1)
    i, j = i[free], j[free]
    lengths = space.distance(path[i], path[j])
    left, following = np.full(n, np.inf), np.zeros(n, np.int64)
    left[-1] = 0.0
    begins = np.searchsorted(i, np.arange(n + 1))
    for k in range(n - 2, -1, -1):
        part = slice(begins[k], begins[k + 1])
        through = lengths[part] + left[j[part]]
        best = int(np.argmin(through))
        left[k], following[k] = through[best], j[part][best]
    kept = [0]
    while kept[-1] < n - 1:
        kept.append(int(following[kept[-1]]))
    return path[kept]


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
