"""Collision of a chain of joints in space, whose bodies are capsules, with solids: poses, motions, clearance.

A body is a segment in the frame of a joint, and a radius; a solid is a box with a radius (a capsule is a box
without width, a sphere one without size), a cylinder with flat ends, or a half-space, which is what each side
of the room is. A body is *separated* from a solid by a gap g when a plane keeps the solid on one side and the
body g away on the other. The plane stands across the shortest way from the solid to the segment, which is
searched for: but the gap is then taken from the plane's normal, by how far the solid reaches along it, so it
is never more than the distance, however exact the search was.

Along a straight motion every coordinate is linear in t. A joint's origin is p(t) = sum of R_k(t) o_k over the
joints up to it, R_k a product of rotations of rates w_1, ..., w_k, so that each |(R_k o_k)''| is at most
(|w_1| + ... + |w_k|)^2 |o_k|; a slide of rate u adds 2 (|w_1| + ... + |w_k|) |u|. With the velocity at hand,
the distance of each end of a segment from a plane that stands still is bounded from below by a parabola, and
so is the gap; the body is stepped to where that ends, and looks for another plane from there. Each pair of a
body and a solid has its own bounds. Of two bodies of the robot the first is a solid, in whose frame all is
seen, so that joints before it do not count.

Layout. That of `guided_gym.kernels.linkage`, as far as the limits of the coordinates and the rows of the
joints go: from `index[TABLE]` the header, of which `SOLIDS` holds the number of solids here, then a row for
each joint (slides, coordinate, periodic), each solid (where its numbers are, kind), each body (joint or -1,
where its numbers are), each pair (body, body whose joint is farther out, where the first one's numbers as a
solid are). `numbers` begin with tolerance and margin.
"""
# mypy: disable-error-code="misc,no-any-return,no-untyped-call"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import carray, cfunc, njit  # type: ignore[attr-defined]

from guided_gym.kernels.collision import TABLE
from guided_gym.kernels.foreign import CLEARANCE, FRACTION, POSE_FREE, SIGNATURE, TOOL_X, TOOL_Y
from guided_gym.kernels.linkage import _allowed, _changes, _known, _within_limits
from guided_gym.kernels.packing import (
    BODIES,
    BOX,
    CYLINDER,
    HALF_SPACE,
    JOINT_NUMBERS,
    JOINTS,
    PAIRS,
    SOLIDS,
    TABLE_HEADER,
    TOOL,
    TOOL_NUMBERS,
)
from guided_gym.kernels.plain import borrowing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

JOINT_ROW, SOLID_ROW, BODY_ROW, PAIR_ROW = 3, 2, 2, 3
JOINT_SIZE = 15
"""Rotation (9, by rows) and offset (3) in the parent's frame, factor and shift of the coordinate, and how
long the offset may get. A joint turns about, or slides along, the z axis of its own frame."""
BODY_SIZE = 8
"""Ends of the segment (3, 3) in the joint's frame, radius, and how far from the joint an end is at most."""
SOLID_SIZE = 17
"""Centre (3), rotation (9, rows are its axes), half of each side (3), radius, radius of a ball around it. Of
a cylinder the first half side is its radius, and z its axis; a half-space is what lies below the plane
through its centre across its first axis."""
TOOL_SIZE = 9
"""The tool in the frame of its joint (3), and the plane of the pictures: its two axes (3, 3)."""

ORIGIN, VELOCITY, SPIN, TURNS, BEND, SPEED = 9, 12, 15, 18, 19, 20
STATE = 21
"""Of a joint's frame: rotation (9, by rows), origin, its velocity, angular velocity, the sum of all rates of
turning, half of |p''| and |p'| at most."""

_MAX_STEPS = 200
_LOOKS = 200
"""At most; a long segment that almost touches a round solid needs up to 120."""
_AIM = 0.02
"""How far off the right direction costs a gap at most, in tolerances."""


@borrowing
def _solid_row(index: IntArray, solid: int) -> int:
    table = index[TABLE]
    return table + TABLE_HEADER + JOINT_ROW * index[table + JOINTS] + SOLID_ROW * solid


@borrowing
def _body_row(index: IntArray, body: int) -> int:
    return _solid_row(index, index[index[TABLE] + SOLIDS]) + BODY_ROW * body


@borrowing
def _pair_row(index: IntArray, pair: int) -> int:
    return _body_row(index, index[index[TABLE] + BODIES]) + PAIR_ROW * pair


# Frames -----------------------------------------------------------------------------------------------------


@borrowing
def _first_frame(
    numbers: FloatArray, at: int, value: float, rate: float, slides: bool, own: FloatArray
) -> None:
    """The frame of the first joint, seen from the frame before it, which does not move; written."""
    ox, oy, oz = numbers[at + 9], numbers[at + 10], numbers[at + 11]
    ax, ay, az = numbers[at + 2], numbers[at + 5], numbers[at + 8]
    own[VELOCITY : SPEED + 1] = 0.0
    if slides:
        for i in range(9):  # the array is longer than it says: no slices
            own[i] = numbers[at + i]
        ox, oy, oz = ox + value * ax, oy + value * ay, oz + value * az
        own[VELOCITY], own[VELOCITY + 1], own[VELOCITY + 2] = rate * ax, rate * ay, rate * az
        own[SPEED] = abs(rate)
    else:
        c, s = math.cos(value), math.sin(value)
        for i in range(3):
            x, y = numbers[at + 3 * i], numbers[at + 3 * i + 1]
            own[3 * i], own[3 * i + 1], own[3 * i + 2] = c * x + s * y, c * y - s * x, numbers[at + 3 * i + 2]
        own[SPIN], own[SPIN + 1], own[SPIN + 2] = rate * ax, rate * ay, rate * az
        own[TURNS] = abs(rate)
    own[ORIGIN], own[ORIGIN + 1], own[ORIGIN + 2] = ox, oy, oz


@borrowing
def _next_frame(
    numbers: FloatArray,
    at: int,
    value: float,
    rate: float,
    slides: bool,
    before: FloatArray,
    own: FloatArray,
) -> None:
    """The frame of a joint on the one before it; written."""
    ox, oy, oz = numbers[at + 9], numbers[at + 10], numbers[at + 11]
    if slides:
        ox, oy, oz = (
            ox + value * numbers[at + 2],
            oy + value * numbers[at + 5],
            oz + value * numbers[at + 8],
        )
    c, s = (1.0, 0.0) if slides else (math.cos(value), math.sin(value))
    px = before[0] * ox + before[1] * oy + before[2] * oz
    py = before[3] * ox + before[4] * oy + before[5] * oz
    pz = before[6] * ox + before[7] * oy + before[8] * oz
    wx, wy, wz = before[SPIN], before[SPIN + 1], before[SPIN + 2]
    own[ORIGIN], own[ORIGIN + 1], own[ORIGIN + 2] = (
        before[ORIGIN] + px,
        before[ORIGIN + 1] + py,
        before[ORIGIN + 2] + pz,
    )
    own[VELOCITY] = before[VELOCITY] + wy * pz - wz * py
    own[VELOCITY + 1] = before[VELOCITY + 1] + wz * px - wx * pz
    own[VELOCITY + 2] = before[VELOCITY + 2] + wx * py - wy * px
    for i in range(3):
        a, b, d = before[3 * i], before[3 * i + 1], before[3 * i + 2]
        x = a * numbers[at] + b * numbers[at + 3] + d * numbers[at + 6]
        y = a * numbers[at + 1] + b * numbers[at + 4] + d * numbers[at + 7]
        own[3 * i + 2] = a * numbers[at + 2] + b * numbers[at + 5] + d * numbers[at + 8]
        own[3 * i], own[3 * i + 1] = c * x + s * y, c * y - s * x
    turns, length = before[TURNS], numbers[at + 14]
    own[BEND] = before[BEND] + 0.5 * turns * turns * length
    own[SPEED] = before[SPEED] + turns * length
    own[TURNS] = turns
    own[SPIN], own[SPIN + 1], own[SPIN + 2] = wx, wy, wz
    moved = VELOCITY if slides else SPIN
    for i in range(3):
        own[moved + i] += rate * own[3 * i + 2]
    if slides:
        own[BEND] += turns * abs(rate)
        own[SPEED] += abs(rate)
    else:
        own[TURNS] += abs(rate)


@borrowing
def _frames(
    numbers: FloatArray,
    index: IntArray,
    q: FloatArray,
    d: FloatArray,
    t: float,
    first: int,
    last: int,
    state: FloatArray,
) -> None:
    """Frames of the joints first, ..., last at time t, seen from the frame of the joint before the first."""
    table = index[TABLE]
    for j in range(first, last + 1):
        row = table + TABLE_HEADER + JOINT_ROW * j
        at = index[table + JOINT_NUMBERS] + JOINT_SIZE * j
        k, factor = index[row + 1], numbers[at + 12]
        value, rate = factor * (q[k] + t * d[k]) + numbers[at + 13], factor * d[k]
        if j == first:
            _first_frame(numbers, at, value, rate, index[row] > 0, state[j])
        else:
            _next_frame(numbers, at, value, rate, index[row] > 0, state[j - 1], state[j])


@borrowing
def _placed(own: FloatArray, numbers: FloatArray, at: int) -> tuple[float, float, float]:
    """A point of a joint's frame, where it is."""
    x, y, z = numbers[at], numbers[at + 1], numbers[at + 2]
    return (
        own[ORIGIN] + own[0] * x + own[1] * y + own[2] * z,
        own[ORIGIN + 1] + own[3] * x + own[4] * y + own[5] * z,
        own[ORIGIN + 2] + own[6] * x + own[7] * y + own[8] * z,
    )


@borrowing
def _along(own: FloatArray, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Velocity along a normal of the point (x, y, z) that moves with a frame."""
    x, y, z = x - own[ORIGIN], y - own[ORIGIN + 1], z - own[ORIGIN + 2]
    wx, wy, wz = own[SPIN], own[SPIN + 1], own[SPIN + 2]
    return (
        nx * (own[VELOCITY] + wy * z - wz * y)
        + ny * (own[VELOCITY + 1] + wz * x - wx * z)
        + nz * (own[VELOCITY + 2] + wx * y - wy * x)
    )


# A segment and a solid --------------------------------------------------------------------------------------


@borrowing
def _from_core(
    numbers: FloatArray, s: int, kind: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """From the nearest point of a box, or of a cylinder, to a point, both in the solid's frame."""
    hx, hy, hz = numbers[s + 12], numbers[s + 13], numbers[s + 14]
    dz = z - min(max(z, -hz), hz)
    if kind == CYLINDER:
        away = math.sqrt(x * x + y * y)
        part = 0.0 if away <= hx else 1.0 - hx / away
        return part * x, part * y, dz
    return x - min(max(x, -hx), hx), y - min(max(y, -hy), hy), dz


@borrowing
def _nearest(
    numbers: FloatArray,
    s: int,
    kind: int,
    a: tuple[float, float, float],
    u: tuple[float, float, float],
) -> tuple[float, float, float]:
    """From the nearest point of a solid's core to the segment a, a + u, to within what `_AIM` allows.

    The slope of the squared distance along the segment grows, the distance from a convex set being convex:
    its zero is found by the rule of false position (Illinois).
    """
    low, high = 0.0, 1.0
    px, py, pz = _from_core(numbers, s, kind, a[0], a[1], a[2])
    before = px * u[0] + py * u[1] + pz * u[2]
    if before >= 0.0:
        return px, py, pz
    px, py, pz = _from_core(numbers, s, kind, a[0] + u[0], a[1] + u[1], a[2] + u[2])
    after = px * u[0] + py * u[1] + pz * u[2]
    if after <= 0.0:
        return px, py, pz
    enough = _AIM * numbers[0]
    side = 0
    for look in range(_LOOKS):
        t = low - before * (high - low) / (after - before)
        if look % 6 == 5 or not low < t < high:
            t = 0.5 * (low + high)
        px, py, pz = _from_core(numbers, s, kind, a[0] + t * u[0], a[1] + t * u[1], a[2] + t * u[2])
        slope = px * u[0] + py * u[1] + pz * u[2]
        if abs(slope) <= enough * math.sqrt(px * px + py * py + pz * pz):
            break
        if slope < 0.0:
            low, before = t, slope
            after = 0.5 * after if side < 0 else after
            side = -1
        else:
            high, after = t, slope
            before = 0.5 * before if side > 0 else before
            side = 1
    return px, py, pz


@borrowing
def _gaps(
    numbers: FloatArray,
    s: int,
    kind: int,
    a: tuple[float, float, float],
    b: tuple[float, float, float],
) -> tuple[float, float, float, float, float]:
    """A plane between a solid and the segment a, b: its normal, and how far from the solid each end is by it.

    Both are -1 where the segment is in the solid.
    """
    ax, ay, az = a[0] - numbers[s], a[1] - numbers[s + 1], a[2] - numbers[s + 2]
    bx, by, bz = b[0] - numbers[s], b[1] - numbers[s + 1], b[2] - numbers[s + 2]
    r0, r1, r2 = numbers[s + 3], numbers[s + 4], numbers[s + 5]
    if kind == HALF_SPACE:
        return r0, r1, r2, r0 * ax + r1 * ay + r2 * az, r0 * bx + r1 * by + r2 * bz
    r3, r4, r5 = numbers[s + 6], numbers[s + 7], numbers[s + 8]
    r6, r7, r8 = numbers[s + 9], numbers[s + 10], numbers[s + 11]
    ax, ay, az = (
        r0 * ax + r1 * ay + r2 * az,
        r3 * ax + r4 * ay + r5 * az,
        r6 * ax + r7 * ay + r8 * az,
    )
    bx, by, bz = (
        r0 * bx + r1 * by + r2 * bz,
        r3 * bx + r4 * by + r5 * bz,
        r6 * bx + r7 * by + r8 * bz,
    )
    nx, ny, nz = _nearest(numbers, s, kind, (ax, ay, az), (bx - ax, by - ay, bz - az))
    away = math.sqrt(nx * nx + ny * ny + nz * nz)
    if away <= 0.0:
        return 1.0, 0.0, 0.0, -1.0, -1.0
    nx, ny, nz = nx / away, ny / away, nz / away
    reach = abs(nz) * numbers[s + 14] + numbers[s + 15]
    if kind == CYLINDER:
        reach += math.sqrt(nx * nx + ny * ny) * numbers[s + 12]
    else:
        reach += abs(nx) * numbers[s + 12] + abs(ny) * numbers[s + 13]
    return (
        r0 * nx + r3 * ny + r6 * nz,
        r1 * nx + r4 * ny + r7 * nz,
        r2 * nx + r5 * ny + r8 * nz,
        nx * ax + ny * ay + nz * az - reach,
        nx * bx + ny * by + nz * bz - reach,
    )


@borrowing
def _gap(
    numbers: FloatArray,
    s: int,
    kind: int,
    a: tuple[float, float, float],
    b: tuple[float, float, float],
) -> float:
    """How far apart a plane keeps a solid and the segment a, b: the distance, but for what `_AIM` allows."""
    _, _, _, one, two = _gaps(numbers, s, kind, a, b)
    return min(one, two)


@borrowing
def gap(numbers: FloatArray, kind: int, a: FloatArray, b: FloatArray) -> float:
    """The same of a solid whose numbers are at the 2nd place, and a segment given by its ends (3,), (3,)."""
    return _gap(numbers, 2, kind, (a[0], a[1], a[2]), (b[0], b[1], b[2]))


@borrowing
def _beyond(numbers: FloatArray, s: int, kind: int, x: float, y: float, z: float, reach: float) -> bool:
    """Whether a ball around (x, y, z) is off a half-space, or off the ball around another solid."""
    x, y, z = x - numbers[s], y - numbers[s + 1], z - numbers[s + 2]
    if kind == HALF_SPACE:
        return numbers[s + 3] * x + numbers[s + 4] * y + numbers[s + 5] * z > reach
    reach += numbers[s + 16]
    return x * x + y * y + z * z > reach * reach


@borrowing
def _far_off(
    numbers: FloatArray,
    s: int,
    kind: int,
    a: tuple[float, float, float],
    b: tuple[float, float, float],
    by: float,
) -> bool:
    """Whether a ball around a segment is farther than that from a solid."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    reach = 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz) + by
    return _beyond(numbers, s, kind, 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]), reach)


CENTRE, BALL, OWN_SPEED = 0, 3, 4
"""Of a ball around a body: its centre in space (3), its radius, and how far a point of the body moves."""


@njit(cache=True)
def _balls(numbers: FloatArray, index: IntArray, state: FloatArray) -> FloatArray:
    """(bodies, 5) balls around the bodies, where the frames of the joints are."""
    bodies = index[index[TABLE] + BODIES]
    balls = np.empty((bodies, 5))
    for body in range(bodies):
        row = _body_row(index, body)
        joint, at = index[row], index[row + 1]
        a = numbers[at], numbers[at + 1], numbers[at + 2]
        b = numbers[at + 3], numbers[at + 4], numbers[at + 5]
        balls[body, OWN_SPEED] = 0.0
        if joint >= 0:
            a, b = _placed(state[joint], numbers, at), _placed(state[joint], numbers, at + 3)
            balls[body, OWN_SPEED] = state[joint, SPEED] + state[joint, TURNS] * numbers[at + 7]
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        for i in range(3):
            balls[body, CENTRE + i] = 0.5 * (a[i] + b[i])
        balls[body, BALL] = 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz) + numbers[at + 6]
    return balls


@borrowing
def _off_solid(numbers: FloatArray, s: int, kind: int, ball: FloatArray, by: float) -> bool:
    """Whether a ball is farther than that from a solid."""
    return _beyond(numbers, s, kind, ball[CENTRE], ball[CENTRE + 1], ball[CENTRE + 2], ball[BALL] + by)


@borrowing
def _off_each_other(one: FloatArray, two: FloatArray, by: float) -> bool:
    """Whether two balls are farther apart than that."""
    x, y, z = one[CENTRE] - two[CENTRE], one[CENTRE + 1] - two[CENTRE + 1], one[CENTRE + 2] - two[CENTRE + 2]
    reach = one[BALL] + two[BALL] + by
    return x * x + y * y + z * z > reach * reach


@borrowing
def _speed_between(numbers: FloatArray, index: IntArray, d: FloatArray, first: int, row: int) -> float:
    """How far any point of a body moves, seen from the frame of the joint before the first, at most."""
    table, turns, speed = index[TABLE], 0.0, 0.0
    joint = index[row]
    for j in range(first, joint + 1):
        at = index[table + JOINT_NUMBERS] + JOINT_SIZE * j
        joint_row = table + TABLE_HEADER + JOINT_ROW * j
        if j > first:
            speed += turns * numbers[at + 14]
        rate = abs(numbers[at + 12] * d[index[joint_row + 1]])
        if index[joint_row] > 0:
            speed += rate
        else:
            turns += rate
    return speed + turns * numbers[index[row + 1] + 7]


# Poses ------------------------------------------------------------------------------------------------------


@borrowing
def _pair_ends(
    numbers: FloatArray, index: IntArray, q: FloatArray, still: FloatArray, pair: int, state: FloatArray
) -> tuple[int, tuple[float, float, float], tuple[float, float, float], float]:
    """The first body of a pair as a solid, and the second's ends and radius, seen from it."""
    row = _pair_row(index, pair)
    one, two = _body_row(index, index[row]), _body_row(index, index[row + 1])
    joint, at = index[two], index[two + 1]
    _frames(numbers, index, q, still, 0.0, index[one] + 1, joint, state)
    own = state[joint]
    return index[row + 2], _placed(own, numbers, at), _placed(own, numbers, at + 3), numbers[at + 6]


@njit(cache=True)
def _pose_free(numbers: FloatArray, index: IntArray, q: FloatArray) -> bool:
    still = np.zeros(q.size)
    if not (_known(q, still, index) and _within_limits(numbers, index, q)):
        return False
    table, tolerance = index[TABLE], numbers[0]
    joints = index[table + JOINTS]
    state = np.empty((joints, STATE))
    _frames(numbers, index, q, still, 0.0, 0, joints - 1, state)
    first, balls = _solid_row(index, 0), _balls(numbers, index, state)
    for body in range(index[table + BODIES] - 1, -1, -1):
        row = _body_row(index, body)
        joint, at = index[row], index[row + 1]
        if joint < 0:
            continue
        a, b = _placed(state[joint], numbers, at), _placed(state[joint], numbers, at + 3)
        within = numbers[at + 6] + tolerance
        for i in range(index[table + SOLIDS]):
            s, kind = index[first + SOLID_ROW * i], index[first + SOLID_ROW * i + 1]
            near = not _off_solid(numbers, s, kind, balls[body], tolerance)
            if near and not _gap(numbers, s, kind, a, b) > within:
                return False
    for pair in range(index[table + PAIRS]):
        row = _pair_row(index, pair)
        if _off_each_other(balls[index[row]], balls[index[row + 1]], tolerance):
            continue
        s, a, b, radius = _pair_ends(numbers, index, q, still, pair, state)
        within = radius + tolerance
        if not _far_off(numbers, s, BOX, a, b, within) and not _gap(numbers, s, BOX, a, b) > within:
            return False
    return True


@njit(cache=True)
def _pose_clearance(numbers: FloatArray, index: IntArray, q: FloatArray) -> float:
    if not _pose_free(numbers, index, q):
        return 0.0
    table, smallest, still = index[TABLE], np.inf, np.zeros(q.size)
    joints = index[table + JOINTS]
    state = np.empty((joints, STATE))
    _frames(numbers, index, q, still, 0.0, 0, joints - 1, state)
    first = _solid_row(index, 0)
    for body in range(index[table + BODIES]):
        row = _body_row(index, body)
        joint, at = index[row], index[row + 1]
        if joint < 0:
            continue
        a, b = _placed(state[joint], numbers, at), _placed(state[joint], numbers, at + 3)
        for i in range(index[table + SOLIDS]):
            s, kind = index[first + SOLID_ROW * i], index[first + SOLID_ROW * i + 1]
            if not _far_off(numbers, s, kind, a, b, smallest + numbers[at + 6]):
                smallest = min(smallest, _gap(numbers, s, kind, a, b) - numbers[at + 6])
    for pair in range(index[table + PAIRS]):
        s, a, b, radius = _pair_ends(numbers, index, q, still, pair, state)
        if not _far_off(numbers, s, BOX, a, b, smallest + radius):
            smallest = min(smallest, _gap(numbers, s, BOX, a, b) - radius)
    return smallest


# Motions ----------------------------------------------------------------------------------------------------


@borrowing
def _first_root(gap: float, rate: float, bend: float) -> float:
    """Smallest positive root of gap + rate t - bend t^2, for gap > 0 and bend >= 0; infinite for none."""
    root = math.sqrt(rate * rate + 4.0 * bend * gap)
    if rate > 0.0:
        return (rate + root) / (2.0 * bend) if bend > 0.0 else np.inf
    return 2.0 * gap / (root - rate) if root - rate > 0.0 else np.inf


@borrowing
def _pair_fraction(
    numbers: FloatArray,
    index: IntArray,
    q: FloatArray,
    d: FloatArray,
    s: int,
    kind: int,
    first: int,
    row: int,
    state: FloatArray,
    later: FloatArray,
    limit: float,
) -> float:
    """The part of [0, limit] in which the body of a row surely stays off a solid.

    All is seen from the frame of the joint before ``first``; ``state`` holds the frames at the beginning, and
    ``later`` is room for those after it.
    """
    joint, at = index[row], index[row + 1]
    margin, far = numbers[at + 6] + numbers[1], numbers[at + 7]
    own = state[joint]
    bend = own[BEND] + 0.5 * own[TURNS] * own[TURNS] * far
    speed = own[SPEED] + own[TURNS] * far
    a, b = _placed(own, numbers, at), _placed(own, numbers, at + 3)
    shortest, t = 1e-3 * numbers[0] / (speed + 1e-300), 0.0
    for _ in range(_MAX_STEPS):
        nx, ny, nz, one, two = _gaps(numbers, s, kind, a, b)
        one, two = one - margin, two - margin
        if not (one > 0.0 and two > 0.0):
            return t
        step = min(
            _first_root(one, _along(own, a[0], a[1], a[2], nx, ny, nz), bend),
            _first_root(two, _along(own, b[0], b[1], b[2], nx, ny, nz), bend),
        )
        if step >= limit - t:
            return limit
        if step < shortest:
            return t
        t += step
        _frames(numbers, index, q, d, t, first, joint, later)
        own = later[joint]
        a, b = _placed(own, numbers, at), _placed(own, numbers, at + 3)
    return t


@njit(cache=True)
def _motion_fraction(
    numbers: FloatArray, index: IntArray, q: FloatArray, other: FloatArray, whole: bool
) -> float:
    """Certified part of the straight motion q -> other; with `whole`, 0 unless it is all of it."""
    d = _changes(index, q, other)
    fraction = _allowed(numbers, index, q, d, whole)
    if fraction == 0.0:
        return 0.0
    if not d.any():
        return 1.0 if _pose_free(numbers, index, q) else 0.0
    table = index[TABLE]
    joints = index[table + JOINTS]
    state, later = np.empty((joints, STATE)), np.empty((joints, STATE))
    # From the middle of the motion, no body moves farther than half of what it moves in all.
    _frames(numbers, index, q, d, 0.5, 0, joints - 1, later)
    balls = _balls(numbers, index, later)
    _frames(numbers, index, q, d, 0.0, 0, joints - 1, state)
    # Margins are more than a pose's, so that rounding never leaves out more here than there.
    solids, margin = _solid_row(index, 0), numbers[1]
    for body in range(index[table + BODIES] - 1, -1, -1):
        row = _body_row(index, body)
        if index[row] < 0:
            continue
        near = margin + 0.5 * balls[body, OWN_SPEED]
        for i in range(index[table + SOLIDS]):
            s, kind = index[solids + SOLID_ROW * i], index[solids + SOLID_ROW * i + 1]
            if _off_solid(numbers, s, kind, balls[body], near):
                continue
            t = _pair_fraction(numbers, index, q, d, s, kind, 0, row, state, later, fraction)
            if t < fraction and (whole or t == 0.0):
                return 0.0
            fraction = min(fraction, t)
    return _own_fraction(numbers, index, q, d, balls, state, later, fraction, whole)


@borrowing
def _own_fraction(
    numbers: FloatArray,
    index: IntArray,
    q: FloatArray,
    d: FloatArray,
    balls: FloatArray,
    state: FloatArray,
    later: FloatArray,
    fraction: float,
    whole: bool,
) -> float:
    """The part of [0, fraction] in which the bodies stay off each other; ``state`` and ``later`` are room.

    Pairs of the same two joints follow each other, and what is the same for them is worked out once.
    """
    seen_from, seen, placed, moved = -1, -1, False, 0.0
    for pair in range(index[index[TABLE] + PAIRS]):
        at = _pair_row(index, pair)
        row, first = _body_row(index, index[at + 1]), index[_body_row(index, index[at])] + 1
        if first != seen_from or row != seen:
            moved = _speed_between(numbers, index, d, first, row)
            placed = placed and first == seen_from and index[row] == index[seen]
            seen_from, seen = first, row
        if _off_each_other(balls[index[at]], balls[index[at + 1]], numbers[1] + 0.5 * moved):
            continue
        if not placed:
            _frames(numbers, index, q, d, 0.0, first, index[row], state)
            placed = True
        t = _pair_fraction(numbers, index, q, d, index[at + 2], BOX, first, row, state, later, fraction)
        if t < fraction and (whole or t == 0.0):
            return 0.0
        fraction = min(fraction, t)
    return fraction


@njit(cache=True)
def _tool(numbers: FloatArray, index: IntArray, q: FloatArray, axis: int) -> float:
    """Where the tool is in the plane of the pictures, along one of its axes."""
    table = index[TABLE]
    joints, at = index[table + JOINTS], index[table + TOOL_NUMBERS]
    state = np.empty((joints, STATE))
    _frames(numbers, index, q, np.zeros(q.size), 0.0, 0, joints - 1, state)
    x, y, z = _placed(state[index[table + TOOL]], numbers, at)
    at += 3 + 3 * axis
    return numbers[at] * x + numbers[at + 1] * y + numbers[at + 2] * z


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
        return _tool(x, i, p, 0 if asked == TOOL_X else 1)
    return _motion_fraction(x, i, p, q, asked != FRACTION)
