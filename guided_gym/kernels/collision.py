"""Collision of a rigid planar robot with convex pieces: poses, certified motions, clearance.

The robot and the obstacles are unions of convex pieces; each side of the bounds is one more piece, a
half-plane. All of it is packed (`geometry.packing.pack`) into a `Geometry`: one float64 and one int64 array,
the same type for every robot.

Layout. `index = [n_robot, n_obstacle, boxes, nodes, node rows, node boxes, rest, entry, table, rows of the
robot pieces ..., rows of the obstacle pieces ..., rows of the nodes ...]`, where a row of a piece is (first
vertex, vertices, first axis, axes, sharp) and `boxes` is where the bounding boxes of the obstacle pieces
(xmin, ymin, xmax, ymax) start in `numbers`. `numbers = [tolerance, margin, radius, origin x, origin y, ...]`;
an axis is (nx, ny, offset) with an outward unit normal and max n.v over the piece's vertices; a robot vertex
is (x, y, norm) in the body frame, an obstacle vertex (x, y) relative to the origin. A half-plane has one axis
and no vertex, a point no axis, a segment two opposite axes. Entry and table are 0 for a rigid body; other
robots have the address of the function that answers for them there (`kernels.foreign`), and what it reads
(`kernels.linkage`).

Broad phase. Where there are many pieces, all but the last ones (from `rest` on: the half-planes) hang in a
tree of bounding boxes. Its nodes stand in preorder; a node's row is (next node that is not below it, first
piece, end of its pieces), the pieces of a leaf being a run of the obstacle pieces. A query walks over the
nodes, skipping what lies below a node that it does not meet.

A piece pair is *separated* by a gap g > 0 when a line keeps each of them g / 2 away on either side. A pose is
free iff every pair is separated by more than `tolerance`. The lines that are tried are along the edges of
either piece. Where a vertex faces a vertex, these find at least sin(a / 2) of the distance, a being the
blunter of the two angles; so where both pieces have corners sharper than 89 degrees (a point is one, an end
of a segment too) the line across the shortest way from one piece to the other is tried as well. Hence a pose
within `tolerance` is never free, and one farther away than 1.43 times that always.

A motion is certified against `margin`, a little more than `tolerance` (by more than all rounding), so that
every pose of a certified motion is free.
"""
# mypy: disable-error-code="misc,no-any-return,call-arg"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.foreign import CLEARANCE, FRACTION, POSE_FREE, TOOL_X, TOOL_Y, WHOLE, call
from guided_gym.kernels.plain import NO, YES, ZERO, borrowing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Geometry = tuple[FloatArray, IntArray]

HEADER = 9
"""Entries before the first row in `index`."""
NUMBERS = 5
"""Entries before the first vertex in `numbers`."""
ROW = 5
"""Entries of one piece's row in `index`."""
ENTRY, TABLE = 7, 8
"""Where `index` says which function answers for a robot that is no rigid body, and where its table begins."""

_MAX_STEPS = 200
_MAX_COORDINATE = 1e12
_MAX_ANGLE = 1e4


@borrowing
def next_run(
    numbers: FloatArray, index: IntArray, node: int, x: float, y: float, dx: float, dy: float, reach: float
) -> tuple[int, int, int]:
    """The next run of pieces whose boxes a disc may meet on its way from (x, y) by (dx, dy).

    Begin with node 0, and go on with the node that comes back until no node is left. What hangs in no tree,
    from `rest` on, is the caller's. Coordinates are relative to the origin.

    Returns:
        The range of the run (it may be empty), and the node to go on with.
    """
    n, row = index[3], index[4]
    xmin, xmax = min(x, x + dx) - reach, max(x, x + dx) + reach
    ymin, ymax = min(y, y + dy) - reach, max(y, y + dy) + reach
    wide = reach * (abs(dx) + abs(dy))
    while node < n:
        b, at = index[5] + 4 * node, row + 3 * node
        left, bottom, right, top = numbers[b], numbers[b + 1], numbers[b + 2], numbers[b + 3]
        across = (0.5 * (left + right) - x) * dy - (0.5 * (bottom + top) - y) * dx
        if (
            xmin > right
            or xmax < left
            or ymin > top
            or ymax < bottom
            or abs(across) > 0.5 * ((right - left) * abs(dy) + (top - bottom) * abs(dx)) + wide
        ):
            node = index[at]
            continue
        node += 1
        if index[at + 2] > 0:
            return index[at + 1], index[at + 2], node
    return 0, 0, node


@borrowing
def _disc_clear(
    numbers: FloatArray, index: IntArray, o: int, x: float, y: float, dx: float, dy: float, reach: float
) -> bool:
    """Whether one axis of the obstacle piece keeps a disc of this radius off it all the way."""
    first = index[o + 2]
    for e in range(first, first + 3 * index[o + 3], 3):
        gap = numbers[e] * x + numbers[e + 1] * y - numbers[e + 2] - reach
        if gap > 0.0 and gap + numbers[e] * dx + numbers[e + 1] * dy > 0.0:
            return True
    return False


@borrowing
def _separated(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> bool:
    """Whether a robot piece at (x, y), rotated by (cos, sin), is more than the tolerance off a piece."""
    tolerance, widest = numbers[0], -np.inf
    vertices, n_vertices, axes, n_axes = index[r], index[r + 1], index[r + 2], index[r + 3]
    first = index[o + 2]
    for e in range(first, first + 3 * index[o + 3], 3):
        ux, uy = numbers[e], numbers[e + 1]
        bx, by = c * ux + s * uy, c * uy - s * ux
        lowest = np.inf
        for v in range(vertices, vertices + 3 * n_vertices, 3):
            lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
        gap = ux * x + uy * y - numbers[e + 2] + lowest
        if gap > tolerance:
            return True
        widest = max(widest, gap)
    first, n_corners = index[o], index[o + 1]
    if n_corners == 0:
        return False
    for e in range(axes, axes + 3 * n_axes, 3):
        ux, uy = c * numbers[e] - s * numbers[e + 1], s * numbers[e] + c * numbers[e + 1]
        lowest = np.inf
        for w in range(first, first + 2 * n_corners, 2):
            lowest = min(lowest, ux * numbers[w] + uy * numbers[w + 1])
        gap = lowest - ux * x - uy * y - numbers[e + 2]
        if gap > tolerance:
            return True
        widest = max(widest, gap)
    if widest < -tolerance or not index[r + 4] & index[o + 4]:  # they overlap, or an edge's axis is as good
        return False
    ux, uy, offset = _axis_across(numbers, index, r, o, x, y, c, s)
    bx, by = c * ux + s * uy, c * uy - s * ux
    lowest = np.inf
    for v in range(vertices, vertices + 3 * n_vertices, 3):
        lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
    return ux * x + uy * y - offset + lowest > tolerance


@borrowing
def _to_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """The shortest way from the segment a-b to the point p."""
    ux, uy, wx, wy = bx - ax, by - ay, px - ax, py - ay
    length = ux * ux + uy * uy
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, (ux * wx + uy * wy) / length))
    return wx - t * ux, wy - t * uy


@borrowing
def _way_across(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> tuple[float, float]:
    """The shortest way from an obstacle piece to a robot piece off it: vertices against edges, both ways."""
    vertices, n_vertices = index[r], index[r + 1]
    first, n_corners = index[o], index[o + 1]
    shortest, wx, wy = np.inf, 0.0, 0.0
    for i in range(n_vertices):
        v, n = vertices + 3 * i, vertices + 3 * ((i + 1) % n_vertices)
        vx, vy = x + c * numbers[v] - s * numbers[v + 1], y + s * numbers[v] + c * numbers[v + 1]
        nx, ny = x + c * numbers[n] - s * numbers[n + 1], y + s * numbers[n] + c * numbers[n + 1]
        for j in range(n_corners):
            k, m = first + 2 * j, first + 2 * ((j + 1) % n_corners)
            kx, ky, mx, my = numbers[k], numbers[k + 1], numbers[m], numbers[m + 1]
            ex, ey = _to_segment(vx, vy, kx, ky, mx, my)
            if ex * ex + ey * ey < shortest:
                shortest, wx, wy = ex * ex + ey * ey, ex, ey
            ex, ey = _to_segment(kx, ky, vx, vy, nx, ny)
            if ex * ex + ey * ey < shortest:
                shortest, wx, wy = ex * ex + ey * ey, -ex, -ey
    return wx, wy


@borrowing
def _axis_across(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> tuple[float, float, float]:
    """The axis of an obstacle piece in the direction of the shortest way to a robot piece off it."""
    wx, wy = _way_across(numbers, index, r, o, x, y, c, s)
    length = math.sqrt(wx * wx + wy * wy)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    ux, uy, offset = wx / length, wy / length, -np.inf
    for k in range(index[o], index[o] + 2 * index[o + 1], 2):
        offset = max(offset, ux * numbers[k] + uy * numbers[k + 1])
    return ux, uy, offset


@borrowing
def _pieces_met(
    numbers: FloatArray, index: IntArray, xmin: float, ymin: float, xmax: float, ymax: float
) -> int:
    """How many pieces a box may meet: all, or all but the four half-planes if it lies inside the bounds."""
    n = index[1]
    b = index[2] + 4 * n
    inside = (
        xmin > numbers[b - 14] and xmax < numbers[b - 12] and ymin > numbers[b - 5] and ymax < numbers[b - 3]
    )
    return n - 4 if inside else n


@borrowing
def _pose_free(numbers: FloatArray, index: IntArray, x: float, y: float, theta: float) -> bool:
    x, y = x - numbers[3], y - numbers[4]
    # NaN and infinity fail this comparison, whatever the culling below makes of them.
    if not (abs(x) < _MAX_COORDINATE and abs(y) < _MAX_COORDINATE and abs(theta) < _MAX_ANGLE):
        return False
    reach = numbers[2] + numbers[1]
    n_robot, box = index[0], index[2]
    rows = HEADER + ROW * n_robot
    c, s, turned = 1.0, 0.0, theta == 0.0
    end = _pieces_met(numbers, index, x - reach, y - reach, x + reach, y + reach)
    node = int(ZERO)
    while node >= 0:
        first, last, at = index[6], end, -1
        if node < index[3]:
            first, last, at = next_run(numbers, index, node, x, y, 0.0, 0.0, reach)
        node = at
        for i in range(first, last):
            b = box + 4 * i
            if (
                x - reach > numbers[b + 2]
                or x + reach < numbers[b]
                or y - reach > numbers[b + 3]
                or y + reach < numbers[b + 1]
            ):
                continue
            o = rows + ROW * i
            if _disc_clear(numbers, index, o, x, y, 0.0, 0.0, reach):
                continue
            if not turned:
                c, s, turned = math.cos(theta), math.sin(theta), True
            for r in range(HEADER, rows, ROW):
                if not _separated(numbers, index, r, o, x, y, c, s):
                    return False
    return True


@borrowing
def pose_free(q: FloatArray, geometry: Geometry) -> bool:
    """Whether the pose q, (x, y) or (x, y, theta), is free (not if non-finite or turned by over 1e4)."""
    if geometry[1][ENTRY] != 0:
        return call(geometry[1][ENTRY], POSE_FREE, q, q, geometry[0], geometry[1]) != 0.0
    return _pose_free(geometry[0], geometry[1], q[0], q[1], q[2] if q.shape[0] > 2 else 0.0)


@njit(cache=True)
def poses_free(qs: FloatArray, geometry: Geometry) -> BoolArray:
    """`pose_free` for each row of qs (n, d): bool array (n,)."""
    free = np.empty(qs.shape[0], dtype=np.bool_)
    if geometry[1][ENTRY] != 0:
        for i in range(qs.shape[0]):
            free[i] = pose_free(qs[i], geometry)
        return free
    turns = qs.shape[1] > 2
    for i in range(qs.shape[0]):
        free[i] = _pose_free(geometry[0], geometry[1], qs[i, 0], qs[i, 1], qs[i, 2] if turns else 0.0)
    return free


@borrowing
def position(q: FloatArray, geometry: Geometry) -> tuple[float, float]:
    """Where the robot is in the workspace: its reference point, or its tool."""
    entry = geometry[1][ENTRY]
    if entry != 0:
        x: float = call(entry, TOOL_X, q, q, geometry[0], geometry[1])
        return x, call(entry, TOOL_Y, q, q, geometry[0], geometry[1])
    return q[0], q[1]


@borrowing
def _first_root(gap: float, rate: float, bend: float) -> float:
    """Smallest positive root of gap + rate t - bend t^2, for gap > 0 and bend >= 0, without cancellation."""
    root = math.sqrt(rate * rate + 4.0 * bend * gap)
    if rate > 0.0:
        return (rate + root) / (2.0 * bend)
    return 2.0 * gap / (root - rate)


@borrowing
def _obstacle_axes_step(
    numbers: FloatArray,
    index: IntArray,
    r: int,
    o: int,
    x: float,
    y: float,
    c: float,
    s: float,
    dx: float,
    dy: float,
    w: float,
    drift: float,
    remaining: float,
) -> float:
    """Longest time for which one axis of the obstacle piece surely separates the moving robot piece.

    The gap of a robot vertex v on a fixed axis u is u.p(t) + u.R(theta(t))v - offset; its second derivative
    is at least -|p''| - w^2 |v|, so a parabola bounds it from below. `drift` is half of what |p''| is at most
    (a rigid body's is 0).
    """
    margin = numbers[1]
    vertices, n_vertices = index[r], index[r + 1]
    first = index[o + 2]
    best = 0.0
    for e in range(first, first + 3 * index[o + 3], 3):
        ux, uy = numbers[e], numbers[e + 1]
        bx, by = c * ux + s * uy, c * uy - s * ux
        gap_p = ux * x + uy * y - numbers[e + 2] - margin
        rate_p = ux * dx + uy * dy
        step = remaining
        for v in range(vertices, vertices + 3 * n_vertices, 3):
            vx, vy = numbers[v], numbers[v + 1]
            gap = gap_p + bx * vx + by * vy
            if not gap > 0.0:
                step = 0.0
                break
            rate = rate_p + w * (by * vx - bx * vy)
            bend = 0.5 * w * w * numbers[v + 2] + drift
            if not gap + (rate - bend * step) * step > 0.0:
                step = min(step, _first_root(gap, rate, bend))
                if step <= best:
                    break
        if step > best:
            best = step
            if best >= remaining:
                break
    return best


@borrowing
def _robot_axes_step(
    numbers: FloatArray,
    index: IntArray,
    r: int,
    o: int,
    x: float,
    y: float,
    c: float,
    s: float,
    dx: float,
    dy: float,
    w: float,
    speed: float,
    drift: float,
    remaining: float,
) -> float:
    """Longest time for which one axis of the moving robot piece, turning with it, surely separates the piece.

    The gap of an obstacle vertex q on an axis u(t) is f = u(t).(q - p(t)) - offset, with
    f'' = -w^2 u.(q - p) - 2 w u_perp.p' - u.p'', bounded below by
    -(w^2 (|q - p(0)| + |p'| remaining) + 2 |w| |p'| + |p''|). `speed` is what |p'| is at most.
    """
    margin = numbers[1]
    axes, n_axes = index[r + 2], index[r + 3]
    first, n_corners = index[o], index[o + 1]
    if n_corners == 0:
        return 0.0
    bend_p = 0.5 * w * w * speed * remaining + abs(w) * speed + drift
    best = 0.0
    for e in range(axes, axes + 3 * n_axes, 3):
        ux, uy = c * numbers[e] - s * numbers[e + 1], s * numbers[e] + c * numbers[e + 1]
        rate_p = -ux * dx - uy * dy
        gap_p = -numbers[e + 2] - margin
        step = remaining
        for k in range(first, first + 2 * n_corners, 2):
            qx, qy = numbers[k] - x, numbers[k + 1] - y
            gap = gap_p + ux * qx + uy * qy
            if not gap > 0.0:
                step = 0.0
                break
            rate = rate_p + w * (ux * qy - uy * qx)
            bend = bend_p + 0.5 * w * w * (abs(qx) + abs(qy))
            if not gap + (rate - bend * step) * step > 0.0:
                step = min(step, _first_root(gap, rate, bend))
                if step <= best:
                    break
        if step > best:
            best = step
            if best >= remaining:
                break
    return best


@borrowing
def _pair_fraction(
    numbers: FloatArray,
    index: IntArray,
    r: int,
    o: int,
    x: float,
    y: float,
    theta: float,
    dx: float,
    dy: float,
    w: float,
    limit: float,
) -> float:
    """The part of [0, limit] in which a robot piece surely stays off an obstacle piece."""
    speed = abs(dx) + abs(dy)
    shortest = 1e-3 * numbers[0] / (speed + numbers[2] * abs(w) + 1e-300)
    t = 0.0
    for _ in range(_MAX_STEPS):
        px, py, angle = x + t * dx, y + t * dy, theta + t * w
        c, s = math.cos(angle), math.sin(angle)
        remaining = limit - t
        step = _obstacle_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, 0.0, remaining)
        if step < remaining:
            turning = _robot_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, speed, 0.0, remaining)
            step = max(step, turning)
        if step >= remaining:
            return limit
        t += step
        if step < shortest:
            break
    return t


@borrowing
def _axis_step(
    numbers: FloatArray,
    index: IntArray,
    r: int,
    axis: tuple[float, float, float],
    x: float,
    y: float,
    c: float,
    s: float,
    dx: float,
    dy: float,
    w: float,
    drift: float,
    remaining: float,
) -> float:
    """For how long one axis surely separates the moving robot piece, as in `_obstacle_axes_step`."""
    ux, uy, offset = axis
    bx, by = c * ux + s * uy, c * uy - s * ux
    step = remaining
    for v in range(index[r], index[r] + 3 * index[r + 1], 3):
        vx, vy = numbers[v], numbers[v + 1]
        gap = ux * x + uy * y - offset - numbers[1] + bx * vx + by * vy
        if not gap > 0.0:
            return 0.0
        rate = ux * dx + uy * dy + w * (by * vx - bx * vy)
        bend = 0.5 * w * w * numbers[v + 2] + drift
        if not gap + (rate - bend * step) * step > 0.0:
            step = min(step, _first_root(gap, rate, bend))
    return step


@borrowing
def _tip_fraction(
    numbers: FloatArray,
    index: IntArray,
    r: int,
    o: int,
    x: float,
    y: float,
    theta: float,
    dx: float,
    dy: float,
    w: float,
    t: float,
    limit: float,
) -> float:
    """`_pair_fraction` from t on, where it ended: by the axis across the shortest way, too.

    Where a vertex passes a vertex, the axes along the edges give out long before they touch.
    """
    speed = abs(dx) + abs(dy)
    shortest = 1e-3 * numbers[0] / (speed + numbers[2] * abs(w) + 1e-300)
    for _ in range(_MAX_STEPS):
        px, py, angle = x + t * dx, y + t * dy, theta + t * w
        c, s = math.cos(angle), math.sin(angle)
        remaining = limit - t
        axis = _axis_across(numbers, index, r, o, px, py, c, s)
        step = _axis_step(numbers, index, r, axis, px, py, c, s, dx, dy, w, 0.0, remaining)
        if step < remaining:
            fixed = _obstacle_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, 0.0, remaining)
            turning = _robot_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, speed, 0.0, remaining)
            step = max(step, fixed, turning)
        if step >= remaining:
            return limit
        if step < shortest:
            break
        t += step
    return t


@borrowing
def _motion_fraction(
    numbers: FloatArray,
    index: IntArray,
    x: float,
    y: float,
    theta: float,
    dx: float,
    dy: float,
    w: float,
    whole: bool,
) -> float:
    """Certified part of the motion by (dx, dy, w) from a pose; with `whole`, 0 unless it is all of it."""
    if dx == 0.0 and dy == 0.0 and w == 0.0:
        return 1.0 if _pose_free(numbers, index, x, y, theta) else 0.0
    x, y = x - numbers[3], y - numbers[4]
    if not (abs(x) + abs(y) + abs(dx) + abs(dy) < _MAX_COORDINATE and abs(theta) + abs(w) < _MAX_ANGLE):
        return 0.0
    # More than a pose's, so that rounding never culls more here than there.
    reach = numbers[2] + 2.0 * numbers[1]
    n_robot, box = index[0], index[2]
    rows = HEADER + ROW * n_robot
    xmin, xmax = min(x, x + dx) - reach, max(x, x + dx) + reach
    ymin, ymax = min(y, y + dy) - reach, max(y, y + dy) + reach
    end = _pieces_met(numbers, index, xmin, ymin, xmax, ymax)
    fraction = 1.0
    node = int(ZERO)
    while node >= 0:
        first, last, at = index[6], end, -1
        if node < index[3]:
            first, last, at = next_run(numbers, index, node, x, y, fraction * dx, fraction * dy, reach)
        node = at
        for i in range(first, last):
            b = box + 4 * i
            if xmin > numbers[b + 2] or xmax < numbers[b] or ymin > numbers[b + 3] or ymax < numbers[b + 1]:
                continue
            o = rows + ROW * i
            if _disc_clear(numbers, index, o, x, y, dx, dy, reach):
                continue
            for r in range(HEADER, rows, ROW):
                t = _pair_fraction(numbers, index, r, o, x, y, theta, dx, dy, w, fraction)
                if t < fraction and index[r + 4] & index[o + 4]:
                    t = _tip_fraction(numbers, index, r, o, x, y, theta, dx, dy, w, t, fraction)
                if t < fraction:
                    if whole:
                        return 0.0
                    fraction = t
    return fraction


@borrowing
def _turn(a: FloatArray, b: FloatArray) -> float:
    """The short way from a's angle to b's, exactly antisymmetric; half a turn keeps the sign of b - a."""
    if a.shape[0] < 3:
        return 0.0
    turn = b[2] - a[2]
    if abs(turn) <= math.pi:
        return turn
    if not abs(turn) < _MAX_ANGLE:
        return np.nan  # rounding of such angles could hide a collision; the motion is refused
    return turn - 2.0 * math.pi * np.rint(turn / (2.0 * math.pi))


@borrowing
def _ordered(a: FloatArray, b: FloatArray) -> bool:
    for i in range(a.shape[0]):
        if a[i] != b[i]:
            return a[i] < b[i]
    return True


@borrowing
def motion_fraction(a: FloatArray, b: FloatArray, geometry: Geometry) -> float:
    """Certified free fraction of the straight motion a -> b: every pose up to it is free; 1.0 = all of it.

    Position and angle (the short way round) are interpolated linearly. 0.0 when a itself is not free.
    """
    if geometry[1][ENTRY] != 0:
        return call(geometry[1][ENTRY], FRACTION, a, b, geometry[0], geometry[1])
    theta = a[2] if a.shape[0] > 2 else 0.0
    return _motion_fraction(
        geometry[0], geometry[1], a[0], a[1], theta, b[0] - a[0], b[1] - a[1], _turn(a, b), bool(NO)
    )


@borrowing
def motion_free(a: FloatArray, b: FloatArray, geometry: Geometry) -> bool:
    """Whether the straight motion between a and b is certified free: never wrongly True, and symmetric.

    Equal to `motion_fraction(...) == 1.0` except where the gap comes within rounding of the margin, because
    this one always runs from the lexicographically smaller end.
    """
    if not _ordered(a, b):
        a, b = b, a
    if geometry[1][ENTRY] != 0:
        return call(geometry[1][ENTRY], WHOLE, a, b, geometry[0], geometry[1]) == 1.0
    theta = a[2] if a.shape[0] > 2 else 0.0
    return (
        _motion_fraction(
            geometry[0], geometry[1], a[0], a[1], theta, b[0] - a[0], b[1] - a[1], _turn(a, b), bool(YES)
        )
        == 1.0
    )


@njit(cache=True)
def motions_free(starts: FloatArray, ends: FloatArray, geometry: Geometry) -> BoolArray:
    """`motion_free` for each pair of rows of two arrays (n, d): bool array (n,)."""
    free = np.empty(starts.shape[0], dtype=np.bool_)
    for i in range(starts.shape[0]):
        free[i] = motion_free(starts[i], ends[i], geometry)
    return free


@njit(cache=True)
def motion_fractions(starts: FloatArray, ends: FloatArray, geometry: Geometry) -> FloatArray:
    """`motion_fraction` for each pair of rows of two arrays (n, d): float64 array (n,)."""
    fractions = np.empty(starts.shape[0])
    for i in range(starts.shape[0]):
        fractions[i] = motion_fraction(starts[i], ends[i], geometry)
    return fractions


@borrowing
def _point_segment_squared(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    ux, uy, wx, wy = bx - ax, by - ay, px - ax, py - ay
    length = ux * ux + uy * uy
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, (ux * wx + uy * wy) / length))
    ex, ey = wx - t * ux, wy - t * uy
    return ex * ex + ey * ey


@borrowing
def _pair_distance(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> float:
    """Distance between two disjoint convex pieces."""
    if index[o + 1] == 0:
        vertices, e = index[r], index[o + 2]
        bx, by = c * numbers[e] + s * numbers[e + 1], c * numbers[e + 1] - s * numbers[e]
        lowest = np.inf
        for v in range(vertices, vertices + 3 * index[r + 1], 3):
            lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
        return max(0.0, numbers[e] * x + numbers[e + 1] * y - numbers[e + 2] + lowest)
    vertices, corners = index[r], index[o]
    last_vertex, last_corner = vertices + 3 * (index[r + 1] - 1), corners + 2 * (index[o + 1] - 1)
    smallest = np.inf
    ux, uy = numbers[last_vertex], numbers[last_vertex + 1]
    ux, uy = x + c * ux - s * uy, y + s * ux + c * uy
    for v in range(vertices, last_vertex + 3, 3):
        vx, vy = x + c * numbers[v] - s * numbers[v + 1], y + s * numbers[v] + c * numbers[v + 1]
        kx, ky = numbers[last_corner], numbers[last_corner + 1]
        for m in range(corners, last_corner + 2, 2):
            mx, my = numbers[m], numbers[m + 1]
            smallest = min(smallest, _point_segment_squared(vx, vy, kx, ky, mx, my))
            smallest = min(smallest, _point_segment_squared(mx, my, ux, uy, vx, vy))
            kx, ky = mx, my
        ux, uy = vx, vy
    return math.sqrt(smallest)


@borrowing
def _box_squared(numbers: FloatArray, b: int, x: float, y: float) -> float:
    """Squared distance from a point to a box."""
    gap_x = max(numbers[b] - x, x - numbers[b + 2], 0.0)
    gap_y = max(numbers[b + 1] - y, y - numbers[b + 3], 0.0)
    return gap_x * gap_x + gap_y * gap_y


@borrowing
def _run_distance(
    numbers: FloatArray,
    index: IntArray,
    first: int,
    last: int,
    x: float,
    y: float,
    c: float,
    s: float,
    smallest: float,
) -> float:
    """The smallest distance to a run of pieces, or `smallest` if that is less."""
    radius, box = numbers[2], index[2]
    rows = HEADER + ROW * index[0]
    for i in range(last - 1, first - 1, -1):  # the half-planes come last and bound everything else
        within = smallest + radius
        o = rows + ROW * i
        if _box_squared(numbers, box + 4 * i, x, y) >= within * within or _disc_clear(
            numbers, index, o, x, y, 0.0, 0.0, within
        ):
            continue
        for r in range(HEADER, rows, ROW):
            smallest = min(smallest, _pair_distance(numbers, index, r, o, x, y, c, s))
    return smallest


@borrowing
def _tree_distance(
    numbers: FloatArray, index: IntArray, x: float, y: float, c: float, s: float, smallest: float
) -> float:
    """The smallest distance to a piece of the tree, or `smallest` if that is less."""
    n, row, boxes = index[3], index[4], index[5]
    node = 0
    while index[row + 3 * node + 2] == 0:  # down to a leaf nearby, so that most nodes are too far then
        left, right = node + 1, index[row + 3 * (node + 1)]
        nearer = _box_squared(numbers, boxes + 4 * left, x, y) <= _box_squared(
            numbers, boxes + 4 * right, x, y
        )
        node = left if nearer else right
    at = row + 3 * node
    smallest = _run_distance(numbers, index, index[at + 1], index[at + 2], x, y, c, s, smallest)
    node = 0
    while node < n:
        at, within = row + 3 * node, smallest + numbers[2]
        if _box_squared(numbers, boxes + 4 * node, x, y) >= within * within:
            node = index[at]
            continue
        node += 1
        if index[at + 2] > 0:
            smallest = _run_distance(numbers, index, index[at + 1], index[at + 2], x, y, c, s, smallest)
    return smallest


@borrowing
def _pose_clearance(numbers: FloatArray, index: IntArray, x: float, y: float, theta: float) -> float:
    if not _pose_free(numbers, index, x, y, theta):
        return 0.0
    x, y = x - numbers[3], y - numbers[4]
    c, s = math.cos(theta), math.sin(theta)
    smallest = _run_distance(numbers, index, index[6], index[1], x, y, c, s, np.inf)
    return _tree_distance(numbers, index, x, y, c, s, smallest) if index[3] > 0 else smallest


@borrowing
def pose_clearance(q: FloatArray, geometry: Geometry) -> float:
    """Distance from the robot at pose q to the nearest obstacle or bound; 0.0 where the pose is not free."""
    if geometry[1][ENTRY] != 0:
        return call(geometry[1][ENTRY], CLEARANCE, q, q, geometry[0], geometry[1])
    return _pose_clearance(geometry[0], geometry[1], q[0], q[1], q[2] if q.shape[0] > 2 else 0.0)


@njit(cache=True)
def pose_clearances(qs: FloatArray, geometry: Geometry) -> FloatArray:
    """`pose_clearance` for each row of qs (n, d): float64 array (n,)."""
    clearances = np.empty(qs.shape[0])
    if geometry[1][ENTRY] != 0:
        for i in range(qs.shape[0]):
            clearances[i] = pose_clearance(qs[i], geometry)
        return clearances
    turns = qs.shape[1] > 2
    for i in range(qs.shape[0]):
        clearances[i] = _pose_clearance(
            geometry[0], geometry[1], qs[i, 0], qs[i, 1], qs[i, 2] if turns else 0.0
        )
    return clearances
