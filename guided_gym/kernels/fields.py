"""Cost-to-go fields on square grids of poses: clearance of a robot, waves of varying speed, lookup.

Arrays over poses are (n, n, T): row y from the bottom up, column x, heading 2 pi k / T. A frame is the
float64 array of `FRAME` entries below. No pose is checked for collision here: all is made from the workspace.
"""
# mypy: disable-error-code="misc,arg-type,no-any-return"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.collision import Geometry, motion_free, pose_free

FloatArray = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

ORIGIN_X: Final = 0  # centre of the cell in row 0 and column 0
ORIGIN_Y: Final = 1
CELL: Final = 2  # side of a cell (length)
WEIGHT: Final = 3  # length per radian; 0 for a robot that cannot turn
GOAL: Final = 4  # three entries: x, y, theta
FRAME: Final = 7

FINE: Final = 4  # samples of the distance along a cell's side
CLIP: Final = 2.0  # cells of room; more is as good
LEAST: Final = -2.0  # cells of room; less is as bad
_AT_GOAL = 4.0  # cells
_UNTIDY = 0.25  # of the way between two poses: what a bucket of arrivals spans
_MOST_BUCKETS = 1 << 15
_SLACK = 0.25  # cells by which bilinear rooms may be wrong
_NEAR = 2.0  # cells from which the goal is looked for itself
_BLOCK = 8  # cells along a side whose near edges are looked for together


@njit(cache=True)
def _edge_distance(edges: FloatArray, e: int, x: float, y: float) -> float:
    x0, y0 = edges[e, 0], edges[e, 1]
    dx, dy = edges[e, 2] - x0, edges[e, 3] - y0
    t = (x - x0) * dx + (y - y0) * dy
    square = dx * dx + dy * dy
    t = 0.0 if t <= 0.0 else (1.0 if t >= square else t / square)
    return math.sqrt((x0 + t * dx - x) ** 2 + (y0 + t * dy - y) ** 2)


@njit(cache=True)
def _signs(edges: FloatArray, frame: FloatArray, n: int) -> Field:
    """-1 inside the obstacles and 1 outside at each sample: (n * FINE, n * FINE), line by line."""
    m, step = n * FINE, frame[CELL] / FINE
    left = frame[ORIGIN_X] - frame[CELL] / 2 + step / 2
    low = frame[ORIGIN_Y] - frame[CELL] / 2 + step / 2
    out = np.ones((m, m), dtype=np.float32)
    turns = np.zeros(m + 1, dtype=np.bool_)
    for r in range(m):
        y = low + r * step
        turns[:] = False
        for e in range(edges.shape[0]):
            y0, y1 = edges[e, 1], edges[e, 3]
            if (y0 > y) != (y1 > y):
                x = edges[e, 0] + (y - y0) * (edges[e, 2] - edges[e, 0]) / (y1 - y0)
                c = int(min(max(math.ceil((x - left) / step), 0.0), m))  # samples left of it
                turns[c] = not turns[c]
        inside = False
        for c in range(m - 1, -1, -1):
            inside = inside != turns[c + 1]
            if inside:
                out[r, c] = -1.0
    return out


@njit(cache=True)
def _near(
    edges: FloatArray, some: IntArray, x: float, y: float, half: float, out: IntArray, room: FloatArray
) -> int:
    """Which of some edges can be the nearest of a point within ``half`` of (x, y); their count."""
    best, count = np.inf, 0
    for i in range(some.size):
        room[i] = _edge_distance(edges, some[i], x, y)
        best = min(best, room[i])
    for i in range(some.size):
        if room[i] <= best + 2.0 * half:
            out[count] = some[i]
            count += 1
    return count


@njit(cache=True)
def signed_distances(edges: FloatArray, bounds: FloatArray, frame: FloatArray, n: int) -> Field:
    """Distance to the nearest obstacle or bound, in cells, negative inside or outside: (n * FINE, n * FINE).

    Each cell has FINE x FINE samples, at the middles of its equal parts.

    Args:
        edges: (e, 4) edges x0, y0, x1, y1 of the obstacles' union, in any order.
        bounds: (4,) xmin, ymin, xmax, ymax.
        frame: Where the cells lie.
        n: Cells along each side.
    """
    cell = frame[CELL]
    out = _signs(edges, frame, n)
    count = edges.shape[0]
    every, block, few = np.arange(count), np.empty(count, np.int64), np.empty(count, np.int64)
    room = np.empty(count)
    for r0 in range(0, n, _BLOCK):
        for c0 in range(0, n, _BLOCK):
            x, y = frame[ORIGIN_X] + (c0 - 0.5) * cell, frame[ORIGIN_Y] + (r0 - 0.5) * cell
            wide = _BLOCK * cell
            half = math.sqrt(0.5) * wide
            near = block[: _near(edges, every, x + wide / 2, y + wide / 2, half, block, room)]
            for r in range(r0, min(r0 + _BLOCK, n)):
                for c in range(c0, min(c0 + _BLOCK, n)):
                    _sample_cell(edges, bounds, frame, r, c, near, few, room, out)
    return out


@njit(cache=True)
def _sample_cell(
    edges: FloatArray,
    bounds: FloatArray,
    frame: FloatArray,
    r: int,
    c: int,
    near: IntArray,
    few: IntArray,
    room: FloatArray,
    out: Field,
) -> None:
    """Turn the signs of one cell's samples into signed distances, by the edges near it."""
    cell = frame[CELL]
    x, y = frame[ORIGIN_X] + c * cell, frame[ORIGIN_Y] + r * cell
    count = _near(edges, near, x, y, math.sqrt(0.5) * cell, few, room)
    for a in range(FINE):
        yy = y + ((a + 0.5) / FINE - 0.5) * cell
        for b in range(FINE):
            xx = x + ((b + 0.5) / FINE - 0.5) * cell
            least = np.inf
            for i in range(count):
                least = min(least, _edge_distance(edges, few[i], xx, yy))
            spare = min(xx - bounds[0], bounds[2] - xx, yy - bounds[1], bounds[3] - yy)
            least *= out[r * FINE + a, c * FINE + b]
            out[r * FINE + a, c * FINE + b] = min(least, spare) / cell


@njit(cache=True)
def _room(
    distances: Field, gx: float, gy: float, cos: float, sin: float, body: FloatArray, enough: float
) -> float:
    """Least distance less radius over the discs of a body at (gx, gy), all in cells; ends at ``enough``."""
    m = distances.shape[0]
    least = np.inf
    for p in range(body.shape[0]):
        x = (gx + cos * body[p, 0] - sin * body[p, 1] + 0.5) * FINE - 0.5
        y = (gy + sin * body[p, 0] + cos * body[p, 1] + 0.5) * FINE - 0.5
        cx, cy = min(max(x, 0.0), m - 1.001), min(max(y, 0.0), m - 1.001)
        i, j = int(cx), int(cy)
        fx, fy = cx - i, cy - j
        low = distances[j, i] + fx * (distances[j, i + 1] - distances[j, i])
        high = distances[j + 1, i] + fx * (distances[j + 1, i + 1] - distances[j + 1, i])
        # Beyond the samples, the value at the rim less the way to it.
        value = low + fy * (high - low) - (abs(x - cx) + abs(y - cy)) / FINE - body[p, 2]
        if value < least:
            least = value
            if least <= enough:
                break
    return least


@njit(cache=True)
def _padded(distances: Field, pad: int) -> Field:
    """The samples with a border: beyond them, the value at the rim less the way to it in cells."""
    m = distances.shape[0]
    out = np.empty((m + 2 * pad, m + 2 * pad), dtype=np.float32)
    for r in range(m + 2 * pad):
        j = min(max(r - pad, 0), m - 1)
        for c in range(m + 2 * pad):
            i = min(max(c - pad, 0), m - 1)
            out[r, c] = distances[j, i] - (abs(r - pad - j) + abs(c - pad - i)) / FINE
    return out


@njit(cache=True)
def robot_clearances(distances: Field, body: FloatArray, radius: float, turns: int) -> Field:
    """Room of the robot at each pose, in cells, as far as the samples tell: (n, n, turns).

    The least distance less radius over the discs of the body; negative where it overlaps. Exact, but for the
    samples' resolution, between `LEAST` and `CLIP`; beyond them a bound.

    Args:
        distances: (n * FINE, n * FINE) what `signed_distances` gives.
        body: (k, 3) discs x, y, radius in the body frame that fill the robot, in cells.
        radius: Circumradius of the robot, in cells.
        turns: Headings T.
    """
    n, k = distances.shape[0] // FINE, body.shape[0]
    pad = int(radius * FINE) + 3
    samples = _padded(distances, pad)
    wide = samples.shape[1]
    flat = samples.ravel()
    # A disc lies at the same place between samples in every cell, so the shares are worked out only once.
    places, shares = np.empty((turns, k), np.int64), np.empty((turns, k, 2), np.float32)
    for t in range(turns):
        cos, sin = math.cos(2.0 * math.pi * t / turns), math.sin(2.0 * math.pi * t / turns)
        for p in range(k):
            x = (cos * body[p, 0] - sin * body[p, 1] + 0.5) * FINE - 0.5 + pad
            y = (sin * body[p, 0] + cos * body[p, 1] + 0.5) * FINE - 0.5 + pad
            places[t, p] = int(y) * wide + int(x)
            shares[t, p, 0], shares[t, p, 1] = x - int(x), y - int(y)
    out = np.empty((n, n, turns), dtype=np.float32)
    for r in range(n):
        for c in range(n):
            middle = distances[r * FINE + FINE // 2, c * FINE + FINE // 2]
            if middle - radius > CLIP or middle + radius < LEAST:
                out[r, c, :] = middle - radius if middle > 0.0 else middle
                continue
            for t in range(turns):
                least = np.float32(np.inf)
                for p in range(k):
                    v = places[t, p] + (r * wide + c) * FINE
                    low = flat[v] + shares[t, p, 0] * (flat[v + 1] - flat[v])
                    v += wide
                    high = flat[v] + shares[t, p, 0] * (flat[v + 1] - flat[v])
                    least = min(least, low + shares[t, p, 1] * (high - low) - np.float32(body[p, 2]))
                    if least <= LEAST:
                        break
                out[r, c, t] = least
    return out


@njit(cache=True)
def free_logits(
    room: Field, workspace: Field, first: Field, bias: Field, last: Field, offset: float
) -> Field:
    """Logit of each pose being free, by one hidden layer over four rooms: (n, n, T).

    A pose's own room, those at the headings beside it, and that of a point there, clipped to `LEAST` and
    `CLIP`.

    Args:
        room: (n, n, T) room of the robot.
        workspace: (n, n) room of a point.
        first: (4, h) weights of the hidden layer.
        bias: (h,) its bias.
        last: (h,) weights of the logit.
        offset: Its bias.
    """
    n, turns, h = room.shape[0], room.shape[2], bias.size
    out = np.empty(room.shape, dtype=np.float32)
    line = np.empty(turns, dtype=np.float32)
    for r in range(n):
        for c in range(n):
            point = min(max(workspace[r, c], LEAST), CLIP)
            for k in range(turns):
                line[k] = min(max(room[r, c, k], LEAST), CLIP)
            for k in range(turns):
                before, after = line[k - 1], line[k + 1 if k + 1 < turns else 0]
                total = offset
                for i in range(h):
                    unit = bias[i] + line[k] * first[0, i] + before * first[1, i] + after * first[2, i]
                    total += max(unit + point * first[3, i], 0.0) * last[i]
                out[r, c, k] = total
    return out


@njit(cache=True)
def _beside(r: int, c: int, k: int, side: int, turns: int) -> tuple[int, int, int]:
    """The neighbour of a pose: 0 and 1 in its row, 2 and 3 in its column, 4 and 5 by a turn."""
    if side < 2:
        return r, c + 2 * side - 1, k
    if side < 4:
        return r + 2 * side - 5, c, k
    return r, c, (k + 2 * side - 9) % turns


@njit(cache=True)
def _solve(known: Field, r: int, c: int, k: int, slowness: float, flat: float, turn: float) -> float:
    """Upwind solution of |grad u| = slowness at one pose, from its neighbours: infinite where not known."""
    n, turns = known.shape[0], known.shape[2]
    a0 = a1 = a2 = np.float32(np.inf)
    if c > 0:
        a0 = known[r, c - 1, k]
    if c < n - 1:
        a0 = min(a0, known[r, c + 1, k])
    if r > 0:
        a1 = known[r - 1, c, k]
    if r < n - 1:
        a1 = min(a1, known[r + 1, c, k])
    if turns > 1:
        below, above = k - 1 if k > 0 else turns - 1, k + 1 if k < turns - 1 else 0
        a2 = min(known[r, c, below], known[r, c, above])
    w0 = w1 = 1.0 / (flat * flat)
    w2 = 1.0 / (turn * turn) if turns > 1 else 1.0
    # Ascending; three swaps sort three.
    if a1 < a0:
        a0, a1 = a1, a0
    if a2 < a1:
        a1, a2, w1, w2 = a2, a1, w2, w1
    if a1 < a0:
        a0, a1, w0, w1 = a1, a0, w1, w0
    value = a0 + slowness / math.sqrt(w0)
    a, b, q = w0, w0 * a0, w0 * a0 * a0 - slowness * slowness
    if value > a1:
        a, b, q = a + w1, b + w1 * a1, q + w1 * a1 * a1
        value = (b + math.sqrt(max(b * b - a * q, 0.0))) / a
        if value > a2:
            a, b, q = a + w2, b + w2 * a2, q + w2 * a2 * a2
            value = (b + math.sqrt(max(b * b - a * q, 0.0))) / a
    return float(value)


@njit(cache=True)
def goal_distance(x: float, y: float, theta: float, frame: FloatArray) -> float:
    """The metric's distance to the goal, obstacles ignored."""
    dx, dy = frame[GOAL] - x, frame[GOAL + 1] - y
    turn = (frame[GOAL + 2] - theta) / (2.0 * math.pi)
    turn = frame[WEIGHT] * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
    return math.sqrt(dx * dx + dy * dy + turn * turn)


@njit(cache=True)
def goal_distances(n: int, turns: int, frame: FloatArray) -> Field:
    """`goal_distance` at every pose of a grid: (n, n, turns)."""
    out = np.empty((n, n, turns), dtype=np.float32)
    for r in range(n):
        for c in range(n):
            for k in range(turns):
                x, y = frame[ORIGIN_X] + c * frame[CELL], frame[ORIGIN_Y] + r * frame[CELL]
                out[r, c, k] = goal_distance(x, y, 2.0 * math.pi * k / turns, frame)
    return out


@njit(cache=True)
def poses_near_goal(
    shape: tuple[int, int, int], frame: FloatArray, reach: int
) -> tuple[IntArray, FloatArray]:
    """Flat places (m,) of the poses at most ``reach`` cells around the goal, and the poses (m, 3).

    Of the headings, the two beside the goal's.
    """
    n, turns = shape[0], shape[2]
    i = math.floor((frame[GOAL] - frame[ORIGIN_X]) / frame[CELL])
    j = math.floor((frame[GOAL + 1] - frame[ORIGIN_Y]) / frame[CELL])
    k = math.floor(frame[GOAL + 2] * turns / (2.0 * math.pi)) if turns > 1 else 0
    sides = 2 if turns > 1 else 1
    places, poses = (
        np.empty(4 * (reach + 1) ** 2 * sides, np.int64),
        np.empty((4 * (reach + 1) ** 2 * sides, 3)),
    )
    count = 0
    for r in range(max(j - reach, 0), min(j + reach + 2, n)):
        for c in range(max(i - reach, 0), min(i + reach + 2, n)):
            for side in range(sides):
                t = (k + side) % turns
                places[count] = (r * n + c) * turns + t
                poses[count, 0] = frame[ORIGIN_X] + c * frame[CELL]
                poses[count, 1] = frame[ORIGIN_Y] + r * frame[CELL]
                poses[count, 2] = 2.0 * math.pi * t / turns if turns > 1 else frame[GOAL + 2]
                count += 1
    return places[:count], poses[:count]


@njit(cache=True)
def wave(
    slowness: Field, wanted: BoolArray, places: IntArray, values: FloatArray, frame: FloatArray
) -> Field:
    """Solve |grad u| = slowness outwards from the goal by fast marching: (n, n, T) float32.

    Ends when it has reached every pose that is wanted; what it has not reached by then comes last, and what
    no way of finite slowness leads to has an infinite value. Poses wait in buckets of arrivals that are told
    apart no further (an untidy priority queue): a pose may be taken before another that is nearer by less
    than a quarter of the way between two poses, or a little more where turns cost next to nothing.

    Args:
        slowness: (n, n, T) at least 1; more where a pose seems blocked; infinite where it is forbidden.
        wanted: (n, n, T) which poses the wave has to reach.
        places: (m,) flat places of the poses where the wave begins.
        values: (m,) how far they are from the goal.
        frame: Where the cells lie, and the weight of a turn.
    """
    n, turns = slowness.shape[0], slowness.shape[2]
    flat = frame[CELL]
    turn = max(frame[WEIGHT] * 2.0 * math.pi / turns, 1e-9 * flat)
    u = np.full(slowness.shape, np.float32(np.inf))
    known = u.copy()  # of the poses that have been taken; infinite at the others
    sides = 6 if turns > 1 else 4
    width = _UNTIDY * (max(min(flat, turn), flat / 8.0) if turns > 1 else flat)
    slowest = np.float32(1.0)
    for item in slowness.flat:
        slowest = max(slowest, item) if item < np.inf else slowest
    longest = slowest * (max(flat, turn) if turns > 1 else flat)
    buckets = min(int(longest / width) + 3, _MOST_BUCKETS)
    first = np.full(buckets, -1, dtype=np.int32)  # of each bucket, a list
    items = np.empty(slowness.size * (sides + 1), dtype=np.int32)
    after, keys = np.empty(items.size, dtype=np.int32), np.empty(items.size, dtype=np.float32)
    size = waiting = 0
    left, last, now = 0, 0.0, 0
    for v in range(slowness.size):
        left += 1 if wanted.flat[v] and slowness.flat[v] < np.inf else 0
    base = values.min() if values.size else 0.0
    for i in range(places.size):
        u.reshape(-1)[places[i]] = values[i]
        b = min(int((values[i] - base) / width), buckets - 1)
        items[size], keys[size], after[size], first[b] = places[i], values[i], first[b], size
        size += 1
    waiting = size
    while waiting > 0 and left > 0:
        b = now % buckets
        if first[b] < 0:
            now += 1
            continue
        entry = first[b]
        key, v = keys[entry], items[entry]
        first[b] = after[entry]
        if int((key - base) / width) > now:  # it was too far ahead for the buckets
            b = min(int((key - base) / width), now + buckets - 1) % buckets
            after[entry], first[b] = first[b], entry
            continue
        waiting -= 1
        k, c, r = v % turns, v // turns % n, v // (turns * n)
        if known[r, c, k] < np.inf or key > u[r, c, k]:
            continue
        known[r, c, k] = key
        left -= 1 if wanted[r, c, k] else 0
        last = max(last, key)
        for side in range(sides):
            rr, cc, kk = _beside(r, c, k, side, turns)
            if 0 <= rr < n and 0 <= cc < n and known[rr, cc, kk] == np.inf:
                value = _solve(known, rr, cc, kk, slowness[rr, cc, kk], flat, turn)
                if value < u[rr, cc, kk]:
                    u[rr, cc, kk] = value
                    # Not before this bucket, and no further ahead than the buckets go round.
                    b = min(max(int((value - base) / width), now), now + buckets - 1) % buckets
                    items[size], keys[size] = (rr * n + cc) * turns + kk, value
                    after[size], first[b] = first[b], size
                    size += 1
                    waiting += 1
    return np.minimum(u, np.float32(last + n * flat)) if left == 0 else u


@njit(cache=True)
def _cell(q: FloatArray, n: int, turns: int, frame: FloatArray) -> tuple[int, int, int, float, float, float]:
    """Lower corner (row, column, heading) of the cell around a pose and the place in it, 0 to 1 each."""
    gx = min(max((q[0] - frame[ORIGIN_X]) / frame[CELL], 0.0), n - 1.001)
    gy = min(max((q[1] - frame[ORIGIN_Y]) / frame[CELL], 0.0), n - 1.001)
    gt = 0.0
    if turns > 1:
        gt = q[2] / (2.0 * math.pi)
        gt = (gt - math.floor(gt)) * turns
    i, j, k = int(gx), int(gy), min(int(gt), turns - 1)
    return j, i, k, gy - j, gx - i, gt - k


@njit(cache=True)
def _interpolate(q: FloatArray, field: Field, frame: FloatArray, places: IntArray, shares: Field) -> bool:
    """Flat places (8,) of the corners around a pose, and their shares (8,), which sum to 1 or to 0.

    Those that seem blocked have none; nor have those whose values differ from the nearest one's by more than
    the way between them lets them: there is a wall in between, thinner than a cell.

    Returns:
        Whether any corner seems free.
    """
    n, turns = field.shape[0], field.shape[2]
    j, i, k, fy, fx, ft = _cell(q, n, turns, frame)
    turn = frame[WEIGHT] * 2.0 * math.pi / turns
    most = 2.0 * math.sqrt(2.0 * frame[CELL] ** 2 + turn**2)
    flat = field.reshape(-1)
    nearest, value = -1.0, 0.0
    for corner in range(8):
        a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
        places[corner] = ((j + b) * n + i + a) * turns + (k + c) % turns
        shares[corner] = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy) * (ft if c else 1.0 - ft)
        if flat[places[corner]] >= 0.0 and shares[corner] > nearest:
            nearest, value = shares[corner], flat[places[corner]]
    total = 0.0
    for corner in range(8):
        if flat[places[corner]] < 0.0 or abs(flat[places[corner]] - value) > most:
            shares[corner] = 0.0
        total += shares[corner]
    if total <= 1e-6:
        shares[:] = 0.0
        return False
    shares /= total
    return True


@njit(cache=True)
def look_up(qs: FloatArray, field: Field, frame: FloatArray) -> FloatArray:
    """The field between its poses, by the corners that seem free: (m,), at least the distance to the goal.

    Args:
        qs: (m, d) configurations.
        field: (n, n, T) cost-to-go, negated where a pose seems blocked. Where all corners are, their least
            value counts.
        frame: Where the cells lie.
    """
    flat = field.reshape(-1)
    places, shares = np.empty(8, dtype=np.int64), np.empty(8, dtype=np.float32)
    out = np.empty(qs.shape[0])
    for m in range(qs.shape[0]):
        if _interpolate(qs[m], field, frame, places, shares):
            value = 0.0
            for corner in range(8):
                if shares[corner] > 0.0:
                    value += shares[corner] * flat[places[corner]]
        else:
            value = np.inf
            for corner in range(8):
                value = min(value, abs(flat[places[corner]]))
        straight = goal_distance(qs[m, 0], qs[m, 1], qs[m, 2] if qs.shape[1] > 2 else 0.0, frame)
        out[m] = max(value, straight)
    return out


class Joined(NamedTuple):
    """How m configurations are joined to the poses of a grid, up to 8 of them each, and to the goal.

    Attributes:
        places: (m, 9) flat places of the poses, and of the one nearest to the goal.
        shares: (m, 8) float32 by which to mix the poses; they sum to 1 or to 0.
        lengths: (m, 10) distances to the poses and to the goal, infinite if not joined, and then the goal's
            distance again, joined or not.
    """

    places: IntArray
    shares: Field
    lengths: FloatArray


@njit(cache=True)
def join(qs: FloatArray, room: Field, free: BoolArray, frame: FloatArray, geometry: Geometry) -> Joined:
    """Join configurations (m, d) to the corners of the cells that they lie in, and to the goal if it is near.

    A corner counts if the straight motion to it is free, which is looked at where the room leaves it in
    doubt; corners that seem free go before others. Where no corner is left all count; in collision none does.

    Args:
        qs: (m, d) configurations.
        room: (n, n, T) room of the robot in cells.
        free: (n, n, T) which poses seem free.
        frame: Where the cells lie, and the goal.
        geometry: What the collision kernels take.
    """
    n, turns, d = room.shape[0], room.shape[2], qs.shape[1]
    cell, span = frame[CELL], 2.0 * math.pi / turns
    count = 8 if turns > 1 else 4
    # Where the corners have this much room, the whole cell is free.
    enough = _SLACK + math.sqrt(0.5) + (geometry[0][2] / cell * span / 2.0 if turns > 1 else 0.0)
    places = np.zeros((qs.shape[0], 9), np.int64)
    shares = np.zeros((qs.shape[0], 8), np.float32)
    lengths = np.full((qs.shape[0], 10), np.inf)
    away, end = np.empty(count), np.empty(d)
    for m in range(qs.shape[0]):
        if not pose_free(qs[m], geometry):
            continue
        j, i, k, fy, fx, ft = _cell(qs[m], n, turns, frame)
        least = np.inf
        for corner in range(count):
            a, b, h = j + (corner >> 1 & 1), i + (corner & 1), (k + (corner >> 2)) % turns
            places[m, corner] = (a * n + b) * turns + h
            least = min(least, room[a, b, h])
        ranks = np.zeros(count, np.int64)
        for corner in range(count):
            place = places[m, corner]
            end[0] = frame[ORIGIN_X] + place // turns % n * cell
            end[1] = frame[ORIGIN_Y] + place // (turns * n) * cell
            turn = 0.0
            if turns > 1:
                end[2] = place % turns * span
                turn = (end[2] - qs[m, 2]) / (2.0 * math.pi)
                turn = frame[WEIGHT] * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
            away[corner] = math.sqrt((end[0] - qs[m, 0]) ** 2 + (end[1] - qs[m, 1]) ** 2 + turn * turn)
            if least >= enough or motion_free(qs[m], end, geometry):
                ranks[corner] = 2 if free.flat[place] else 1
        best, total = ranks.max(), 0.0
        for corner in range(count):
            if ranks[corner] == best:
                lengths[m, corner] = away[corner]
                share = (fx if corner & 1 else 1.0 - fx) * (fy if corner >> 1 & 1 else 1.0 - fy)
                shares[m, corner] = share * (ft if corner >> 2 else 1.0 - ft)
                total += shares[m, corner]
        shares[m] *= 1.0 / total if total > 1e-6 else 0.0
        _join_goal(qs[m], n, turns, frame, geometry, places, lengths, m)
    return Joined(places, shares, lengths)


@njit(cache=True)
def _join_goal(
    q: FloatArray,
    n: int,
    turns: int,
    frame: FloatArray,
    geometry: Geometry,
    places: IntArray,
    lengths: FloatArray,
    m: int,
) -> None:
    """Enter the goal as the last of the m-th configuration's corners, if it is near and in sight."""
    d = q.size
    goal = frame[GOAL : GOAL + d].copy()
    j, i, k, fy, fx, ft = _cell(goal, n, turns, frame)
    j, i, k = j + int(fy > 0.5), i + int(fx > 0.5), (k + int(ft > 0.5)) % turns
    places[m, 8] = (j * n + i) * turns + k
    lengths[m, 9] = goal_distance(q[0], q[1], q[2] if d > 2 else 0.0, frame)
    near = _NEAR * math.sqrt(2.0) * frame[CELL]
    if math.hypot(goal[0] - q[0], goal[1] - q[1]) <= near and motion_free(q, goal, geometry):
        lengths[m, 8] = lengths[m, 9]


@njit(cache=True)
def joined_values(joined: Joined, arrival: Field, effort: Field) -> FloatArray:
    """(m,) cost-to-go of configurations that `join` has joined; infinite where it has not.

    The mix of the corners, or the least of corner and way to it, whichever is less: the one where the field
    is smooth, the other where it is not. Neither falls where the arrival rises.

    Args:
        joined: What `join` gives.
        arrival: (n, n, T) when the wave comes to the poses.
        effort: (n, n, T) how many times slower they have become.
    """
    places, shares, lengths = joined.places, joined.shares, joined.lengths
    flat, slower = arrival.reshape(-1), effort.reshape(-1)
    out = np.full(places.shape[0], np.inf)
    for m in range(places.shape[0]):
        mixed = 0.0
        total = 0.0
        for corner in range(8):
            value = flat[places[m, corner]]
            out[m] = min(out[m], value + lengths[m, corner])
            if shares[m, corner] > 0.0:
                total += shares[m, corner]
                mixed += shares[m, corner] * value
        if total > 0.0:
            out[m] = min(out[m], mixed)
        out[m] = max(out[m], lengths[m, 9])
        if lengths[m, 8] < np.inf and slower[places[m, 8]] < np.inf:
            out[m] = min(out[m], lengths[m, 8] * slower[places[m, 8]])
    return out


@njit(cache=True)
def corners(qs: FloatArray, field: Field, frame: FloatArray) -> tuple[IntArray, Field]:
    """What `look_up` interpolates: (m, 8) flat indices into the field and their shares, which sum to 1.

    All shares are 0 where every corner seems blocked.
    """
    places = np.zeros((qs.shape[0], 8), dtype=np.int64)
    shares = np.zeros((qs.shape[0], 8), dtype=np.float32)
    for m in range(qs.shape[0]):
        _interpolate(qs[m], field, frame, places[m], shares[m])
    return places, shares


@njit(cache=True)
def least_room(
    q: FloatArray, candidates: FloatArray, distances: Field, body: FloatArray, frame: FloatArray, parts: int
) -> FloatArray:
    """(m,) least room, in cells, at ``parts`` poses along the motions from q to candidates (m, d).

    Args:
        q: (d,) where the motions begin; not looked at itself.
        candidates: (m, d) where they end.
        distances: (n * FINE, n * FINE) what `signed_distances` gives.
        body: (k, 3) discs that fill the robot, in cells.
        frame: Where the cells lie.
        parts: How many poses.
    """
    d = q.size
    out = np.empty(candidates.shape[0])
    for m in range(candidates.shape[0]):
        least = np.inf
        turn = 0.0
        if d > 2:
            turn = (candidates[m, 2] - q[2]) / (2.0 * math.pi)
            turn = 2.0 * math.pi * (turn - math.floor(turn + 0.5))
        for p in range(1, parts + 1):
            t = p / parts
            gx = (q[0] + t * (candidates[m, 0] - q[0]) - frame[ORIGIN_X]) / frame[CELL]
            gy = (q[1] + t * (candidates[m, 1] - q[1]) - frame[ORIGIN_Y]) / frame[CELL]
            theta = q[2] + t * turn if d > 2 else 0.0
            least = min(least, _room(distances, gx, gy, math.cos(theta), math.sin(theta), body, LEAST))
        out[m] = least
    return out


@njit(cache=True)
def best_motion(
    q: FloatArray,
    candidates: FloatArray,
    scores: FloatArray,
    distances: Field,
    body: FloatArray,
    frame: FloatArray,
    parts: int,
    enough: float,
    penalty: float,
) -> int:
    """The candidate of the least score, where a motion with less room than ``enough`` cells scores more.

    The score grows by ``penalty`` for each ``enough`` that is lacking, and no more below `LEAST`. Only
    motions that can still be the best are looked at.

    Args:
        q: (d,) where the motions begin.
        candidates: (m, d) where they end.
        scores: (m,) their scores, room left out.
        distances: (n * FINE, n * FINE) what `signed_distances` gives.
        body: (k, 3) discs that fill the robot, in cells.
        frame: Where the cells lie.
        parts: Poses along a motion at which its room is looked up.
        enough: Room in cells.
        penalty: What lacking that room costs.
    """
    chosen, best = 0, np.inf
    motion = np.empty((1, q.size))
    for m in np.argsort(scores):
        if scores[m] >= best:
            break
        motion[0] = candidates[m]
        room = least_room(q, motion, distances, body, frame, parts)[0]
        total = scores[m] + penalty * max((enough - room) / enough, 0.0)
        if total < best:
            chosen, best = m, total
    return chosen


@njit(cache=True)
def spare_room(
    q: FloatArray, ends: FloatArray, distances: Field, body: FloatArray, frame: FloatArray, parts: int
) -> FloatArray:
    """(m,) how sure it is that the motions from q to ends (m, d) have room, in cells: at least 0 if it is.

    The least, over pairs of neighbouring poses, of their rooms less the way between them: what has no room
    between two poses leaves one of them little.

    Args:
        q: (d,) where the motions begin.
        ends: (m, d) where they end.
        distances: (n * FINE, n * FINE) what `signed_distances` gives.
        body: (k, 3) discs that fill the robot, in cells.
        frame: Where the cells lie.
        parts: Pairs of poses along a motion.
    """
    d = q.size
    out = np.empty(ends.shape[0])
    for m in range(ends.shape[0]):
        turn = 0.0
        if d > 2:
            turn = (ends[m, 2] - q[2]) / (2.0 * math.pi)
            turn = 2.0 * math.pi * (turn - math.floor(turn + 0.5))
        dx, dy = (ends[m, 0] - q[0]) / frame[CELL], (ends[m, 1] - q[1]) / frame[CELL]
        way = (math.hypot(dx, dy) + abs(turn) * frame[WEIGHT] / frame[CELL]) / parts
        least, before = np.inf, 0.0
        for p in range(parts + 1):
            t = p / parts
            gx, gy = (q[0] - frame[ORIGIN_X]) / frame[CELL], (q[1] - frame[ORIGIN_Y]) / frame[CELL]
            theta = q[2] + t * turn if d > 2 else 0.0
            room = _room(distances, gx + t * dx, gy + t * dy, math.cos(theta), math.sin(theta), body, LEAST)
            if p > 0:
                least = min(least, before + room - way)
            before = room
        out[m] = least
    return out


@njit(cache=True)
def blocked_on_way(q: FloatArray, field: Field, frame: FloatArray) -> int:
    """Poses that seem blocked on the field's way from q (d,) to the goal, the one beside q left out.

    From the best corner around q that seems free, always on to the neighbour of least cost-to-go. A way that
    does not end at the goal, where the wave has not come, counts as blocked.

    Args:
        q: Where the way begins.
        field: (n, n, T) cost-to-go, negated where a pose seems blocked.
        frame: Where the cells lie.
    """
    n, turns = field.shape[0], field.shape[2]
    j, i, k, _, _, _ = _cell(q, n, turns, frame)
    r, c, t, best = j, i, k, np.inf
    for corner in range(8 if turns > 1 else 4):
        a, b, h = j + (corner & 1), i + (corner >> 1 & 1), (k + (corner >> 2)) % turns
        if 0.0 <= field[a, b, h] < best:
            r, c, t, best = a, b, h, field[a, b, h]
    blocked = 0
    while True:
        best, rr, cc, tt = abs(field[r, c, t]), r, c, t
        for side in range(6 if turns > 1 else 4):
            a, b, h = _beside(r, c, t, side, turns)
            if 0 <= a < n and 0 <= b < n and abs(field[a, b, h]) < best:
                best, rr, cc, tt = abs(field[a, b, h]), a, b, h
        if rr == r and cc == c and tt == t:
            away = abs((frame[GOAL] - frame[ORIGIN_X]) / frame[CELL] - c)
            away = max(away, abs((frame[GOAL + 1] - frame[ORIGIN_Y]) / frame[CELL] - r))
            return blocked if away <= _AT_GOAL else blocked + 1
        r, c, t = rr, cc, tt
        blocked += 1 if field[r, c, t] < 0.0 else 0


@njit(cache=True)
def add_effort(effort: Field, points: FloatArray, frame: FloatArray, reach: float, gain: float) -> None:
    """Add gain exp(-(distance / reach)^2) at the poses around points (p, d), to (n, n, T), in place."""
    n, turns = effort.shape[0], effort.shape[2]
    cell, weight = frame[CELL], frame[WEIGHT]
    wide = int(3.0 * reach / cell) + 1
    for m in range(points.shape[0]):
        gx, gy = (points[m, 0] - frame[ORIGIN_X]) / cell, (points[m, 1] - frame[ORIGIN_Y]) / cell
        for r in range(max(int(gy) - wide, 0), min(int(gy) + wide + 2, n)):
            for c in range(max(int(gx) - wide, 0), min(int(gx) + wide + 2, n)):
                flat = ((c - gx) * cell) ** 2 + ((r - gy) * cell) ** 2
                for t in range(turns):
                    square = flat
                    if turns > 1:
                        turn = t / turns - points[m, 2] / (2.0 * math.pi)
                        turn = weight * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
                        square += turn * turn
                    if square < 9.0 * reach * reach:
                        effort[r, c, t] += gain * math.exp(-square / (reach * reach))


@njit(cache=True)
def multiply_near(field: Field, q: FloatArray, frame: FloatArray, reach: float, factor: float) -> None:
    """Multiply (n, n, T) in place at the poses within ``reach`` (length) of q (d,), and at the nearest."""
    n, turns = field.shape[0], field.shape[2]
    cell = frame[CELL]
    gx, gy = (q[0] - frame[ORIGIN_X]) / cell, (q[1] - frame[ORIGIN_Y]) / cell
    gt = q[2] * turns / (2.0 * math.pi) if turns > 1 else 0.0
    span = frame[WEIGHT] * 2.0 * math.pi / turns
    j, i = min(max(round(gy), 0), n - 1), min(max(round(gx), 0), n - 1)
    k = int(round(gt) % turns)
    field[j, i, k] *= factor
    wide = int(min(reach / cell, float(n))) + 1
    for r in range(max(j - wide, 0), min(j + wide + 1, n)):
        for c in range(max(i - wide, 0), min(i + wide + 1, n)):
            flat = ((c - gx) * cell) ** 2 + ((r - gy) * cell) ** 2
            for t in range(turns):
                away = (t - gt) / turns
                turn = span * turns * (away - math.floor(away + 0.5)) if turns > 1 else 0.0
                if flat + turn * turn <= reach * reach and not (r == j and c == i and t == k):
                    field[r, c, t] *= factor


@njit(cache=True)
def crowding(qs: FloatArray, points: FloatArray, reach: float, weight: float) -> FloatArray:
    """Sum over points (p, d) of exp(-(distance / reach)^2) for each of qs (m, d): (m,)."""
    out = np.zeros(qs.shape[0])
    for m in range(qs.shape[0]):
        for p in range(points.shape[0]):
            dx, dy = qs[m, 0] - points[p, 0], qs[m, 1] - points[p, 1]
            square = dx * dx + dy * dy
            if qs.shape[1] > 2:
                turn = (qs[m, 2] - points[p, 2]) / (2.0 * math.pi)
                turn = weight * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
                square += turn * turn
            if square < 9.0 * reach * reach:
                out[m] += math.exp(-square / (reach * reach))
    return out
