"""What a skeleton takes of loops over its samples, edges and branches."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.plain import copy_row

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]
Bools = NDArray[np.bool_]


@njit(cache=True)
def _in_cells(
    samples: Floats, among: Ints, low: Floats, cell: float, rows: int, cols: int
) -> tuple[Ints, Ints]:
    """Some samples by cell of a grid: where those of each cell begin, and the samples in that order."""
    first, of = np.zeros(rows * cols + 1, np.int64), np.empty(among.size, np.int64)
    for k in range(among.size):
        x, y = samples[among[k], 0] - low[0], samples[among[k], 1] - low[1]
        of[k] = min(int(x / cell), rows - 1) * cols + min(int(y / cell), cols - 1)
        first[of[k] + 1] += 1
    for c in range(rows * cols):
        first[c + 1] += first[c]
    at, held = first[:-1].copy(), np.empty(among.size, np.int64)
    for k in range(among.size):
        held[at[of[k]]] = among[k]
        at[of[k]] += 1
    return first, held


@njit(cache=True)
def _grown(points: Floats, count: int) -> Floats:
    if count < points.shape[0]:
        return points
    larger = np.empty((2 * points.shape[0], points.shape[1]))
    for i in range(count):
        copy_row(points[i], larger[i])
    return larger


@njit(cache=True)
def facing_feet(
    samples: Floats, ahead: Floats, apart: Floats, reach: Floats, same: Floats, feet: Ints, walls: Ints
) -> Floats:
    """Feet of samples on the walls that they are nearer to than twice what the samples of either are apart.

    Args:
        samples: (n, 2) points on walls.
        ahead: (n, 2) from each sample along its wall to the next.
        apart: (n,) how far each sample may be from the next or the last.
        reach: (n,) how far samples of its wall may be apart.
        same: (n,) distance from samples of its wall at which a foot is none of its own.
        feet: Samples whose feet are asked for.
        walls: Samples from which to the next a foot may lie.

    Returns:
        (m, 4) sample, sample before the foot, and foot.
    """
    found, count = np.empty((64, 4)), 0
    low = np.array([samples[:, 0].min(), samples[:, 1].min()])
    size = np.array([samples[:, 0].max() - low[0], samples[:, 1].max() - low[1]])
    octave = np.floor(np.log2(apart[feet]))
    for k in np.unique(octave):  # samples that are far apart would make the cells of all large
        among = feet[octave == k]
        farthest = 2.0 * 2.0 ** (k + 1.0)
        cell = max(
            farthest, np.sqrt(size[0] * size[1] / among.size), (size[0] + size[1]) / (4.0 * among.size)
        )
        rows, cols = int(size[0] / cell) + 1, int(size[1] / cell) + 1
        first, held = _in_cells(samples, among, low, cell, rows, cols)
        for i in walls:
            ux, uy = ahead[i]
            length = np.hypot(ux, uy)
            if length <= 0.0:
                continue
            wide = max(farthest, 2.0 * reach[i])
            x, y = samples[i, 0] - low[0], samples[i, 1] - low[1]
            left, right = int(max(0.0, x + min(ux, 0.0) - wide) / cell), int((x + max(ux, 0.0) + wide) / cell)
            below, above = (
                int(max(0.0, y + min(uy, 0.0) - wide) / cell),
                int((y + max(uy, 0.0) + wide) / cell),
            )
            for row in range(left, min(right, rows - 1) + 1):
                start, end = row * cols + below, row * cols + min(above, cols - 1) + 1
                for j in held[first[min(start, rows * cols)] : first[end]]:
                    wx, wy = samples[j, 0] - samples[i, 0], samples[j, 1] - samples[i, 1]
                    along, away = (wx * ux + wy * uy) / length, abs(ux * wy - uy * wx) / length
                    near = 2.0 * max(apart[j], reach[i])
                    if same[i] < along < length - same[i] and same[i] < away <= near:
                        found = _grown(found, count)
                        t = along / length
                        found[count, 0], found[count, 1] = j, i
                        found[count, 2], found[count, 3] = samples[i, 0] + t * ux, samples[i, 1] + t * uy
                        count += 1
    return found[:count]


@njit(cache=True)
def ridges(beyond: Int32s, points: Floats, room: Floats) -> tuple[Int32s, Bools]:
    """Edges between the centres of circles of triangles with a common side, where both have room.

    Args:
        beyond: (t, 3) triangle across each side.
        points: (t, 2) centre of each triangle's circle.
        room: (t,) clearance there.

    Returns:
        (m, 2) int32 triangles. (m,) whether the edge leaves the free discs around its ends.
    """
    count = 0
    for t in range(beyond.shape[0]):
        for k in range(3):
            count += room[t] > 0.0 and beyond[t, k] > t and room[beyond[t, k]] > 0.0
    pairs, leaves, count = np.empty((count, 2), np.int32), np.empty(count, np.bool_), 0
    for t in range(beyond.shape[0]):
        for k in range(3):
            o = beyond[t, k]
            if room[t] > 0.0 and o > t and room[o] > 0.0:
                pairs[count, 0], pairs[count, 1] = t, o
                length = np.hypot(points[o, 0] - points[t, 0], points[o, 1] - points[t, 1])
                leaves[count] = length >= max(room[t], room[o])
                count += 1
    return pairs, leaves


@njit(cache=True)
def _edges_at(n: int, pairs: Ints) -> tuple[Ints, Ints]:
    """Where the edges at each vertex begin, and the edges in that order."""
    first = np.zeros(n + 1, np.int64)
    for e in range(pairs.shape[0]):
        first[pairs[e, 0] + 1] += 1
        first[pairs[e, 1] + 1] += 1
    for v in range(n):
        first[v + 1] += first[v]
    at, edges = first[:-1].copy(), np.empty(2 * pairs.shape[0], np.int64)
    for e in range(pairs.shape[0]):
        for k in range(2):
            edges[at[pairs[e, k]]] = e
            at[pairs[e, k]] += 1
    return first, edges


@njit(cache=True)
def without_dead_ends(clearance: Floats, pairs: Ints, falls: Floats, reach: Floats) -> tuple[Bools, Bools]:
    """Shorten dead ends until they end so far from the boundary, or run along it, or are gone.

    Args:
        clearance: (v,) of the vertices.
        pairs: (m, 2) edges.
        falls: (m,) by how much clearance falls along an edge that still runs along the boundary.
        reach: (v,) clearance at which a dead end stays.

    Returns:
        (m,) the edges and (v,) the vertices that stay.
    """
    n = clearance.size
    first, edges = _edges_at(n, pairs)
    degree = first[1:] - first[:-1]
    kept, alive = np.ones(pairs.shape[0], np.bool_), np.ones(n, np.bool_)
    leaves, open_ = np.empty(2 * n + 1, np.int64), 0
    for v in range(n):
        if degree[v] <= 1:
            leaves[open_] = v
            open_ += 1
    while open_ > 0:
        open_ -= 1
        v = leaves[open_]
        if not alive[v] or degree[v] > 1 or clearance[v] >= reach[v]:
            continue
        dead = True
        for e in edges[first[v] : first[v + 1]]:
            if kept[e]:
                u = pairs[e, 0] + pairs[e, 1] - v
                if clearance[u] - clearance[v] <= falls[e]:
                    dead = False
                    break
                kept[e] = False
                degree[u] -= 1
                if degree[u] <= 1:
                    leaves[open_] = u
                    open_ += 1
        if dead:
            alive[v] = False
    return kept, alive


@njit(cache=True)
def branches(n: int, pairs: Ints) -> tuple[Ints, Ints]:
    """Paths between vertices of degree other than 2, through those of degree 2, each once.

    A loop without such a vertex is cut at its least vertex.

    Args:
        n: Number of vertices.
        pairs: (m, 2) edges in lexicographic order.

    Returns:
        The vertices of all paths in a row, and (k + 1,) where each path begins.
    """
    first, edges = _edges_at(n, pairs)
    row, begins = np.empty(2 * pairs.shape[0], np.int64), np.zeros(pairs.shape[0] + 1, np.int64)
    gone, at, count = np.zeros(pairs.shape[0], np.bool_), 0, 0
    for loops in range(2):
        for v in range(n):
            degree = first[v + 1] - first[v]
            if degree == 0 or (degree == 2) != (loops == 1):
                continue
            for e in edges[first[v] : first[v + 1]]:
                if gone[e]:
                    continue
                row[at], u = v, v
                at += 1
                while True:
                    gone[e] = True
                    u = pairs[e, 0] + pairs[e, 1] - u
                    row[at] = u
                    at += 1
                    if u == v or first[u + 1] - first[u] != 2:
                        break
                    e = edges[first[u]] if edges[first[u]] != e else edges[first[u] + 1]
                count += 1
                begins[count] = at
    return row[:at], begins[: count + 1]


@njit(cache=True)
def cut_branches(points: Floats, row: Ints, begins: Ints, parts: Ints) -> tuple[Floats, Ints]:
    """Branches as edges of equal length.

    Args:
        points: (n, 2) vertices.
        row: Vertices of all branches.
        begins: (k + 1,) where each branch begins.
        parts: (k,) number of edges of each.

    Returns:
        (v, 2) vertices and (m, 2) edges.
    """
    ids = np.full(points.shape[0], -1, np.int64)
    cut, edges = np.empty((parts.sum() + parts.size, 2)), np.empty((parts.sum(), 2), np.int64)
    n, m = 0, 0
    for b in range(parts.size):
        first, last = begins[b], begins[b + 1] - 1
        for v in (row[first], row[last]):
            if ids[v] < 0:
                ids[v] = n
                cut[n] = points[v]
                n += 1
        whole = 0.0
        for i in range(first, last):
            whole += np.hypot(
                points[row[i + 1], 0] - points[row[i], 0], points[row[i + 1], 1] - points[row[i], 1]
            )
        tail, i, passed, length = ids[row[first]], first, 0.0, -1.0
        for k in range(1, parts[b]):
            goal = whole * k / parts[b]
            while True:
                dx, dy = points[row[i + 1], 0] - points[row[i], 0], points[row[i + 1], 1] - points[row[i], 1]
                length = np.hypot(dx, dy)
                if passed + length >= goal or i + 2 > last:
                    break
                passed += length
                i += 1
            t = min(1.0, max(0.0, (goal - passed) / length)) if length > 0.0 else 0.0
            cut[n, 0], cut[n, 1] = points[row[i], 0] + t * dx, points[row[i], 1] + t * dy
            edges[m, 0], edges[m, 1] = tail, n
            tail, n, m = n, n + 1, m + 1
        edges[m, 0], edges[m, 1] = tail, ids[row[last]]
        m += 1
    return cut[:n], edges[:m]
