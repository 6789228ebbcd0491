"""Configurations anchored to a roadmap: their heuristic, and the anchors that failures take away.

An anchor joins a configuration to a roadmap vertex: h is the least (length of the anchor + distance of its
vertex). Where the anchor runs along a roadmap edge, its length grows with the edge's multiplier.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance
from guided_gym.kernels.metric import Metric, placed, segment_separation, separation, shortest
from guided_gym.kernels.nearest import State, insert_many, k_nearest, within
from guided_gym.kernels.plain import borrowing
from guided_gym.kernels.segments import segments_within
from guided_gym.kernels.shortest_paths import Adjacency, Scratch, Tree, lengthen

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Taught = tuple[Floats, Floats, Floats]
Anchored = tuple[Int32s, Floats, Int32s]
_WIDER = 1.5  # times the distance of its own vertices: how far beyond the candidates vertices are shared
_SLACK = 1.0 + 1e-9  # the index and the metric may round differently


@njit(cache=True)
def anchored_values_of(
    rows: Ints, vertices: Int32s, lengths: Floats, edges: Int32s, multipliers: Floats, distance: Floats
) -> Floats:
    """Heuristic of some configurations; infinite where no anchor leads to the goal.

    Args:
        rows: (r,) int64 which of the configurations.
        vertices: (n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (n, k) length of each anchor; infinite if it was dropped.
        edges: (n, k) int32 roadmap edge that the anchor runs along; -1 for none.
        multipliers: (m,) factor on the length of each roadmap edge.
        distance: (v,) length of the shortest path from each vertex to the goal.
    """
    out = np.empty(rows.size)
    for r in range(rows.size):
        i = rows[r]
        best = np.inf
        for j in range(vertices.shape[1]):
            v = vertices[i, j]
            if v >= 0:
                e = edges[i, j]
                length = lengths[i, j] if e < 0 else lengths[i, j] * multipliers[e]
                best = min(best, length + distance[v])
        out[r] = best
    return out


@borrowing
def _apart(a: Floats, i: int, b: Floats, j: int, weights: Floats, periods: Floats) -> float:
    """`separation` of row i of a and row j of b; a view of each row would cost more than the distance."""
    total = 0.0
    for c in range(a.shape[1]):
        delta = b[j, c] - a[i, c]
        if periods[c] > 0.0:
            delta -= periods[c] * np.floor(delta / periods[c] + 0.5)
        total += (weights[c] * delta) * (weights[c] * delta)
    return np.sqrt(total)


@borrowing
def _charged(
    length: float,
    q: Floats,
    v: Floats,
    near: Ints,
    count: int,
    taught: Taught,
    metric: Metric,
) -> float:
    """Length of the anchor from ``q`` to ``v`` with what was raised near it, at the first states."""
    states, reaches, factors = taught
    away = separation(q, v, metric)
    for s in range(count):
        f = near[s]
        if segment_separation(q, v, states[f], metric) <= reaches[f]:
            if factors[f] == np.inf:
                return np.inf
            length += (factors[f] - 1.0) * away
    return length


@borrowing
def _find_close(
    q: Floats, i: int, among: Ints, taught: Taught, longest: float, metric: Metric, near: Ints
) -> int:
    """Write, first in ``near``, which of some states an anchor from row i of ``q`` can pass within reach of.

    Returns:
        How many.
    """
    states, reaches, _ = taught
    weights, periods = metric
    count = 0
    for f in among:
        if _apart(q, i, states, f, weights, periods) <= reaches[f] + longest:
            near[count] = f
            count += 1
    return count


@njit(cache=True)
def _close(q: Floats, i: int, among: Ints, taught: Taught, longest: float, metric: Metric) -> Ints:
    """Which of some states an anchor of that length from row i of ``q`` can pass within their reach."""
    near = np.empty(among.size, np.int64)
    count = _find_close(q, i, among, taught, longest, metric, near)
    return near[:count]


@njit(cache=True)
def _around(
    q: Floats, i: int, index: State, taught: Taught, farthest: float, longest: float, metric: Metric
) -> Ints:
    """`_close` among all states, by an index over them; ``farthest`` is the largest of their reaches."""
    some = within(index, q[i], (farthest + longest) * _SLACK)
    return _close(q, i, some, taught, longest, metric)


@njit(cache=True)
def charge_anchors(
    q: Floats,
    rows: Ints,
    vertices: Int32s,
    lengths: Floats,
    points: Floats,
    taught: Taught,
    metric: Metric,
) -> None:
    """Add ``factor - 1`` times their distance to the anchors that pass near some states; infinite drops them.

    Args:
        q: (n, d) configurations.
        rows: (r,) int64 those to look at.
        vertices: (n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (n, k) length of each anchor, changed in place.
        points: (v, d) roadmap vertices.
        taught: (f, d) where ways were made costlier, (f,) how far around them, (f,) how many times costlier.
        metric: Weights and periods of the distance.
    """
    every = np.arange(taught[1].size)
    for i in rows:
        longest = -1.0
        for j in range(vertices.shape[1]):
            if vertices[i, j] >= 0 and lengths[i, j] < np.inf:
                longest = max(longest, separation(q[i], points[vertices[i, j]], metric))
        if longest < 0.0:
            continue
        near = _close(q, i, every, taught, longest, metric)
        for j in range(vertices.shape[1]):
            if vertices[i, j] >= 0 and lengths[i, j] < np.inf:
                v = points[vertices[i, j]]
                lengths[i, j] = _charged(lengths[i, j], q[i], v, near, near.size, taught, metric)


@njit(cache=True)
def charge_near(
    lesson: tuple[Floats, float, float],
    index: State,
    nodes: tuple[Floats, Int32s, Floats],
    sizes: tuple[int, int],
    longest: float,
    points: Floats,
    metric: Metric,
) -> Ints:
    """`charge_anchors` of the nodes around one state; returns their rows.

    Args:
        lesson: (d,) where ways were made costlier, how far around, and how many times costlier.
        index: Nearest-neighbour index over the first nodes, with room for the others.
        nodes: States, and vertices and lengths of anchors, of all nodes.
        sizes: How many nodes the index has, and how many there are.
        longest: At least the length of any anchor.
        points: (v, d) roadmap vertices.
        metric: Weights and periods of the distance.
    """
    state, reach, factor = lesson
    states, vertices, lengths = nodes
    insert_many(index, states[sizes[0] : sizes[1]])
    rows = within(index, state, reach + longest)
    taught = state.reshape(1, state.size), np.full(1, reach), np.full(1, factor)
    charge_anchors(states, rows, vertices, lengths, points, taught, metric)
    return rows


@njit(cache=True)
def nearest_anchors(q: Floats, index: State, points: Floats, k: int, metric: Metric) -> tuple[Int32s, Floats]:
    """(n, k) int32 the nearest vertices of each configuration, and (n, k) their distances.

    Args:
        q: (n, d) configurations.
        index: Nearest-neighbour index over the vertices but the last, which is the goal.
        points: (v, d) roadmap vertices.
        k: Anchors a configuration, at most v - 1; the goal takes the place of the farthest if it is nearer.
        metric: Weights and periods of the distance.
    """
    vertices, lengths = np.empty((q.shape[0], k), np.int32), np.empty((q.shape[0], k))
    goal = points.shape[0] - 1
    for i in range(q.shape[0]):
        ids, away = k_nearest(index, q[i], k)
        vertices[i], lengths[i] = ids.astype(np.int32), away
        far = separation(q[i], points[goal], metric)
        if far <= away[-1]:
            vertices[i, k - 1], lengths[i, k - 1] = goal, far
    return vertices, lengths


@njit(cache=True)
def charged_anchors(
    q: Floats,
    index: State,
    points: Floats,
    k: int,
    taught: Taught,
    lessons: State,
    farthest: float,
    metric: Metric,
) -> Anchored:
    """`nearest_anchors` that have paid for what was raised near them (`charge_anchors`), along no edges."""
    vertices, lengths = nearest_anchors(q, index, points, k, metric)
    for i in range(q.shape[0]):
        near = _around(q, i, lessons, taught, farthest, lengths[i].max(), metric)
        for j in range(k):
            v = points[vertices[i, j]]
            lengths[i, j] = _charged(lengths[i, j], q[i], v, near, near.size, taught, metric)
    return vertices, lengths, np.full(vertices.shape, -1, np.int32)


@borrowing
def _all_apart(q: Floats, i: int, columns: Floats, metric: Metric, out: Floats) -> None:
    """`_apart` of row i of q and each of some points, in loops that become vector instructions.

    Args:
        q: (n, d) configurations.
        i: Which of them.
        columns: (d, m) coordinates of the points.
        metric: Weights and periods of the distance.
        out: (m,) distances, written.
    """
    weights, periods = metric
    for a in range(out.size):
        out[a] = 0.0
    for c in range(columns.shape[0]):
        weight, period, x, row = weights[c], periods[c], q[i, c], columns[c]
        if period > 0.0:
            for a in range(out.size):
                delta = row[a] - x
                delta -= period * np.floor(delta / period + 0.5)
                out[a] += (weight * delta) * (weight * delta)
        else:
            for a in range(out.size):
                delta = row[a] - x
                out[a] += (weight * delta) * (weight * delta)
    for a in range(out.size):
        out[a] = np.sqrt(out[a])


@borrowing
def _keep_nearest(
    q: Floats, i: int, columns: Floats, some: Ints, room: tuple[Floats, Ints, Floats], metric: Metric
) -> None:
    """Find the nearest of some vertices to row i of q.

    Args:
        q: (n, d) configurations.
        i: Which of them.
        columns: (d, m) coordinates of the vertices.
        some: (m,) their numbers, k at least.
        room: (k,) their distances, the nearest first, and (k,) their numbers, both written; and (m,) for all
            distances.
        metric: Weights and periods of the distance.
    """
    lengths, ids, apart = room
    k, held = lengths.size, 0
    _all_apart(q, i, columns, metric, apart)
    for a in range(some.size):
        length = apart[a]
        if held == k and length >= lengths[k - 1]:
            continue
        slot = held if held < k else k - 1
        while slot > 0 and lengths[slot - 1] > length:
            lengths[slot], ids[slot] = lengths[slot - 1], ids[slot - 1]
            slot -= 1
        lengths[slot], ids[slot] = length, some[a]
        held = min(held + 1, k)


@borrowing
def _least_charged(
    q: Floats,
    i: int,
    room: tuple[Floats, Ints, Floats],
    points: Floats,
    distance: Floats,
    near: Ints,
    count: int,
    taught: Taught,
    metric: Metric,
) -> float:
    """Value of row i of q over what `_keep_nearest` found, with what was raised near the ways."""
    lengths, ids, _ = room
    least = np.inf
    for j in range(lengths.size):
        if lengths[j] + distance[ids[j]] < least:
            length = _charged(lengths[j], q[i], points[ids[j]], near, count, taught, metric)
            least = min(least, length + distance[ids[j]])
    return least


@njit(cache=True)
def candidate_values(
    q: Floats,
    index: State,
    points: Floats,
    distance: Floats,
    k: int,
    taught: Taught,
    lessons: State,
    farthest: float,
    metric: Metric,
) -> Floats:
    """Heuristic of configurations; those that lie close together share the search for their vertices.

    Args:
        q: (n, d) configurations.
        index: Nearest-neighbour index over the vertices but the last, which is the goal.
        points: (v, d) roadmap vertices.
        distance: (v,) length of the shortest path from each vertex to the goal.
        k: Anchors a configuration; there are more vertices than these.
        taught: Where ways were made costlier, as in `charge_anchors`.
        lessons: Index over those places, so that a choice costs what was taught near it and not all there is.
        farthest: The largest of their reaches.
        metric: Weights and periods of the distance.

    Returns:
        (n,) the least of length + distance, infinite where no anchor leads to the goal.
    """
    periods = metric[1]
    n, goal = q.shape[0], points.shape[0] - 1
    middle = np.zeros(q.shape[1])
    for i in range(n):
        for c in range(q.shape[1]):
            middle[c] += shortest(q[i, c] - q[0, c], periods[c]) / n
    for c in range(q.shape[1]):
        middle[c] = placed(q[0, c] + middle[c], periods[c])
    spread = 0.0
    for i in range(n):
        spread = max(spread, separation(middle, q[i], metric))
    # Vertices are about as far apart everywhere here; where one is farther off, its own are looked for.
    reach = spread + _WIDER * k_nearest(index, middle, k)[1][k - 1]
    some = within(index, middle, reach)
    if separation(middle, points[goal], metric) <= reach:
        some = np.append(some, goal)
    alone = middle.reshape(1, middle.size)
    close = _around(alone, 0, lessons, taught, farthest, 2.0 * spread + reach, metric)
    out, room = np.empty(n), (np.empty(k), np.empty(k, np.int64), np.empty(some.size))
    near, columns = np.empty(close.size, np.int64), np.empty((q.shape[1], some.size))
    for c in range(q.shape[1]):
        for a in range(some.size):
            columns[c, a] = points[some[a], c]
    for i in range(n):
        known = reach - separation(middle, q[i], metric)
        _keep_nearest(q, i, columns, some, room, metric)
        if room[0][k - 1] <= known:
            count = _find_close(q, i, close, taught, room[0][k - 1], metric, near)
            out[i] = _least_charged(q, i, room, points, distance, near, count, taught, metric)
        else:  # another vertex may be nearer
            vertices, lengths = nearest_anchors(q[i : i + 1], index, points, k, metric)
            own = _around(q, i, lessons, taught, farthest, lengths[0, k - 1], metric)
            for j in range(k):
                room[0][j], room[1][j] = lengths[0, j], vertices[0, j]
            out[i] = _least_charged(q, i, room, points, distance, own, own.size, taught, metric)
    return out


@njit(cache=True)
def roadmap_edges_near(
    segments: tuple[State, Floats, Floats, Floats],
    own: tuple[Floats, Floats],
    first: int,
    q: Floats,
    reach: float,
    metric: Metric,
) -> Ints:
    """Edges that pass within ``reach`` of a configuration: those of an index, then some that are in none.

    Args:
        segments: What `segments_within` takes.
        own: (m, d) both ends of the others.
        first: Number of the first of those.
        q: (d,) configuration.
        reach: How far around it (length).
        metric: Weights and periods of the distance.
    """
    some = segments_within(segments[0], segments[1], segments[2], segments[3], q, reach)
    others = segments_touched(own[0], own[1], q, reach, metric)
    if others.size == 0:
        return some
    out = np.empty(some.size + others.size, np.int64)
    for s in range(some.size):
        out[s] = some[s]
    for s in range(others.size):
        out[some.size + s] = first + others[s]
    return out


@njit(cache=True)
def not_yet_near(index: State, q: Floats, reach: float, seen: Bools) -> Ints:
    """Vertices within ``reach`` of a configuration that were not ``seen`` (v,) before; now they are."""
    near = within(index, q, reach)
    count = 0
    for v in near:
        if not seen[v]:
            seen[v] = True
            near[count] = v
            count += 1
    return near[:count]


@njit(cache=True)
def edges_at(vertices: Ints, bad: Bools, indptr: Int32s, edge_of: Int32s) -> Ints:
    """The edges at the ``bad`` ones (k,) of some vertices (k,), vertex by vertex."""
    count = 0
    for s in range(vertices.size):
        if bad[s]:
            count += indptr[vertices[s] + 1] - indptr[vertices[s]]
    out, count = np.empty(count, np.int64), 0
    for s in range(vertices.size):
        if bad[s]:
            for a in range(indptr[vertices[s]], indptr[vertices[s] + 1]):
                out[count] = edge_of[a]
                count += 1
    return out


@njit(cache=True)
def segments_touched(tails: Floats, heads: Floats, q: Floats, reach: float, metric: Metric) -> Ints:
    """Which of a few segments (m, d) to (m, d) pass within ``reach`` of a configuration."""
    out, count = np.empty(tails.shape[0], np.int64), 0
    for e in range(tails.shape[0]):
        if segment_separation(tails[e], heads[e], q, metric) <= reach:
            out[count] = e
            count += 1
    return out[:count]


@borrowing
def link_anchors(
    vertices: Int32s, first: int, last: int, head: Int32s, node_of: Int32s, following: Int32s, count: int
) -> int:
    """Enter rows ``first`` to ``last`` into the lists, one per roadmap vertex, of who is anchored to it.

    Args:
        vertices: (>= last, k) int32 roadmap vertex of each anchor; -1 for none.
        first: First row to enter.
        last: One past the last.
        head: (v,) int32 first link of each vertex's list; -1 for none.
        node_of: (>= count + (last - first) k,) int32 row of each link.
        following: The same length, int32 next link in the same list; -1 at its end.
        count: Links so far.

    Returns:
        The new number of links.
    """
    for i in range(first, last):
        for j in range(vertices.shape[1]):
            v = vertices[i, j]
            if v >= 0:
                node_of[count], following[count], head[v] = i, head[v], count
                count += 1
    return count


@borrowing
def enter_anchors(
    held: Anchored, fresh: Anchored, first: int, lists: tuple[Int32s, Int32s, Int32s], count: int
) -> tuple[int, float]:
    """Write the anchors of the next nodes behind those of the earlier ones, and enter them into the lists.

    Args:
        held: Vertices, lengths and edges (capacity, k) of all nodes' anchors, changed in place.
        fresh: Those of the next nodes, (n, k).
        first: How many nodes there were.
        lists: ``head``, ``node_of`` and ``following`` of `link_anchors`.
        count: Links so far.

    Returns:
        The new number of links, and the longest of the fresh anchors that are finite, else 0.
    """
    last, longest = first + fresh[0].shape[0], 0.0
    for i in range(first, last):
        for j in range(fresh[0].shape[1]):
            length = fresh[1][i - first, j]
            held[0][i, j], held[1][i, j], held[2][i, j] = (
                fresh[0][i - first, j],
                length,
                fresh[2][i - first, j],
            )
            if longest < length < np.inf:
                longest = length
    return link_anchors(held[0], first, last, lists[0], lists[1], lists[2], count), longest


@njit(cache=True)
def enter_charged(
    q: Floats,
    place: tuple[int, int, int],
    held: Anchored,
    lists: tuple[Int32s, Int32s, Int32s],
    h: Floats,
    graph: tuple[State, Floats, Floats],
    taught: Taught,
    lessons: State,
    farthest: float,
    metric: Metric,
) -> tuple[int, float]:
    """`charged_anchors` of the next nodes, entered (`enter_anchors`), and their values.

    Args:
        q: (n, d) states of the next nodes.
        place: How many nodes there were, links so far, and anchors of a node.
        held: Vertices, lengths and edges of all nodes' anchors, written.
        lists: Those of `link_anchors`.
        h: Values of all nodes, written.
        graph: Index over its vertices but the goal, its vertices, and their distances to the goal.
        taught: As `charge_anchors` takes it.
        lessons: Index over those places.
        farthest: The largest of their reaches.
        metric: Weights and periods of the distance.

    Returns:
        What `enter_anchors` does.
    """
    first, count, k = place
    fresh = charged_anchors(q, graph[0], graph[1], k, taught, lessons, farthest, metric)
    for i in range(q.shape[0]):
        best = np.inf
        for j in range(k):
            best = min(best, fresh[1][i, j] + graph[2][fresh[0][i, j]])
        h[first + i] = best
    return enter_anchors(held, fresh, first, lists, count)


@njit(cache=True)
def enter_joined(
    q: Floats,
    place: tuple[int, int],
    held: Anchored,
    lists: tuple[Int32s, Int32s, Int32s],
    h: Floats,
    segments: tuple[Floats, Floats, Int32s, Floats],
    multipliers: Floats,
    distance: Floats,
    geometry: Geometry,
) -> tuple[int, float]:
    """`edge_anchors` of the next nodes, entered (`enter_anchors`), and their values.

    Args:
        q: (n, 2) states of the next nodes.
        place: How many nodes there were, and links so far.
        held: Vertices, lengths and edges of all nodes' anchors, written.
        lists: Those of `link_anchors`.
        h: Values of all nodes, written.
        segments: Ends, vertices and lengths of the segments, as `edge_anchors` takes them.
        multipliers: (m,) factor on the length of each segment.
        distance: (v,) length of the shortest path from each vertex to the goal.
        geometry: Of a point robot.

    Returns:
        What `enter_anchors` does.
    """
    first, count = place
    tails, heads, edges, lengths = segments
    fresh = edge_anchors(q, tails, heads, edges, lengths, geometry)
    found = enter_anchors(held, fresh, first, lists, count)
    rows = np.arange(first, first + q.shape[0])
    values = anchored_values_of(rows, held[0], held[1], held[2], multipliers, distance)
    for i in range(q.shape[0]):
        h[first + i] = values[i]
    return found


@njit(cache=True)
def joined_values(
    q: Floats,
    segments: tuple[Floats, Floats, Int32s, Floats],
    multipliers: Floats,
    distance: Floats,
    geometry: Geometry,
) -> Floats:
    """(n,) values of states (n, 2) that are joined to their nearest segments (`edge_anchors`)."""
    tails, heads, edges, lengths = segments
    vertices, along, edge = edge_anchors(q, tails, heads, edges, lengths, geometry)
    return anchored_values_of(np.arange(q.shape[0]), vertices, along, edge, multipliers, distance)


@borrowing
def _mark(v: int, lists: tuple[Int32s, Int32s, Int32s], marked: Bools) -> None:
    """Mark the rows that are anchored to a vertex."""
    head, node_of, following = lists
    link = head[v]
    while link >= 0:
        marked[node_of[link]] = True
        link = following[link]


@njit(cache=True)
def concerned_nodes(
    raised: Ints,
    changed: Ints,
    stale: Ints,
    graph: tuple[Adjacency, Int32s, Tree, Scratch],
    costs: tuple[Floats, Floats],
    lists: tuple[Int32s, Int32s, Int32s],
    n: int,
) -> Ints:
    """The rows, ascending, whose cost a change of the graph concerns; shortest paths are repaired first.

    Args:
        raised: (k,) int64 edges whose multipliers were raised.
        changed: (c,) int64 vertices whose distance, or the weight of one of whose edges, changed before.
        stale: (s,) int64 rows that are concerned anyway.
        graph: What `lengthen` takes.
        costs: Length and multiplier of each edge.
        lists: ``head``, ``node_of`` and ``following`` of `link_anchors`.
        n: Number of rows.
    """
    adjacency, ends, tree, scratch = graph
    marked = np.zeros(n, np.bool_)
    if raised.size > 0:
        count = lengthen(adjacency, ends, tree, scratch, raised, costs[0], costs[1])
        for s in range(count):
            _mark(scratch[2][s], lists, marked)
        for e in raised:  # anchors run along them, too
            _mark(ends[e, 0], lists, marked)
            _mark(ends[e, 1], lists, marked)
    for v in changed:
        _mark(v, lists, marked)
    for i in stale:
        marked[i] = True
    rows, count = np.empty(n, np.int64), 0
    for i in range(n):
        if marked[i]:
            rows[count] = i
            count += 1
    return rows[:count]


@borrowing
def _segment_squared(q: Floats, i: int, tails: Floats, heads: Floats, e: int) -> tuple[float, float]:
    """Fraction along a segment of its point nearest to row i of q, and the square of the distance to that."""
    ux, uy = heads[e, 0] - tails[e, 0], heads[e, 1] - tails[e, 1]
    px, py = q[i, 0] - tails[e, 0], q[i, 1] - tails[e, 1]
    squared = ux * ux + uy * uy
    t = 0.0 if squared == 0.0 else min(1.0, max(0.0, (ux * px + uy * py) / squared))
    dx, dy = px - t * ux, py - t * uy
    return t, dx * dx + dy * dy


@borrowing
def _nearest_segment(q: Floats, i: int, tails: Floats, heads: Floats) -> tuple[int, float, float]:
    """The segment nearest to row i of q, the first of equals; fraction along it, and distance."""
    segment, fraction, least = 0, 0.0, np.inf
    for e in range(tails.shape[0]):
        t, squared = _segment_squared(q, i, tails, heads, e)
        if squared < least:
            segment, fraction, least = e, t, squared
    return segment, fraction, np.sqrt(least)


@njit(cache=True)
def nearest_segments(q: Floats, tails: Floats, heads: Floats) -> tuple[Int32s, Floats, Floats]:
    """The nearest of a set of plane segments to each point.

    Args:
        q: (n, >= 2) points; the first two coordinates count.
        tails: (m, 2) first end of each segment.
        heads: (m, 2) second end of each segment.

    Returns:
        (n,) int32 segment, (n,) fraction along it of the nearest point, (n,) distance to that point.
    """
    n = q.shape[0]
    segment, fraction, away = np.empty(n, np.int32), np.empty(n), np.empty(n)
    for i in range(n):
        segment[i], fraction[i], away[i] = _nearest_segment(q, i, tails, heads)
    return segment, fraction, away


@njit(cache=True)
def edge_anchors(
    q: Floats, tails: Floats, heads: Floats, edges: Int32s, lengths: Floats, geometry: Geometry
) -> Anchored:
    """Join each point to both ends of its nearest segment; one in an obstacle by ways of infinite length.

    Args:
        q: (n, 2) points.
        tails: (m, 2) first end of each segment.
        heads: (m, 2) second end of each segment.
        edges: (m, 2) int32 vertices of both ends.
        lengths: (m,) length of each segment.
        geometry: Of a point robot.

    Returns:
        (n, 2) int32 vertices, (n, 2) lengths along the segment, (n, 2) int32 the segment.
    """
    n = q.shape[0]
    segment, fraction, _ = nearest_segments(q, tails, heads)
    vertices, along, edge = np.empty((n, 2), np.int32), np.empty((n, 2)), np.empty((n, 2), np.int32)
    for i in range(n):
        e = segment[i]
        vertices[i], edge[i] = edges[e], e
        if pose_clearance(q[i], geometry) > 0.0:
            along[i, 0] = fraction[i] * lengths[e]
            along[i, 1] = lengths[e] - along[i, 0]
        else:
            along[i] = np.inf
    return vertices, along, edge


@njit(cache=True)
def segments_near(
    segments: tuple[State, Floats, Floats, Floats], ends: tuple[Floats, Floats], q: Floats, reach: float
) -> Ints:
    """The segment nearest to a point, and those that pass within ``reach`` of it, ascending.

    Args:
        segments: What `segments_within` takes.
        ends: (m, 2) both ends of each.
        q: (2,) point.
        reach: How far around it (length); 0 for the nearest alone.
    """
    nearest = np.int64(nearest_segments(q.reshape(1, 2), ends[0], ends[1])[0][0])
    if reach == 0.0:
        return np.full(1, nearest)
    near = segments_within(segments[0], segments[1], segments[2], segments[3], q, reach)
    at = 0
    while at < near.size and near[at] < nearest:
        at += 1
    if at < near.size and near[at] == nearest:
        return near
    out = np.empty(near.size + 1, np.int64)
    out[at] = nearest
    for s in range(near.size):
        out[s if s < at else s + 1] = near[s]
    return out
