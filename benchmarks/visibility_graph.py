"""Exact shortest ways of a point among polygons: Dijkstra over the corners that see each other.

A reference for `benchmarks/oracle.py` and for the oracle's tests.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.sparse.csgraph import dijkstra


def visibility_distances(obstacles, bounds, goal, points):
    """(n,) exact distance of each of points (n, 2) from the goal, around polygons that do not overlap."""
    inside = shapely.union_all(obstacles).buffer(-1e-9)
    corners = np.array([goal] + [c for o in obstacles for c in o.exterior.coords[:-1]])
    corners = corners[shapely.covers(shapely.box(*bounds), shapely.points(corners))]

    def seen(a, b):
        return ~shapely.intersects(shapely.linestrings(np.stack(np.broadcast_arrays(a, b), axis=-2)), inside)

    gaps = np.linalg.norm(corners[:, None] - corners, axis=-1)
    to_goal = dijkstra(np.where(seen(corners[:, None], corners), gaps, 0.0), indices=0)
    legs = np.linalg.norm(points[:, None] - corners, axis=-1)
    return np.where(seen(points[:, None], corners), legs + to_goal, np.inf).min(axis=1)
