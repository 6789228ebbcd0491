"""Paths that a robot can follow: shortened, with headings, clearance and times.

Everything here is certified: what it returns consists of motions that `ConfigurationSpace.motion_free` has
proved free, or, where it is curved, of curves that stay nearer to such motions than these are to obstacles.
"""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import affordable, integer, number, shown
from guided_gym.doors import door
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.geometry.space import ConfigurationSpace

FloatArray = NDArray[np.float64]

_CHORDS: Final = 16  # of a blend, to certify it
_HALVINGS: Final = 6  # of a blend that has no room
_GRID: Final = 24  # times along each part of a path at which its speed is decided
_MOST_INTERVALS: Final = 20_000


# Shorter ----------------------------------------------------------------------------------------------------


@door
def path_length(space: ConfigurationSpace, path: FloatArray) -> float:
    """Length of a path (n, d) in the space's distance.

    Raises:
        InvalidInputError: It is not an (n, d) array of at least one configuration.
    """
    path = _waypoints(space, path)
    return float(space.distance(path[:-1], path[1:]).sum())


@door
def shortcut(
    space: ConfigurationSpace, path: FloatArray, rng: np.random.Generator, attempts: int
) -> FloatArray:
    """A path that is no longer than this one: drops waypoints between two that see each other, repeatedly.

    Args:
        space: The configuration space.
        path: (n, d) a free path.
        rng: Draws the two waypoints to look at.
        attempts: How often to try.

    Raises:
        InvalidInputError: No path, or a number out of range.
    """
    path = _waypoints(space, path)
    for _ in range(integer("attempts", attempts, least=0)):
        if len(path) < 3:
            break
        first, last = np.sort(rng.choice(len(path), 2, replace=False))
        if last - first > 1 and space.motion_free(path[first], path[last]):
            path = np.delete(path, np.s_[first + 1 : last], axis=0)
    return path


@door
def smooth(
    space: ConfigurationSpace,
    path: FloatArray,
    rng: np.random.Generator,
    attempts: int = 200,
    *,
    room: float = 0.0,
) -> FloatArray:
    """A shorter path: joins places anywhere along it by straight motions, repeatedly.

    Args:
        space: The configuration space.
        path: (n, d) a free path; its ends stay.
        rng: Draws the places to look at.
        attempts: How often to try.
        room: Clearance that a new motion has to have, within a tenth (length). The shortest paths touch
            corners; where the path itself has less, it stays as it is.

    Returns:
        (m, d) a free path that is not longer.

    Raises:
        InvalidInputError: No path, one that is not free, or a number out of range.
    """
    path = checked_path(space, path)
    attempts = integer("attempts", attempts, least=0)
    room = number("room", room, least=0, what="length")
    for _ in range(attempts):
        if len(path) < 3:
            break
        path = _dropped(space, _cut(space, path, rng, room), rng, room)
    return path


def _dropped(
    space: ConfigurationSpace, path: FloatArray, rng: np.random.Generator, room: float
) -> FloatArray:
    """The path without the waypoints between two random ones, if the motion between these is free."""
    if len(path) < 3:
        return path
    first, last = np.sort(rng.choice(len(path), 2, replace=False)).tolist()
    if last - first < 2 or not _roomy(space, path[first], path[last], room):
        return path
    return np.delete(path, np.s_[first + 1 : last], axis=0)


def _roomy(space: ConfigurationSpace, a: FloatArray, b: FloatArray, room: float) -> bool:
    """Whether the motion is free and has that clearance."""
    if not space.motion_free(a, b):
        return False
    return room == 0 or path_clearance(space, np.stack([a, b]), 0.1 * room) >= 0.9 * room


def _cut(space: ConfigurationSpace, path: FloatArray, rng: np.random.Generator, room: float) -> FloatArray:
    """The path with a straight motion between two random places, if that is free and shorter."""
    steps = np.asarray(space.distance(path[:-1], path[1:]))
    ends = np.cumsum(steps)
    places = np.sort(rng.random(2)) * ends[-1]
    i, j = np.minimum(np.searchsorted(ends, places), len(steps) - 1).tolist()
    if i == j:
        return path
    fractions = 1.0 - (ends[[i, j]] - places) / steps[[i, j]]
    a, b = (
        space.interpolate(path[k], path[k + 1], f) for k, f in zip((i, j), fractions.tolist(), strict=True)
    )
    direct = float(space.distance(a, b))
    around = float(places[1] - places[0])
    if direct >= around * (1.0 - 1e-9):
        return path
    # Parts of a free motion are free, but a certificate may be harder to find for them: ask again.
    whole = space.motion_free(path[i], a) and space.motion_free(b, path[j + 1])
    if not (whole and _roomy(space, a, b, room)):
        return path
    return np.concatenate([path[: i + 1], [a, b], path[j + 1 :]])


def checked_path(space: ConfigurationSpace, path: object) -> FloatArray:
    """A path as an array of its own.

    Raises:
        InvalidInputError: It is no (n, d) array of two configurations or more, or a motion is not free.
    """
    array = _waypoints(space, path, 2).copy()
    free = space.motions_free(array[:-1], array[1:])
    if not free.all():
        raise InvalidInputError(
            f"path: expected free motions, got one in collision from waypoint {int(np.argmin(free))}"
        )
    return array


def _waypoints(space: ConfigurationSpace, path: object, least: int = 1) -> FloatArray:
    """A path as an array (n, d), whatever its motions are.

    Raises:
        InvalidInputError: It is no array of ``least`` configurations or more, or one is not finite.
    """
    try:
        array = np.asarray(path, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(f"path: expected an array of configurations, got {error}") from None
    if array.ndim != 2 or array.shape[1] != space.dimension or len(array) < least:
        raise InvalidInputError(
            f"path: expected shape (n, {space.dimension}) with n >= {least}, got {array.shape}"
        )
    if not np.isfinite(array).all():
        raise InvalidInputError("path: expected finite configurations, got NaN or infinity")
    return array


# What a robot needs to know ---------------------------------------------------------------------------------


@door
def headings(space: ConfigurationSpace, path: FloatArray) -> FloatArray:
    """(n,) direction of travel (radians) at each waypoint: that of the motion that leaves it.

    At the last waypoint it is that of the motion that arrives. Where the robot turns on the spot, the last
    direction is kept.

    Raises:
        InvalidInputError: It is not an (n, d) array of at least two configurations.
    """
    change = np.diff(space.robot.position(_waypoints(space, path, 2)), axis=0)
    moves = np.hypot(*change.T) > 1e-12 * space.extent
    angles = np.arctan2(change[:, 1], change[:, 0])
    known = np.where(moves, np.arange(len(angles)), -1)
    known = np.maximum.accumulate(known)
    first = int(np.argmax(moves)) if moves.any() else 0
    known = np.where(known < 0, first, known)
    found = angles[known]
    return np.append(found, found[-1])


@door
def spaced_path(space: ConfigurationSpace, path: FloatArray, spacing: float) -> FloatArray:
    """The path with more waypoints, so that none is farther from the next than ``spacing`` (length).

    Raises:
        InvalidInputError: No path, or a spacing that is not positive or asks for more waypoints than memory
            holds.
    """
    path = _waypoints(space, path)
    spacing = number("spacing", spacing, above=0, what="length")
    size = 8.0 * space.dimension * (path_length(space, path) / spacing + len(path))
    affordable("spacing", spacing, int(min(size, 1e300)), "so many waypoints")
    rows = [path[:1]]
    for a, b in itertools.pairwise(path):
        count = max(1, math.ceil(float(space.distance(a, b)) / spacing))
        rows.append(space.interpolate(a, b, np.arange(1, count) / count).reshape(-1, space.dimension))
        rows.append(b[None])
    return np.concatenate(rows)


@door
def path_clearance(space: ConfigurationSpace, path: FloatArray, within: float | None = None) -> float:
    """The least distance from the robot to obstacles and bounds along a path; never overestimated.

    Args:
        space: The configuration space.
        path: (n, d) a path.
        within: How much less than the true least distance it may be; 1e-4 of the workspace's diagonal by
            default. At most some ten thousand poses are looked at: on very long paths it may be less still.

    Returns:
        A lower bound of the clearance (length), 0 where a pose is not valid.

    Raises:
        InvalidInputError: No path, or a number out of range.
    """
    within = 1e-4 * space.extent if within is None else number("within", within, above=0, what="length")
    ends = _waypoints(space, path)
    starts, stops = ends[:-1], ends[1:]
    room = np.asarray(space.clearance(np.ascontiguousarray(ends)))
    at_start, at_stop = room[:-1], room[1:]
    best = float(room.min())
    looked = 0
    while True:
        bounds = np.maximum((at_start + at_stop - _displacement(space, starts, stops)) / 2.0, 0.0)
        open_ = bounds < best - within
        if not open_.any() or looked > _MOST_INTERVALS or best == 0.0:
            return float(min(best, bounds.min(initial=best)))
        starts, stops, at_start, at_stop = starts[open_], stops[open_], at_start[open_], at_stop[open_]
        middles = space.interpolate(starts, stops, np.full(len(starts), 0.5))
        at_middle = np.asarray(space.clearance(np.ascontiguousarray(middles)))
        looked += len(middles)
        best = min(best, float(at_middle.min()))
        starts, stops = np.concatenate([starts, middles]), np.concatenate([middles, stops])
        at_start, at_stop = np.concatenate([at_start, at_middle]), np.concatenate([at_middle, at_stop])


def _displacement(space: ConfigurationSpace, a: FloatArray, b: FloatArray) -> FloatArray:
    """The farthest that any point of the robot moves between configurations, at most (length)."""
    return space.robot.displacement(space.difference(a, b))


# Times ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trajectory:
    """A path with times.

    Attributes:
        times: (n,) seconds from 0, ascending.
        configurations: (n, d); angles in [-pi, pi).
        velocities: (n, d) per second.
        accelerations: (n, d) per second squared.
        stops: How many times it stops on its way.
    """

    times: FloatArray
    configurations: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    stops: int

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return float(self.times[-1])


@dataclass(frozen=True)
class _Part:
    """A straight line or a parabola q(s) = a + b s + c s^2, 0 <= s <= length; b is a unit vector at s = 0."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    length: float

    def at(self, s: FloatArray) -> FloatArray:
        return self.a + s[:, None] * self.b + s[:, None] ** 2 * self.c

    def slope(self, s: FloatArray) -> FloatArray:
        return self.b + 2.0 * s[:, None] * self.c


@door
def time_path(
    space: ConfigurationSpace,
    path: FloatArray,
    velocity: float | Sequence[float],
    acceleration: float | Sequence[float],
    *,
    blend: float | None = None,
    interval: float = 0.05,
) -> Trajectory:
    """A path with times, under limits of velocity and acceleration of each coordinate.

    Corners are rounded by parabolas, as far as there is proof of room for them; at a corner without room the
    robot stops. Along the rounded path toppra finds the fastest speeds; between its grid points the
    acceleration along the path is constant. The limits hold at every time: if they would be passed between
    grid points, the whole path is slowed down by as much.

    Args:
        space: The configuration space.
        path: (n, d) a free path.
        velocity: Largest speed of each coordinate, or of all (length or radians per second).
        acceleration: Largest acceleration of each coordinate, or of all.
        blend: How far from a corner its rounding may begin (length); 5 % of the workspace's diagonal
            by default; 0 to stop at each corner.
        interval: Seconds between the rows of the result.

    Raises:
        InvalidInputError: No free path, or a limit that is not positive.
        GuidedGymError: toppra is not installed, or finds no speeds.
    """
    path = checked_path(space, path)
    limits = _limits(space, "velocity", velocity), _limits(space, "acceleration", acceleration)
    blend = 0.05 * space.extent if blend is None else number("blend", blend, least=0, what="length")
    interval = number("interval", interval, above=0, what="time")
    pieces = []
    clock = 0.0
    runs = _runs(space, path, blend)
    for parts in runs:
        nodes = _nodes(parts)
        speeds = _speeds(parts, nodes, *limits)
        pieces.append(_sampled(parts, nodes, speeds, *limits, clock, interval))
        clock = float(pieces[-1][0][-1])
    last = [i == len(pieces) - 1 for i in range(len(pieces))]
    columns = [
        np.concatenate([piece[k] if end else piece[k][:-1] for piece, end in zip(pieces, last, strict=True)])
        for k in range(4)
    ]
    return Trajectory(columns[0], space.wrap(columns[1]), columns[2], columns[3], len(runs) - 1)


def _limits(space: ConfigurationSpace, name: str, value: float | Sequence[float]) -> FloatArray:
    values = [value] * space.dimension if isinstance(value, int | float) else list(value)
    if len(values) != space.dimension:
        raise InvalidInputError(f"{name}: expected a number or {space.dimension} of them, got {shown(value)}")
    return np.array([number(name, limit, above=0) for limit in values])


def _runs(space: ConfigurationSpace, path: FloatArray, blend: float) -> list[list[_Part]]:
    """The path, its corners rounded, from stop to stop."""
    keep = np.append(True, space.distance(path[:-1], path[1:]) > 1e-9 * space.extent)
    path = path[keep] if keep.sum() > 1 else path[:2]
    changes = space.difference(path[:-1], path[1:])
    places = np.concatenate([path[:1], path[0] + np.cumsum(changes, axis=0)])  # angles that go on counting
    lengths = np.sqrt(((changes * space.weights) ** 2).sum(axis=1))
    if (lengths == 0).any():
        raise InvalidInputError("path: expected one that goes somewhere, got a single place")
    units = changes / lengths[:, None]
    cuts = np.zeros(len(places))
    for i in range(1, len(places) - 1):
        most = min(blend, *(lengths[i - 1 : i + 1] / 2.0).tolist())
        cuts[i] = _room_to_round(space, places[i], units[i - 1], units[i], most)
    runs: list[list[_Part]] = [[]]
    for i, (unit, length) in enumerate(zip(units, lengths, strict=True)):
        rest = float(length - cuts[i] - cuts[i + 1])
        if rest > 1e-12 * space.extent:
            runs[-1].append(_Part(places[i] + cuts[i] * unit, unit, np.zeros_like(unit), rest))
        if i == len(units) - 1:
            break
        if cuts[i + 1] > 0:
            runs[-1].append(_corner(places[i + 1], unit, units[i + 1], float(cuts[i + 1])))
        elif np.abs(units[i + 1] - unit).max() > 1e-9:
            runs.append([])
    return [run for run in runs if run]


def _corner(place: FloatArray, before: FloatArray, after: FloatArray, cut: float) -> _Part:
    """The parabola from ``cut`` before a corner to ``cut`` after it."""
    return _Part(place - cut * before, before, (after - before) / (4.0 * cut), 2.0 * cut)


def _room_to_round(
    space: ConfigurationSpace, place: FloatArray, before: FloatArray, after: FloatArray, cut: float
) -> float:
    """How far from a corner its parabola may begin so that it is certified; 0 for not at all."""
    for _ in range(_HALVINGS):
        if cut <= 1e-6 * space.extent:
            break
        part = _corner(place, before, after, cut)
        s = np.linspace(0.0, part.length, _CHORDS + 1)
        poses = space.wrap(part.at(s))
        # Between two poses the parabola leaves the chord by no more than c h^2 / 4.
        bow = part.c * (s[1] / 2.0) ** 2
        sagitta = float(space.robot.displacement(bow))
        room = max(sagitta, 1e-6 * space.extent)
        free = bool(space.motions_free(poses[:-1], poses[1:]).all())
        if free and path_clearance(space, poses, room) > sagitta + space.tolerance:
            return cut
        cut /= 2.0
    return 0.0


def _nodes(parts: list[_Part]) -> list[FloatArray]:
    """Grid points along each part."""
    return [np.linspace(0.0, part.length, _GRID + 1) for part in parts]


class _Curve:
    """A run of parts, as toppra asks for it."""

    def __init__(self, parts: list[_Part]) -> None:
        self._parts = parts
        self._ends = np.concatenate([[0.0], np.cumsum([part.length for part in parts])])
        self.dof = parts[0].a.size
        self.path_interval = np.array([0.0, self._ends[-1]])
        self.waypoints = None

    def __call__(self, s: Any, order: int = 0) -> FloatArray:
        flat = np.atleast_1d(np.asarray(s, np.float64))
        which = np.clip(np.searchsorted(self._ends, flat, side="right") - 1, 0, len(self._parts) - 1)
        values = np.empty((flat.size, self.dof))
        for k in np.unique(which):
            part, here = self._parts[k], which == k
            local = flat[here] - self._ends[k]
            rows = (part.at, part.slope, lambda x, c=part.c: np.tile(2.0 * c, (x.size, 1)))[order](local)
            values[here] = rows
        return values[0] if np.ndim(s) == 0 else values


def _speeds(
    parts: list[_Part], nodes: list[FloatArray], velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Speed along the path (per second) at each grid point of a run; 0 at both ends.

    Raises:
        GuidedGymError: toppra is not installed, or finds none.
    """
    try:
        constraint = importlib.import_module("toppra.constraint")
        algorithm = importlib.import_module("toppra.algorithm")
    except ImportError as error:
        raise GuidedGymError(f"times need toppra: pip install 'guided-gym[times]' ({error})") from error
    offsets = np.concatenate([[0.0], np.cumsum([part.length for part in parts])])
    grid = np.concatenate([[0.0], *(o + n[1:] for o, n in zip(offsets[:-1], nodes, strict=True))])
    rules = [
        constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    found = algorithm.TOPPRA(rules, _Curve(parts), gridpoints=grid, solver_wrapper="seidel")
    _, speeds, _ = found.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.isfinite(speeds).all():
        raise GuidedGymError("expected speeds along the path, but toppra found none for these limits")
    return np.asarray(speeds, np.float64)


def _sampled(
    parts: list[_Part],
    nodes: list[FloatArray],
    speeds: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    clock: float,
    interval: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times, configurations, velocities and accelerations of a run, slowed down to within the limits."""
    part_of = np.repeat(np.arange(len(parts)), _GRID)
    begin = np.concatenate([n[:-1] for n in nodes])
    width = np.concatenate([np.diff(n) for n in nodes])
    v0, v1 = speeds[:-1], speeds[1:]
    pull = (v1**2 - v0**2) / (2.0 * width)  # acceleration along the path, constant between grid points
    slow = _excess(parts, part_of, begin, width, v0, v1, pull, velocity, acceleration)
    v0, v1, pull = v0 / slow, v1 / slow, pull / slow**2
    spans = 2.0 * width / (v0 + v1)
    ends = np.concatenate([[0.0], np.cumsum(spans)])
    times = np.append(np.arange(0.0, ends[-1], interval), ends[-1])
    k = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(spans) - 1)
    t = times - ends[k]
    s = np.minimum(begin[k] + v0[k] * t + 0.5 * pull[k] * t**2, begin[k] + width[k])
    speed = np.maximum(v0[k] + pull[k] * t, 0.0)
    a, b, c = (np.array([getattr(part, name) for part in parts])[part_of[k]] for name in ("a", "b", "c"))
    q = a + s[:, None] * b + s[:, None] ** 2 * c
    slope = b + 2.0 * s[:, None] * c
    return (
        clock + times,
        q,
        slope * speed[:, None],
        slope * pull[k][:, None] + 2.0 * c * speed[:, None] ** 2,
    )


def _excess(
    parts: list[_Part],
    part_of: NDArray[np.int64],
    begin: FloatArray,
    width: FloatArray,
    v0: FloatArray,
    v1: FloatArray,
    pull: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> float:
    """By what factor a run is too fast; 1 if it is not.

    Between grid points the slope of the path and the square of the speed change linearly, so does the
    acceleration: it is largest at a grid point. The velocity is no larger than the larger slope by the larger
    speed.
    """
    b, c = (np.array([getattr(part, name) for part in parts])[part_of] for name in ("b", "c"))
    worst = 1.0
    slopes = [b + 2.0 * s[:, None] * c for s in (begin, begin + width)]
    fast = np.maximum(*map(np.abs, slopes)) * np.maximum(v0, v1)[:, None]
    worst = max(worst, float((fast / velocity).max()))
    for slope, speed in zip(slopes, (v0, v1), strict=True):
        force = np.abs(slope * pull[:, None] + 2.0 * c * speed[:, None] ** 2)
        worst = max(worst, math.sqrt(float((force / acceleration).max())))
    return worst
