"""Narrow passages: certified ways through gaps that the oracle's grid may be too coarse to see.

A gap hardly wider than the robot lets it through only at few positions and angles, and a grid has a vertex
there by luck. So wherever two obstacle pieces come that near to each other, poses are drawn that stand in the
gap, the robot's narrow side across it, and joined by certified motions: a little roadmap in each gap, which
does not depend on the grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.geometry.robots import rigid
from guided_gym.geometry.space import ConfigurationSpace

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_POSES: Final = 40  # drawn in each gap, for each of the two ways round
_MOST: Final = 400  # places; the narrowest ones are taken
_TURN: Final = 0.35  # radians to either side of the gap's own direction
_SEED: Final = 0


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Poses in narrow gaps, and the certified motions between them.

    Attributes:
        nodes: (n, d) free poses.
        first: (m,) one end of each motion.
        second: (m,) its other end.
        lengths: (m,) its length.
    """

    nodes: FloatArray
    first: IndexArray
    second: IndexArray
    lengths: FloatArray

    def spread(self, values: FloatArray) -> FloatArray:
        """(n,) the least, for each node, of its own value and those of others plus the way to them.

        Args:
            values: (n,) at least 0; infinite where nothing is known.
        """
        from scipy.sparse import coo_array  # here: it takes .1 s to load, and few problems have such passages
        from scipy.sparse.csgraph import dijkstra

        n = len(self.nodes)
        known = np.flatnonzero(np.isfinite(values))
        if not known.size:
            return values.copy()
        # A source beside the nodes, joined to each by its value; lengths of 0 would count as no edge.
        rows = np.concatenate([np.full(known.size, n), self.first, self.second])
        columns = np.concatenate([known, self.second, self.first])
        weights = np.concatenate([values[known], self.lengths, self.lengths])
        places = rows.astype(np.int32), columns.astype(np.int32)  # before scipy 1.15 nothing else is taken
        graph = coo_array((np.maximum(weights, 1e-300), places), shape=(n + 1, n + 1)).tocsr()
        return np.asarray(dijkstra(graph, indices=n)[:n], np.float64)


def passages(space: ConfigurationSpace, inradius: float, spacing: float) -> Roadmap:
    """The roadmap through the gaps that a grid of this spacing may miss.

    Args:
        space: The configuration space.
        inradius: Radius of a disc that the robot covers: no narrower gap can be passed.
        spacing: Of the grid (length).
    """
    rng = np.random.default_rng(_SEED)
    gaps = _gaps(space, *_widths(inradius, spacing))
    if not len(gaps.widths):
        empty = np.empty(0, np.int64)
        return Roadmap(np.empty((0, space.dimension)), empty, empty, np.empty(0))
    poses = _poses(space, rng, gaps, np.maximum(gaps.widths - 2.0 * inradius, 0.0), spacing)
    count = poses.shape[1]
    flat = np.ascontiguousarray(space.wrap(poses.reshape(-1, space.dimension)))
    free = np.asarray(space.valid(flat))
    i, j = np.triu_indices(count, 1)
    half = count // 2 if space.dimension == 3 else count
    same = (i < half) == (j < half)  # turned the same way round
    base = np.arange(len(gaps.widths))[:, None] * count
    a, b = (base + i[same]).ravel(), (base + j[same]).ravel()
    along = _along(gaps.pairs, count)
    a, b = np.append(a, along[0]), np.append(b, along[1])
    both = free[a] & free[b]
    a, b = a[both], b[both]
    joined = np.asarray(space.motions_free(flat[a], flat[b]))
    a, b = a[joined], b[joined]
    number = np.cumsum(free) - 1
    return Roadmap(flat[free], number[a], number[b], space.distance(flat[a], flat[b]))


def _widths(inradius: float, spacing: float) -> tuple[float, float, float]:
    """What `_gaps` takes."""
    return 2.0 * inradius, 2.0 * inradius + 2.5 * spacing, 0.25 * spacing


def _along(pairs: IndexArray, count: int) -> tuple[IndexArray, IndexArray]:
    """Poses of two narrow places between the same two pieces, to be joined: the ends of a corridor."""
    few = np.arange(0, count, 2 * _POSES // 8)  # some of those that stand straight
    order = np.argsort(pairs, kind="stable")
    first, second = [], []
    for apart in (1, 2, 3):
        same = pairs[order[apart:]] == pairs[order[:-apart]]
        first.append(order[:-apart][same])
        second.append(order[apart:][same])
    a, b = np.concatenate(first), np.concatenate(second)
    i, j = np.meshgrid(few, few, indexing="ij")
    return (
        (a[:, None] * count + i.ravel()).ravel().astype(np.int64),
        (b[:, None] * count + j.ravel()).ravel().astype(np.int64),
    )


@dataclass(frozen=True, eq=False)
class _Gaps:
    """Narrow places: middles (n, 2), unit vectors across (n, 2), widths (n,), which two pieces (n,)."""

    middles: FloatArray
    across: FloatArray
    widths: FloatArray
    pairs: IndexArray


def _gaps(space: ConfigurationSpace, least: float, most: float, same: float) -> _Gaps:
    """Where two obstacle pieces, or one and a bound, are as near to each other as that.

    Beside the shortest way from one to the other that is, for each corner, the way from there: two walls side
    by side are nearest to each other along a whole corridor, which begins and ends at such a corner.

    Args:
        space: The configuration space.
        least: Smallest width (length).
        most: Largest width.
        same: Places of two pieces that are so near to each other count as one.
    """
    pieces = [shapely.Polygon(piece) for piece in space.environment.pieces]
    pieces += _sides(space.environment.bounds)
    tree, shapes = shapely.STRtree(pieces), np.array(pieces, dtype=object)
    left, right = tree.query(shapes, predicate="dwithin", distance=most)
    once = left < right
    left, right = left[once], right[once]
    numbers = np.arange(left.size)
    lines, pairs = [shapely.shortest_line(shapes[left], shapes[right])], [numbers]
    for one, other in ((left, right), (right, left)):
        points, at = shapely.get_coordinates(shapes[one], return_index=True)
        lines.append(shapely.shortest_line(shapely.points(points), shapes[other][at]))
        pairs.append(numbers[at])
    ends = shapely.get_coordinates(np.concatenate(lines)).reshape(-1, 2, 2)
    pair, change = np.concatenate(pairs), ends[:, 1] - ends[:, 0]
    widths, middles = np.hypot(change[:, 0], change[:, 1]), ends.mean(axis=1)
    kept = np.flatnonzero((widths > max(least, space.tolerance)) & (widths <= most))
    # A third piece may lie between the two; its own gaps to them are others.
    kept = np.delete(kept, np.unique(tree.query(shapely.points(middles[kept]), predicate="within")[0]))
    cells = np.column_stack([pair[kept], np.round(middles[kept] / same)])
    kept = kept[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
    kept = kept[np.argsort(widths[kept], kind="stable")][:_MOST]
    return _Gaps(middles[kept], change[kept] / widths[kept, None], widths[kept], pair[kept])


def _sides(bounds: tuple[float, float, float, float]) -> list[shapely.Polygon]:
    x0, y0, x1, y1 = bounds
    t = max(x1 - x0, y1 - y0)
    return [
        shapely.box(x0 - t, y0 - t, x0, y1 + t),
        shapely.box(x1, y0 - t, x1 + t, y1 + t),
        shapely.box(x0 - t, y0 - t, x1 + t, y0),
        shapely.box(x0 - t, y1, x1 + t, y1 + t),
    ]


def _poses(
    space: ConfigurationSpace,
    rng: np.random.Generator,
    gaps: _Gaps,
    spare: FloatArray,
    spacing: float,
) -> FloatArray:
    """(gaps, poses, d) poses in each gap: some straight through its middle, others around those."""
    middles, across = gaps.middles, gaps.across
    n, turns = len(middles), space.dimension == 3
    ways = 2 if turns else 1
    reach = (space.robot.radius if turns else 0.0) + 1.5 * spacing
    along = np.tile(np.linspace(-1.0, 1.0, _POSES), ways) * reach
    straight = np.arange(ways * _POSES) % 2 == 0
    jitter = rng.uniform(-0.5, 0.5, (n, ways * _POSES, 2))
    jitter[:, straight] = 0.0
    direction = np.stack([-across[:, 1], across[:, 0]], axis=-1)
    poses = np.empty((n, ways * _POSES, space.dimension))
    aside = jitter[..., 0] * (spare[:, None] + 0.5 * np.abs(along))
    poses[..., :2] = (
        middles[:, None] + along[:, None] * direction[:, None] + aside[..., None] * across[:, None]
    )
    if turns:
        long, offset = _slab(rigid(space.robot, "oracle").outline)
        angle = np.arctan2(direction[:, 1], direction[:, 0]) - long
        angles = angle[:, None] + np.repeat([0.0, math.pi], _POSES) + 2.0 * _TURN * jitter[..., 1]
        poses[..., 2] = angles
        c, s = np.cos(angles), np.sin(angles)
        poses[..., 0] -= c * offset[0] - s * offset[1]
        poses[..., 1] -= s * offset[0] + c * offset[1]
    return poses


def _slab(outline: shapely.Geometry) -> tuple[float, FloatArray]:
    """Direction (radians, body frame) of the robot's narrowest slab, and offset (2,) of the slab's middle."""
    corners = shapely.get_coordinates(outline.convex_hull)
    sides = np.diff(corners, axis=0)
    sides = sides[np.hypot(sides[:, 0], sides[:, 1]) > 0.0]
    normals = np.stack([-sides[:, 1], sides[:, 0]], axis=-1) / np.hypot(sides[:, 0], sides[:, 1])[:, None]
    heights = corners @ normals.T
    best = int(np.argmin(np.ptp(heights, axis=0)))
    middle = 0.5 * (heights[:, best].max() + heights[:, best].min())
    return math.atan2(sides[best, 1], sides[best, 0]), middle * normals[best]
