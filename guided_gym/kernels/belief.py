"""How likely motions are free, from what a small network makes of the room that bodies have along them.

A motion is looked at in configurations so close together that no point moves far from one to the next. In
each, the room of a body is the least distance of its points to the obstacles in a raster of the workspace,
less their radius; the robot's own room is the least distance between two bodies that must not touch each
other. Each body's part of the way between two configurations has a logit of being free, from the room at
both and from how far it moves; they multiply. Nothing here is checked for collision.
"""
# mypy: disable-error-code="misc,no-any-return,no-untyped-call"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.metric import Metric, shortest
from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]
Field = NDArray[np.float32]
Ints = NDArray[np.int64]

COLUMNS: Final = 4
"""Less and more room of two configurations, the body's move between them, and whether the room is its own."""
FAR: Final = 1.0  # units of room; more is as good
NEVER: Final = -30.0  # log probabilities end there


class Scene(NamedTuple):
    """A robot's bodies as points, and the obstacles as a raster.

    Attributes:
        joints: (j, 2) int64 parent or -1, and coordinate or -1, of each joint.
        offsets: (j, 3) x, y and heading of each joint in its parent's frame; of the world without one.
        base: Whether the first two coordinates move the robot.
        bodies: (b, 3) int64 joint, and first and last row (exclusive) of the points of each body.
        points: (p, 3) x, y and radius in the joint's frame.
        sizes: (b,) how far from its middle point anything of a body is (length).
        pairs: (k, 2) int64 bodies that must not touch each other.
        raster: (n, n) float32 signed distance to the nearest obstacle or bound (length).
        frame: Left and low of the first sample, and the distance between samples.
        unit: What room and moves are divided by (length).
        spacing: How far a configuration may be from the next one, in the metric.
    """

    joints: Ints
    offsets: Floats
    base: bool
    bodies: Ints
    points: Floats
    sizes: Floats
    pairs: Ints
    raster: Field
    frame: tuple[float, float, float]
    unit: float
    spacing: float


class Net(NamedTuple):
    """One hidden layer: (h, COLUMNS) weights, (h,) biases, (h,) weights of the output, and its bias."""

    first: Floats
    bias: Floats
    last: Floats
    offset: float


@borrowing
def _distance(raster: Field, frame: tuple[float, float, float], x: float, y: float) -> float:
    """The raster between its samples, bilinear; at the nearest border beyond it."""
    most = raster.shape[0] - 1.001
    u = min(max((x - frame[0]) / frame[2], 0.0), most)
    v = min(max((y - frame[1]) / frame[2], 0.0), most)
    c, r = int(u), int(v)
    u, v = u - c, v - r
    low = raster[r, c] * (1.0 - u) + raster[r, c + 1] * u
    high = raster[r + 1, c] * (1.0 - u) + raster[r + 1, c + 1] * u
    return low * (1.0 - v) + high * v


@borrowing
def _look(q: Floats, scene: Scene, places: Floats, rooms: Floats, state: Floats) -> None:
    """Where the points are at q, (p, 2), and the room of each body and of the robot beside itself (b + 1,).

    Of the joints' frames it writes (j, 5) x, y, cosine and sine of the heading, and the heading.
    """
    for j in range(scene.joints.shape[0]):
        parent, coordinate = scene.joints[j, 0], scene.joints[j, 1]
        x, y, heading = scene.offsets[j, 0], scene.offsets[j, 1], scene.offsets[j, 2]
        if parent >= 0:
            c, s = state[parent, 2], state[parent, 3]
            x, y = state[parent, 0] + c * x - s * y, state[parent, 1] + s * x + c * y
            heading += state[parent, 4]
        elif scene.base:
            x, y = x + q[0], y + q[1]
        if coordinate >= 0:
            heading += q[coordinate]
        state[j, 0], state[j, 1], state[j, 4] = x, y, heading
        state[j, 2], state[j, 3] = math.cos(heading), math.sin(heading)
    far = FAR * scene.unit
    for b in range(scene.bodies.shape[0]):
        joint, room = scene.bodies[b, 0], far
        x0, y0, c, s = state[joint, 0], state[joint, 1], state[joint, 2], state[joint, 3]
        for p in range(scene.bodies[b, 1], scene.bodies[b, 2]):
            px, py = scene.points[p, 0], scene.points[p, 1]
            x, y = x0 + c * px - s * py, y0 + s * px + c * py
            places[p, 0], places[p, 1] = x, y
            room = min(room, _distance(scene.raster, scene.frame, x, y) - scene.points[p, 2])
        rooms[b] = max(room, -far)
    own = far
    for k in range(scene.pairs.shape[0]):
        own = _own_room(scene, places, scene.pairs[k, 0], scene.pairs[k, 1], own)
    rooms[-1] = max(own, -far)


@borrowing
def _own_room(scene: Scene, places: Floats, one: int, two: int, own: float) -> float:
    """The room between two bodies, if it is less than ``own``; else that."""
    first, last, first2, last2 = (
        scene.bodies[one, 1], scene.bodies[one, 2], scene.bodies[two, 1], scene.bodies[two, 2],
    )  # fmt: skip
    middle, middle2 = (first + last) // 2, (first2 + last2) // 2
    dx, dy = places[middle, 0] - places[middle2, 0], places[middle, 1] - places[middle2, 1]
    reach = own + scene.sizes[one] + scene.sizes[two]
    if dx * dx + dy * dy >= reach * reach:
        return own
    for p in range(first, last):
        for r in range(first2, last2):
            dx, dy = places[p, 0] - places[r, 0], places[p, 1] - places[r, 1]
            radii = scene.points[p, 2] + scene.points[r, 2]
            if dx * dx + dy * dy < (own + radii) * (own + radii):
                own = math.sqrt(dx * dx + dy * dy) - radii
    return own


@borrowing
def _columns(scene: Scene, before: tuple[Floats, Floats], after: tuple[Floats, Floats], out: Floats) -> None:
    """(b + 1, COLUMNS) what the network sees of each body between two configurations, and of all of them."""
    (places, rooms), (places2, rooms2) = before, after
    most = 0.0
    for b in range(scene.bodies.shape[0]):
        moved = 0.0
        for p in range(scene.bodies[b, 1], scene.bodies[b, 2]):
            dx, dy = places2[p, 0] - places[p, 0], places2[p, 1] - places[p, 1]
            moved = max(moved, dx * dx + dy * dy)
        moved = math.sqrt(moved)
        out[b, 2], out[b, 3] = moved / scene.unit, 0.0
        most = max(most, moved)
    out[-1, 2], out[-1, 3] = most / scene.unit, 1.0
    for b in range(rooms.size):
        out[b, 0] = min(rooms[b], rooms2[b]) / scene.unit
        out[b, 1] = max(rooms[b], rooms2[b]) / scene.unit


@borrowing
def parts_of(a: Floats, b: Floats, spacing: float, metric: Metric) -> int:
    """Into how many parts the motion from a to b is divided; none for a configuration."""
    weights, periods = metric
    total = 0.0
    for i in range(a.size):
        step = weights[i] * shortest(b[i] - a[i], periods[i])
        total += step * step
    return math.ceil(math.sqrt(total) / spacing)


@borrowing
def _log_free(columns: Floats, net: Net) -> float:
    """Sum of the log probabilities of the rows being free; those with much room count as free."""
    total = 0.0
    for row in range(columns.shape[0]):
        if columns[row, 0] >= FAR:  # much room at both ends
            continue
        logit = net.offset
        for h in range(net.bias.size):
            unit = net.bias[h]
            for c in range(COLUMNS):
                unit += net.first[h, c] * columns[row, c]
            if unit > 0.0:
                logit += net.last[h] * unit
        total -= math.log1p(math.exp(-logit)) if logit > 0.0 else math.log1p(math.exp(logit)) - logit
    return total


@njit(cache=True)
def motions_likely(
    starts: Floats, ends: Floats, scene: Scene, net: Net, metric: Metric, least: float
) -> tuple[Floats, int]:
    """(n,) log probability of each motion being free, and how many configurations were looked at.

    Args:
        starts: (n, d) configurations.
        ends: (n, d) configurations; the same for the likelihood of a configuration.
        scene: Robot and obstacles.
        net: The network.
        metric: Weights and periods of the distance.
        least: Log probability below which a motion is not looked at any further.
    """
    periods = metric[1]
    n, d = starts.shape
    out, looks = np.zeros(n), 0
    count, bodies = scene.points.shape[0], scene.bodies.shape[0] + 1
    places, rooms = np.empty((2, count, 2)), np.empty((2, bodies))
    columns, q, state = np.empty((bodies, COLUMNS)), np.empty(d), np.empty((scene.joints.shape[0], 5))
    for i in range(n):
        parts = parts_of(starts[i], ends[i], scene.spacing, metric)
        _look(starts[i], scene, places[0], rooms[0], state)
        looks += 1
        if parts == 0:
            _columns(scene, (places[0], rooms[0]), (places[0], rooms[0]), columns)
            out[i] = _log_free(columns, net)
        for k in range(1, parts + 1):
            for c in range(d):
                q[c] = starts[i, c] + k / parts * shortest(ends[i, c] - starts[i, c], periods[c])
            now, last = k % 2, (k - 1) % 2
            _look(q, scene, places[now], rooms[now], state)
            looks += 1
            _columns(scene, (places[last], rooms[last]), (places[now], rooms[now]), columns)
            out[i] += _log_free(columns, net)
            if out[i] < least:
                break
        out[i] = max(out[i], NEVER)
    return out, looks


@njit(cache=True)
def rooms_along(starts: Floats, ends: Floats, count: int, scene: Scene, metric: Metric) -> Field:
    """(n, count, b + 1) room, in units, at configurations evenly spread from each start to its end."""
    periods = metric[1]
    n, d = starts.shape
    bodies = scene.bodies.shape[0] + 1
    out = np.empty((n, count, bodies), np.float32)
    places, rooms = np.empty((scene.points.shape[0], 2)), np.empty(bodies)
    q, state = np.empty(d), np.empty((scene.joints.shape[0], 5))
    for i in range(n):
        for k in range(count):
            part = k / (count - 1) if count > 1 else 0.0
            for c in range(d):
                q[c] = starts[i, c] + part * shortest(ends[i, c] - starts[i, c], periods[c])
            _look(q, scene, places, rooms, state)
            for b in range(bodies):
                out[i, k, b] = rooms[b] / scene.unit
    return out


@njit(cache=True)
def motion_columns(starts: Floats, ends: Floats, scene: Scene, metric: Metric) -> tuple[Field, Ints]:
    """All rows of columns of some motions, and which of the motions each belongs to: for training."""
    periods = metric[1]
    n, d = starts.shape
    count, bodies = scene.points.shape[0], scene.bodies.shape[0] + 1
    total = 0
    for i in range(n):
        total += max(1, parts_of(starts[i], ends[i], scene.spacing, metric)) * bodies
    out, owner = np.empty((total, COLUMNS), np.float32), np.empty(total, np.int64)
    places, rooms = np.empty((2, count, 2)), np.empty((2, bodies))
    columns, q, state = np.empty((bodies, COLUMNS)), np.empty(d), np.empty((scene.joints.shape[0], 5))
    row = 0
    for i in range(n):
        parts = max(1, parts_of(starts[i], ends[i], scene.spacing, metric))
        _look(starts[i], scene, places[0], rooms[0], state)
        for k in range(1, parts + 1):
            for c in range(d):
                q[c] = starts[i, c] + k / parts * shortest(ends[i, c] - starts[i, c], periods[c])
            now, last = k % 2, (k - 1) % 2
            _look(q, scene, places[now], rooms[now], state)
            _columns(scene, (places[last], rooms[last]), (places[now], rooms[now]), columns)
            for b in range(bodies):
                for c in range(COLUMNS):
                    out[row, c] = columns[b, c]
                owner[row] = i
                row += 1
    return out, owner


@njit(cache=True)
def way_edges(vertex: int, parents: NDArray[np.int32], edges: NDArray[np.int32], known: NDArray[np.bool_],
              most: int) -> Ints:  # fmt: skip
    """Up to ``most`` edges on the way from a vertex to the source that are not known yet, in their order."""
    out, count = np.empty(most, np.int64), 0
    while parents[vertex] >= 0 and count < most:
        if not known[edges[vertex]]:
            out[count] = edges[vertex]
            count += 1
        vertex = parents[vertex]
    return out[:count]
