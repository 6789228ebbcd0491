"""Waves over a grid of poses: |grad u| = slowness outwards from a goal, as far as somebody asks.

Arrays over poses have a border of one cell, so that no neighbour lies outside: (n + 2, n + 2, T), flat. A
wave takes the poses in the order of their arrival, or, where it heads for a target, of arrival and the way
from there: what leads elsewhere comes late, and its room is not even looked at before (A*).
"""
# mypy: disable-error-code="misc,arg-type,no-any-return"

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.collision import Geometry
from guided_gym.kernels.fields import (
    CELL,
    ORIGIN_X,
    ORIGIN_Y,
    WEIGHT,
    BoolArray,
    Field,
    FloatArray,
    Ground,
    IntArray,
    Joined,
    Links,
    join,
    joined_values,
    look,
)
from guided_gym.kernels.plain import borrowing

Int32s = npt.NDArray[np.int32]

_UNTIDY: Final = 0.25  # of the way between two poses: what a bucket of arrivals spans
_MOST_BUCKETS: Final = 1 << 15
_SURE: Final = 60.0  # logit of being free for each cell of room
_CERTAIN: Final = 40.0  # logit from which 1 / p is 1, to the last bit
_HEED: Final = 0.7  # how much the way to the target counts: by all of it, arrivals would be 7 % late

WAITING: Final = (
    0  # entries of `Front.counts`: poses that wait, places in the queue, the first spare one, bucket
)
_SIZE, _SPARE, _NOW = 1, 2, 3
_BASE, _WIDTH, _JUMP, _BLOCKED, _MOST, _TURN, _ROW, _COLUMN, _HEADING, _HEED_AT = range(10)


class Front(NamedTuple):
    """A wave as far as it has run. Poses wait in buckets that are told apart no further: an untidy queue.

    A pose may be taken before another that is nearer by less than a quarter of the way between two poses, or
    a little more where turns cost next to nothing.

    Attributes:
        known: Arrival at the poses that have been taken (length); infinite at the others.
        least: The least arrival found so far.
        slow: Slowness, at least 1; infinite on the border and where it is forbidden, NaN where nobody has
            looked yet.
        effort: How many times slower than its room lets it be the wave is.
        aims: Poses that it has to reach.
        doors: What `fields.closed_links` gives; empty where all are open.
        first: First entry of each bucket, -1 for none; as many buckets as a power of two.
        after: The entry behind each entry, -1 at the end of its list.
        items: Pose of each entry.
        keys: Its arrival.
        dues: When it is to be taken: its arrival and, as far as it is heeded, the way to the target.
        counts: (4,) see `WAITING`.
        numbers: (10,) of the buckets, the slowness and the target.
    """

    known: Field
    least: Field
    slow: Field
    effort: Field
    aims: BoolArray
    doors: Links
    first: Int32s
    after: Int32s
    items: Int32s
    keys: Field
    dues: Field
    counts: IntArray
    numbers: FloatArray


def bordered(values: npt.NDArray[Any], border: float) -> npt.NDArray[Any]:
    """(p,) what is (n, n, T), with a border around the cells."""
    n, turns = values.shape[0], values.shape[2]
    out = np.full((n + 2, n + 2, turns), border, values.dtype)
    out[1:-1, 1:-1] = values
    return out.reshape(-1)


@njit(cache=True)
def begin(
    slow: Field,
    effort: Field,
    shape: tuple[int, int, int],
    doors: Links,
    limits: tuple[float, float],
    places: IntArray,
    values: FloatArray,
    frame: FloatArray,
    target: FloatArray,
) -> Front:
    """A wave that has not run yet.

    Args:
        slow: (p,) slowness; see `Front`.
        effort: (p,) how many times slower poses have become.
        shape: That of the grid without border.
        doors: (p,) what `fields.closed_links` gives; (0,) where all links are open.
        limits: The largest slowness by lack of room, and the largest in all.
        places: (m,) flat places, in the grid without border, where the wave begins.
        values: (m,) how far they are from the goal.
        frame: Where the cells lie, and the weight of a turn.
        target: (3,) the pose that it heads for, or (0,).
    """
    n, turns = shape[0], shape[2]
    cell, turn = frame[CELL], max(frame[WEIGHT] * 2.0 * math.pi / turns, 1e-9 * frame[CELL])
    jump = limits[0] * cell
    width, longest = _UNTIDY * cell, cell
    if turns > 1:
        width, longest = _UNTIDY * max(min(cell, turn), cell / 8.0), max(cell, turn)
    longest = (limits[1] + _HEED) * longest + (jump if doors.size else 0.0)
    buckets = int(min(2.0 ** math.ceil(math.log2(longest / width + 3.0)), _MOST_BUCKETS))
    numbers = np.zeros(10)
    numbers[_WIDTH], numbers[_JUMP], numbers[_BLOCKED], numbers[_MOST] = width, jump, limits[0], limits[1]
    numbers[_TURN] = turn
    if target.size:
        numbers[_ROW] = (target[1] - frame[ORIGIN_Y]) / cell
        numbers[_COLUMN] = (target[0] - frame[ORIGIN_X]) / cell
        numbers[_HEADING] = target[2] / (2.0 * math.pi) * turns
        numbers[_HEED_AT] = _HEED
    size = slow.size
    front = Front(
        np.full(size, np.float32(np.inf)),
        np.full(size, np.float32(np.inf)),
        slow,
        effort,
        np.zeros(size, np.bool_),
        doors,
        np.full(buckets, -1, np.int32),
        np.empty(7 * size, np.int32),
        np.empty(7 * size, np.int32),
        np.empty(7 * size, np.float32),
        np.empty(7 * size, np.float32),
        np.array([places.size, places.size, -1, 0]),
        numbers,
    )
    _enter(front, places, values, n, cell, turns)
    return front


@borrowing
def _enter(front: Front, places: IntArray, values: FloatArray, n: int, cell: float, turns: int) -> None:
    """Have the places where a wave begins wait."""
    numbers, buckets = front.numbers, front.first.size
    for i in range(places.size):
        r, c, k = places[i] // (turns * n), places[i] // turns % n, places[i] % turns
        v = ((r + 1) * (n + 2) + c + 1) * turns + k
        front.least[v], front.items[i], front.keys[i] = values[i], v, values[i]
        front.dues[i] = values[i] + _way(numbers, r, c, k, cell, turns)
    least = front.dues[0] if places.size else np.float32(0.0)
    for i in range(places.size):
        least = min(least, front.dues[i])
    numbers[_BASE] = least
    for i in range(places.size):
        b = min(int((front.dues[i] - numbers[_BASE]) / numbers[_WIDTH]), buckets - 1)
        front.after[i], front.first[b] = front.first[b], i


@borrowing
def _way(numbers: FloatArray, r: int, c: int, k: int, cell: float, turns: int) -> float:
    """How far a pose is from the target, as far as it is heeded."""
    if numbers[_HEED_AT] == 0.0:
        return 0.0
    away = 0.0
    if turns > 1:
        away = abs(k - numbers[_HEADING])
        while away >= turns:  # hardly ever more than once; a remainder of floats takes far longer
            away -= turns
        away = min(away, turns - away) * numbers[_TURN]
    up, along = (r - numbers[_ROW]) * cell, (c - numbers[_COLUMN]) * cell
    return numbers[_HEED_AT] * math.sqrt(up * up + along * along + away * away)


@borrowing
def reach(front: Front, ground: Ground, places: IntArray) -> None:
    """Run on until the wave has come to (m,) flat places, border included, or can come no further."""
    left = 0
    for place in places:
        if front.known[place] == np.inf and not front.aims[place]:
            front.aims[place] = True
            left += 1
    if left:
        run(front, ground, left)
        for place in places:
            front.aims[place] = False


@njit(cache=True)
def values(front: Front, ground: Ground, floor: Field, joined: Joined) -> FloatArray:
    """(m,) cost-to-go of joined configurations, to which the wave runs on; see `joined_values`."""
    left = 0
    for m in range(joined.places.shape[0]):
        for corner in range(8):
            place = joined.places[m, corner]
            if joined.lengths[m, corner] == np.inf or front.known[place] < np.inf or front.aims[place]:
                continue
            front.aims[place] = True
            left += 1
    if left:
        run(front, ground, left)
        for m in range(joined.places.shape[0]):
            for corner in range(8):
                front.aims[joined.places[m, corner]] = False
    return joined_values(joined, front.known, floor, front.effort)


@njit(cache=True)
def arrive(
    front: Front,
    ground: Ground,
    floor: Field,
    seems: Field,
    frame: FloatArray,
    geometry: Geometry,
    qs: FloatArray,
) -> tuple[Joined, FloatArray]:
    """How configurations (m, d) are joined to the grid (see `join`), and their cost-to-go (m,)."""
    joined = join(qs, ground, seems, frame, geometry)
    return joined, values(front, ground, floor, joined)


@borrowing
def run(front: Front, ground: Ground, left: int) -> None:
    """Take pose after pose until ``left`` aims are reached, or none waits any more."""
    known, least, slow, effort, aims, doors, first, after, items, keys, dues, counts, numbers = front
    turns = ground.room.shape[2]
    side = ground.room.shape[0] + 2
    row = side * turns
    base, jump, turn, cell = numbers[_BASE], numbers[_JUMP], numbers[_TURN], ground.frame[CELL]
    buckets = 1.0 / numbers[_WIDTH]
    ways = (cell, turn, (cell / turn) ** 2)
    around = first.size - 1
    waiting, size, spare, now = counts[0], counts[1], counts[2], counts[3]
    while waiting > 0 and left > 0:
        entry = first[now & around]
        if entry < 0:
            now += 1
            continue
        key, v = keys[entry], items[entry]
        first[now & around] = after[entry]
        b = int((dues[entry] - base) * buckets)
        if b > now:  # it was too far ahead for the buckets
            b = min(b, now + around) & around
            after[entry], first[b] = first[b], entry
            continue
        waiting -= 1
        after[entry], spare = spare, entry
        if known[v] < np.inf or key > least[v]:
            continue
        known[v] = key
        left -= 1 if aims[v] else 0
        square = v // turns  # two divisions and no remainder: they take long
        r = square // side - 1
        c, k = square - (r + 1) * side - 1, v - square * turns
        for way in range(6 if turns > 1 else 4):
            w, h, rr, cc = v, k, r, c
            if way < 2:
                cc, w = cc + 2 * way - 1, w + turns * (2 * way - 1)
            elif way < 4:
                rr, w = rr + 2 * way - 5, w + row * (2 * way - 5)
            else:
                h = (k - 1 if k > 0 else turns - 1) if way == 4 else (k + 1 if k < turns - 1 else 0)
                w += h - k
            if known[w] < np.inf:
                continue
            if slow[w] != slow[w]:
                look(ground, rr, cc)
                _slow_down(slow, effort, numbers, ground.room[rr, cc], w - h)
            if slow[w] == np.inf:
                continue
            value = _solve(_upwind(known, doors, w, h, turns, row, jump), float(slow[w]), ways)
            if value < least[w]:
                least[w] = value
                # Not before the bucket that is due, and no further ahead than the buckets go round.
                due = value + _way(numbers, rr, cc, h, cell, turns)
                b = min(max(int((due - base) * buckets), now), now + around) & around
                if spare < 0:
                    entry, size = size, size + 1
                else:
                    entry, spare = spare, after[spare]
                items[entry], keys[entry], dues[entry] = w, value, due
                after[entry], first[b] = first[b], entry
                waiting += 1
    counts[0], counts[1], counts[2], counts[3] = waiting, size, spare, now


@borrowing
def _slow_down(slow: Field, effort: Field, numbers: FloatArray, room: Field, first: int) -> None:
    """Enter the slowness at the headings of a cell, whose room is known and whose first place this is."""
    for t in range(room.size):
        most = tries(_SURE * room[t], numbers[_BLOCKED])
        much = most * effort[first + t]
        if much < np.inf:  # not slower than a failure makes it, either
            much = min(much, max(most, numbers[_MOST]))
        slow[first + t] = much


@borrowing
def tries(logit: float, blocked: float) -> float:
    """1/p: as often as one would have to try where this is the logit of being free; ``blocked`` at most."""
    if logit >= _CERTAIN:
        return min(1.0, blocked)
    return min(1.0 + math.exp(min(-logit, 30.0)), blocked)


@borrowing
def _solve(upwind: tuple[float, float, float], slowness: float, ways: tuple[float, float, float]) -> float:
    """Upwind solution of |grad u| = slowness at one pose.

    Args:
        upwind: What `_upwind` gives.
        slowness: Slowness there.
        ways: Length of a cell, length of a turn to the next heading, ratio of their squares.
    """
    a0, a1, a2 = upwind
    cell, turn, ratio = ways
    # All is scaled by the square of the cell: the weight of a row or column is 1, that of a turn the ratio.
    if a1 < a0:
        a0, a1 = a1, a0
    s = slowness * cell
    square = s * s
    if a2 >= a1:  # the turn comes last
        value = a0 + s
        if value > a1:
            value = 0.5 * (a0 + a1 + math.sqrt(max(2.0 * square - (a1 - a0) * (a1 - a0), 0.0)))
        if value <= a2:
            return value
    else:
        high = max(a0, a2)
        value = a0 + s if a0 <= a2 else a2 + slowness * turn
        if value <= high:
            return value
        # Two of them: (u - a0)^2 + ratio (u - a2)^2 = s^2.
        gap = a2 - a0
        weight = 1.0 + ratio
        root = math.sqrt(max(weight * square - ratio * gap * gap, 0.0))
        value = (a0 + ratio * a2 + root) / weight
        if value <= a1:
            return value
    # All three.
    weight = 2.0 + ratio
    d1, d2 = a1 - a0, a2 - a0
    b = d1 + ratio * d2
    root = math.sqrt(max(b * b - weight * (d1 * d1 + ratio * d2 * d2 - square), 0.0))
    return a0 + (b + root) / weight


@borrowing
def _upwind(
    known: Field, doors: Links, w: int, h: int, turns: int, row: int, jump: float
) -> tuple[float, float, float]:
    """The lesser known value beside a pose in its row, its column, and at the headings beside its h-th.

    What a closed link takes is added; ``doors`` is empty where all are open.
    """
    up = w + 1 if h < turns - 1 else w + 1 - turns
    down = w - 1 if h > 0 else w - 1 + turns
    if doors.size == 0:
        turned = float(min(known[down], known[up])) if turns > 1 else np.inf
        beside = float(min(known[w - turns], known[w + turns]))
        return beside, float(min(known[w - row], known[w + row])), turned
    a0 = min(
        known[w - turns] + jump * (doors[w - turns] & 1),
        known[w + turns] + jump * (doors[w] & 1),
    )
    a1 = min(
        known[w - row] + jump * (doors[w - row] >> 1 & 1),
        known[w + row] + jump * (doors[w] >> 1 & 1),
    )
    a2 = np.inf
    if turns > 1:
        a2 = min(known[down] + jump * (doors[down] >> 2), known[up] + jump * (doors[w] >> 2))
    return a0, a1, a2
