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

from guided_gym.compute.compile_lock import vectorised
from guided_gym.kernels.collision import Geometry, motion_free, pose_free
from guided_gym.kernels.plain import borrowing, owning

FloatArray = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Links = npt.NDArray[np.uint8]

ORIGIN_X: Final = 0  # centre of the cell in row 0 and column 0
ORIGIN_Y: Final = 1
CELL: Final = 2  # side of a cell (length)
WEIGHT: Final = 3  # length per radian; 0 for a robot that cannot turn
GOAL: Final = 4  # three entries: x, y, theta
FRAME: Final = 7

FAR: Final = 3.0  # reaches beyond which a crowd ends
FINE: Final = 4  # samples of the distance along a cell's side
CLIP: Final = 2.0  # cells of room; more is as good
LEAST: Final = -2.0  # cells of room; less is as bad
_AT_GOAL = 4.0  # cells
_SLACK = 0.25  # cells by which bilinear rooms may be wrong
_SURE = 0.1  # cells of room that a pose lacks which is surely blocked
_NEAR = 2.0  # cells from which the goal is looked for itself
_BLOCK: Final = 8  # cells along a side whose near edges are looked for together
_HALF: Final = _BLOCK // 2


@borrowing
def _edge_square(edges: FloatArray, e: int, x: float, y: float) -> float:
    """Square of the distance from (x, y) to an edge."""
    x0, y0 = edges[e, 0], edges[e, 1]
    dx, dy = edges[e, 2] - x0, edges[e, 3] - y0
    t = (x - x0) * dx + (y - y0) * dy
    square = dx * dx + dy * dy
    t = 0.0 if t <= 0.0 else (1.0 if t >= square else t / square)
    return (x0 + t * dx - x) ** 2 + (y0 + t * dy - y) ** 2


@njit(cache=True)
def _signs(edges: FloatArray, frame: FloatArray, n: int, fine: int) -> Field:
    """-1 inside the obstacles and 1 outside at each sample: (n * fine, n * fine), line by line."""
    out = np.ones((n * fine, n * fine), dtype=np.float32)
    _draw_signs(edges, frame, frame[CELL] / fine, out)
    return out


@borrowing
def _draw_signs(edges: FloatArray, frame: FloatArray, step: float, out: Field) -> None:
    """Change the signs of the samples left of each edge."""
    m = out.shape[0]
    left = frame[ORIGIN_X] - frame[CELL] / 2 + step / 2
    low = frame[ORIGIN_Y] - frame[CELL] / 2 + step / 2
    for e in range(edges.shape[0]):
        y0, y1 = edges[e, 1], edges[e, 3]
        first = min(max((min(y0, y1) - low) / step - 1.0, 0.0), m)
        last = min(max((max(y0, y1) - low) / step + 2.0, 0.0), m)
        for r in range(int(first), int(last)):
            y = low + r * step
            if (y0 > y) != (y1 > y):
                x = edges[e, 0] + (y - y0) * (edges[e, 2] - edges[e, 0]) / (y1 - y0)
                _change_signs(out[r, : int(min(max(math.ceil((x - left) / step), 0.0), m))])


@borrowing
@vectorised
def _change_signs(values: Field) -> None:
    for i in range(values.size):
        values[i] = -values[i]


@borrowing
def _near(
    edges: FloatArray, some: IntArray, x: float, y: float, half: float, out: IntArray, squares: FloatArray
) -> int:
    """Which of some edges can be the nearest of a point within ``half`` of (x, y); their count."""
    best, count = np.inf, 0
    for i in range(some.size):
        squares[i] = _edge_square(edges, some[i], x, y)
        best = min(best, squares[i])
    most = (math.sqrt(best) + 2.0 * half) ** 2 if some.size else 0.0
    for i in range(some.size):
        if squares[i] <= most:
            out[count] = some[i]
            count += 1
    return count


class Ground(NamedTuple):
    """The workspace and a robot's room in it, looked at where it is asked for.

    Attributes:
        edges: (e, 4) edges x0, y0, x1, y1 of the obstacles' union, in any order.
        bounds: (4,) xmin, ymin, xmax, ymax.
        frame: Where the cells lie.
        distances: (n * f, n * f) distance to the nearest obstacle or bound, in cells, negative inside or
            outside: each cell has f x f samples, at the middles of its equal parts, f being `FINE` or 1. Only
            its sign counts in blocks that have not been looked at.
        seen: (b, b) which blocks of cells have been.
        body: (k, 3) discs x, y, radius in the body frame that fill the robot, in cells. Where f is 1, one
            disc around the reference point.
        radius: (1,) circumradius of the robot, in cells.
        room: (n, n, T) room of the robot in cells, as far as the samples tell: the least distance less radius
            over the discs; negative where it overlaps, NaN in blocks that have not been looked at.
        looked: (b, b) which blocks have been.
    """

    edges: FloatArray
    bounds: FloatArray
    frame: FloatArray
    distances: Field
    seen: BoolArray
    body: FloatArray
    radius: FloatArray
    room: Field
    looked: BoolArray


@njit(cache=True)
def unseen(
    edges: FloatArray,
    bounds: FloatArray,
    frame: FloatArray,
    n: int,
    turns: int,
    body: FloatArray,
    radius: float,
    fine: int,
) -> Ground:
    """The ground of n x n cells and ``turns`` headings, of which only the signs are known; see `Ground`."""
    blocks = (n + _BLOCK - 1) // _BLOCK
    return Ground(
        edges,
        bounds,
        frame,
        _signs(edges, frame, n, fine),
        np.zeros((blocks, blocks), np.bool_),
        body,
        np.array([radius]),
        np.full((n, n, turns), np.float32(np.nan)),
        np.zeros((blocks, blocks), np.bool_),
    )


@owning
def look(ground: Ground, r: int, c: int) -> None:
    """Find the room at all headings of a cell, and of those in its block, unless it is known."""
    if ground.looked[r // _BLOCK, c // _BLOCK]:
        return
    ground.looked[r // _BLOCK, c // _BLOCK] = True
    n, wide = ground.room.shape[0], int(ground.radius[0]) + 2
    r0, c0 = r // _BLOCK * _BLOCK, c // _BLOCK * _BLOCK
    if ground.distances.shape[0] == n:
        _measure_discs(ground, r0, c0)
        return
    for i in range(max(r0 - wide, 0) // _BLOCK, min(r0 + _BLOCK - 1 + wide, n - 1) // _BLOCK + 1):
        for j in range(max(c0 - wide, 0) // _BLOCK, min(c0 + _BLOCK - 1 + wide, n - 1) // _BLOCK + 1):
            if not ground.seen[i, j]:
                ground.seen[i, j] = True
                _sample_block(ground, i * _BLOCK, j * _BLOCK)
    _measure_block(ground.distances, ground.body, r0, c0, wide, ground.room)


@njit(cache=True)
def _measure_discs(ground: Ground, r0: int, c0: int) -> None:
    """Enter the room of a disc around the reference point at the cells of a block, by one sample each."""
    n = ground.room.shape[0]
    if not ground.seen[r0 // _BLOCK, c0 // _BLOCK]:
        ground.seen[r0 // _BLOCK, c0 // _BLOCK] = True
        _sample_block(ground, r0, c0)
    for r in range(r0, min(r0 + _BLOCK, n)):
        for c in range(c0, min(c0 + _BLOCK, n)):
            ground.room[r, c, :] = ground.distances[r, c] - ground.body[0, 2]


@borrowing
def look_everywhere(ground: Ground) -> None:
    """Find all distances and rooms."""
    for r in range(0, ground.room.shape[0], _BLOCK):
        for c in range(0, ground.room.shape[0], _BLOCK):
            look(ground, r, c)


@borrowing
def look_around(ground: Ground, places: IntArray) -> None:
    """Find the room at the cells of flat places (m,) of the grid."""
    n, turns = ground.room.shape[0], ground.room.shape[2]
    for place in places:
        look(ground, place // (turns * n), place // turns % n)


@njit(cache=True)
def _measure_block(distances: Field, body: FloatArray, r0: int, c0: int, wide: int, room: Field) -> None:
    """Enter the room at the poses of a block: the least distance less radius over the discs of the body.

    A disc lies at the same place between samples in every cell: the samples are taken apart by their place in
    a cell, so that a block is one sum. Beyond the samples counts the value at the rim less the way to it.
    Discs opposite of each other change places in half a turn: they are put down at half the headings only.
    """
    m, n, turns, side = distances.shape[0], room.shape[0], room.shape[2], _BLOCK + 2 * wide
    planes = np.empty((FINE, FINE, side * side), np.float32)
    low, left = (r0 - wide) * FINE, (c0 - wide) * FINE
    for r in range(side * FINE):
        j = min(max(low + r, 0), m - 1)
        beyond, row, at = abs(low + r - j), distances[j], r // FINE * side
        for b in range(FINE):
            plane = planes[r % FINE, b, at : at + side]
            if beyond == 0 and left >= 0 and left + side * FINE <= m:
                _take_apart(row[left + b : left + side * FINE], plane)
                continue
            for c in range(side):
                i = min(max(left + c * FINE + b, 0), m - 1)
                plane[c] = row[i] - np.float32((beyond + abs(left + c * FINE + b - i)) / FINE)
    opposite = _opposite(body)
    half = turns // 2 if turns % 2 == 0 else turns
    alike = np.empty((_BLOCK - 1) * side + _BLOCK, np.float32)  # what lies between the rows of the block, too
    least = np.empty_like(alike)
    for t in range(half):
        alike[:] = np.inf
        _lower(alike, planes, body, opposite, 2.0 * math.pi * t / turns, side)
        for h in range(t, turns, half):
            least[:] = alike
            _lower(least, planes, body, ~opposite, 2.0 * math.pi * h / turns, side)
            for r in range(min(_BLOCK, n - r0)):
                for c in range(min(_BLOCK, n - c0)):
                    room[r0 + r, c0 + c, h] = least[r * side + c]


@borrowing
@vectorised
def _take_apart(row: Field, plane: Field) -> None:
    """Every `FINE`-th sample of a row."""
    for c in range(plane.size):
        plane[c] = row[FINE * c]


@njit(cache=True)
def _opposite(body: FloatArray) -> BoolArray:
    """Which of the discs (k, 3) x, y, radius have another one opposite of them, up to rounding."""
    found = np.zeros(body.shape[0], np.bool_)
    for p in range(body.shape[0]):
        x, y, radius = body[p, 0], body[p, 1], body[p, 2]
        slack = 1e-9 * (abs(x) + abs(y) + radius)
        for o in range(body.shape[0]):
            if abs(body[o, 0] + x) + abs(body[o, 1] + y) + abs(body[o, 2] - radius) <= slack:
                found[p] = True
    return found


@borrowing
def _lower(
    least: Field, planes: Field, body: FloatArray, which: BoolArray, heading: float, side: int
) -> None:
    """Lower the rooms of a block to those of some discs: four samples each, mixed, less the radius."""
    cos, sin, before = math.cos(heading), math.sin(heading), 0.5 * (side - _BLOCK) + 0.5
    for p in range(body.shape[0]):
        if which[p]:
            x = (cos * body[p, 0] - sin * body[p, 1] + before) * FINE - 0.5
            y = (sin * body[p, 0] + cos * body[p, 1] + before) * FINE - 0.5
            i, j = int(x), int(y)
            fx, fy, less = np.float32(x - i), np.float32(y - j), np.float32(body[p, 2])
            low, high = j // FINE * side, (j + 1) // FINE * side
            left, right, n = i // FINE, (i + 1) // FINE, least.size
            low0 = planes[j % FINE, i % FINE, low + left : low + left + n]
            low1 = planes[j % FINE, (i + 1) % FINE, low + right : low + right + n]
            high0 = planes[(j + 1) % FINE, i % FINE, high + left : high + left + n]
            high1 = planes[(j + 1) % FINE, (i + 1) % FINE, high + right : high + right + n]
            _lower_mixed(least, low0, low1, high0, high1, (fx, fy, less))


@borrowing
@vectorised
def _lower_mixed(
    least: Field,
    low0: Field,
    low1: Field,
    high0: Field,
    high1: Field,
    parts: tuple[np.float32, np.float32, np.float32],
) -> None:
    """Lower (n,) to four samples each, mixed by two parts, less a third number."""
    fx, fy, less = parts
    for c in range(least.size):
        below = low0[c] + fx * (low1[c] - low0[c])
        above = high0[c] + fx * (high1[c] - high0[c])
        value = below + fy * (above - below) - less
        least[c] = value if value < least[c] else least[c]


@njit(cache=True)
def _sample_block(ground: Ground, r0: int, c0: int) -> None:
    """Turn the signs of a block of cells into signed distances."""
    edges, bounds, frame, out = ground.edges, ground.bounds, ground.frame, ground.distances
    n, cell, count = ground.room.shape[0], frame[CELL], edges.shape[0]
    block, some, squares = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    samples = (_HALF * FINE) ** 2
    scratch = np.empty(samples), np.empty(samples), np.empty(samples)
    x, y = frame[ORIGIN_X] + (c0 - 0.5) * cell, frame[ORIGIN_Y] + (r0 - 0.5) * cell
    wide = _BLOCK * cell
    half = math.sqrt(0.5) * wide
    around = block[: _near(edges, np.arange(count), x + wide / 2, y + wide / 2, half, block, squares)]
    for part in range(4):  # those near a quarter of the block are fewer again
        r1, c1 = r0 + part // 2 * _HALF, c0 + part % 2 * _HALF
        x, y = frame[ORIGIN_X] + (c1 - 0.5) * cell, frame[ORIGIN_Y] + (r1 - 0.5) * cell
        near = some[: _near(edges, around, x + wide / 4, y + wide / 4, half / 2, some, squares)]
        if out.shape[0] == n:
            for r in range(r1, min(r1 + _HALF, n)):
                for c in range(c1, min(c1 + _HALF, n)):
                    _sample_middle(edges, bounds, frame, r, c, near, out)
        elif r1 < n and c1 < n:
            _sample_part(edges, bounds, frame, r1, c1, near, scratch, out)


@borrowing
def _sample_middle(
    edges: FloatArray, bounds: FloatArray, frame: FloatArray, r: int, c: int, near: IntArray, out: Field
) -> None:
    """Turn the sign of one cell's only sample into a signed distance, by the edges near it."""
    x, y = frame[ORIGIN_X] + c * frame[CELL], frame[ORIGIN_Y] + r * frame[CELL]
    square = np.inf
    for e in near:
        square = min(square, _edge_square(edges, e, x, y))
    spare = min(x - bounds[0], bounds[2] - x, y - bounds[1], bounds[3] - y)
    out[r, c] = min(math.sqrt(square) * out[r, c], spare) / frame[CELL]


@borrowing
def _sample_part(
    edges: FloatArray,
    bounds: FloatArray,
    frame: FloatArray,
    r0: int,
    c0: int,
    near: IntArray,
    scratch: tuple[FloatArray, FloatArray, FloatArray],
    out: Field,
) -> None:
    """Turn the signs of a quarter of a block into signed distances, by the edges near it."""
    m, cell = out.shape[0], frame[CELL]
    high, wide = min(_HALF * FINE, m - r0 * FINE), min(_HALF * FINE, m - c0 * FINE)
    squares, xs, ys = scratch[0][: high * wide], scratch[1][: high * wide], scratch[2][: high * wide]
    for i in range(wide):
        xs[i] = frame[ORIGIN_X] + (c0 + i // FINE) * cell + ((i % FINE + 0.5) / FINE - 0.5) * cell
    for r in range(high):
        y = frame[ORIGIN_Y] + (r0 + r // FINE) * cell + ((r % FINE + 0.5) / FINE - 0.5) * cell
        _fill_line(xs[:wide], y, xs[r * wide : (r + 1) * wide], ys[r * wide : (r + 1) * wide])
    for i in range(squares.size):
        squares[i] = np.inf
    for e in near:
        _lower_squares(squares, xs, ys, edges[e])
    _take_roots(squares)
    for r in range(high):
        line, row = squares[r * wide : (r + 1) * wide], out[r0 * FINE + r, c0 * FINE : c0 * FINE + wide]
        y = ys[r * wide]
        _enter_distances(line, xs, min(y - bounds[1], bounds[3] - y), bounds[0], bounds[2], cell, row)


@borrowing
@vectorised
def _fill_line(line: FloatArray, y: float, xs: FloatArray, ys: FloatArray) -> None:
    for i in range(line.size):
        xs[i], ys[i] = line[i], y


@borrowing
@vectorised
def _enter_distances(
    distances: FloatArray, xs: FloatArray, spare: float, left: float, right: float, cell: float, row: Field
) -> None:
    """Enter distances into a row of signs: as far as the bounds, with their signs, in cells."""
    for i in range(row.size):
        inside = min(spare, min(xs[i] - left, right - xs[i]))
        row[i] = min(distances[i] * row[i], inside) / cell


@borrowing
@vectorised
def _lower_squares(squares: FloatArray, xs: FloatArray, ys: FloatArray, edge: FloatArray) -> None:
    """Lower (m,) squares of distances to those from points to an edge x0, y0, x1, y1; see `_edge_square`."""
    x0, y0 = edge[0], edge[1]
    dx, dy = edge[2] - x0, edge[3] - y0
    length = dx * dx + dy * dy
    inverse = 1.0 / length if length > 0.0 else 0.0
    for i in range(squares.size):
        px, py = xs[i] - x0, ys[i] - y0
        t = (px * dx + py * dy) * inverse
        t = t if t > 0.0 else 0.0
        t = t if t < 1.0 else 1.0
        px, py = px - t * dx, py - t * dy
        square = px * px + py * py
        squares[i] = square if square < squares[i] else squares[i]


@borrowing
@vectorised
def _take_roots(squares: FloatArray) -> None:
    for i in range(squares.size):
        squares[i] = math.sqrt(squares[i])


@borrowing
def _room(
    distances: Field,
    fine: int,
    gx: float,
    gy: float,
    cos: float,
    sin: float,
    body: FloatArray,
    enough: float,
) -> float:
    """Least distance less radius over the discs of a body at (gx, gy), all in cells; ends at ``enough``."""
    m = distances.shape[0]
    least = np.inf
    for p in range(body.shape[0]):
        x = (gx + cos * body[p, 0] - sin * body[p, 1] + 0.5) * fine - 0.5
        y = (gy + sin * body[p, 0] + cos * body[p, 1] + 0.5) * fine - 0.5
        cx, cy = min(max(x, 0.0), m - 1.001), min(max(y, 0.0), m - 1.001)
        i, j = int(cx), int(cy)
        fx, fy = cx - i, cy - j
        low = distances[j, i] + fx * (distances[j, i + 1] - distances[j, i])
        high = distances[j + 1, i] + fx * (distances[j + 1, i + 1] - distances[j + 1, i])
        # Beyond the samples, the value at the rim less the way to it.
        value = low + fy * (high - low) - (abs(x - cx) + abs(y - cy)) / fine - body[p, 2]
        if value < least:
            least = value
            if least <= enough:
                break
    return least


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


@borrowing
def _beside(r: int, c: int, k: int, side: int, turns: int) -> tuple[int, int, int]:
    """The neighbour of a pose: 0 and 1 in its row, 2 and 3 in its column, 4 and 5 by a turn."""
    if side < 2:
        return r, c + 2 * side - 1, k
    if side < 4:
        return r + 2 * side - 5, c, k
    return r, c, (k + 2 * side - 9) % turns


@njit(cache=True)
def closed_links(room: Field, frame: FloatArray, geometry: Geometry) -> tuple[Links, int]:
    """Links between neighbouring poses that are not free: (n, n, T) uint8, and how many were looked at.

    A bit for the link to the next pose in the row (1), in the column (2) and by a turn (4). A link is open
    for sure where the rooms at its ends make up its length; the others are looked at, but those that end at a
    pose that is surely blocked: they are slow enough. In a thin wall no pose is.

    Args:
        room: (n, n, T) room of the robot in cells.
        frame: Where the cells lie.
        geometry: What the collision kernels take.
    """
    n, turns = room.shape[0], room.shape[2]
    cell, span = frame[CELL], 2.0 * math.pi / turns
    out, looks = np.zeros(room.shape, np.uint8), 0
    a, b = np.zeros(3 if turns > 1 else 2), np.zeros(3 if turns > 1 else 2)
    for r in range(n):
        for c in range(n):
            for k in range(turns):
                for side in range(1, 7 if turns > 1 else 5, 2):
                    rr, cc, kk = _beside(r, c, k, side, turns)
                    if rr >= n or cc >= n or min(room[r, c, k], room[rr, cc, kk]) <= -_SURE:
                        continue
                    length = 1.0 if side < 4 else geometry[0][2] / cell * span
                    if room[r, c, k] + room[rr, cc, kk] >= length + 2.0 * _SLACK:
                        continue
                    a[0], a[1] = frame[ORIGIN_X] + c * cell, frame[ORIGIN_Y] + r * cell
                    b[0], b[1] = frame[ORIGIN_X] + cc * cell, frame[ORIGIN_Y] + rr * cell
                    if turns > 1:
                        a[2], b[2] = k * span, kk * span
                    looks += 1
                    if not motion_free(a, b, geometry):
                        out[r, c, k] |= 1 << (side >> 1)
    return out, looks


@borrowing
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
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The poses at most ``reach`` cells around the goal; of the headings, the two beside the goal's.

    Returns:
        Flat places (m,), the poses (m, 3), and how far they are from the goal (m,).
    """
    n, turns = shape[0], shape[2]
    i = math.floor((frame[GOAL] - frame[ORIGIN_X]) / frame[CELL])
    j = math.floor((frame[GOAL + 1] - frame[ORIGIN_Y]) / frame[CELL])
    k = math.floor(frame[GOAL + 2] * turns / (2.0 * math.pi)) if turns > 1 else 0
    sides = 2 if turns > 1 else 1
    most = 4 * (reach + 1) ** 2 * sides
    places, poses, distances = np.empty(most, np.int64), np.empty((most, 3)), np.empty(most)
    count = 0
    for r in range(max(j - reach, 0), min(j + reach + 2, n)):
        for c in range(max(i - reach, 0), min(i + reach + 2, n)):
            for side in range(sides):
                t = (k + side) % turns
                x, y = frame[ORIGIN_X] + c * frame[CELL], frame[ORIGIN_Y] + r * frame[CELL]
                theta = 2.0 * math.pi * t / turns if turns > 1 else frame[GOAL + 2]
                places[count] = (r * n + c) * turns + t
                poses[count, 0], poses[count, 1], poses[count, 2] = x, y, theta
                distances[count] = goal_distance(x, y, theta, frame)
                count += 1
    return places[:count], poses[:count], distances[:count]


@borrowing
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


@borrowing
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
        places: (m, 9) flat places of the poses, and of the one nearest to the goal, in a grid with a border
            (see `guided_gym.kernels.marching`).
        shares: (m, 8) float32 by which to mix the poses; they sum to 1 or to 0.
        lengths: (m, 10) distances to the poses and to the goal, infinite if not joined, and then the goal's
            distance again, joined or not.
    """

    places: IntArray
    shares: Field
    lengths: FloatArray


@njit(cache=True)
def join(qs: FloatArray, ground: Ground, seems: Field, frame: FloatArray, geometry: Geometry) -> Joined:
    """Join configurations (m, d) to the corners of the cells that they lie in, and to the goal if it is near.

    A corner counts if the straight motion to it is free, which is looked at where the room leaves it in
    doubt; corners that seem free go before others. Where no corner is left all count; in collision none does.

    Args:
        qs: (m, d) configurations.
        ground: The workspace; what is there is looked at.
        seems: (n, n, T) above 0 where a pose seems free.
        frame: Where the cells lie, and the goal.
        geometry: What the collision kernels take.
    """
    room = ground.room
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
            places[m, corner] = ((a + 1) * (n + 2) + b + 1) * turns + h
            look(ground, a, b)
            least = min(least, room[a, b, h])
        ranks = np.zeros(count, np.int64)
        for corner in range(count):
            a, b, h = j + (corner >> 1 & 1), i + (corner & 1), (k + (corner >> 2)) % turns
            end[0] = frame[ORIGIN_X] + b * cell
            end[1] = frame[ORIGIN_Y] + a * cell
            turn = 0.0
            if turns > 1:
                end[2] = h * span
                turn = (end[2] - qs[m, 2]) / (2.0 * math.pi)
                turn = frame[WEIGHT] * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
            away[corner] = math.sqrt((end[0] - qs[m, 0]) ** 2 + (end[1] - qs[m, 1]) ** 2 + turn * turn)
            if least >= enough or motion_free(qs[m], end, geometry):
                ranks[corner] = 2 if seems[a, b, h] > 0.0 else 1
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
    places[m, 8] = ((j + 1) * (n + 2) + i + 1) * turns + k
    lengths[m, 9] = goal_distance(q[0], q[1], q[2] if d > 2 else 0.0, frame)
    near = _NEAR * math.sqrt(2.0) * frame[CELL]
    if math.hypot(goal[0] - q[0], goal[1] - q[1]) <= near and motion_free(q, goal, geometry):
        lengths[m, 8] = lengths[m, 9]


@njit(cache=True)
def joined_values(joined: Joined, known: Field, floor: Field, effort: Field) -> FloatArray:
    """(m,) cost-to-go of configurations that `join` has joined; infinite where it has not.

    The mix of the corners, or the least of corner and way to it, whichever is less: the one where the field
    is smooth, the other where it is not. Neither falls where the arrival rises.

    Args:
        joined: What `join` gives.
        known: (p,) when the wave comes to the poses.
        floor: (p,) when it came at the latest before: it comes no earlier.
        effort: (p,) how many times slower they have become.
    """
    places, shares, lengths = joined.places, joined.shares, joined.lengths
    out = np.full(places.shape[0], np.inf)
    for m in range(places.shape[0]):
        mixed = 0.0
        total = 0.0
        for corner in range(8):
            value = max(known[places[m, corner]], floor[places[m, corner]])
            out[m] = min(out[m], value + lengths[m, corner])
            if shares[m, corner] > 0.0:
                total += shares[m, corner]
                mixed += shares[m, corner] * value
        if total > 0.0:
            out[m] = min(out[m], mixed)
        out[m] = max(out[m], lengths[m, 9])
        if lengths[m, 8] < np.inf and effort[places[m, 8]] < np.inf:
            out[m] = min(out[m], lengths[m, 8] * effort[places[m, 8]])
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
def spare_room(q: FloatArray, ends: FloatArray, ground: Ground, frame: FloatArray, parts: int) -> FloatArray:
    """(m,) how sure it is that the motions from q to ends (m, d) have room, in cells: at least 0 if it is.

    The least, over pairs of neighbouring poses, of their rooms less the way between them: what has no room
    between two poses leaves one of them little.

    Args:
        q: (d,) where the motions begin.
        ends: (m, d) where they end.
        ground: The workspace and the robot; looked at where the motions are.
        frame: Where the cells lie.
        parts: Pairs of poses along a motion.
    """
    d, distances, body = q.size, ground.distances, ground.body
    fine = distances.shape[0] // ground.room.shape[0]
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
            at = gx + t * dx, gy + t * dy
            room = _room(distances, fine, at[0], at[1], math.cos(theta), math.sin(theta), body, LEAST)
            if p > 0:
                least = min(least, before + room - way)
            before = room
        out[m] = least
    return out


@borrowing
def _shut(closed: Links, r: int, c: int, k: int, side: int, turns: int) -> bool:
    """Whether the link from a pose to the neighbour of that side is closed; see `_beside`."""
    if closed.size == 0:
        return False
    if side & 1 == 0:
        r, c, k = _beside(r, c, k, side, turns)
    return bool(closed[r, c, k] >> (side >> 1) & 1)


@borrowing
def blocked_on_way(q: FloatArray, field: Field, seems: Field, closed: Links, frame: FloatArray) -> int:
    """Poses that seem blocked, and closed links, on the field's way from q (d,) to the goal.

    From the best corner around q that seems free, always on to the neighbour of least cost-to-go; through a
    closed link where there is no other. A way that does not end at the goal, where the wave has not come,
    counts as blocked.

    Args:
        q: Where the way begins.
        field: (n, n, T) cost-to-go.
        seems: (n, n, T) above 0 where a pose seems free.
        closed: What `closed_links` gives; (0, 0, 0) where all are open.
        frame: Where the cells lie.
    """
    n, turns = field.shape[0], field.shape[2]
    j, i, k, _, _, _ = _cell(q, n, turns, frame)
    r, c, t, best = j, i, k, np.inf
    for corner in range(8 if turns > 1 else 4):
        a, b, h = j + (corner & 1), i + (corner >> 1 & 1), (k + (corner >> 2)) % turns
        if seems[a, b, h] > 0.0 and field[a, b, h] < best:
            r, c, t, best = a, b, h, field[a, b, h]
    blocked = 0
    while True:
        here = field[r, c, t]
        best, chosen, shut = here, -1, True
        for side in range(6 if turns > 1 else 4):
            a, b, h = _beside(r, c, t, side, turns)
            if 0 <= a < n and 0 <= b < n and field[a, b, h] < here:
                through = _shut(closed, r, c, t, side, turns)
                if (shut and not through) or (shut == through and field[a, b, h] < best):
                    best, chosen, shut = field[a, b, h], side, through
        if chosen < 0:
            away = abs((frame[GOAL] - frame[ORIGIN_X]) / frame[CELL] - c)
            away = max(away, abs((frame[GOAL + 1] - frame[ORIGIN_Y]) / frame[CELL] - r))
            return blocked if away <= _AT_GOAL else blocked + 1
        r, c, t = _beside(r, c, t, chosen, turns)
        blocked += 1 if not seems[r, c, t] > 0.0 or shut else 0


@borrowing
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
def crowding(
    qs: FloatArray, points: FloatArray, counts: FloatArray, reach: float, weight: float
) -> FloatArray:
    """Sum over points (p, d) of exp(-(distance / reach)^2) for each of qs (m, d): (m,).

    Points further away than `FAR` reaches add nothing; each counts as often as ``counts`` (p,) says.
    """
    out = np.zeros(qs.shape[0])
    for m in range(qs.shape[0]):
        for p in range(points.shape[0]):
            dx, dy = qs[m, 0] - points[p, 0], qs[m, 1] - points[p, 1]
            square = dx * dx + dy * dy
            if qs.shape[1] > 2:
                turn = (qs[m, 2] - points[p, 2]) / (2.0 * math.pi)
                turn = weight * 2.0 * math.pi * (turn - math.floor(turn + 0.5))
                square += turn * turn
            if square < FAR * FAR * reach * reach:
                out[m] += counts[p] * math.exp(-square / (reach * reach))
    return out
