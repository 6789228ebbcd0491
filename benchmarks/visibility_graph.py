"""Exact shortest ways of a point among polygons: Dijkstra over the corners that see each other.

A reference for `benchmarks/oracle.py`, `benchmarks/movingai.py` and the oracle's tests.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.sparse.csgraph import dijkstra


def visibility_distances(obstacles, bounds, goal, points, hair=0.0):
    """(n,) exact distance of each of points (n, 2) from the goal, around polygons that do not overlap.

    With a ``hair``, ways keep up to that distance from corners, and none leads between two cells of a grid
    that touch at a corner.
    """
    solid = shapely.union_all(obstacles)
    inside = solid if hair else solid.buffer(-1e-9)
    corners = np.unique(shapely.get_coordinates(obstacles), axis=0)
    if hair:
        corners = np.concatenate([corners + hair * np.array([i, j]) for i in (-1, 1) for j in (-1, 1)])
        corners = corners[~shapely.intersects_xy(solid, corners)]
    corners = np.concatenate((np.array([goal]), corners))
    corners = corners[shapely.covers(shapely.box(*bounds), shapely.points(corners))]
    shapely.prepare(inside)

    def seen(a, b):
        return ~shapely.intersects(inside, shapely.linestrings(np.stack(np.broadcast_arrays(a, b), axis=-2)))

    gaps = np.linalg.norm(corners[:, None] - corners, axis=-1)
    to_goal = dijkstra(np.where(seen(corners[:, None], corners), gaps, 0.0), indices=0)
    legs = np.linalg.norm(points[:, None] - corners, axis=-1)
    return np.where(seen(points[:, None], corners), legs + to_goal, np.inf).min(axis=1)
