"""The Delaunay triangulation of points in a plane: points go in one by one, and edges flip until none has to.

More points may go in later (`insert`); triangles that they leave alone keep their places in the arrays.

Which side of a line a point is on is exact, since points lie on a grid of integers. An edge flips only where
rounding leaves no doubt that a circle holds a point, so flips come to an end. Points that lie on one circle
may be triangulated either way. The order follows a curve that fills the square (Hilbert's), in rounds, each
of twice as many points as the last: a point is found by a walk of a few triangles from the one before.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.plain import ZERO, borrowing

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]

CORNERS = 4  # of a square around all points, four times as large: the first vertices
_HALF = 2**28  # the points lie within this of the origin: a product of differences fits in 64 bits
_AROUND = 4 * _HALF - 1
_DEPTH = 16  # of Hilbert's curve
_INCIRCLE = 12.0 * 2.0**-53  # error of the determinant, as a share of its permanent


@njit(cache=True)
def on_grid(points: Floats, box: Floats) -> Ints:
    """The square's corners and then the points, as integers; a step is 2e-9 of the box's longer side."""
    n = points.shape[0]
    placed = np.empty((CORNERS + n, 2), np.int64)
    for k in range(CORNERS):
        placed[k, 0] = _AROUND if k in (1, 2) else -_AROUND
        placed[k, 1] = _AROUND if k in (2, 3) else -_AROUND
    side = max(box[2] - box[0], box[3] - box[1])
    scale = 2 * _HALF / side if side > 0.0 else 0.0
    for i in range(n):
        for k in range(2):
            step = np.int64(np.rint((points[i, k] - box[k]) * scale)) - _HALF
            placed[CORNERS + i, k] = min(max(step, -_HALF), _HALF)
    return placed


@borrowing
def _along_curve(placed: Ints, v: int) -> int:
    """How far along Hilbert's curve a point lies."""
    x, y = (placed[v, 0] + _HALF) >> (29 - _DEPTH), (placed[v, 1] + _HALF) >> (29 - _DEPTH)
    far, s = np.int64(0), np.int64(1) << (_DEPTH - 1)
    while s > 0:
        right, up = np.int64((x & s) > 0), np.int64((y & s) > 0)
        far += s * s * ((3 * right) ^ up)
        if up == 0:
            if right == 1:
                x, y = s - 1 - (x & (s - 1)), s - 1 - (y & (s - 1))
            x, y = y, x
        s >>= 1
    return int(far)


@njit(cache=True)
def insertion_order(placed: Ints, begin: int) -> Ints:
    """Vertices from ``begin`` on, in rounds of twice as many each, along the curve within a round."""
    n = placed.shape[0] - begin
    keys, last = np.empty(n, np.int64), 0
    while (1 << last) < n:
        last += 1
    mixed = np.uint64(1)
    for i in range(n):
        mixed ^= mixed << np.uint64(13)
        mixed ^= mixed >> np.uint64(7)
        mixed ^= mixed << np.uint64(17)
        level, bits = last, mixed
        while level > 0 and bits & np.uint64(1):
            level, bits = level - 1, bits >> np.uint64(1)
        keys[i] = (np.int64(level) << 33) + _along_curve(placed, begin + i)
    return np.argsort(keys) + begin


@borrowing
def _turn(placed: Ints, a: int, b: int, c: int) -> int:
    """Positive if a, b, c turn left, exactly."""
    ux, uy = placed[b, 0] - placed[a, 0], placed[b, 1] - placed[a, 1]
    wx, wy = placed[c, 0] - placed[a, 0], placed[c, 1] - placed[a, 1]
    return ux * wy - uy * wx


@borrowing
def _surely_within(placed: Ints, a: int, b: int, c: int, d: int) -> bool:
    """Whether d lies in the circle of a, b, c (which turn left), beyond doubt."""
    ax, ay = float(placed[a, 0] - placed[d, 0]), float(placed[a, 1] - placed[d, 1])
    bx, by = float(placed[b, 0] - placed[d, 0]), float(placed[b, 1] - placed[d, 1])
    cx, cy = float(placed[c, 0] - placed[d, 0]), float(placed[c, 1] - placed[d, 1])
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    determinant = a2 * (bx * cy - cx * by) + b2 * (cx * ay - ax * cy) + c2 * (ax * by - bx * ay)
    permanent = (
        a2 * (abs(bx * cy) + abs(cx * by))
        + b2 * (abs(cx * ay) + abs(ax * cy))
        + c2 * (abs(ax * by) + abs(bx * ay))
    )
    return determinant > _INCIRCLE * permanent


@borrowing
def _found(placed: Ints, corners: Int32s, beyond: Int32s, v: int, t: int) -> tuple[int, int, int]:
    """The triangle that v lies in, by a walk from triangle t; a side that v is on (or -1), and how many."""
    turn = 0
    while True:
        side, on, moved = -1, 0, False
        for step in range(3):
            k = (turn + step) % 3
            turned = _turn(placed, corners[t, (k + 1) % 3], corners[t, (k + 2) % 3], v)
            if turned < 0:
                t, moved = beyond[t, k], True
                break
            if turned == 0:
                side, on = k, on + 1
        if not moved:
            return t, side, on
        turn += 1


@borrowing
def _put(table: Int32s, t: int, a: int, b: int, c: int) -> None:
    table[t, 0], table[t, 1], table[t, 2] = a, b, c


@borrowing
def _side_from(corners: Int32s, t: int, a: int) -> int:
    """The side of triangle t that begins at vertex ``a``."""
    k = 0
    while corners[t, (k + 1) % 3] != a:
        k += 1
    return k


@borrowing
def _join(corners: Int32s, beyond: Int32s, t: int, k: int, other: int, a: int) -> None:
    """Let side k of triangle t and the side of the other one that begins at vertex ``a`` there be one."""
    beyond[t, k] = other
    if other >= 0:
        beyond[other, _side_from(corners, other, a)] = t


@borrowing
def _placed_in(
    corners: Int32s, beyond: Int32s, t: int, k: int, on: int, v: int, count: int
) -> tuple[int, int, int, int]:
    """Cut the triangle (or, with v on its side k, the two) that v lies in; all have v first.

    Returns:
        The three or four triangles; -1 for none.
    """
    if on == 0:
        k = 0
    a, b, c = corners[t, k], corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
    at_a, at_b, at_c = beyond[t, k], beyond[t, (k + 1) % 3], beyond[t, (k + 2) % 3]
    if on == 0:
        one, two, three = t, count, count + 1
        _put(corners, one, v, b, c)
        _put(corners, two, v, c, a)
        _put(corners, three, v, a, b)
        _put(beyond, one, at_a, two, three)
        _put(beyond, two, at_b, three, one)
        _put(beyond, three, at_c, one, two)
        _join(corners, beyond, two, 0, at_b, a)
        _join(corners, beyond, three, 0, at_c, b)
        return one, two, three, -1
    s = at_a  # the triangle across: (d, c, b)
    j = _side_from(corners, s, c)
    d, at_c2, at_b2 = corners[s, j], beyond[s, (j + 1) % 3], beyond[s, (j + 2) % 3]
    one, two, three, four = t, int(s), count, count + 1
    _put(corners, one, v, c, a)
    _put(corners, two, v, b, d)
    _put(corners, three, v, a, b)
    _put(corners, four, v, d, c)
    _put(beyond, one, at_b, three, four)
    _put(beyond, two, at_c2, four, three)
    _put(beyond, three, at_c, two, one)
    _put(beyond, four, at_b2, one, two)
    _join(corners, beyond, three, 0, at_c, b)
    _join(corners, beyond, four, 0, at_b2, c)
    return one, two, three, four


@njit(cache=True)
def box_of(points: Floats) -> Floats:
    """Lowest and highest coordinates of at least one point: xmin, ymin, xmax, ymax."""
    xs, ys = points[:, 0], points[:, 1]
    return np.array([xs.min(), ys.min(), xs.max(), ys.max()])


@njit(cache=True)
def triangulate(points: Floats) -> tuple[Int32s, Int32s]:
    """Delaunay triangles of points and of a square around them.

    Points nearer to one another than the grid's step are one, the first.

    Args:
        points: (n, 2) finite, at least one.

    Returns:
        (t, 3) int32 vertices of each triangle, turning left: 0 to 3 are the square's corners and 4 + i is
        point i. (t, 3) int32 triangle across the side that faces each vertex; -1 for none.
    """
    corners, beyond = np.empty((2, 3), np.int32), np.empty((2, 3), np.int32)
    _put(corners, 0, 0, 1, 2)
    _put(corners, 1, 0, 2, 3)
    _put(beyond, 0, -1, 1, -1)
    _put(beyond, 1, -1, -1, 0)
    return insert(points, int(ZERO), box_of(points), corners, beyond)


@njit(cache=True)
def _with_room(table: Int32s, rows: int) -> Int32s:
    larger = np.empty((rows, table.shape[1]), np.int32)
    for t in range(table.shape[0]):
        for k in range(table.shape[1]):
            larger[t, k] = table[t, k]
    return larger


@njit(cache=True)
def insert(points: Floats, begin: int, box: Floats, corners: Int32s, beyond: Int32s) -> tuple[Int32s, Int32s]:
    """Put more points into a triangulation.

    Args:
        points: (n, 2) all of them, in the box.
        begin: How many of them it has.
        box: `box_of` the points that it was begun with.
        corners: (t, 3) as `triangulate` returns them; left as they are, and so is ``beyond``.
        beyond: (t, 3) likewise.

    Returns:
        The same of all points.
    """
    placed, count = on_grid(points, box), corners.shape[0]
    rows = count + 2 * (points.shape[0] - begin)
    corners, beyond = _with_room(corners, rows), _with_room(beyond, rows)
    last = 0
    doubtful, open_ = np.empty(64, np.int64), 0
    for v in insertion_order(placed, begin + CORNERS):
        last, side, on = _found(placed, corners, beyond, v, last)
        if on == 2:
            continue  # a vertex lies there
        for t in _placed_in(corners, beyond, last, side, on, v, count):
            if t >= 0:
                doubtful[open_] = t
                open_ += 1
        count += 2
        while open_ > 0:
            open_ -= 1
            t = doubtful[open_]
            s = beyond[t, 0]
            if s < 0:
                continue
            a, b = corners[t, 1], corners[t, 2]
            j = _side_from(corners, s, b)
            d = corners[s, j]
            if not _surely_within(placed, v, a, b, d):
                continue
            at_a, at_b = beyond[t, 1], beyond[t, 2]  # across the sides (b, v) and (v, a)
            past_b, past_a = beyond[s, (j + 1) % 3], beyond[s, (j + 2) % 3]  # across (a, d) and (d, b)
            _put(corners, t, v, a, d)
            _put(corners, s, v, d, b)
            _put(beyond, t, past_b, s, at_b)
            _put(beyond, s, past_a, at_a, t)
            _join(corners, beyond, t, 0, past_b, d)
            _join(corners, beyond, s, 1, at_a, v)
            _join(corners, beyond, s, 0, past_a, b)
            if open_ + 2 > doubtful.size:
                larger = np.empty(2 * doubtful.size, np.int64)
                larger[:open_] = doubtful[:open_]
                doubtful = larger
            doubtful[open_], doubtful[open_ + 1] = t, s
            open_ += 2
    return corners[:count], beyond[:count]


@njit(cache=True)
def circle_centres(points: Floats, corners: Int32s) -> Floats:
    """Centre of the circle through each triangle: (t, 2); NaN with a corner of the square, or none."""
    centres = np.full((corners.shape[0], 2), np.nan)
    for t in range(corners.shape[0]):
        a, b, c = corners[t, 0] - CORNERS, corners[t, 1] - CORNERS, corners[t, 2] - CORNERS
        if min(a, b, c) < 0:
            continue
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        wx, wy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        twice = 2.0 * (ux * wy - uy * wx)
        if twice > 0.0:
            u2, w2 = ux * ux + uy * uy, wx * wx + wy * wy
            centres[t, 0] = points[a, 0] + (wy * u2 - uy * w2) / twice
            centres[t, 1] = points[a, 1] + (ux * w2 - wx * u2) / twice
    return centres
