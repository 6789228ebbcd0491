"""The grid on which the oracle solves: free vertices, certified links, and what sees the goal.

A *frame* is a float64 array that says where the vertices lie; its entries are named below. Vertices are
numbered as in `eikonal`, with `PAD` empty columns and rows on each side. Every link is a certified free
motion, so a solution never leaks through a wall, however thin.
"""
# mypy: disable-error-code="misc,arg-type,assignment,no-any-return"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.collision import (
    HEADER,
    ROW,
    Geometry,
    _motion_fraction,
)
from guided_gym.kernels.eikonal import LINK_THETA, LINK_X, LINK_Y, PAD, IndexArray, LinkArray
from guided_gym.kernels.plain import ONE, YES, ZERO, borrowing

FloatArray = npt.NDArray[np.float64]

ORIGIN_X, ORIGIN_Y = 0, 1
"""Frame: position of the first vertex that is not padding; its angle is 0."""
STEP_X, STEP_Y, STEP_THETA = 2, 3, 4
"""Frame: spacing, the angle's in radians."""
COUNT_X, COUNT_Y, COUNT_THETA = 5, 6, 7
"""Frame: vertices along each axis, padding left out; one angle for a robot that does not turn."""
GOAL = 8
"""Frame: first of the goal's three coordinates."""
WEIGHT = 11
"""Frame: length per radian."""
SIGHT = 12
"""Frame: distance from the goal within which straight free motions to it are looked for."""
FRAME = 13
"""Entries of a frame."""

VALID = 8
"""Link bit: the vertex is a free pose."""
SEES_GOAL = 16
"""Link bit: the straight motion to the goal is free, and the distance exact."""

LENT = 0.35
"""Part of a link that must be free for its far end to be lent. Among random polygons, mean errors on a grid
of 64 x 64 were 0.70, 0.66, 0.64 and 0.68 % with 0.05, 0.2, 0.35 and 0.5, and 0.88 % with nothing lent."""


@borrowing
def inradius(geometry: Geometry) -> float:
    """Radius of a disc about the reference point that the robot covers at every angle; 0 if there is none."""
    numbers, index = geometry
    best = 0.0
    for r in range(HEADER, HEADER + ROW * index[0], ROW):
        if index[r + 1] < 3:
            continue
        smallest = np.inf
        for e in range(index[r + 2], index[r + 2] + 3 * index[r + 3], 3):
            smallest = min(smallest, numbers[e + 2])
        best = max(best, smallest)
    return best


@borrowing
def _blocked_region(
    geometry: Geometry, r: int, o: int, theta: float, inflation: float, planes: FloatArray
) -> int:
    """Where the reference point can't be: half-planes n.p <= c whose intersection is that region.

    At one angle, the positions at which a robot piece is not separated from an obstacle piece are a convex
    polygon (their Minkowski sum), and the axes of both pieces are its sides.

    Args:
        geometry: Robot and obstacles.
        r: Row of the robot's piece.
        o: Row of the obstacle's piece.
        theta: The angle.
        inflation: Length by which the region is larger than that of certified motions.
        planes: (m, 3) receives nx, ny, c of each half-plane.

    Returns:
        The number of half-planes.
    """
    numbers, index = geometry
    c, s, gap = math.cos(theta), math.sin(theta), numbers[1] + inflation
    count = 0
    for e in range(index[o + 2], index[o + 2] + 3 * index[o + 3], 3):
        ux, uy = numbers[e], numbers[e + 1]
        bx, by = c * ux + s * uy, c * uy - s * ux
        lowest = np.inf
        for v in range(index[r], index[r] + 3 * index[r + 1], 3):
            lowest = min(lowest, bx * numbers[v] + by * numbers[v + 1])
        planes[count, 0], planes[count, 1], planes[count, 2] = ux, uy, numbers[e + 2] + gap - lowest
        count += 1
    if index[o + 1] == 0:
        return count
    for e in range(index[r + 2], index[r + 2] + 3 * index[r + 3], 3):
        ux, uy = c * numbers[e] - s * numbers[e + 1], s * numbers[e] + c * numbers[e + 1]
        lowest = np.inf
        for w in range(index[o], index[o] + 2 * index[o + 1], 2):
            lowest = min(lowest, ux * numbers[w] + uy * numbers[w + 1])
        planes[count, 0], planes[count, 1], planes[count, 2] = -ux, -uy, numbers[e + 2] + gap - lowest
        count += 1
    return count


@borrowing
def _span(planes: FloatArray, count: int, axis: int, at: float) -> tuple[float, float]:
    """The part of the line that runs along `axis`, at `at` on the other axis, that lies in a region."""
    low, high = -np.inf, np.inf
    for e in range(count):
        slope, rest = planes[e, axis], planes[e, 2] - planes[e, 1 - axis] * at
        if abs(slope) < 1e-14:
            if rest < 0.0:
                return np.inf, -np.inf
        elif slope > 0.0:
            high = min(high, rest / slope)
        else:
            low = max(low, rest / slope)
    return low, high


@borrowing
def _lines(low: float, high: float, origin: float, step: float, count: int) -> tuple[int, int]:
    """Numbers (first, end) of the grid lines between two coordinates."""
    first = math.ceil(max(0.0, min(float(count), (low - origin) / step)))
    end = math.floor(max(-1.0, min(float(count) - 1.0, (high - origin) / step))) + 1
    return int(first), int(end)


@borrowing
def _cut(
    frame: FloatArray,
    links: LinkArray,
    denied: LinkArray,
    planes: FloatArray,
    count: int,
    axis: int,
    at: int,
    k: int,
) -> None:
    """Mark what a region takes of one grid line along `axis`: vertices, the links at its ends, claims there.

    Links between two vertices in the region are left to who looks for free vertices.
    """
    other = 1 - axis
    low, high = _span(planes, count, axis, frame[ORIGIN_X + other] + at * frame[STEP_X + other])
    if low > high:
        return
    n, last = int(frame[COUNT_X + axis]), int(frame[COUNT_X + axis]) - 1
    low = max(-2.0, min(n + 1.0, (low - frame[ORIGIN_X + axis]) / frame[STEP_X + axis]))
    high = max(-2.0, min(n + 1.0, (high - frame[ORIGIN_X + axis]) / frame[STEP_X + axis]))
    first, end = math.ceil(low), math.floor(high) + 1  # the vertices in it, the end left out
    nt = int(frame[COUNT_THETA])
    column = (int(frame[COUNT_Y]) + 2 * PAD) * nt
    stride, across = (column, nt) if axis == 0 else (nt, column)
    origin = (at + PAD) * across + PAD * stride + k
    if axis == 1:
        for j in range(max(first, 0), min(end, n)):
            links[origin + j * stride] &= ~np.uint8(VALID)
    if 0 < first <= last:
        links[origin + (first - 1) * stride] &= ~np.uint8(1 << axis)
        if low - (first - 1) <= LENT:
            denied[origin + first * stride] |= np.uint8(1 << 2 * axis)
    if 0 < end <= last:
        links[origin + (end - 1) * stride] &= ~np.uint8(1 << axis)
        if end - high <= LENT:
            denied[origin + (end - 1) * stride] |= np.uint8(1 << (2 * axis + 1))


@borrowing
def _cut_turns(
    frame: FloatArray, links: LinkArray, planes: FloatArray, count: int, column: int, k: int
) -> None:
    """Clear LINK_THETA at the vertices of one column in a region."""
    low, high = _span(planes, count, int(ONE), frame[ORIGIN_X] + column * frame[STEP_X])
    first, end = _lines(low, high, frame[ORIGIN_Y], frame[STEP_Y], int(frame[COUNT_Y]))
    nt = int(frame[COUNT_THETA])
    origin = ((column + PAD) * (int(frame[COUNT_Y]) + 2 * PAD) + PAD) * nt + k
    for j in range(first, end):
        links[origin + j * nt] &= ~np.uint8(LINK_THETA)


@borrowing
def _most_axes(index: IndexArray) -> int:
    """Axes that a robot piece and an obstacle piece have together, at most."""
    middle, end = HEADER + ROW * index[0], HEADER + ROW * (index[0] + index[1])
    robot, obstacle = 0, 0
    for row in range(HEADER, middle, ROW):
        robot = max(robot, index[row + 3])
    for row in range(middle, end, ROW):
        obstacle = max(obstacle, index[row + 3])
    return robot + obstacle


@njit(cache=True)
def draw_obstacles(geometry: Geometry, frame: FloatArray) -> tuple[LinkArray, LinkArray]:
    """Draw the obstacles into a grid, angle by angle, as the robot's reference point meets them.

    At one angle, what an obstacle piece takes of a line of the grid is an interval, known exactly. That gives
    vertices and links along x and y without a collision check for each. A turn is sure where the regions of
    the angle half-way, grown by what half of the turn can move, leave it free.

    Args:
        geometry: Robot and obstacles.
        frame: (FRAME,) where the vertices lie.

    Returns:
        (n,) uint8 links: VALID is right for every vertex; the bits of links are right between free vertices,
        but LINK_THETA may be missing; and (n,) uint8 claims that must be denied (see `certify_links`).
    """
    numbers, index = geometry
    nx, ny, nt = int(frame[COUNT_X]), int(frame[COUNT_Y]), int(frame[COUNT_THETA])
    links = np.zeros((nx + 2 * PAD) * (ny + 2 * PAD) * nt, dtype=np.uint8)
    denied = np.zeros(links.size, dtype=np.uint8)
    for i in range(nx):
        first = ((i + PAD) * (ny + 2 * PAD) + PAD) * nt
        links[first : first + ny * nt] = VALID | LINK_X | LINK_Y | LINK_THETA
    planes = np.empty((_most_axes(index), 3))
    frame = frame.copy()
    frame[ORIGIN_X] -= numbers[3]  # the pieces lie about an origin of their own
    frame[ORIGIN_Y] -= numbers[4]
    growth = 0.5 * frame[STEP_THETA] * numbers[2]
    reach = numbers[2] + 2.0 * numbers[1]
    for n in range(index[1]):
        o, box = HEADER + ROW * (index[0] + n), index[2] + 4 * n
        left, right = _lines(
            numbers[box] - reach, numbers[box + 2] + reach, frame[ORIGIN_X], frame[STEP_X], nx
        )
        low, high = _lines(
            numbers[box + 1] - reach, numbers[box + 3] + reach, frame[ORIGIN_Y], frame[STEP_Y], ny
        )
        for r in range(HEADER, HEADER + ROW * index[0], ROW):
            for k in range(nt):
                count = _blocked_region(geometry, r, o, k * frame[STEP_THETA], 0.0, planes)
                for i in range(left, right):
                    _cut(frame, links, denied, planes, count, int(ONE), i, k)
                for j in range(low, high):
                    _cut(frame, links, denied, planes, count, int(ZERO), j, k)
                if nt > 1:
                    count = _blocked_region(geometry, r, o, (k + 0.5) * frame[STEP_THETA], growth, planes)
                    for i in range(left, right):
                        _cut_turns(frame, links, planes, count, i, k)
    return links, denied


@borrowing
def along(frame: FloatArray, v: int, axis: int, sense: int) -> int:
    """The vertex next to v along an axis, in the sense +1 or -1; the angle wraps."""
    nt = int(frame[COUNT_THETA])
    if axis == 0:
        return v + sense * (int(frame[COUNT_Y]) + 2 * PAD) * nt
    if axis == 1:
        return v + sense * nt
    k = v % nt
    return v - k + (k + nt + sense) % nt


@njit(cache=True)
def certify_links(geometry: Geometry, frame: FloatArray, links: LinkArray, denied: LinkArray) -> LinkArray:
    """Leave the bits of links between free neighbours whose motion is certified, and no others.

    Args:
        geometry: Robot and obstacles.
        frame: (FRAME,) where the vertices lie.
        links: (n,) uint8, from `draw_obstacles`; completed.
        denied: (n,) uint8, likewise: claims along x and y of which too little of the link is free.

    Returns:
        (n,) uint8 claims on vertices in collision by their free neighbours, see `round_boundary`. The bit
        2 * axis + 0 stands for the neighbour before it along the axis, 2 * axis + 1 for the one after it.
    """
    nx, ny, nt = int(frame[COUNT_X]), int(frame[COUNT_Y]), int(frame[COUNT_THETA])
    claims = np.zeros(links.size, dtype=np.uint8)
    strides = ((ny + 2 * PAD) * nt, nt)
    for p in range(nx * ny):
        i, j = p // ny, p % ny
        first = ((i + PAD) * (ny + 2 * PAD) + j + PAD) * nt
        for axis in range(2):
            stride = strides[axis]
            if (i if axis == 0 else j) == (nx if axis == 0 else ny) - 1:
                for v in range(first, first + nt):
                    links[v] &= ~np.uint8(1 << axis)
                continue
            for v in range(first, first + nt):
                free, beyond = links[v] & VALID, links[v + stride] & VALID
                if not (free and beyond):
                    links[v] &= ~np.uint8(1 << axis)
                    if free and not denied[v + stride] & (1 << 2 * axis):
                        claims[v + stride] |= np.uint8(1 << 2 * axis)
                    elif beyond and not denied[v] & (2 << 2 * axis):
                        claims[v] |= np.uint8(2 << 2 * axis)
        if nt > 1:
            x, y = frame[ORIGIN_X] + i * frame[STEP_X], frame[ORIGIN_Y] + j * frame[STEP_Y]
            _certify_turns(geometry, frame, links, claims, first, x, y)
        elif not links[first] & VALID:
            links[first] = 0
    return claims


@borrowing
def _certify_turns(
    geometry: Geometry, frame: FloatArray, links: LinkArray, claims: LinkArray, first: int, x: float, y: float
) -> None:
    """`certify_links` for the turns at one position."""
    numbers, index = geometry
    nt, turn = int(frame[COUNT_THETA]), frame[STEP_THETA]
    for k in range(nt):
        v, w = first + k, first + (k + 1) % nt
        free, beyond = links[v] & VALID, links[w] & VALID
        if free and beyond:
            if not links[v] & LINK_THETA and (
                _motion_fraction(numbers, index, x, y, k * turn, 0.0, 0.0, turn, bool(YES)) == 1.0
            ):
                links[v] |= np.uint8(LINK_THETA)
            continue
        links[v] &= ~np.uint8(LINK_THETA)
        if free:
            if _motion_fraction(numbers, index, x, y, k * turn, 0.0, 0.0, LENT * turn, bool(YES)) == 1.0:
                claims[w] |= np.uint8(1 << 4)
        elif beyond:
            angle = (k + 1) * turn
            if _motion_fraction(numbers, index, x, y, angle, 0.0, 0.0, -LENT * turn, bool(YES)) == 1.0:
                claims[v] |= np.uint8(1 << 5)


@borrowing
def _linked(links: LinkArray, v: int, w: int, axis: int, sense: int) -> bool:
    """Whether v and its neighbour w along an axis, in the sense +1 or -1, are linked."""
    return bool(links[v if sense > 0 else w] & (1 << axis))


@borrowing
def round_boundary(frame: FloatArray, links: LinkArray, claims: LinkArray, claimed: IndexArray) -> None:
    """Move the boundary of the free space to about the nearest vertices, not always to the inner ones.

    A grid of free vertices alone keeps every path up to a link away from the walls and makes all of them too
    long. So a vertex in collision is lent to the wave if the part LENT of a link to it is free, but only
    where that cannot join what was apart: the free neighbours that claim it must be joined around it already.

    Args:
        frame: (FRAME,) where the vertices lie.
        links: (n,) uint8; links to and between lent vertices are set.
        claims: (n,) uint8, from `certify_links`; cleared where they cannot be granted.
        claimed: (m,) the vertices with claims.
    """
    axes = 3 if frame[COUNT_THETA] > 1.0 else 2
    for n in range(claimed.size):
        if not _one_side(frame, links, np.int64(claims[claimed[n]]), claimed[n], axes):
            claims[claimed[n]] = 0
    for n in range(claimed.size):
        w = claimed[n]
        for a in range(axes):
            shared = claims[w] & claims[along(frame, w, a, int(ONE))]
            for t in range(2 * axes):
                claimant = along(frame, w, t >> 1, 2 * (t & 1) - 1)
                # Two lent vertices are linked where that closes a square over a certified link.
                if t >> 1 != a and shared & (1 << t) and links[claimant] & (1 << a):
                    links[w] |= 1 << a
    for n in range(claimed.size):
        w = claimed[n]
        if axes == 2 and claims[w]:
            links[w] |= LINK_THETA
        for t in range(2 * axes):
            if claims[w] & (1 << t):
                links[w if t & 1 else along(frame, w, t >> 1, int(-ONE))] |= 1 << (t >> 1)


@borrowing
def _one_side(frame: FloatArray, links: LinkArray, claim: int, w: int, axes: int) -> bool:
    """Whether the vertices that claim w are joined with each other by links around it."""
    joined, grown = claim & -claim, True
    while grown and joined != claim:
        grown = False
        for pair in range(4 * axes * axes):
            s, t = pair // (2 * axes), pair % (2 * axes)
            a, b = s >> 1, t >> 1
            if a == b or joined & (1 << s) or not claim & (1 << s) or not joined & (1 << t):
                continue
            sense_a, sense_b = 2 * (s & 1) - 1, 2 * (t & 1) - 1
            v, u = along(frame, w, a, sense_a), along(frame, w, b, sense_b)
            corner = along(frame, v, b, sense_b)
            if _linked(links, v, corner, b, sense_b) and _linked(links, u, corner, a, sense_a):
                joined |= 1 << s
                grown = True
    return joined == claim


@borrowing
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(cache=True)
def seed_goal(geometry: Geometry, frame: FloatArray, links: LinkArray) -> tuple[IndexArray, FloatArray]:
    """The vertices near the goal that see it, and their exact distances; marks them SEES_GOAL.

    Exact values around the goal take away the largest error of an eikonal solver, the one at the point
    source.
    """
    nx, ny, nt = int(frame[COUNT_X]), int(frame[COUNT_Y]), int(frame[COUNT_THETA])
    hx, hy, ht, weight, sight = frame[STEP_X], frame[STEP_Y], frame[STEP_THETA], frame[WEIGHT], frame[SIGHT]
    gx, gy, gt = frame[GOAL] - frame[ORIGIN_X], frame[GOAL + 1] - frame[ORIGIN_Y], frame[GOAL + 2]
    column = (ny + 2 * PAD) * nt
    low_x, high_x = max(0, math.ceil((gx - sight) / hx)), min(nx - 1, math.floor((gx + sight) / hx))
    low_y, high_y = max(0, math.ceil((gy - sight) / hy)), min(ny - 1, math.floor((gy + sight) / hy))
    size = max(0, high_x - low_x + 1) * max(0, high_y - low_y + 1) * nt
    seeds, values = np.empty(size, dtype=np.int64), np.empty(size)
    found = 0
    for i in range(low_x, high_x + 1):
        for j in range(low_y, high_y + 1):
            dx, dy = gx - i * hx, gy - j * hy
            for k in range(nt):
                turn = wrapped(gt - k * ht) if nt > 1 else 0.0
                d = math.sqrt(dx * dx + dy * dy + (weight * turn) ** 2)
                v = (i + PAD) * column + (j + PAD) * nt + k
                if d > sight or not links[v] & VALID:
                    continue
                x, y = frame[ORIGIN_X] + i * hx, frame[ORIGIN_Y] + j * hy
                if _motion_fraction(geometry[0], geometry[1], x, y, k * ht, dx, dy, turn, bool(YES)) == 1.0:
                    links[v] |= SEES_GOAL
                    seeds[found], values[found] = v, d
                    found += 1
    return seeds[:found], values[:found]
