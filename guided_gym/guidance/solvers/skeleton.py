"""The medial axis of the free workspace, from the Voronoi diagram of its boundary, and the way along it."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import affordable, number
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.guidance.solvers.base import require_dimensions, require_rigid
from guided_gym.guidance.solvers.graph import AnchoredStates, Anchors, Graph, GraphCostToGo
from guided_gym.kernels.anchors import (
    edge_anchors,
    enter_joined,
    joined_values,
    nearest_segments,
    segments_near,
)
from guided_gym.kernels.collision import Geometry, motions_free
from guided_gym.kernels.delaunay import CORNERS, box_of, circle_centres, insert, triangulate
from guided_gym.kernels.skeleton import branches, cut_branches, facing_feet, ridges, without_dead_ends
from guided_gym.storage.preparations import Arrays, fits, prepared, within
from guided_gym.structures.nearest import kernel_array
from guided_gym.structures.shortest_paths import graph_from_edges

if TYPE_CHECKING:
    import networkx as nx

_SAMPLES_PER_DIAGONAL = 100  # boundary samples along a line as long as the workspace's diagonal
_AT_LEAST = 8  # boundary samples along a line as long as the diagonal of a part of the free space
_ALONG = 0.02  # of its length by which the clearance of an edge falls that runs along the boundary
_TRIES = 4  # times that a skeleton is drawn, by more and more samples where it is not what it must be
_FINER = 4  # times as many samples on the walls where it is broken
_FEW = 1000  # walls of a part whose other walls have twice as many samples, too
_MANY = 1_000_000  # vertices of a diagram so large that a finer one would take tens of seconds
_ENDS = 16  # vertices of a loose piece, about, that may be tied
_TIES = 64  # pairs of vertices, the nearest first, by which a loose piece may be tied to the rest
_SIGHT = 0.5  # clearance halfway to a foot, of half the way there: where less, something stands between
_TOUCHING = 1e-9  # extents by which corners are one
_SAME = 1e-6  # spacings by which two samples are one
_EDGE = 700  # bytes of an edge and its vertex, in graph, index and tree of shortest paths
_PRUNE = 1.5  # a dead end nearer to the boundary than this many sample spacings is an artefact of sampling

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]


class _Axis(NamedTuple):
    """A skeleton as arrays."""

    points: Floats  # [v, 2]
    clearance: Floats  # [v]
    pairs: Ints  # [m, 2] edges u < v, in lexicographic order

    def components(self) -> Ints:
        """Number of the component that each vertex belongs to."""
        return _linked(self.pairs, len(self.points))

    def only(self, kept: NDArray[np.bool_]) -> _Axis:
        """Some of the vertices, with the edges between them."""
        ids = np.cumsum(kept) - 1
        return _Axis(self.points[kept], self.clearance[kept], ids[self.pairs[kept[self.pairs].all(axis=1)]])


class _Walls(NamedTuple):
    """Straight walls, ring by ring."""

    tails: Floats  # [w, 2] where each begins
    along: Floats  # [w, 2] from there to its end
    ring: Ints  # [w]
    part: Ints  # [w] of the free space
    lengths: Floats  # [w]
    spacing: Floats  # [w] that samples of its part keep
    pieces: Ints  # [w] that samples cut it into

    @property
    def finer(self) -> Floats:
        """By what factor the samples of each are denser than the spacing of its part asks for."""
        return np.asarray(self.pieces / np.ceil(self.lengths / self.spacing))


class _Diagram(NamedTuple):
    """Delaunay triangles of samples of the walls; the middles of their circles are Voronoi vertices."""

    box: Floats  # [4] that the samples lie in
    sites: Floats  # [n, 2]
    wall_of: Int32s  # [n]
    corners: Int32s  # [t, 3]
    beyond: Int32s  # [t, 3]
    points: Floats  # [t, 2] middle of each circle, or NaN
    room: Floats  # [t] clearance there


def skeleton_graph(environment: Environment) -> nx.Graph:
    """The medial axis as a networkx graph: ``pos`` (x, y) and ``clearance`` per vertex, ``length`` per edge.

    Raises:
        InvalidInputError: The free workspace is too small for a skeleton.
    """
    import networkx as nx  # here: it takes .1 s to load, and no search needs it

    axis = _axis(environment)
    graph = nx.Graph()
    for v, (pos, clearance) in enumerate(zip(axis.points.tolist(), axis.clearance.tolist(), strict=True)):
        graph.add_node(v, pos=tuple(pos), clearance=clearance)
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
            and fits(kept["pairs"], np.int64, -1, 2)
            and within(kept["pairs"], n)
        )

    kept = prepared("skeleton 4", environment.fingerprint, lambda: _found(environment)._asdict(), sound)
    return _Axis(*(kept[name] for name in _Axis._fields))


def _found(environment: Environment) -> _Axis:
    """The medial axis of the free workspace.

    Vertices of the Voronoi diagram of samples of the boundary, joined where the Voronoi edge lies in the
    free space; dead ends that run into the boundary (into corners, and between samples) are pruned. Parts of
    the free space that have no skeleton in one piece with a loop around each hole (those that touch are one)
    get more samples, unless the diagram has more than a million vertices. Where that fails, loose pieces are
    tied to what they see, and the drawing that is wrong least then is taken.

    Raises:
        InvalidInputError: The free workspace is too small for a skeleton.
    """
    parts = shapely.get_parts(environment.free_space)
    parts = parts[shapely.area(parts) > 0]
    if len(parts) == 0:
        raise InvalidInputError("the free workspace is too small for a medial axis: there is none")
    walls = _walls(parts, environment.extent / _SAMPLES_PER_DIAGONAL)
    loops = _loops(walls, environment.extent)
    drawings: list[tuple[_Axis, NDArray[np.bool_]]] = []
    diagram, denser = None, np.ones(len(walls.part), np.bool_)
    for _ in range(_TRIES):
        diagram = _diagram(environment, walls, denser, diagram)
        axis, beside, broken = _drawn(environment, walls, diagram)
        wrong, loose = _wrong(axis, parts, loops)
        if not wrong.any():
            return axis
        drawings.append((axis, loose))
        if len(diagram.points) > _MANY:
            break
        broken[beside[loose]] = True
        some = wrong[walls.part] > 0
        few = np.bincount(walls.part)[walls.part] < _FEW
        times = np.where(some, np.where(broken, _FINER, np.where(few, 2, 1)), 1)
        walls.pieces[:] *= times
        denser = times > 1
    tied = [_tied(*drawing, environment) for drawing in drawings if len(drawing[0].pairs)]
    if not tied:
        raise InvalidInputError("the free workspace is too small for a medial axis: no skeleton edge is left")
    return min(tied, key=lambda axis: int(_wrong(axis, parts, loops)[0].sum()))


def _tied(axis: _Axis, loose: NDArray[np.bool_], environment: Environment) -> _Axis:
    """A skeleton whose loose pieces are tied to the nearest of the rest that they see, which makes no loop.

    They are crumbs of a few vertices between needles, or at their tips, that no finer drawing does away with:
    there the walls' samples are too unlike.
    """
    of, ties = axis.components(), []
    for vertex in np.flatnonzero(loose)[np.unique(of[loose], return_index=True)[1]]:
        mine = of == of[vertex]
        own, others = np.flatnonzero(mine), np.flatnonzero(~mine)
        own = own[:: 1 + len(own) // _ENDS]
        away = np.hypot(*(axis.points[own][:, None] - axis.points[others]).transpose(2, 0, 1)).ravel()
        near = np.argpartition(away, min(_TIES, away.size - 1))[:_TIES]
        row, column = np.divmod(near[np.argsort(away[near], kind="stable")], len(others))
        pairs = np.stack([own[row], others[column]], axis=1)
        ends = axis.points[pairs]
        free = motions_free(ends[:, 0].copy(), ends[:, 1].copy(), environment.point_geometry)
        if free.any():
            ties.append(pairs[free.argmax()])
            of[mine] = of[ties[-1][1]]
    new = np.sort(np.reshape(ties, (-1, 2)), axis=1).astype(np.int64)
    return axis._replace(pairs=np.unique(np.concatenate([axis.pairs, new]), axis=0))


def _linked(links: Ints, n: int) -> Ints:
    """Number of the component that each of n vertices belongs to; links are (m, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    matrix = coo_array((np.ones(len(links), np.bool_), tuple(links.T)), shape=(n, n))
    return np.asarray(connected_components(matrix, directed=False)[1], np.int64)


def _loops(walls: _Walls, extent: float) -> tuple[Ints, Ints]:
    """The fewest and the most loops that the skeleton of each part of the free space may have.

    Each ring of walls but the outer one takes a loop. Rings with a corner in common are one, since no way
    leads between them; those whose corners are the same but for rounding may be one or not.
    """
    rings, parts, found = int(walls.ring.max()) + 1, int(walls.part.max()) + 1, []
    for corners in (np.rint(walls.tails / (_TOUCHING * extent)), walls.tails):
        _, corner = np.unique(np.ascontiguousarray(corners).view(np.complex128)[:, 0], return_inverse=True)
        links = np.stack([walls.ring, rings + corner], axis=1)
        whole = _linked(links, rings + int(corner.max()) + 1)[walls.ring]
        one = np.unique(whole * parts + walls.part)  # parts may touch, too
        found.append(np.bincount(one % parts, minlength=parts) - 1)
    return found[0], found[1]


def _wrong(
    axis: _Axis, parts: NDArray[np.object_], loops: tuple[Ints, Ints]
) -> tuple[Ints, NDArray[np.bool_]]:
    """By how many components and loops each part of the free space has others than it must.

    Returns:
        That; and which vertices are not in the largest component of their part.
    """
    of = axis.components()
    sizes, first = np.bincount(of), np.unique(of, return_index=True)[1]
    found = np.bincount(of[axis.pairs[:, 0]], minlength=len(first)) - sizes + 1
    shapely.prepare(parts)
    one, near = shapely.STRtree(parts).query(shapely.points(axis.points[first]))
    inside = shapely.contains_xy(parts[near], *axis.points[first][one].T)
    one, part = one[inside], near[inside]
    largest = np.zeros(len(parts), np.int64)
    np.maximum.at(largest, part, sizes[one])
    loose = np.zeros(len(first), np.bool_)
    loose[one] = sizes[one] < largest[part]
    components = np.bincount(part, minlength=len(parts))
    around = np.bincount(part, found[one], len(parts)).astype(np.int64)
    beyond = np.maximum(loops[0] - around, 0) + np.maximum(around - loops[1], 0)
    return np.abs(components - 1) + beyond, loose[of]


def _walls(parts: NDArray[np.object_], spacing: float) -> _Walls:
    """The straight walls of parts of the free space."""
    low_x, low_y, high_x, high_y = shapely.bounds(parts).T
    spacings = np.minimum(spacing, np.hypot(high_x - low_x, high_y - low_y) / _AT_LEAST)
    rings, owner = shapely.get_rings(parts, return_index=True)
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    along = np.diff(corners, axis=0)
    wall = np.flatnonzero((ring[1:] == ring[:-1]) & (along != 0).any(axis=1))
    ring, along = ring[wall], along[wall]
    lengths, spacings = np.hypot(*along.T), spacings[owner[ring]]
    pieces = np.ceil(lengths / spacings).astype(np.int64)
    return _Walls(corners[wall], along, ring, owner[ring], lengths, spacings, pieces)


def _diagram(
    environment: Environment, walls: _Walls, denser: NDArray[np.bool_], coarse: _Diagram | None
) -> _Diagram:
    """The diagram of samples of the walls: all of them, or what was drawn, with more on some walls."""
    sites, wall_of = _boundary_samples(environment, walls, denser)
    if coarse is None:
        box, old = box_of(sites), 0
        corners, beyond = triangulate(sites)
        fresh = np.arange(len(corners))
    else:
        box, old = coarse.box, len(coarse.corners)
        sites = np.concatenate([coarse.sites, sites])
        wall_of = np.concatenate([coarse.wall_of, wall_of])
        corners, beyond = insert(sites, len(coarse.sites), box, coarse.corners, coarse.beyond)
        same = (corners[:old] == coarse.corners).all(axis=1)
        fresh = np.append(np.flatnonzero(~same), np.arange(old, len(corners)))
    points, room = np.empty((len(corners), 2)), np.zeros(len(corners))
    if coarse is not None:
        points[:old], room[:old] = coarse.points, coarse.room
    points[fresh] = circle_centres(sites, corners[fresh])
    room[fresh] = 0.0
    real = fresh[np.isfinite(points[fresh]).all(axis=1)]
    room[real] = environment.clearance(points[real])
    return _Diagram(box, sites, wall_of, corners, beyond, points, room)


def _drawn(
    environment: Environment, walls: _Walls, diagram: _Diagram
) -> tuple[_Axis, Int32s, NDArray[np.bool_]]:
    """The skeleton by some samples of the walls.

    Returns:
        It; three walls that are nearest to each vertex; and the walls between which an edge between rings is
        missing, for want of samples.
    """
    _, _, wall_of, corners, beyond, points, room = diagram
    pairs, leaves = ridges(beyond, points, room)  # those that leave no free disc are free
    doubtful = np.flatnonzero(leaves)
    ends = points[pairs[doubtful]]
    cut = doubtful[~motions_free(ends[:, 0].copy(), ends[:, 1].copy(), environment.point_geometry)]
    broken = np.zeros(len(walls.part), np.bool_)
    across = wall_of[_across(corners, beyond, pairs[cut], room) - CORNERS]
    broken[across[np.diff(walls.ring[across])[:, 0] != 0]] = True
    axis, of = _merged(points, room, np.delete(pairs, cut, axis=0), environment)
    beside = wall_of[corners[of] - CORNERS]
    falls = _ALONG * np.hypot(*(axis.points[axis.pairs[:, 1]] - axis.points[axis.pairs[:, 0]]).T)
    reach = _PRUNE * (walls.spacing / walls.finer)[beside[:, 0]]
    kept, alive = without_dead_ends(axis.clearance, axis.pairs, falls, reach)
    return axis._replace(pairs=axis.pairs[kept]).only(alive), beside[alive], broken


def _across(corners: Int32s, beyond: Int32s, cut: Int32s, room: Floats) -> Int32s:
    """The two sites of each edge that was cut, or leaves the free space."""
    t, k = np.nonzero((room[:, None] > 0) & (beyond >= 0) & (room[beyond] == 0))
    leaving = np.stack([corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]], axis=1)
    of = corners[cut[:, 0]]
    shared = of[(of[:, :, None] == corners[cut[:, 1]][:, None]).any(axis=2)].reshape(-1, 2)
    sites = np.concatenate([leaving, shared])
    return sites[(sites >= CORNERS).all(axis=1)]


def _boundary_samples(
    environment: Environment, walls: _Walls, denser: NDArray[np.bool_]
) -> tuple[Floats, Int32s]:
    """Points on the boundary, and across narrow gaps, what they face; with the wall of each.

    Where two walls are closer than the samples, the Voronoi diagram has its way between them only if samples
    face each other: the edge between a point and its foot on the other wall is the middle line.

    Args:
        environment: The walls'.
        walls: All of them.
        denser: (w,) those that got more samples since the rest was sampled.

    Returns:
        (n, 2) points that the denser walls bring, and (n,) the wall of each.
    """
    of = np.repeat(np.arange(len(walls.pieces), dtype=np.int32), walls.pieces)
    pieces, widest = walls.pieces[of], walls.spacing[of]
    k = np.arange(len(of)) - np.repeat(np.cumsum(walls.pieces) - walls.pieces, walls.pieces)
    samples = walls.tails[of] + (k / pieces)[:, None] * walls.along[of]
    # Samples of a wall shorter than the spacing are only as far apart as the wall is long.
    finer = walls.finer[of]
    reach = np.minimum(walls.lengths[of], widest) / finer
    steps = np.where(reach > 0.5 * widest / finer, widest / finer, reach)
    begins = np.flatnonzero(np.diff(walls.ring[of], prepend=-1))
    before = np.roll(steps, 1)
    before[begins] = steps[np.append(begins[1:], len(of)) - 1]
    ahead, apart, same = walls.along[of] / pieces[:, None], np.maximum(steps, before), _SAME * widest
    new = np.flatnonzero(denser[of])
    rest = np.flatnonzero(~denser[of])
    faced = facing_feet(samples, ahead, apart, reach, same, np.arange(len(of)), new)
    if len(rest):
        others = facing_feet(samples, ahead, apart, reach, same, new, rest)
        faced = np.concatenate([faced, others])
    feet, source, foot = faced[:, 2:], faced[:, 0].astype(np.int64), faced[:, 1].astype(np.int64)
    gaps = np.hypot(*(feet - samples[source]).T)
    free = environment.clearance((samples[source] + feet) / 2) > _SIGHT * gaps / 2
    return np.concatenate([samples[new], feet[free]]), np.concatenate([of[new], of[foot[free]]])


def _merged(points: Floats, room: Floats, pairs: Int32s, environment: Environment) -> tuple[_Axis, Ints]:
    """The skeleton, with vertices that rounding keeps apart taken as one; and one of them for each."""
    digits = 9 - int(np.ceil(np.log10(max(environment.extent, 1e-300))))
    at_end = np.zeros(len(points), np.bool_)
    at_end[pairs] = True
    used = np.flatnonzero(at_end)
    rounded = np.round(points[used], digits)
    order = np.lexsort((rounded[:, 1], rounded[:, 0]))
    first = np.append(True, (rounded[order[1:]] != rounded[order[:-1]]).any(axis=1))[: len(order)]
    ids = np.empty(len(points), np.int64)
    ids[used[order]] = np.cumsum(first) - 1
    merged = rounded[order[first]]
    ends = np.sort(ids[pairs], axis=1)
    keys = np.sort(ends[:, 0] * len(merged) + ends[:, 1])
    keys = keys[np.diff(keys, prepend=-1) > 0]
    pairs = np.stack(np.divmod(keys, max(len(merged), 1)), axis=1)
    one = used[order[first]]
    return _Axis(merged, room[one], pairs[pairs[:, 0] != pairs[:, 1]]), one


def _whole(size: float) -> int:
    return int(size) if math.isfinite(size) else 2**1023


@lru_cache(maxsize=64)
def medial_axis(environment: Environment, spacing: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The skeleton as arrays, its branches cut into edges of about ``spacing``.

    Returns:
        (v, 2) vertices and (m, 2) int32 edges.
    """
    axis = _axis(environment)
    row, begins = branches(len(axis.points), axis.pairs)
    steps = np.hypot(*np.diff(axis.points[row], axis=0, append=np.nan).T)
    steps[begins[1:] - 1] = 0.0
    lengths = np.add.reduceat(steps, begins[:-1])
    affordable("spacing", spacing, _whole(_EDGE * lengths.sum() / spacing), "a skeleton cut into such edges")
    parts = np.maximum(1, np.rint(lengths / spacing).astype(np.int64))
    points, edges = cut_branches(axis.points, row, begins, parts)
    return points, edges[edges[:, 0] != edges[:, 1]].astype(np.int32)


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
        return Anchors(*edge_anchors(states, *self._edges_with_ends, self._geometry))

    @property
    def _edges_with_ends(self) -> tuple[Floats, Floats, Int32s, Floats]:
        graph = self.graph
        return self._tails, self._heads, graph.edges, graph.lengths

    @property
    def _geometry(self) -> Geometry:
        return self.query.space.environment.point_geometry

    def __call__(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) positions to (n,) cost-to-go."""
        if not self._open:
            return np.full(len(states), np.inf)
        graph = self.graph
        h: NDArray[np.float64] = joined_values(
            np.ascontiguousarray(states), self._edges_with_ends, graph.multipliers, graph.ways,
            self._geometry,
        )  # fmt: skip
        return h

    def _enter(self, nodes: AnchoredStates, states: NDArray[np.float64]) -> None:
        """Join the next nodes of a tree, and compute their cost-to-go."""
        if not self._open:
            super()._enter(nodes, states)
            return
        first, graph = len(nodes), self.graph
        nodes.make_room(states, 2)
        found = enter_joined(
            states, (first, nodes.links), nodes.held, nodes.lists, self._h, self._edges_with_ends,
            graph.multipliers, graph.ways, self._geometry,
        )  # fmt: skip
        nodes.joined(*found)

    def _charge(self, states: NDArray[np.float64], anchors: Anchors) -> None:
        """Nothing: anchors run along edges, and grow with them."""

    def raise_near(self, state: NDArray[np.float64], reach: float, factor: float) -> None:
        """Lengthen, or remove, the edges that pass within ``reach`` of a state, and its own."""
        self.graph.raise_edges(self.edges_near(kernel_array(state, np.float64), reach), factor)

    def edges_near(self, state: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
        """The edge that a state is joined to, and those that pass within ``reach`` of it."""
        ends = self._tails, self._heads
        near: NDArray[np.int64] = segments_near(self.segments.state, ends, state, reach)
        return near

    def vertices_near(self, state: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
        """Vertices within ``reach`` of a state."""
        return np.flatnonzero(np.hypot(*(self.graph.points - state).T) <= reach)
