"""Collision of a rigid planar robot with convex pieces: poses, certified motions, clearance.

The robot and the obstacles are unions of convex pieces; each side of the bounds is one more piece, a
half-plane. All of it is packed (`geometry.convex.pack`) into a `Geometry`: one float64 and one int64 array,
the same type for every robot.

Layout. `index = [n_robot, n_obstacle, boxes, rows of the robot pieces ..., rows of the obstacle pieces ...]`,
where a row is (first vertex, vertices, first axis, axes) and `boxes` is where the bounding boxes of the
obstacle pieces (xmin, ymin, xmax, ymax) start in `numbers`. `numbers = [tolerance, margin, radius, ...]`; an
axis is (nx, ny, offset) with an outward unit normal and max n.v over the piece's vertices; a robot vertex is
(x, y, norm) in the body frame, an obstacle vertex (x, y). A half-plane has one axis and no vertex, a point no
axis, a segment two opposite axes.

A piece pair is *separated* by a gap g > 0 when an axis of either piece keeps the other one g away from its
supporting line. A pose is free iff every pair is separated by more than `tolerance`. A motion is certified
against `margin`, a little more than `tolerance` (by more than all rounding), so that every pose of a
certified motion is free.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Geometry = tuple[FloatArray, IntArray]

HEADER = 3
"""Entries before the first row in `index`, and before the first vertex in `numbers`."""
ROW = 4
"""Entries of one piece's row in `index`."""

_MAX_STEPS = 200
_MAX_COORDINATE = 1e12
_MAX_ANGLE = 1e4


@njit(cache=True)
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


@njit(cache=True)
def _separated(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> bool:
    """Whether a robot piece at (x, y), rotated by (cos, sin), is more than the tolerance off a piece."""
    tolerance = numbers[0]
    vertices, n_vertices, axes, n_axes = index[r], index[r + 1], index[r + 2], index[r + 3]
    first = index[o + 2]
    for e in range(first, first + 3 * index[o + 3], 3):
        ux, uy = numbers[e], numbers[e + 1]
        bx, by = c * ux + s * uy, c * uy - s * ux
        lowest = np.inf
        for v in range(vertices, vertices + 3 * n_vertices, 3):
            lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
        if ux * x + uy * y - numbers[e + 2] + lowest > tolerance:
            return True
    first, n_corners = index[o], index[o + 1]
    if n_corners == 0:
        return False
    for e in range(axes, axes + 3 * n_axes, 3):
        ux, uy = c * numbers[e] - s * numbers[e + 1], s * numbers[e] + c * numbers[e + 1]
        lowest = np.inf
        for w in range(first, first + 2 * n_corners, 2):
            lowest = min(lowest, ux * numbers[w] + uy * numbers[w + 1])
        if lowest - ux * x - uy * y - numbers[e + 2] > tolerance:
            return True
    return False


@njit(cache=True)
def _pose_free(numbers: FloatArray, index: IntArray, x: float, y: float, theta: float) -> bool:
    # NaN and infinity fail this comparison, whatever the culling below makes of them.
    if not (abs(x) < _MAX_COORDINATE and abs(y) < _MAX_COORDINATE and abs(theta) < _MAX_ANGLE):
        return False
    reach = numbers[2] + numbers[1]
    n_robot, n_obstacle, box = index[0], index[1], index[2]
    rows = HEADER + ROW * n_robot
    c, s, turned = 1.0, 0.0, theta == 0.0
    for i in range(n_obstacle):
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


@njit(cache=True)
def pose_free(q: FloatArray, geometry: Geometry) -> bool:
    """Whether the pose q, (x, y) or (x, y, theta), is free (not if non-finite or turned by over 1e4)."""
    return _pose_free(geometry[0], geometry[1], q[0], q[1], q[2] if q.shape[0] > 2 else 0.0)


@njit(cache=True)
def poses_free(qs: FloatArray, geometry: Geometry) -> BoolArray:
    """`pose_free` for each row of qs (n, d): bool array (n,)."""
    free = np.empty(qs.shape[0], dtype=np.bool_)
    turns = qs.shape[1] > 2
    for i in range(qs.shape[0]):
        free[i] = _pose_free(geometry[0], geometry[1], qs[i, 0], qs[i, 1], qs[i, 2] if turns else 0.0)
    return free


@njit(cache=True)
def _first_root(gap: float, rate: float, bend: float) -> float:
    """Smallest positive root of gap + rate t - bend t^2, for gap > 0 and bend >= 0, without cancellation."""
    root = math.sqrt(rate * rate + 4.0 * bend * gap)
    if rate > 0.0:
        return (rate + root) / (2.0 * bend)
    return 2.0 * gap / (root - rate)


@njit(cache=True)
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
    remaining: float,
) -> float:
    """Longest time for which one axis of the obstacle piece surely separates the moving robot piece.

    The gap of a robot vertex v on a fixed axis u is u.p(t) + u.R(theta(t))v - offset; its second derivative
    is at least -w^2 |v|, so a parabola bounds it from below.
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
            bend = 0.5 * w * w * numbers[v + 2]
            if not gap + (rate - bend * step) * step > 0.0:
                step = min(step, _first_root(gap, rate, bend))
                if step <= best:
                    break
        if step > best:
            best = step
            if best >= remaining:
                break
    return best


@njit(cache=True)
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
    remaining: float,
) -> float:
    """Longest time for which one axis of the moving robot piece, turning with it, surely separates the piece.

    The gap of an obstacle vertex q on an axis u(t) is f = u(t).(q - p(t)) - offset, with
    f'' = -w^2 u.(q - p) - 2 w u_perp.p', bounded below by -(w^2 (|q - p(0)| + |p'| remaining) + 2 |w| |p'|).
    """
    margin = numbers[1]
    axes, n_axes = index[r + 2], index[r + 3]
    first, n_corners = index[o], index[o + 1]
    if n_corners == 0:
        return 0.0
    speed = abs(dx) + abs(dy)
    bend_p = 0.5 * w * w * speed * remaining + abs(w) * speed
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


@njit(cache=True)
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
    shortest = 1e-3 * numbers[0] / (abs(dx) + abs(dy) + numbers[2] * abs(w) + 1e-300)
    t = 0.0
    for _ in range(_MAX_STEPS):
        px, py, angle = x + t * dx, y + t * dy, theta + t * w
        c, s = math.cos(angle), math.sin(angle)
        remaining = limit - t
        step = _obstacle_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, remaining)
        if step < remaining:
            step = max(step, _robot_axes_step(numbers, index, r, o, px, py, c, s, dx, dy, w, remaining))
        if step >= remaining:
            return limit
        t += step
        if step < shortest:
            break
    return t


@njit(cache=True)
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
    if not (abs(x) + abs(y) + abs(dx) + abs(dy) < _MAX_COORDINATE and abs(theta) + abs(w) < _MAX_ANGLE):
        return 0.0
    reach = (
        numbers[2] + 2.0 * numbers[1]
    )  # more than a pose's, so that rounding never culls more here than there
    n_robot, n_obstacle, box = index[0], index[1], index[2]
    rows = HEADER + ROW * n_robot
    xmin, xmax = min(x, x + dx) - reach, max(x, x + dx) + reach
    ymin, ymax = min(y, y + dy) - reach, max(y, y + dy) + reach
    fraction = 1.0
    for i in range(n_obstacle):
        b = box + 4 * i
        if xmin > numbers[b + 2] or xmax < numbers[b] or ymin > numbers[b + 3] or ymax < numbers[b + 1]:
            continue
        o = rows + ROW * i
        if _disc_clear(numbers, index, o, x, y, dx, dy, reach):
            continue
        for r in range(HEADER, rows, ROW):
            t = _pair_fraction(numbers, index, r, o, x, y, theta, dx, dy, w, fraction)
            if t < fraction:
                if whole:
                    return 0.0
                fraction = t
    return fraction


@njit(cache=True)
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


@njit(cache=True)
def _ordered(a: FloatArray, b: FloatArray) -> bool:
    for i in range(a.shape[0]):
        if a[i] != b[i]:
            return a[i] < b[i]
    return True


@njit(cache=True)
def motion_fraction(a: FloatArray, b: FloatArray, geometry: Geometry) -> float:
    """Certified free fraction of the straight motion a -> b: every pose up to it is free; 1.0 = all of it.

    Position and angle (the short way round) are interpolated linearly. 0.0 when a itself is not free.
    """
    theta = a[2] if a.shape[0] > 2 else 0.0
    return _motion_fraction(
        geometry[0], geometry[1], a[0], a[1], theta, b[0] - a[0], b[1] - a[1], _turn(a, b), False
    )


@njit(cache=True)
def motion_free(a: FloatArray, b: FloatArray, geometry: Geometry) -> bool:
    """Whether the straight motion between a and b is certified free: never wrongly True, and symmetric.

    Equal to `motion_fraction(...) == 1.0` except where the gap comes within rounding of the margin, because
    this one always runs from the lexicographically smaller end.
    """
    if not _ordered(a, b):
        a, b = b, a
    theta = a[2] if a.shape[0] > 2 else 0.0
    return (
        _motion_fraction(
            geometry[0], geometry[1], a[0], a[1], theta, b[0] - a[0], b[1] - a[1], _turn(a, b), True
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


@njit(cache=True)
def _point_segment_squared(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    ux, uy, wx, wy = bx - ax, by - ay, px - ax, py - ay
    length = ux * ux + uy * uy
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, (ux * wx + uy * wy) / length))
    ex, ey = wx - t * ux, wy - t * uy
    return ex * ex + ey * ey


@njit(cache=True)
def _pair_distance(
    numbers: FloatArray, index: IntArray, r: int, o: int, x: float, y: float, c: float, s: float
) -> float:
    """Distance between two disjoint convex pieces: vertices against edges, both ways."""
    vertices, n_vertices = index[r], index[r + 1]
    first, n_corners = index[o], index[o + 1]
    if n_corners == 0:
        e = index[o + 2]
        bx, by = c * numbers[e] + s * numbers[e + 1], c * numbers[e + 1] - s * numbers[e]
        lowest = np.inf
        for v in range(vertices, vertices + 3 * n_vertices, 3):
            lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
        return max(0.0, numbers[e] * x + numbers[e + 1] * y - numbers[e + 2] + lowest)
    smallest = np.inf
    for i in range(n_vertices):
        v, n = vertices + 3 * i, vertices + 3 * ((i + 1) % n_vertices)
        vx, vy = x + c * numbers[v] - s * numbers[v + 1], y + s * numbers[v] + c * numbers[v + 1]
        nx, ny = x + c * numbers[n] - s * numbers[n + 1], y + s * numbers[n] + c * numbers[n + 1]
        for j in range(n_corners):
            k, m = first + 2 * j, first + 2 * ((j + 1) % n_corners)
            kx, ky, mx, my = numbers[k], numbers[k + 1], numbers[m], numbers[m + 1]
            smallest = min(smallest, _point_segment_squared(vx, vy, kx, ky, mx, my))
            smallest = min(smallest, _point_segment_squared(kx, ky, vx, vy, nx, ny))
    return math.sqrt(smallest)


@njit(cache=True)
def _pose_clearance(numbers: FloatArray, index: IntArray, x: float, y: float, theta: float) -> float:
    if not _pose_free(numbers, index, x, y, theta):
        return 0.0
    radius = numbers[2]
    n_robot, n_obstacle, box = index[0], index[1], index[2]
    rows = HEADER + ROW * n_robot
    c, s = math.cos(theta), math.sin(theta)
    smallest = np.inf
    for i in range(n_obstacle - 1, -1, -1):  # the half-planes come last and bound everything else
        b = box + 4 * i
        gap_x = max(numbers[b] - x, x - numbers[b + 2], 0.0)
        gap_y = max(numbers[b + 1] - y, y - numbers[b + 3], 0.0)
        within = smallest + radius
        if gap_x * gap_x + gap_y * gap_y >= within * within:
            continue
        for r in range(HEADER, rows, ROW):
            smallest = min(smallest, _pair_distance(numbers, index, r, rows + ROW * i, x, y, c, s))
    return smallest


@njit(cache=True)
def pose_clearance(q: FloatArray, geometry: Geometry) -> float:
    """Distance from the robot at pose q to the nearest obstacle or bound; 0.0 where the pose is not free."""
    return _pose_clearance(geometry[0], geometry[1], q[0], q[1], q[2] if q.shape[0] > 2 else 0.0)


@njit(cache=True)
def pose_clearances(qs: FloatArray, geometry: Geometry) -> FloatArray:
    """`pose_clearance` for each row of qs (n, d): float64 array (n,)."""
    clearances = np.empty(qs.shape[0])
    turns = qs.shape[1] > 2
    for i in range(qs.shape[0]):
        clearances[i] = _pose_clearance(
            geometry[0], geometry[1], qs[i, 0], qs[i, 1], qs[i, 2] if turns else 0.0
        )
    return clearances
