"""Convex decomposition: rings that are convex already, and triangles merged while the result stays convex.

Shapes come and go as ragged arrays: all vertices in one (n, 2) array, and where each part ends in it.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.plain import YES, ZERO, borrowing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

COLLINEAR = 1e-13
"""Sine below which three vertices count as collinear: a sagitta far below every collision tolerance."""

_MANY_DIAGONALS = 16
"""Beyond this many diagonals, fewer orders of dropping them are tried."""


@borrowing
def _corner_sine(xy: FloatArray, p: int, q: int, r: int) -> float:
    """Sine of the left turn at vertex q on the way from p to r."""
    ux, uy = xy[q, 0] - xy[p, 0], xy[q, 1] - xy[p, 1]
    vx, vy = xy[r, 0] - xy[q, 0], xy[r, 1] - xy[q, 1]
    lengths = math.hypot(ux, uy) * math.hypot(vx, vy)
    return (ux * vy - uy * vx) / lengths if lengths > 0.0 else 0.0


@borrowing
def _emit(xy: FloatArray, ring: IntArray, n: int, out: FloatArray, at: int) -> int:
    """Write a ring of vertices without its collinear ones into `out`; return how many there are."""
    m = at
    for k in range(n):
        if abs(_corner_sine(xy, ring[k - 1 if k else n - 1], ring[k], ring[k + 1 if k + 1 < n else 0])) > (
            COLLINEAR
        ):
            out[m, 0], out[m, 1] = xy[ring[k], 0], xy[ring[k], 1]
            m += 1
    if m - at >= 3:
        return m - at
    for k in range(n):
        out[at + k, 0], out[at + k, 1] = xy[ring[k], 0], xy[ring[k], 1]
    return n


@borrowing
def _turns_left(xy: FloatArray, first: int, n: int) -> bool:
    """Whether the ring of n vertices from `first` is convex and counter-clockwise, up to rounding."""
    for k in range(n):
        before, after = first + (k - 1 if k else n - 1), first + (k + 1 if k + 1 < n else 0)
        if _corner_sine(xy, before, first + k, after) < -COLLINEAR:
            return False
    return True


@njit(cache=True)
def convex_rings(
    xy: FloatArray, counts: npt.NDArray[np.int32]
) -> tuple[FloatArray, IntArray, IntArray, bool]:
    """Of closed rings, those that are convex, counter-clockwise and without superfluous vertices.

    Args:
        xy: (n, 2) vertices of all rings; each begins and ends with the same one.
        counts: (r,) how many of them belong to each ring.

    Returns:
        (m, 2) vertices of the convex rings; (r,) how many of them belong to each ring, 0 if it is not convex;
        (r,) where each ring ends among them; whether all are convex.
    """
    out, sizes = np.empty_like(xy), np.zeros(counts.size, dtype=np.int64)
    ring, ends = np.empty(xy.shape[0], dtype=np.int64), np.empty_like(sizes)
    at, first, convex = int(ZERO), int(ZERO), bool(YES)
    for i in range(counts.size):
        n = 0
        for k in range(first, first + counts[i] - 1):
            if n == 0 or xy[k, 0] != xy[ring[n - 1], 0] or xy[k, 1] != xy[ring[n - 1], 1]:
                ring[n] = k
                n += 1
        first += counts[i]
        while n > 1 and xy[ring[0], 0] == xy[ring[n - 1], 0] and xy[ring[0], 1] == xy[ring[n - 1], 1]:
            n -= 1
        n = _emit(xy, ring, n, out, at)
        area = 0.0
        for k in range(at + 1, at + n - 1):
            ux, uy = out[k, 0] - out[at, 0], out[k, 1] - out[at, 1]
            area += ux * (out[k + 1, 1] - out[at, 1]) - uy * (out[k + 1, 0] - out[at, 0])
        if not area > 0.0:
            for k in range(n // 2):
                for c in range(2):
                    out[at + k, c], out[at + n - 1 - k, c] = out[at + n - 1 - k, c], out[at + k, c]
        if _turns_left(out, at, n):
            sizes[i] = n
            at += n
        convex &= sizes[i] > 0
        ends[i] = at
    return out[:at], sizes, ends, convex


@borrowing
def _find(owner: IntArray, i: int) -> int:
    while owner[i] != i:
        owner[i] = owner[owner[i]]
        i = owner[i]
    return i


@borrowing
def _drop_diagonals(
    xy: FloatArray,
    triangles: tuple[int, int],
    diagonals: IntArray,
    order: int,
    after: IntArray,
    before: IntArray,
    owner: IntArray,
    head: IntArray,
) -> int:
    """Hertel-Mehlhorn: drop each diagonal in turn whose removal leaves a convex piece.

    Edge e of the triangles runs from vertex e to the next vertex of triangle e // 3. Written are the edges
    before and after each in its piece, the triangle that stands for each triangle's piece, and the first
    edge of each piece.

    Args:
        xy: (3 t, 2) vertices of the triangles, counter-clockwise.
        triangles: The range of triangles that belong to the shape.
        diagonals: (k, 2) their shared edges, the longest first: an edge and its reverse.
        order: 0 for the order of the diagonals, 1 for its reverse, i > 1 to begin with diagonal i - 1.
        after: (3 t,) written.
        before: (3 t,) written.
        owner: (t,) written.
        head: (t,) written.

    Returns:
        The number of pieces.
    """
    for t in range(triangles[0], triangles[1]):
        owner[t], head[t] = t, 3 * t
        for k in range(3):
            after[3 * t + k], before[3 * t + k] = 3 * t + (k + 1) % 3, 3 * t + (k + 2) % 3
    pieces, n = triangles[1] - triangles[0], diagonals.shape[0]
    for k in range(n):
        d = k if order == 0 else n - 1 - k if order == 1 else (k + order - 1) % n
        e, back = diagonals[d, 0], diagonals[d, 1]
        i, j = _find(owner, e // 3), _find(owner, back // 3)
        if i == j:
            continue
        # Where the pieces meet, an edge that ends at a vertex goes on with the other piece's next edge.
        if (
            _corner_sine(xy, before[e], e, after[after[back]]) >= -COLLINEAR
            and _corner_sine(xy, before[back], back, after[after[e]]) >= -COLLINEAR
        ):
            after[before[e]], before[after[back]] = after[back], before[e]
            after[before[back]], before[after[e]] = after[e], before[back]
            owner[j], head[i] = i, after[e]
            pieces -= 1
    return pieces


@njit(cache=True)
def merge_triangles(
    xy: FloatArray, triangle_ends: IntArray, diagonals: IntArray, diagonal_ends: IntArray
) -> tuple[FloatArray, IntArray, IntArray]:
    """The fewest convex pieces that dropping diagonals in one of several orders leaves, for each shape.

    Args:
        xy: (3 t, 2) vertices of the triangles of all shapes, counter-clockwise.
        triangle_ends: (s,) where each shape's triangles end.
        diagonals: (k, 2) shared edges of all shapes, see `_drop_diagonals`.
        diagonal_ends: (s,) where each shape's diagonals end.

    Returns:
        (m, 2) vertices of the pieces, (p,) how many belong to each piece, (p,) the shape of each piece.
    """
    t = xy.shape[0] // 3
    after, before = np.empty(3 * t, dtype=np.int64), np.empty(3 * t, dtype=np.int64)
    owner, head = np.empty(t, dtype=np.int64), np.empty(t, dtype=np.int64)
    out, ring = np.empty_like(xy), np.empty(3 * t, dtype=np.int64)
    sizes, shapes = np.empty(t, dtype=np.int64), np.empty(t, dtype=np.int64)
    first, low, n, at = 0, 0, 0, 0
    for shape in range(triangle_ends.size):
        own = (first, triangle_ends[shape])
        shared = diagonals[low : diagonal_ends[shape]]
        orders = 2 if shared.shape[0] > _MANY_DIAGONALS else max(2, shared.shape[0] + 1)
        best, fewest, order = 0, 3 * t, 0
        for order in range(orders):
            pieces = _drop_diagonals(xy, own, shared, order, after, before, owner, head)
            if pieces < fewest:
                best, fewest = order, pieces
        if best != order:
            _drop_diagonals(xy, own, shared, best, after, before, owner, head)
        for i in range(own[0], own[1]):
            if owner[i] == i:
                m, e = 0, head[i]
                while m == 0 or e != head[i]:
                    ring[m], m, e = e, m + 1, after[e]
                sizes[n], shapes[n] = _emit(xy, ring, m, out, at), shape
                at, n = at + sizes[n], n + 1
        first, low = triangle_ends[shape], diagonal_ends[shape]
    return out[:at], sizes[:n], shapes[:n]
