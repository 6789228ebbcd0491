"""Cost-to-go fields on square grids of poses: clearance of a robot, waves of varying speed, lookup.

Arrays over poses are (n, n, T): row y from the bottom up, column x, heading 2 pi k / T. A frame is the
float64 array of `FRAME` entries below. No pose is checked for collision here: all is made from the workspace.
"""
# mypy: disable-error-code="misc,arg-type,no-any-return"

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]

ORIGIN_X: Final = 0  # centre of the cell in row 0 and column 0
ORIGIN_Y: Final = 1
CELL: Final = 2  # side of a cell (length)
WEIGHT: Final = 3  # length per radian; 0 for a robot that cannot turn
GOAL: Final = 4  # three entries: x, y, theta
FRAME: Final = 7

_MARGIN = 3  # robot radii of room beyond which the outline does not matter
_FREE = 2.0  # slowness up to which a pose counts as free


@njit(cache=True)
def signed_distances(edges: FloatArray, bounds: FloatArray, frame: FloatArray, n: int) -> FloatArray:
    """Distance of the cells' centres to the nearest obstacle or bound, negative inside or outside: (n, n).

    Args:
        edges: (e, 4) edges x0, y0, x1, y1 of the obstacles' union, in any order.
        bounds: (4,) xmin, ymin, xmax, ymax.
        frame: Where the cells lie.
        n: Cells along each side.
    """
    out = np.empty((n, n))
    for r in range(n):
        y = frame[ORIGIN_Y] + r * frame[CELL]
        for c in range(n):
            x = frame[ORIGIN_X] + c * frame[CELL]
            best, inside = np.inf, False
            for e in range(edges.shape[0]):
                x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
                dx, dy = x1 - x0, y1 - y0
                t = (x - x0) * dx + (y - y0) * dy
                square = dx * dx + dy * dy
                t = 0.0 if t <= 0.0 else (1.0 if t >= square else t / square)
                ex, ey = x0 + t * dx - x, y0 + t * dy - y
                best = min(best, ex * ex + ey * ey)
                if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * dx / dy:
                    inside = not inside
            distance = -math.sqrt(best) if inside else math.sqrt(best)
            room = min(x - bounds[0], bounds[2] - x, y - bounds[1], bounds[3] - y)
            out[r, c] = min(distance, room)
    return out


@njit(cache=True)
def _bilinear(grid: FloatArray, gx: float, gy: float) -> float:
    """Value between the cells' centres; beyond them, the value at the rim less the distance in cells."""
    n = grid.shape[0]
    x, y = min(max(gx, 0.0), n - 1.001), min(max(gy, 0.0), n - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    low = grid[j, i] + fx * (grid[j, i + 1] - grid[j, i])
    high = grid[j + 1, i] + fx * (grid[j + 1, i + 1] - grid[j + 1, i])
    return low + fy * (high - low) - abs(gx - x) - abs(gy - y)


@njit(cache=True)
def robot_clearances(
    distances: FloatArray, body: FloatArray, radius: float, cell: float, turns: int
) -> Field:
    """Room of the robot at each pose, in cells, as far as the grid of distances tells: (n, n, turns).

    The least distance less radius over the discs of the body; negative where it overlaps. Far from obstacles
    a lower bound.

    Args:
        distances: (n, n) what `signed_distances` gives.
        body: (k, 3) discs x, y, radius in the body frame that fill the robot.
        radius: Circumradius of the robot.
        cell: Side of a cell.
        turns: Headings T.
    """
    n, k = distances.shape[0], body.shape[0]
    scaled = distances / cell
    discs = body / cell
    turned = np.empty((turns, k, 2))
    for t in range(turns):
        cos, sin = math.cos(2.0 * math.pi * t / turns), math.sin(2.0 * math.pi * t / turns)
        for p in range(k):
            turned[t, p, 0] = cos * discs[p, 0] - sin * discs[p, 1]
            turned[t, p, 1] = sin * discs[p, 0] + cos * discs[p, 1]
    out = np.empty((n, n, turns), dtype=np.float32)
    reach = radius / cell
    for r in range(n):
        for c in range(n):
            room = scaled[r, c]
            if room > _MARGIN * reach + 1.0 or room < -reach - 1.0:
                out[r, c, :] = room - reach if room > 0 else room
                continue
            for t in range(turns):
                least = np.inf
                for p in range(k):
                    value = _bilinear(scaled, c + turned[t, p, 0], r + turned[t, p, 1]) - discs[p, 2]
                    least = min(least, value)
                out[r, c, t] = least
    return out


@njit(cache=True)
def _push(keys: Field, items: npt.NDArray[np.int32], size: int, key: float, item: int) -> None:
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if keys[parent] <= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        i = parent
    keys[i], items[i] = key, item


@njit(cache=True)
def _drop_first(keys: Field, items: npt.NDArray[np.int32], size: int) -> None:
    """Remove the root of a heap of that size."""
    last = size - 1
    key, item = keys[last], items[last]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item


@njit(cache=True)
def _solve(
    known: npt.NDArray[np.bool_], u: Field, r: int, c: int, k: int, slowness: float, flat: float, turn: float
) -> float:
    """Upwind solution of |grad u| = slowness at one pose from its neighbours that are known."""
    n, turns = u.shape[0], u.shape[2]
    a0 = a1 = a2 = np.inf
    if c > 0 and known[r, c - 1, k]:
        a0 = u[r, c - 1, k]
    if c < n - 1 and known[r, c + 1, k]:
        a0 = min(a0, u[r, c + 1, k])
    if r > 0 and known[r - 1, c, k]:
        a1 = u[r - 1, c, k]
    if r < n - 1 and known[r + 1, c, k]:
        a1 = min(a1, u[r + 1, c, k])
    if turns > 1:
        below, above = k - 1 if k > 0 else turns - 1, k + 1 if k < turns - 1 else 0
        if known[r, c, below]:
            a2 = u[r, c, below]
        if known[r, c, above]:
            a2 = min(a2, u[r, c, above])
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
    return value


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
def _seeds(u: Field, room: Field, frame: FloatArray) -> None:
    """Write the distance to the goal at the poses near it that nothing can lie in between.

    Such a pose has at least as much room as the goal is far. If there is none, the best of the nearest.
    """
    n, turns = u.shape[0], u.shape[2]
    gx, gy = (frame[GOAL] - frame[ORIGIN_X]) / frame[CELL], (frame[GOAL + 1] - frame[ORIGIN_Y]) / frame[CELL]
    gk = math.floor(frame[GOAL + 2] * turns / (2.0 * math.pi)) if turns > 1 else 0
    i, j = math.floor(gx), math.floor(gy)
    best, best_r, best_c, best_k = -np.inf, 0, 0, 0
    for r in range(max(j - 2, 0), min(j + 4, n)):
        for c in range(max(i - 2, 0), min(i + 4, n)):
            for turned in range(2 if turns > 1 else 1):
                k = (gk + turned) % turns
                spare = room[r, c, k] - math.sqrt((c - gx) ** 2 + (r - gy) ** 2)
                if spare >= 0.0:
                    x, y = frame[ORIGIN_X] + c * frame[CELL], frame[ORIGIN_Y] + r * frame[CELL]
                    u[r, c, k] = goal_distance(x, y, 2.0 * math.pi * k / turns, frame)
                if spare > best:
                    best, best_r, best_c, best_k = spare, r, c, k
    if best < 0.0:
        x, y = frame[ORIGIN_X] + best_c * frame[CELL], frame[ORIGIN_Y] + best_r * frame[CELL]
        u[best_r, best_c, best_k] = goal_distance(x, y, 2.0 * math.pi * best_k / turns, frame)


@njit(cache=True)
def wave(slowness: Field, room: Field, frame: FloatArray) -> Field:
    """Solve |grad u| = slowness outwards from the goal by fast marching: (n, n, T) float32.

    Ends when it has reached every pose of slowness 2 or less; what it has not reached by then comes last.

    Args:
        slowness: (n, n, T) at least 1; more where a pose seems blocked.
        room: (n, n, T) what `robot_clearances` gives: it says where the wave may begin.
        frame: Where the cells lie, the weight of a turn, and the goal.
    """
    n, turns = slowness.shape[0], slowness.shape[2]
    flat = frame[CELL]
    turn = max(frame[WEIGHT] * 2.0 * math.pi / turns, 1e-9)
    u = np.full(slowness.shape, np.float32(np.inf))
    _seeds(u, room, frame)
    known = np.zeros(slowness.shape, dtype=np.bool_)
    sides = 6 if turns > 1 else 4
    space = slowness.size * (sides + 1)
    keys, items, size = np.empty(space, dtype=np.float32), np.empty(space, dtype=np.int32), 0
    for v, seed in enumerate(u.flat):
        if seed < np.inf:
            _push(keys, items, size, seed, v)
            size += 1
    left, last = 0, 0.0
    for item in slowness.flat:
        left += 1 if item <= _FREE else 0
    while size > 0 and left > 0:
        key, v = keys[0], items[0]
        _drop_first(keys, items, size)
        size -= 1
        k, c, r = v % turns, v // turns % n, v // (turns * n)
        if known[r, c, k] or key > u[r, c, k]:
            continue
        known[r, c, k] = True
        left -= 1 if slowness[r, c, k] <= _FREE else 0
        last = max(last, key)
        for side in range(sides):
            rr, cc, kk = r, c, k
            if side < 2:
                cc += 2 * side - 1
            elif side < 4:
                rr += 2 * side - 5
            else:
                kk = (k + 2 * side - 9) % turns
            if 0 <= rr < n and 0 <= cc < n and not known[rr, cc, kk]:
                value = _solve(known, u, rr, cc, kk, slowness[rr, cc, kk], flat, turn)
                if value < u[rr, cc, kk]:
                    u[rr, cc, kk] = value
                    _push(keys, items, size, value, (rr * n + cc) * turns + kk)
                    size += 1
    return np.minimum(u, np.float32(last + n * flat))


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
def look_up(qs: FloatArray, field: Field, frame: FloatArray) -> FloatArray:
    """The field between its poses, by the corners that seem free: (m,), at least the distance to the goal.

    Args:
        qs: (m, d) configurations.
        field: (n, n, T) cost-to-go, negated where a pose seems blocked. Where all corners are, their least
            value counts.
        frame: Where the cells lie.
    """
    n, turns = field.shape[0], field.shape[2]
    out = np.empty(qs.shape[0])
    for m in range(qs.shape[0]):
        j, i, k, fy, fx, ft = _cell(qs[m], n, turns, frame)
        total, summed, blocked = 0.0, 0.0, np.inf
        for corner in range(8 if turns > 1 else 4):
            a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
            value = field[j + b, i + a, (k + c) % turns]
            share = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy) * (ft if c else 1.0 - ft)
            if value >= 0.0:
                total += share
                summed += share * value
            else:
                blocked = min(blocked, -value)
        straight = goal_distance(qs[m, 0], qs[m, 1], qs[m, 2] if qs.shape[1] > 2 else 0.0, frame)
        out[m] = max(summed / total if total > 1e-6 else blocked, straight)
    return out


@njit(cache=True)
def corners(
    qs: FloatArray, field: Field, frame: FloatArray
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """What `look_up` interpolates: (m, 8) flat indices into the field and their shares, which sum to 1.

    All shares are 0 where every corner seems blocked.
    """
    n, turns = field.shape[0], field.shape[2]
    places = np.zeros((qs.shape[0], 8), dtype=np.int64)
    shares = np.zeros((qs.shape[0], 8), dtype=np.float32)
    for m in range(qs.shape[0]):
        j, i, k, fy, fx, ft = _cell(qs[m], n, turns, frame)
        total = 0.0
        for corner in range(8 if turns > 1 else 4):
            a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
            places[m, corner] = ((j + b) * n + i + a) * turns + (k + c) % turns
            if field[j + b, i + a, (k + c) % turns] >= 0.0:
                share = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy) * (ft if c else 1.0 - ft)
                shares[m, corner] = share
                total += share
        for corner in range(8):
            shares[m, corner] = shares[m, corner] / total if total > 1e-6 else 0.0
    return places, shares


@njit(cache=True)
def room_at(q: FloatArray, room: Field, frame: FloatArray) -> float:
    """`robot_clearances` between its poses, in cells."""
    n, turns = room.shape[0], room.shape[2]
    j, i, k, fy, fx, ft = _cell(q, n, turns, frame)
    value = 0.0
    for corner in range(8 if turns > 1 else 4):
        a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
        share = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy) * (ft if c else 1.0 - ft)
        value += share * room[j + b, i + a, (k + c) % turns]
    return value


@njit(cache=True)
def least_room(
    q: FloatArray, candidates: FloatArray, room: Field, frame: FloatArray, parts: int
) -> FloatArray:
    """(m,) least room, in cells, at ``parts`` poses along the motions from q to candidates (m, d)."""
    d = q.size
    out = np.empty(candidates.shape[0])
    pose = np.empty(d)
    for m in range(candidates.shape[0]):
        least = np.inf
        turn = 0.0
        if d > 2:
            turn = (candidates[m, 2] - q[2]) / (2.0 * math.pi)
            turn = 2.0 * math.pi * (turn - math.floor(turn + 0.5))
        for p in range(1, parts + 1):
            t = p / parts
            pose[0] = q[0] + t * (candidates[m, 0] - q[0])
            pose[1] = q[1] + t * (candidates[m, 1] - q[1])
            if d > 2:
                pose[2] = q[2] + t * turn
            least = min(least, room_at(pose, room, frame))
        out[m] = least
    return out


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
