"""Floors of buildings, in metres: rooms along corridors, doors that the robot just fits through, furniture.

Not of the paper. They ask of everything what a 10 x 10 box does not: a workspace much larger than the robot,
hundreds of pieces, and ways that lead through many narrow doors.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Polygon, box

from guided_gym.catalogue.placement import free_pose
from guided_gym.errors import NoPathError
from guided_gym.geometry.environment import Bounds, Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.problems import Problem, Task

NAME: Final = "RandomBuilding"
SIZE: Final = (40.0, 30.0)
ROBOT: Final = (0.6, 0.4)
DOOR: Final = 0.9
WALL: Final = 0.15
CORRIDOR: Final = 2.0
DEPTH: Final = (4.0, 5.0)  # of a row of rooms, about
ROOM: Final = (3.4, 6.0)  # width
CONNECTED: Final = 0.3  # share of the walls between two rooms that have a door
AISLE: Final = 0.85  # room between pieces of furniture that do not belong together
FURNITURE: Final = 16  # groups that a room is tried to be given
FIXED_SEED: Final = 8
TRIES: Final = 50

_SWING: Final = 1.1  # metres around the middle of a door that stay empty


@dataclass
class _Floor:
    walls: list[Polygon] = field(default_factory=list)
    furniture: list[Polygon] = field(default_factory=list)
    doors: list[tuple[float, float]] = field(default_factory=list)
    rooms: list[Bounds] = field(default_factory=list)


def building() -> Problem:
    """A floor of 40 x 30 m: rooms along corridors, doors of 0.9 m, furniture; from corner to corner."""
    floor = _floor(np.random.default_rng(FIXED_SEED), *SIZE)
    return _posed(np.random.default_rng(FIXED_SEED), floor, SIZE, "Building", corners=True)


def random_building(rng: np.random.Generator) -> Problem:
    """A random floor of 40 x 30 m: rooms, corridors, doors and furniture; start and goal in two rooms."""
    return floor_problem(rng, *SIZE)


def floor_problem(rng: np.random.Generator, width: float, height: float) -> Problem:
    """A random floor of any size.

    Args:
        rng: Source of the draws.
        width: Along x, in metres; at least 12.
        height: Along y, in metres; at least 12.

    Returns:
        A problem named ``RandomBuilding``, start and goal in two rooms.

    Raises:
        NoPathError: There was no room left for start or goal.
    """
    for _ in range(TRIES):
        try:
            return _posed(rng, _floor(rng, width, height), (width, height), NAME, corners=False)
        except NoPathError:
            continue
    raise NoPathError(f"{NAME}: expected room for start and goal, got none in {TRIES} floors")


def _floor(rng: np.random.Generator, width: float, height: float) -> _Floor:
    """Double rows of rooms with a corridor between them, and a corridor across that joins them all."""
    floor = _Floor()
    blocks = max(1, round(height / (2 * np.mean(DEPTH) + CORRIDOR)))
    edges = np.linspace(0.0, height, blocks + 1)
    lobby = float(rng.uniform(0.3, 0.7) * width)
    for low, high in pairwise(edges.tolist()):
        middle = 0.5 * (low + high) + rng.uniform(-0.5, 0.5)
        below, above = middle - CORRIDOR / 2, middle + CORRIDOR / 2
        for x0, x1 in ((0.0, lobby - CORRIDOR / 2), (lobby + CORRIDOR / 2, width)):
            _row(rng, floor, (x0, low, x1, below), corridor=below, ends=(x0 > 0, x1 < width))
            _row(rng, floor, (x0, above, x1, high), corridor=above, ends=(x0 > 0, x1 < width))
        if low > 0.0:  # the wall between two rows that stand back to back
            for x0, x1 in ((0.0, lobby - CORRIDOR / 2), (lobby + CORRIDOR / 2, width)):
                floor.walls.append(box(x0, low - WALL / 2, x1, low + WALL / 2))
    for room in floor.rooms:
        _furnish(rng, floor, room)
    return floor


def _row(
    rng: np.random.Generator, floor: _Floor, area: Bounds, corridor: float, ends: tuple[bool, bool]
) -> None:
    """Rooms side by side, each with a door to the corridor, some with one to the next room."""
    x0, y0, x1, y1 = area
    count = max(1, round((x1 - x0) / rng.uniform(*ROOM)))
    spread = 0.15 * (x1 - x0) / count
    inner = np.linspace(x0, x1, count + 1)[1:-1] + rng.uniform(-spread, spread, count - 1)
    edges = [x0, *inner.tolist(), x1]
    doors = [float(rng.uniform(a + 1.0, b - 1.0)) for a, b in pairwise(edges)]
    _wall(floor, (x0, corridor), (x1, corridor), doors)
    floor.doors += [(door, corridor) for door in doors]
    for edge in inner.tolist():
        door = [float(rng.uniform(y0 + 1.0, y1 - 1.0))] if rng.random() < CONNECTED else []
        _wall(floor, (edge, y0), (edge, y1), door)
        floor.doors += [(edge, at) for at in door]
    for edge, closed in zip((x0, x1), ends, strict=True):
        if closed:
            _wall(floor, (edge, y0), (edge, y1), [])
    floor.rooms += [(a, y0, b, y1) for a, b in pairwise(edges)]


def _wall(floor: _Floor, first: tuple[float, float], last: tuple[float, float], doors: list[float]) -> None:
    """A wall along x or y, open for a door at each place along it."""
    upright = first[0] == last[0]
    start, end = (first[1], last[1]) if upright else (first[0], last[0])
    breaks = [start, *(at + side * DOOR / 2 for at in sorted(doors) for side in (-1, 1)), end]
    for a, b in zip(breaks[::2], breaks[1::2], strict=True):
        if b - a > 1e-6:
            across = first[0] if upright else first[1]
            low, high = across - WALL / 2, across + WALL / 2
            floor.walls.append(box(low, a, high, b) if upright else box(a, low, b, high))


def _furnish(rng: np.random.Generator, floor: _Floor, room: Bounds) -> None:
    """Shelves along the walls and tables with chairs, where they leave the doors and aisles free."""
    half = WALL / 2
    inside = (room[0] + half, room[1] + half, room[2] - half, room[3] - half)
    doors = [
        shapely.Point(x, y)
        for x, y in floor.doors
        if room[0] - half <= x <= room[2] + half and room[1] - half <= y <= room[3] + half
    ]
    placed: list[Polygon] = []
    for _ in range(FURNITURE):
        shelf = rng.random() < 0.5
        group = _shelf(rng, inside) if shelf else _table(rng, inside)
        whole = shapely.union_all(group)
        x0, y0, x1, y1 = whole.bounds
        gap = min(x0 - inside[0], y0 - inside[1], inside[2] - x1, inside[3] - y1)
        if gap < (-1e-9 if shelf else AISLE) or any(whole.distance(door) < _SWING for door in doors):
            continue
        if all(whole.distance(other) >= AISLE for other in placed):
            placed.append(whole)
            floor.furniture += group


def _shelf(rng: np.random.Generator, inside: Bounds) -> list[Polygon]:
    """One to three cupboards side by side, flush with a wall."""
    x0, y0, x1, y1 = inside
    depth, count = rng.uniform(0.35, 0.7), int(rng.integers(1, 4))
    lengths = rng.uniform(0.6, 1.1, count)
    side, at = int(rng.integers(4)), rng.random()
    pieces, along = [], 0.0
    for length in lengths.tolist():
        if side < 2:
            start = x0 + at * max(0.0, x1 - x0 - lengths.sum()) + along
            low = y0 if side == 0 else y1 - depth
            pieces.append(box(start, low, start + length, low + depth))
        else:
            start = y0 + at * max(0.0, y1 - y0 - lengths.sum()) + along
            low = x0 if side == 2 else x1 - depth
            pieces.append(box(low, start, low + depth, start + length))
        along += length
    return pieces


def _table(rng: np.random.Generator, inside: Bounds) -> list[Polygon]:
    """A table at any angle, with two to four chairs pushed up to it."""
    x0, y0, x1, y1 = inside
    length, width = rng.uniform(1.0, 1.6), rng.uniform(0.6, 0.9)
    pieces = [box(-length / 2, -width / 2, length / 2, width / 2)]
    for k in range(int(rng.integers(2, 5))):
        x = (-0.25 if k < 2 else 0.25) * length
        y = (width / 2 + 0.12) * (1 if k % 2 else -1)
        pieces.append(box(x - 0.2, y - 0.2, x + 0.2, y + 0.2))
    angle = float(rng.choice([0.0, 90.0, rng.uniform(0.0, 180.0)]))
    centre = (float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1)))
    return [affinity.translate(affinity.rotate(piece, angle, origin=(0.0, 0.0)), *centre) for piece in pieces]


def _posed(
    rng: np.random.Generator, floor: _Floor, size: tuple[float, float], name: str, *, corners: bool
) -> Problem:
    """The problem of a floor; start and goal in the first and the last room, or in any two."""
    robot = Robot.rectangle(*ROBOT)
    environment = Environment((0.0, 0.0, *size), (*floor.walls, *floor.furniture))
    space = ConfigurationSpace(robot, environment)
    first, last = 0, len(floor.rooms) - 1
    if not corners:
        first, last = (int(k) for k in rng.choice(len(floor.rooms), 2, replace=False))
    start = free_pose(space, rng, floor.rooms[first])
    goal = free_pose(space, rng, floor.rooms[last])
    regions = {"rooms": shapely.union_all([box(*room) for room in floor.rooms])}
    regions["corridors"] = box(0.0, 0.0, *size).difference(regions["rooms"])
    return Problem(robot, environment, Task(start, goal), name, regions)
