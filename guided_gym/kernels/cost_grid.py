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
    _disc_clear,
    _motion_fraction,
    _point_segment_squared,
    _pose_free,
    next_run,
)
from guided_gym.kernels.eikonal import LINK_THETA, LINK_X, LINK_Y, PAD, IndexArray, LinkArray

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
of
64 x 64 were 0.70, 0.66, 0.64 and 0.68 % with 0.05, 0.2, 0.35 and 0.5, and 0.88 % with nothing lent."""

_OUTSIDE, _BLOCKED, _MIXED, _TURNS, _OPEN = 0, 1, 2, 3, 4


@njit(cache=True)
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


@njit(cache=True)
def _touches_disc(geometry: Geometry, o: int, x: float, y: float, radius: float) -> bool:
    """Whether an obstacle piece comes within `radius` of the point (x, y)."""
    numbers, index = geometry
    gap = -np.inf
    for e in range(index[o + 2], index[o + 2] + 3 * index[o + 3], 3):
        gap = max(gap, numbers[e] * x + numbers[e + 1] * y - numbers[e + 2])
    if gap >= radius or gap < 0.0 or index[o + 1] == 0:
        return gap < radius
    first, n_corners = index[o], index[o + 1]
    for j in range(n_corners):
        k, m = first + 2 * j, first + 2 * ((j + 1) % n_corners)
        if (
            _point_segment_squared(x, y, numbers[k], numbers[k + 1], numbers[m], numbers[m + 1])
            < radius * radius
        ):
            return True
    return False


@njit(cache=True)
def _position_kind(geometry: Geometry, x: float, y: float, inradius: float, step: float) -> int:
    """What the robot's circumscribed and inscribed discs tell about all angles at one position."""
    numbers, index = geometry
    reach = numbers[2] + numbers[1]
    far = reach + step
    x, y = x - numbers[3], y - numbers[4]
    kind, node = _OPEN, 0
    while node >= 0:
        first, last, at = index[6], index[1], -1
        if node < index[3]:
            first, last, at = next_run(numbers, index, node, x, y, 0.0, 0.0, far)
        node = at
        for i in range(first, last):
            b = index[2] + 4 * i
            if (
                x - far > numbers[b + 2]
                or x + far < numbers[b]
                or y - far > numbers[b + 3]
                or y + far < numbers[b + 1]
            ):
                continue
            o = HEADER + ROW * (index[0] + i)
            if _disc_clear(numbers, index, o, x, y, 0.0, 0.0, far):
                continue
            if _touches_disc(geometry, o, x, y, inradius):
                return _BLOCKED
            if kind != _MIXED:
                kind = _TURNS if _disc_clear(numbers, index, o, x, y, 0.0, 0.0, reach) else _MIXED
    return kind


@njit(cache=True)
def free_vertices(geometry: Geometry, frame: FloatArray) -> tuple[LinkArray, LinkArray]:
    """Find the free vertices of a grid.

    Args:
        geometry: Robot and obstacles.
        frame: (FRAME,) where the vertices lie.

    Returns:
        (n,) uint8 links with nothing but the bit VALID, and (columns, rows) uint8: what the
        robot's discs tell about each position.
    """
    nx, ny, nt = int(frame[COUNT_X]), int(frame[COUNT_Y]), int(frame[COUNT_THETA])
    hx, hy = frame[STEP_X], frame[STEP_Y]
    links = np.zeros((nx + 2 * PAD) * (ny + 2 * PAD) * nt, dtype=np.uint8)
    kinds = np.zeros((nx + 2 * PAD, ny + 2 * PAD), dtype=np.uint8)
    inner = inradius(geometry)
    for i in range(nx):
        for j in range(ny):
            x, y = frame[ORIGIN_X] + i * hx, frame[ORIGIN_Y] + j * hy
            kind = _position_kind(geometry, x, y, inner, max(hx, hy))
            kinds[i + PAD, j + PAD] = kind
            v = ((i + PAD) * (ny + 2 * PAD) + j + PAD) * nt
            for k in range(nt):
                if kind >= _TURNS or (
                    kind == _MIXED and _pose_free(geometry[0], geometry[1], x, y, k * frame[STEP_THETA])
                ):
                    links[v + k] = VALID
    return links, kinds


@njit(cache=True)
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
def certify_links(geometry: Geometry, frame: FloatArray, links: LinkArray, kinds: LinkArray) -> LinkArray:
    """Set the bits of the links between free neighbours whose motion is certified.

    Returns:
        (n,) uint8 claims on vertices in collision by their free neighbours, see `round_boundary`. The bit
        2 * axis + 0 stands for the neighbour before it along the axis, 2 * axis + 1 for the one after it.
    """
    nx, ny, nt = int(frame[COUNT_X]), int(frame[COUNT_Y]), int(frame[COUNT_THETA])
    claims = np.zeros(links.size, dtype=np.uint8)
    step = np.zeros(3)
    for p in range(nx * ny):
        i, j = p // ny, p % ny
        kind = kinds[i + PAD, j + PAD]
        if kind == _BLOCKED:
            continue
        x, y = frame[ORIGIN_X] + i * frame[STEP_X], frame[ORIGIN_Y] + j * frame[STEP_Y]
        first = ((i + PAD) * (ny + 2 * PAD) + j + PAD) * nt
        if kind == _OPEN:
            links[first : first + nt] = VALID | LINK_X | LINK_Y | LINK_THETA
        for side in range(6 if kind != _OPEN else 0):
            axis, sense = side >> 1, 1 - 2 * (side & 1)
            other = kinds[i + PAD + (sense if axis == 0 else 0), j + PAD + (sense if axis == 1 else 0)]
            known = other == _OPEN or (axis == 2 and (nt == 1 or kind == _TURNS))
            for k in range(nt if other != _OUTSIDE else 0):
                w = along(frame, first + k, axis, sense)
                both = links[w] & VALID
                if not links[first + k] & VALID or (both and sense < 0):
                    continue
                if not known:
                    step[:] = 0.0
                    step[axis] = sense * frame[STEP_X + axis] * (1.0 if both else LENT)
                    theta = k * frame[STEP_THETA]
                    fraction = _motion_fraction(
                        geometry[0], geometry[1], x, y, theta, step[0], step[1], step[2], True
                    )
                    if fraction != 1.0:
                        continue
                if both:
                    links[first + k] |= 1 << axis
                else:
                    claims[w] |= 1 << side
    return claims


@njit(cache=True)
def _linked(links: LinkArray, v: int, w: int, axis: int, sense: int) -> bool:
    """Whether v and its neighbour w along an axis, in the sense +1 or -1, are linked."""
    return bool(links[v if sense > 0 else w] & (1 << axis))


@njit(cache=True)
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
            shared = claims[w] & claims[along(frame, w, a, 1)]
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
                links[w if t & 1 else along(frame, w, t >> 1, -1)] |= 1 << (t >> 1)


@njit(cache=True)
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


@njit(cache=True)
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
                if _motion_fraction(geometry[0], geometry[1], x, y, k * ht, dx, dy, turn, True) == 1.0:
                    links[v] |= SEES_GOAL
                    seeds[found], values[found] = v, d
                    found += 1
    return seeds[:found], values[:found]
