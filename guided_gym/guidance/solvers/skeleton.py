"""The medial axis of the free workspace, from the Voronoi diagram of its boundary, and the way along it."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import NamedTuple

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import affordable, number
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.guidance.solvers.base import require_dimensions, require_rigid
from guided_gym.guidance.solvers.graph import Anchors, Graph, GraphCostToGo
from guided_gym.kernels.anchors import edge_anchors, nearest_segments
from guided_gym.storage.preparations import Arrays, fits, prepared, within
from guided_gym.structures.shortest_paths import graph_from_edges

_SAMPLES_PER_DIAGONAL = 100  # boundary samples along a line as long as the workspace's diagonal
_ALONG = 0.02  # of its length by which the clearance of an edge falls that runs along the boundary
_FINER = 4  # samples twice as dense each time, where the skeleton is not what it must be
_MANY = 200_000  # vertices of a diagram so large that a finer one would take tens of seconds
_SAME = 1e-6  # spacings by which two samples are one
_EDGE = 700  # bytes of an edge and its vertex, in graph, index and tree of shortest paths
_PRUNE = 1.5  # a dead end nearer to the boundary than this many sample spacings is an artefact of sampling


class _Axis(NamedTuple):
    """A skeleton as arrays; vertices without an edge have been pruned away."""

    points: NDArray[np.float64]  # [v, 2]
    clearance: NDArray[np.float64]  # [v]
    pairs: NDArray[np.int64]  # [m, 2] edges u < v, in lexicographic order
    alive: NDArray[np.bool_]  # [v] which vertices have not been pruned

    def wrong(self, parts: int, holes: int) -> int:
        """By how many components and loops it differs from what it must have."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        n, m = len(self.points), len(self.pairs)
        links = coo_array((np.ones(m), tuple(self.pairs.T)), shape=(n, n))
        dead = n - int(np.count_nonzero(self.alive))
        components = (int(connected_components(links, directed=False)[0]) if n else 0) - dead
        return abs(components - parts) + abs(m - (n - dead) + components - holes)


def skeleton_graph(environment: Environment) -> nx.Graph:
    """The medial axis as a networkx graph: ``pos`` (x, y) and ``clearance`` per vertex, ``length`` per edge.

    Raises:
        InvalidInputError: The free workspace is too small for a skeleton.
    """
    axis = _axis(environment)
    graph = nx.Graph()
    for v in np.flatnonzero(axis.alive).tolist():
        graph.add_node(v, pos=tuple(axis.points[v].tolist()), clearance=float(axis.clearance[v]))
    lengths = np.hypot(*(axis.points[axis.pairs[:, 1]] - axis.points[axis.pairs[:, 0]]).T)
    for (a, b), length in zip(axis.pairs.tolist(), lengths.tolist(), strict=True):
        graph.add_edge(a, b, length=length)
    return graph


@lru_cache(maxsize=64)
def _axis(environment: Environment) -> _Axis:
    """The medial axis of the free workspace, from the disk where it is kept; see `_found`."""

    def sound(kept: Arrays) -> bool:
        n = len(kept["points"])
        return (
            fits(kept["points"], np.float64, n, 2)
            and fits(kept["clearance"], np.float64, n)
            and fits(kept["alive"], np.bool_, n)
            and fits(kept["pairs"], np.int64, -1, 2)
            and within(kept["pairs"], n)
        )

    kept = prepared("skeleton 1", environment.fingerprint, lambda: _found(environment)._asdict(), sound)
    return _Axis(*(kept[name] for name in _Axis._fields))


def _found(environment: Environment) -> _Axis:
    """The medial axis of the free workspace.

    Vertices of the Voronoi diagram of samples of the boundary, joined where the Voronoi edge lies in the
    free space; dead ends that run into the boundary (into corners, and between samples) are pruned. Where it
    does not have a part for each part of the free space and a loop around each hole, it is drawn finer,
    unless it has more than 200,000 vertices.

    Raises:
        InvalidInputError: The free workspace is too small for a skeleton.
    """
    free = environment.free_space
    parts = [part for part in shapely.get_parts(free) if part.area > 0]
    holes = sum(len(part.interiors) for part in parts)
    spacing = environment.extent / _SAMPLES_PER_DIAGONAL
    best, least = None, len(parts) + holes
    for _ in range(_FINER if parts else 0):
        axis = _drawn(environment, free, spacing)
        wrong = axis.wrong(len(parts), holes) if axis is not None else least
        if wrong < least:
            best, least = axis, wrong
        if wrong == 0 or (axis is not None and len(axis.points) > _MANY):
            break
        spacing /= 2
    if best is None or len(best.pairs) == 0:
        raise InvalidInputError("the free workspace is too small for a medial axis: no skeleton edge is left")
    return best


def _drawn(environment: Environment, free: shapely.Geometry, spacing: float) -> _Axis | None:
    """The skeleton by samples of the boundary that are so far apart."""
    from scipy.spatial import Voronoi  # dear to import; four times as fast as shapely's diagram

    sites = np.unique(_boundary_samples(free, spacing), axis=0)
    if len(sites) < 4:
        return None
    origin = sites.mean(axis=0)
    diagram = Voronoi(sites - origin)
    points, pairs = diagram.vertices + origin, np.array(diagram.ridge_vertices)
    shapely.prepare(free)
    within = shapely.contains_xy(free, points)
    pairs = pairs[(pairs[:, 0] >= 0) & (pairs[:, 1] >= 0)]
    pairs = pairs[within[pairs[:, 0]] & within[pairs[:, 1]]]
    room = np.zeros(len(points))
    room[within] = environment.clearance(points[within])
    lengths = np.hypot(*(points[pairs[:, 1]] - points[pairs[:, 0]]).T)
    # An edge shorter than the clearance of an end stays in the disc around it.
    doubtful = np.flatnonzero(lengths >= room[pairs].max(axis=1))
    lines = shapely.linestrings(points[pairs[doubtful]])
    pairs = np.delete(pairs, doubtful[~shapely.contains_properly(free, lines)], axis=0)
    return _pruned(*_merged(points, pairs, environment), _PRUNE * spacing)


def _boundary_samples(free: shapely.Geometry, spacing: float) -> NDArray[np.float64]:
    """Points on the boundary, at most ``spacing`` apart; and across narrow gaps, what they face.

    Where two walls are closer than the samples, the Voronoi diagram has its way between them only if samples
    face each other: the edge between a point and its foot on the other wall is the middle line.
    """
    rings = shapely.get_rings(shapely.get_parts(free))
    samples, owners = shapely.get_coordinates(shapely.segmentize(rings, spacing), return_index=True)
    corners, of = shapely.get_coordinates(rings, return_index=True)
    within = np.flatnonzero(of[1:] == of[:-1])
    tails, heads = corners[within], corners[within + 1]
    points, near = _neighbours(samples, owners, tails, heads, spacing)
    p, a, b = samples[points], tails[near], heads[near]
    along = b - a
    t = np.einsum("ij,ij->i", p - a, along) / np.einsum("ij,ij->i", along, along)
    feet = a + np.clip(t, 0, 1)[:, None] * along
    away = np.hypot(*(feet - p).T)
    # A foot at an angle is round a corner: it faces nobody.
    aslant = np.abs(np.einsum("ij,ij->i", feet - p, along)) / np.hypot(*along.T)
    facing = (away > _SAME * spacing) & (aslant <= 1e-6 * away)
    facing[facing] = shapely.contains_xy(free, *((p + feet)[facing] / 2).T)
    feet = feet[facing]
    known = shapely.STRtree(shapely.points(samples))
    seen, _ = known.query(shapely.points(feet), predicate="dwithin", distance=_SAME * spacing)
    return np.concatenate([samples, np.delete(feet, seen, axis=0)])


def _neighbours(
    samples: NDArray[np.float64],
    owners: NDArray[np.int64],
    tails: NDArray[np.float64],
    heads: NDArray[np.float64],
    spacing: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Samples and walls that may face each other across a gap narrower than the samples of either are apart.

    Along a wall shorter than ``spacing``, samples are only as far apart as the wall is long.
    """
    lengths = np.minimum(np.hypot(*(heads - tails).T), spacing)
    apart = np.zeros(len(samples))
    steps = np.where(owners[1:] == owners[:-1], np.hypot(*np.diff(samples, axis=0).T), 0.0)
    steps[steps > 0.5 * spacing] = spacing  # parts of a longer wall
    apart[:-1] = steps
    apart[1:] = np.maximum(apart[1:], steps)
    dots, lines = shapely.points(samples), shapely.linestrings(np.stack([tails, heads], axis=1))
    found = shapely.STRtree(lines).query(dots, predicate="dwithin", distance=2 * apart)
    wide = np.flatnonzero(lengths > 0.0)
    back = shapely.STRtree(dots).query(lines[wide], predicate="dwithin", distance=2 * lengths[wide])
    pairs = np.concatenate([found.T, np.stack([back[1], wide[back[0]]], axis=1)])
    keys = np.unique(pairs[:, 0] * len(lines) + pairs[:, 1])
    return keys // len(lines), keys % len(lines)


def _merged(
    points: NDArray[np.float64], pairs: NDArray[np.int64], environment: Environment
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points, clearances and edges, with vertices that rounding keeps apart taken as one."""
    digits = 9 - int(np.ceil(np.log10(max(environment.extent, 1e-300))))
    used, pairs = np.unique(pairs, return_inverse=True)
    rounded = np.round(points[used], digits)
    order = np.lexsort((rounded[:, 1], rounded[:, 0]))
    first = np.append(True, (rounded[order[1:]] != rounded[order[:-1]]).any(axis=1))[: len(order)]
    ids = np.empty(len(order), np.int64)
    ids[order] = np.cumsum(first) - 1
    merged = rounded[order[first]]
    ends = np.sort(ids[pairs.reshape(-1, 2)], axis=1)
    keys = np.unique(ends[:, 0] * len(merged) + ends[:, 1])
    pairs = np.stack(np.divmod(keys, max(len(merged), 1)), axis=1)
    clearance = environment.clearance(merged) if len(merged) else np.zeros(0)
    return merged, clearance, pairs[pairs[:, 0] != pairs[:, 1]]


def _pruned(
    points: NDArray[np.float64], clearance: NDArray[np.float64], pairs: NDArray[np.int64], reach: float
) -> _Axis:
    """Shorten dead ends until they end ``reach`` away from the boundary, or run along it, or are gone.

    An edge runs into the boundary, in a corner, if clearance falls along it: the wider, the faster.
    """
    falls = _ALONG * np.hypot(*(points[pairs[:, 1]] - points[pairs[:, 0]]).T)
    degree = np.bincount(pairs.ravel(), minlength=len(points))
    edges_of: list[list[int]] = [[] for _ in points]
    for e, (a, b) in enumerate(pairs.tolist()):
        edges_of[a].append(e)
        edges_of[b].append(e)
    kept, alive = np.ones(len(pairs), np.bool_), np.ones(len(points), np.bool_)
    leaves = np.flatnonzero(degree <= 1).tolist()
    while leaves:
        v = leaves.pop()
        if not alive[v] or degree[v] > 1 or clearance[v] >= reach:
            continue
        for e in edges_of[v]:
            if kept[e]:
                u = int(pairs[e].sum()) - v
                if clearance[u] - clearance[v] <= falls[e]:
                    break
                kept[e] = False
                degree[u] -= 1
                if degree[u] <= 1:
                    leaves.append(u)
        else:
            alive[v] = False
    return _Axis(points, clearance, pairs[kept], alive)


def _whole(size: float) -> int:
    return int(size) if math.isfinite(size) else 2**1023


@lru_cache(maxsize=64)
def medial_axis(environment: Environment, spacing: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The skeleton as arrays, its branches cut into edges of about ``spacing``.

    Returns:
        (v, 2) vertices and (m, 2) int32 edges.
    """
    axis = _axis(environment)
    chains = _chains(axis)
    sizes = [len(chain) for chain in chains]
    lines = shapely.linestrings(
        axis.points[np.concatenate(chains)], indices=np.repeat(np.arange(len(chains)), sizes)
    )
    whole = float(shapely.length(lines).sum())
    affordable("spacing", spacing, _whole(_EDGE * whole / spacing), "a skeleton cut into such edges")
    parts = np.maximum(1, np.rint(shapely.length(lines) / spacing).astype(np.int64))
    shares = np.concatenate([np.arange(1, k) / k for k in parts.tolist()])
    inner = shapely.get_coordinates(
        shapely.line_interpolate_point(np.repeat(lines, parts - 1), shares, normalized=True)
    )
    points: list[NDArray[np.float64]] = []
    ids: dict[int, int] = {}
    edges: list[tuple[int, int]] = []

    def vertex(v: int) -> int:
        if v not in ids:
            ids[v] = len(points)
            points.append(axis.points[v])
        return ids[v]

    last = 0
    for chain, count in zip(chains, (parts - 1).tolist(), strict=True):
        ends = vertex(chain[0]), vertex(chain[-1])
        row = [ends[0], *range(len(points), len(points) + count), ends[1]]
        points.extend(inner[last : last + count])
        edges.extend(itertools.pairwise(row))
        last += count
    kept = [(a, b) for a, b in edges if a != b]
    return np.array(points), np.array(kept, np.int32).reshape(-1, 2)


def _chains(axis: _Axis) -> list[list[int]]:
    """Paths between corners through vertices of degree 2, each once."""
    near: dict[int, list[int]] = {v: [] for v in np.flatnonzero(axis.alive).tolist()}
    for a, b in axis.pairs.tolist():
        near[a].append(b)
        near[b].append(a)
    corners = {v for v, others in near.items() if len(others) != 2}
    chains: list[list[int]] = []
    seen: set[tuple[int, int]] = set()

    def walk(corner: int) -> None:
        for first in sorted(near[corner]):
            if (corner, first) in seen:
                continue
            chain = [corner, first]
            while chain[-1] not in corners:
                a, b = near[chain[-1]]
                chain.append(b if a == chain[-2] else a)
            seen.update([(chain[0], chain[1]), (chain[-1], chain[-2])])
            passed.update(chain)
            chains.append(chain)

    passed: set[int] = set()
    for corner in sorted(corners):
        walk(corner)
    for v in near:
        if v not in passed and v not in corners:  # on a loop: cut it here, at its first vertex
            corners.add(v)
            walk(v)
    return chains


class Skeleton(GraphCostToGo):
    """Shortest paths along the medial axis of the free workspace, from the nearest edge of it.

    A state inside an obstacle has no way. What is joined is a position: for other robots than a point, the
    skeleton is that of the workspace, not of C'.

    Args:
        spacing: Length of a skeleton edge, in natural lengths of the space.

    Raises:
        InvalidInputError: A spacing that is not positive.
    """

    def __init__(self, *, spacing: float = 1.0) -> None:
        self.spacing = number("spacing", spacing, above=0)

    def build(self) -> Graph:
        """The skeleton, with the goal's projection as its last vertex.

        Raises:
            InvalidInputError: A space of other than 2 dimensions, or one too small for a skeleton.
        """
        require_dimensions("skeleton", self.query, 2)
        require_rigid("skeleton", self.query)
        space, goal = self.query.space, self.query.goal
        points, edges = medial_axis(space.environment, self.spacing * space.scale)
        split, fraction, _ = nearest_segments(goal[None], points[edges[:, 0]], points[edges[:, 1]])
        a, b = edges[split[0]]
        n = len(points)
        points = np.vstack([points, points[a] + fraction[0] * (points[b] - points[a])])
        edges = np.vstack([np.delete(edges, split[0], axis=0), [[a, n], [n, b]]]).astype(np.int32)
        self._tails, self._heads = (np.ascontiguousarray(points[edges[:, i]]) for i in (0, 1))
        lengths = np.hypot(*(self._heads - self._tails).T)
        return Graph(points, graph_from_edges(n + 1, edges, lengths), n)

    def anchor(self, states: NDArray[np.float64]) -> Anchors:
        """Join each state to both ends of its nearest skeleton edge."""
        graph, geometry = self.graph, self.query.space.environment.point_geometry
        return Anchors(*edge_anchors(states, self._tails, self._heads, graph.edges, graph.lengths, geometry))

    def _charge(self, states: NDArray[np.float64], anchors: Anchors) -> None:
        """Nothing: anchors run along edges, and grow with them."""

    def _teach(self, state: NDArray[np.float64], reach: float, factor: float) -> None:
        self.graph.raise_edges(self.edges_near(state, reach), factor)

    def edges_near(self, state: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
        """The edge that a state is joined to, and those that pass within ``reach`` of it."""
        nearest = nearest_segments(state[None], self._tails, self._heads)[0].astype(np.int64)
        if reach == 0:
            return nearest
        near = super().edges_near(state, reach)
        return near if nearest[0] in near else np.insert(near, np.searchsorted(near, nearest), nearest)

    def vertices_near(self, state: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
        """Vertices within ``reach`` of a state."""
        return np.flatnonzero(np.hypot(*(self.graph.points - state).T) <= reach)
