"""Collision of a planar linkage, bodies on a tree of joints, with convex pieces: poses, motions, clearance.

The packed form is that of `guided_gym.kernels.collision` and a table of the joints behind it. Along a
straight motion every joint's angle is linear in t, and so is each link's heading, the sum of those before it.
A link's origin is p(t) = sum of R(heading_j(t)) o_j over the joints before it, so |p''| is at most the sum of
rate_j^2 |o_j|, and the parabolas that bound the gaps of a rigid body bound those of a link, with this more.
Each pair of a link and an obstacle is certified with its own bound; two links of the robot likewise, one of
them seen from the other, where the rates are differences.

Table. From `index[TABLE]`: joints, bodies, pairs of bodies, base (1: the first two coordinates move it),
where the numbers of the joints (offset x, y, heading, length of the offset), of the bodies (centre x, y,
radius) and of the coordinates (low, high) start, and where the robot pieces start once more, as obstacles in
their own frame; the joint of the tool and where its numbers (x, y) start. Then a row for each joint (parent
or -1, coordinate, periodic), for each body (joint, first row of its pieces, end of them) and for each pair
that may collide (its bodies).
"""
# mypy: disable-error-code="misc,no-any-return,no-untyped-call"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import carray, cfunc, njit  # type: ignore[attr-defined]

from guided_gym.kernels.collision import (
    HEADER,
    ROW,
    TABLE,
    _axis_across,
    _axis_step,
    _box_squared,
    _disc_clear,
    _obstacle_axes_step,
    _pair_distance,
    _pieces_met,
    _robot_axes_step,
    _separated,
    next_run,
)
from guided_gym.kernels.foreign import CLEARANCE, FRACTION, POSE_FREE, SIGNATURE, TOOL_X, TOOL_Y
from guided_gym.kernels.packing import (
    BASE,
    BODIES,
    BODY_NUMBERS,
    JOINT_NUMBERS,
    JOINTS,
    LIMITS,
    OWN_ROWS,
    PAIRS,
    TABLE_HEADER,
    TOOL,
    TOOL_NUMBERS,
)
from guided_gym.kernels.plain import borrowing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

JOINT_ROW, BODY_ROW, PAIR_ROW = 3, 3, 2
JOINT_SIZE, BODY_SIZE = 4, 3

HEADING, RATE, X, Y, COS, SIN, VX, VY, DRIFT, SPEED = range(10)
STATE = 10
"""What is known of a joint's frame: where it is, how it moves, half of |p''| and |p'| at most."""

_WORLD = -1
_MAX_STEPS = 200
_MAX_COORDINATE = 1e12
_MAX_ANGLE = 1e4
_SLACK = 1e-9
"""By so much (radians) may a joint be beyond its limits: more than the rounding of interpolation."""


@borrowing
def _joint_row(index: IntArray, joint: int) -> int:
    return index[TABLE] + TABLE_HEADER + JOINT_ROW * joint


@borrowing
def _body_row(index: IntArray, body: int) -> int:
    table = index[TABLE]
    return table + TABLE_HEADER + JOINT_ROW * index[table + JOINTS] + BODY_ROW * body


@borrowing
def _pair_row(index: IntArray, pair: int) -> int:
    table = index[TABLE]
    return _body_row(index, index[table + BODIES]) + PAIR_ROW * pair


@borrowing
def _known(q: FloatArray, d: FloatArray, index: IntArray) -> bool:
    """Whether all coordinates and changes are numbers that rounding does not blur."""
    base = 2 * index[index[TABLE] + BASE]
    for k in range(q.size):
        most = _MAX_COORDINATE if k < base else _MAX_ANGLE
        if not abs(q[k]) + abs(d[k]) < most:
            return False
    return True


@borrowing
def _frames(numbers: FloatArray, index: IntArray, q: FloatArray, d: FloatArray, state: FloatArray) -> None:
    """Where the joints' frames are at q and how they move along the motion by d; (joints, STATE), written."""
    table = index[TABLE]
    base_x, base_y, base_vx, base_vy = -numbers[3], -numbers[4], 0.0, 0.0
    if index[table + BASE] > 0:
        base_x, base_y, base_vx, base_vy = base_x + q[0], base_y + q[1], d[0], d[1]
    base_speed = math.hypot(base_vx, base_vy)
    for j in range(index[table + JOINTS]):
        row, at = _joint_row(index, j), index[table + JOINT_NUMBERS] + JOINT_SIZE * j
        parent, coordinate = index[row], index[row + 1]
        ox, oy = numbers[at], numbers[at + 1]
        if parent < 0:
            heading, rate = 0.0, 0.0
            x, y, vx, vy, drift, speed = base_x + ox, base_y + oy, base_vx, base_vy, 0.0, base_speed
        else:
            before = state[parent]
            heading, rate = before[HEADING], before[RATE]
            px, py = before[COS] * ox - before[SIN] * oy, before[SIN] * ox + before[COS] * oy
            x, y = before[X] + px, before[Y] + py
            vx, vy = before[VX] - rate * py, before[VY] + rate * px
            drift = before[DRIFT] + 0.5 * rate * rate * numbers[at + 3]
            speed = before[SPEED] + abs(rate) * numbers[at + 3]
        heading, rate = heading + numbers[at + 2] + q[coordinate], rate + d[coordinate]
        own = state[j]
        own[HEADING], own[RATE], own[X], own[Y] = heading, rate, x, y
        own[COS], own[SIN] = math.cos(heading), math.sin(heading)
        own[VX], own[VY], own[DRIFT], own[SPEED] = vx, vy, drift, speed


@borrowing
def _place(
    numbers: FloatArray, index: IntArray, state: FloatArray, seen_from: int, joint: int, t: float
) -> tuple[float, float, float, float, float, float]:
    """A joint's frame at time t of the motion, seen from another's (or the world): x, y, cos, sin, velocity.

    Seen from a frame that turns, headings and rates are differences, and what lies before both drops out.
    """
    own_heading, own_rate = 0.0, 0.0
    if seen_from >= 0:
        own_heading, own_rate = state[seen_from, HEADING], state[seen_from, RATE]
    x, y, vx, vy = 0.0, 0.0, 0.0, 0.0
    at, other = joint, seen_from
    while at != other:
        # Parents come before their children, so the larger of the two is not before the other.
        sign, moved = (1.0, at) if at > other else (-1.0, other)
        parent = index[_joint_row(index, moved)]
        offset = index[index[TABLE] + JOINT_NUMBERS] + JOINT_SIZE * moved
        heading, rate = -own_heading, -own_rate
        if parent >= 0:
            heading, rate = heading + state[parent, HEADING], rate + state[parent, RATE]
        elif seen_from < 0:
            break
        c, s = math.cos(heading + t * rate), math.sin(heading + t * rate)
        ox, oy = sign * numbers[offset], sign * numbers[offset + 1]
        px, py = c * ox - s * oy, s * ox + c * oy
        x, y, vx, vy = x + px, y + py, vx - rate * py, vy + rate * px
        if at > other:
            at = parent
        else:
            other = parent
    if seen_from < 0:  # `at` is the first joint, whose frame does not turn about anything
        x, y = x + state[at, X] + t * state[at, VX], y + state[at, Y] + t * state[at, VY]
        vx, vy = vx + state[at, VX], vy + state[at, VY]
    angle = state[joint, HEADING] - own_heading + t * (state[joint, RATE] - own_rate)
    return x, y, math.cos(angle), math.sin(angle), vx, vy


@borrowing
def _bounds_between(
    numbers: FloatArray, index: IntArray, state: FloatArray, seen_from: int, joint: int
) -> tuple[float, float]:
    """Half of |p''| and |p'| at most, of a joint's origin seen from another joint's frame."""
    own_rate, drift, speed = state[seen_from, RATE], 0.0, 0.0
    at, other = joint, seen_from
    while at != other:
        moved = max(at, other)
        parent = index[_joint_row(index, moved)]
        rate = (state[parent, RATE] if parent >= 0 else 0.0) - own_rate
        length = numbers[index[index[TABLE] + JOINT_NUMBERS] + JOINT_SIZE * moved + 3]
        drift, speed = drift + 0.5 * rate * rate * length, speed + abs(rate) * length
        if at > other:
            at = parent
        else:
            other = parent
    return drift, speed


@borrowing
def _pair_fraction(
    numbers: FloatArray,
    index: IntArray,
    state: FloatArray,
    r: int,
    o: int,
    seen_from: int,
    joint: int,
    radius: float,
    limit: float,
) -> float:
    """The part of [0, limit] in which a piece of a link surely stays off a piece that stands still.

    That is an obstacle's piece, or one of another link in whose frame everything is seen.
    """
    if seen_from < 0:
        drift, speed, w = state[joint, DRIFT], state[joint, SPEED], state[joint, RATE]
    else:
        drift, speed = _bounds_between(numbers, index, state, seen_from, joint)
        w = state[joint, RATE] - state[seen_from, RATE]
    shortest = 1e-3 * numbers[0] / (speed + radius * abs(w) + 1e-300)
    tips = index[r + 4] & index[o + 4]
    t, across = 0.0, False
    for _ in range(_MAX_STEPS):
        if t == 0.0 and seen_from < 0:
            at = state[joint]
            x, y, c, s, dx, dy = at[X], at[Y], at[COS], at[SIN], at[VX], at[VY]
        else:
            x, y, c, s, dx, dy = _place(numbers, index, state, seen_from, joint, t)
        remaining = limit - t
        step = _obstacle_axes_step(numbers, index, r, o, x, y, c, s, dx, dy, w, drift, remaining)
        if step < remaining:
            turning = _robot_axes_step(numbers, index, r, o, x, y, c, s, dx, dy, w, speed, drift, remaining)
            step = max(step, turning)
        if across and step < remaining:
            axis = _axis_across(numbers, index, r, o, x, y, c, s)
            step = max(step, _axis_step(numbers, index, r, axis, x, y, c, s, dx, dy, w, drift, remaining))
        if step >= remaining:
            return limit
        if step < shortest:
            if across or not tips:
                return t
            across = True  # where a vertex passes a vertex, the axes along the edges give out too soon
            continue
        t += step
    return t


@borrowing
def _body_centre(numbers: FloatArray, index: IntArray, state: FloatArray, body: int) -> tuple[float, float]:
    joint = index[_body_row(index, body)]
    at = index[index[TABLE] + BODY_NUMBERS] + BODY_SIZE * body
    c, s, ox, oy = state[joint, COS], state[joint, SIN], numbers[at], numbers[at + 1]
    return state[joint, X] + c * ox - s * oy, state[joint, Y] + s * ox + c * oy


@borrowing
def _body_radius(numbers: FloatArray, index: IntArray, body: int) -> float:
    return numbers[index[index[TABLE] + BODY_NUMBERS] + BODY_SIZE * body + 2]


@borrowing
def _bulge(numbers: FloatArray, index: IntArray, state: FloatArray, body: int) -> float:
    """By how much the path of a body's centre may leave the straight line between its ends at most."""
    joint = index[_body_row(index, body)]
    at = index[index[TABLE] + BODY_NUMBERS] + BODY_SIZE * body
    rate = state[joint, RATE]
    return 0.25 * (state[joint, DRIFT] + 0.5 * rate * rate * math.hypot(numbers[at], numbers[at + 1]))


# Poses ------------------------------------------------------------------------------------------------------


@borrowing
def _within_limits(numbers: FloatArray, index: IntArray, q: FloatArray) -> bool:
    table = index[TABLE]
    for j in range(index[table + JOINTS]):
        row = _joint_row(index, j)
        k = index[row + 1]
        at = index[table + LIMITS] + 2 * k
        if index[row + 2] == 0 and not numbers[at] - _SLACK <= q[k] <= numbers[at + 1] + _SLACK:
            return False
    return True


@borrowing
def _body_free(numbers: FloatArray, index: IntArray, state: FloatArray, body: int) -> bool:
    """Whether a body is off all obstacles and bounds."""
    row = _body_row(index, body)
    at = state[index[row]]
    x, y = _body_centre(numbers, index, state, body)
    reach = _body_radius(numbers, index, body) + numbers[1]
    rows, box = HEADER + ROW * index[0], index[2]
    end = _pieces_met(numbers, index, x - reach, y - reach, x + reach, y + reach)
    node = 0
    while node >= 0:
        first, last, after = index[6], end, -1
        if node < index[3]:
            first, last, after = next_run(numbers, index, node, x, y, 0.0, 0.0, reach)
        node = after
        for i in range(first, last):
            b, o = box + 4 * i, rows + ROW * i
            if (
                x - reach > numbers[b + 2]
                or x + reach < numbers[b]
                or y - reach > numbers[b + 3]
                or y + reach < numbers[b + 1]
                or _disc_clear(numbers, index, o, x, y, 0.0, 0.0, reach)
            ):
                continue
            for r in range(index[row + 1], index[row + 2], ROW):
                if not _separated(numbers, index, r, o, at[X], at[Y], at[COS], at[SIN]):
                    return False
    return True


@borrowing
def _apart(numbers: FloatArray, index: IntArray, state: FloatArray, pair: int) -> bool:
    """Whether two bodies of the robot are off each other."""
    at = _pair_row(index, pair)
    one, two = index[at], index[at + 1]
    ax, ay = _body_centre(numbers, index, state, one)
    bx, by = _body_centre(numbers, index, state, two)
    reach = _body_radius(numbers, index, one) + _body_radius(numbers, index, two) + numbers[1]
    if (ax - bx) * (ax - bx) + (ay - by) * (ay - by) > reach * reach:
        return True
    own, row = _body_row(index, one), _body_row(index, two)
    x, y, c, s, _, _ = _place(numbers, index, state, index[own], index[row], 0.0)
    shift = index[index[TABLE] + OWN_ROWS] - HEADER
    for o in range(index[own + 1] + shift, index[own + 2] + shift, ROW):
        for r in range(index[row + 1], index[row + 2], ROW):
            if not _separated(numbers, index, r, o, x, y, c, s):
                return False
    return True


@njit(cache=True)
def _pose_free(numbers: FloatArray, index: IntArray, q: FloatArray) -> bool:
    still = np.zeros(q.size)
    if not (_known(q, still, index) and _within_limits(numbers, index, q)):
        return False
    table = index[TABLE]
    state = np.empty((index[table + JOINTS], STATE))
    _frames(numbers, index, q, still, state)
    for body in range(index[table + BODIES] - 1, -1, -1):
        if not _body_free(numbers, index, state, body):
            return False
    free = True
    for pair in range(index[table + PAIRS]):
        free = free and _apart(numbers, index, state, pair)
    return free


# Motions ----------------------------------------------------------------------------------------------------


@njit(cache=True)
def _changes(index: IntArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """B - a, the short way round where a joint turns freely; exactly antisymmetric."""
    d = b - a
    for j in range(index[index[TABLE] + JOINTS]):
        row = _joint_row(index, j)
        k = index[row + 1]
        if index[row + 2] > 0 and abs(d[k]) > math.pi:
            d[k] -= 2.0 * math.pi * np.rint(d[k] / (2.0 * math.pi))
    return d


@borrowing
def _limited(numbers: FloatArray, index: IntArray, a: FloatArray, d: FloatArray) -> float:
    """The part of the motion in which all joints stay within their limits."""
    table, fraction = index[TABLE], 1.0
    if not _within_limits(numbers, index, a):
        return 0.0
    for j in range(index[table + JOINTS]):
        row = _joint_row(index, j)
        k = index[row + 1]
        at = index[table + LIMITS] + 2 * k
        if index[row + 2] > 0:
            continue
        if a[k] + d[k] > numbers[at + 1] + _SLACK:
            fraction = min(fraction, max(0.0, (numbers[at + 1] - a[k]) / d[k]))
        elif a[k] + d[k] < numbers[at] - _SLACK:
            fraction = min(fraction, max(0.0, (numbers[at] - a[k]) / d[k]))
    return fraction


@borrowing
def _allowed(numbers: FloatArray, index: IntArray, a: FloatArray, d: FloatArray, whole: bool) -> float:
    """The part of the motion by d that its numbers and limits allow; with `whole`, 0 unless it is all."""
    if not _known(a, d, index):
        return 0.0
    fraction = _limited(numbers, index, a, d)
    return 0.0 if whole and fraction < 1.0 else fraction


@borrowing
def _body_fraction(
    numbers: FloatArray,
    index: IntArray,
    state: FloatArray,
    body: int,
    dx: float,
    dy: float,
    fraction: float,
    whole: bool,
) -> float:
    """The part of [0, fraction] in which a body stays off all pieces; its centre moves by (dx, dy) in all."""
    row = _body_row(index, body)
    joint, radius = index[row], _body_radius(numbers, index, body)
    x, y = _body_centre(numbers, index, state, body)
    at = index[index[TABLE] + BODY_NUMBERS] + BODY_SIZE * body
    far = math.hypot(numbers[at], numbers[at + 1]) + radius
    # More than a pose's, so that rounding never culls more here than there.
    reach = radius + _bulge(numbers, index, state, body) + 2.0 * numbers[1]
    rows, box = HEADER + ROW * index[0], index[2]
    xmin, xmax = min(x, x + dx) - reach, max(x, x + dx) + reach
    ymin, ymax = min(y, y + dy) - reach, max(y, y + dy) + reach
    end = _pieces_met(numbers, index, xmin, ymin, xmax, ymax)
    node = 0
    while node >= 0:
        first, last, after = index[6], end, -1
        if node < index[3]:
            first, last, after = next_run(numbers, index, node, x, y, dx, dy, reach)
        node = after
        for i in range(first, last):
            b, o = box + 4 * i, rows + ROW * i
            if xmin > numbers[b + 2] or xmax < numbers[b] or ymin > numbers[b + 3] or ymax < numbers[b + 1]:
                continue
            if _disc_clear(numbers, index, o, x, y, dx, dy, reach):
                continue
            for r in range(index[row + 1], index[row + 2], ROW):
                t = _pair_fraction(numbers, index, state, r, o, _WORLD, joint, far, fraction)
                if t < fraction:
                    if whole:
                        return 0.0
                    fraction = t
    return fraction


@borrowing
def _pair_of_bodies_fraction(
    numbers: FloatArray,
    index: IntArray,
    state: FloatArray,
    pair: int,
    ends: FloatArray,
    fraction: float,
    whole: bool,
) -> float:
    """The part of [0, fraction] in which two bodies of the robot stay off each other."""
    at = _pair_row(index, pair)
    one, two = index[at], index[at + 1]
    ax, ay = _body_centre(numbers, index, state, one)
    bx, by = _body_centre(numbers, index, state, two)
    reach = _body_radius(numbers, index, one) + _body_radius(numbers, index, two) + 2.0 * numbers[1]
    reach += _bulge(numbers, index, state, one) + _bulge(numbers, index, state, two)
    x, y = bx - ax, by - ay
    dx, dy = ends[two, 0] - ends[one, 0] - x, ends[two, 1] - ends[one, 1] - y
    length = dx * dx + dy * dy
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, -(x * dx + y * dy) / length))
    x, y = x + t * dx, y + t * dy
    if x * x + y * y > reach * reach:
        return fraction
    own, row = _body_row(index, one), _body_row(index, two)
    shift = index[index[TABLE] + OWN_ROWS] - HEADER
    at = index[index[TABLE] + BODY_NUMBERS] + BODY_SIZE * two
    far = math.hypot(numbers[at], numbers[at + 1]) + numbers[at + 2]
    for o in range(index[own + 1] + shift, index[own + 2] + shift, ROW):
        for r in range(index[row + 1], index[row + 2], ROW):
            t = _pair_fraction(numbers, index, state, r, o, index[own], index[row], far, fraction)
            if t < fraction:
                if whole:
                    return 0.0
                fraction = t
    return fraction


@njit(cache=True)
def _motion_fraction(
    numbers: FloatArray, index: IntArray, a: FloatArray, b: FloatArray, whole: bool
) -> float:
    """Certified part of the straight motion a -> b; with `whole`, 0 unless it is all of it."""
    d = _changes(index, a, b)
    fraction = _allowed(numbers, index, a, d, whole)
    if fraction == 0.0:
        return 0.0
    if not d.any():
        return 1.0 if _pose_free(numbers, index, a) else 0.0
    table = index[TABLE]
    joints, bodies = index[table + JOINTS], index[table + BODIES]
    state, last = np.empty((joints, STATE)), np.empty((joints, STATE))
    _frames(numbers, index, a, d, state)
    _frames(numbers, index, a + d, d, last)
    ends = np.empty((bodies, 2))
    for body in range(bodies - 1, -1, -1):
        x, y = _body_centre(numbers, index, state, body)
        ends[body] = _body_centre(numbers, index, last, body)
        dx, dy = ends[body, 0] - x, ends[body, 1] - y
        fraction = _body_fraction(numbers, index, state, body, dx, dy, fraction, whole)
        if fraction == 0.0:
            return 0.0
    for pair in range(index[table + PAIRS]):
        fraction = _pair_of_bodies_fraction(numbers, index, state, pair, ends, fraction, whole)
        if fraction == 0.0:
            return 0.0
    return fraction


# Clearance --------------------------------------------------------------------------------------------------


@borrowing
def _body_distance(
    numbers: FloatArray, index: IntArray, state: FloatArray, body: int, smallest: float
) -> float:
    """The distance of a body to the nearest piece, or `smallest` if that is less."""
    row = _body_row(index, body)
    at, radius = state[index[row]], _body_radius(numbers, index, body)
    x, y = _body_centre(numbers, index, state, body)
    rows, box = HEADER + ROW * index[0], index[2]
    # The half-planes come last and bound everything else, so first they, then what hangs in no tree.
    nodes, node, first, last = index[3], -1, index[6], index[1]
    while True:
        for i in range(last - 1, first - 1, -1):
            within, o = smallest + radius, rows + ROW * i
            if _box_squared(numbers, box + 4 * i, x, y) >= within * within or _disc_clear(
                numbers, index, o, x, y, 0.0, 0.0, within
            ):
                continue
            for r in range(index[row + 1], index[row + 2], ROW):
                distance = _pair_distance(numbers, index, r, o, at[X], at[Y], at[COS], at[SIN])
                smallest = min(smallest, distance)
        node += 1
        first = last = 0
        while node < nodes:
            within, after = smallest + radius, index[4] + 3 * node
            if _box_squared(numbers, index[5] + 4 * node, x, y) >= within * within:
                node = index[after]
            elif index[after + 2] == 0:
                node += 1
            else:
                first, last = index[after + 1], index[after + 2]
                break
        if node >= nodes:
            return smallest


@njit(cache=True)
def _pose_clearance(numbers: FloatArray, index: IntArray, q: FloatArray) -> float:
    if not _pose_free(numbers, index, q):
        return 0.0
    table, smallest = index[TABLE], np.inf
    state = np.empty((index[table + JOINTS], STATE))
    _frames(numbers, index, q, np.zeros(q.size), state)
    for body in range(index[table + BODIES] - 1, -1, -1):
        smallest = _body_distance(numbers, index, state, body, smallest)
    shift = index[table + OWN_ROWS] - HEADER
    for pair in range(index[table + PAIRS]):
        at = _pair_row(index, pair)
        own, row = _body_row(index, index[at]), _body_row(index, index[at + 1])
        x, y, c, s, _, _ = _place(numbers, index, state, index[own], index[row], 0.0)
        for o in range(index[own + 1] + shift, index[own + 2] + shift, ROW):
            for r in range(index[row + 1], index[row + 2], ROW):
                smallest = min(smallest, _pair_distance(numbers, index, r, o, x, y, c, s))
    return smallest


@njit(cache=True)
def _tool(numbers: FloatArray, index: IntArray, q: FloatArray) -> tuple[float, float]:
    """Where the tool is in the workspace."""
    table = index[TABLE]
    state = np.empty((index[table + JOINTS], STATE))
    _frames(numbers, index, q, np.zeros(q.size), state)
    at, own = index[table + TOOL_NUMBERS], state[index[table + TOOL]]
    x, y = numbers[at], numbers[at + 1]
    return (
        numbers[3] + own[X] + own[COS] * x - own[SIN] * y,
        numbers[4] + own[Y] + own[SIN] * x + own[COS] * y,
    )


@cfunc(SIGNATURE, cache=True)
def answer(
    asked: int, a: FloatArray, b: FloatArray, size: int, numbers: FloatArray, index: IntArray
) -> float:
    """What `kernels.collision` asks of the robot whose geometry holds the address of this function."""
    # The arrays of the geometry are longer than is said here; nothing checks.
    p, q = carray(a, (size,)), carray(b, (size,))  # type: ignore[call-overload]
    x, i = carray(numbers, (1,)), carray(index, (1,))  # type: ignore[call-overload]
    if asked == POSE_FREE:
        return 1.0 if _pose_free(x, i, p) else 0.0
    if asked == CLEARANCE:
        return _pose_clearance(x, i, p)
    if asked in (TOOL_X, TOOL_Y):
        return _tool(x, i, p)[0 if asked == TOOL_X else 1]
    return _motion_fraction(x, i, p, q, asked != FRACTION)
