"""Random traps and cups: what misled one guiding space in the paper's problems, in any order and place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from shapely.geometry import box
from shapely.geometry.base import BaseGeometry
from shapely.ops import unary_union

from guided_gym.catalogue.placement import free_pose
from guided_gym.catalogue.shapes import SIZE, rectangle_robot
from guided_gym.geometry.environment import Bounds, Environment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.problems import Problem, Task

NAME: Final = "RandomTrapCup"
# What stands between start and goal, in the order of the straight way, and how often.
ORDERS: Final = (
    (("trap", "cup"), 0.3),
    (("cup", "trap"), 0.3),
    (("trap", "trap"), 0.1),
    (("cup", "cup"), 0.1),
    (("trap",), 0.1),
    (("cup",), 0.1),
)
ROOM: Final = 1.5  # at least this much before, between and behind them
ENDS: Final = 2.0  # start and goal are at most this far from their side
TRAP_THICKNESS: Final = (0.5, 1.0)
FALSE_WIDTH: Final = (0.1, 0.25)  # a point fits, the robot, 0.3 wide, never does
TRUE_WIDTH: Final = (0.9, 1.6)
APART: Final = 1.8  # between the middles of a wall's gaps
SECOND_FALSE: Final = 0.3  # how often a wall has a second gap that is too narrow
CUP_DEPTH: Final = (1.8, 2.6)
CUP_HEIGHT: Final = (3.0, 5.5)
CUP_THICKNESS: Final = (0.3, 0.5)
PASSABLE: Final = 1.3  # a cup nearer to a side is joined to it by a wall
JOINED: Final = 0.5  # how often others are
AWAY: Final = 0.2  # how often a cup is open towards the goal


@dataclass(frozen=True)
class _Frame:
    """The problem is laid out from left to right, then turned and mirrored."""

    swapped: bool
    mirrored: tuple[bool, bool]

    def area(self, x0: float, y0: float, x1: float, y1: float) -> Bounds:
        spans = [sorted((x0, x1)), sorted((y0, y1))]
        spans = spans[::-1] if self.swapped else spans
        (a0, a1), (b0, b1) = (
            (SIZE - high, SIZE - low) if mirrored else (low, high)
            for (low, high), mirrored in zip(spans, self.mirrored, strict=True)
        )
        return a0, b0, a1, b1


@dataclass
class _Layout:
    """Rectangles in the frame of the layout, as they are drawn."""

    obstacles: list[Bounds]
    traps: list[Bounds]
    cups: list[Bounds]


def random_trap_cup(rng: np.random.Generator) -> Problem:
    """One or two traps and cups in any order and place, seen from any side: no one guidance suits all."""
    kinds = ORDERS[int(rng.choice(len(ORDERS), p=[p for _, p in ORDERS]))][0]
    widths = [rng.uniform(*(TRAP_THICKNESS if kind == "trap" else CUP_DEPTH)) for kind in kinds]
    spare = SIZE - sum(widths) - ROOM * (len(kinds) + 1)
    rooms = ROOM + spare * rng.dirichlet(np.ones(len(kinds) + 1))
    start_y, goal_y = rng.uniform(2.0, 8.0, 2).tolist()
    layout = _Layout([], [], [])
    x = 0.0
    for kind, width, room in zip(kinds, widths, rooms, strict=False):
        x += room
        y = start_y + (goal_y - start_y) * (x + width / 2) / SIZE  # where the straight way meets it
        (_add_trap if kind == "trap" else _add_cup)(rng, layout, x, x + width, y)
        x += width
    frame = _Frame(rng.random() < 0.5, (rng.random() < 0.5, rng.random() < 0.5))
    starts = frame.area(0.0, start_y - 0.5, min(rooms[0], ENDS), start_y + 0.5)
    goals = frame.area(SIZE - min(rooms[-1], ENDS), goal_y - 0.5, SIZE, goal_y + 0.5)
    return _posed(rng, layout, frame, starts, goals)


def _add_trap(rng: np.random.Generator, layout: _Layout, x0: float, x1: float, y: float) -> None:
    """A wall with a gap that is too narrow near ``y``, and one that is not elsewhere."""
    gaps = [(float(np.clip(y + rng.normal(0.0, 0.7), 1.0, SIZE - 1.0)), rng.uniform(*FALSE_WIDTH))]
    wanted = [rng.uniform(*TRUE_WIDTH)]
    if rng.random() < SECOND_FALSE:
        wanted.append(rng.uniform(*FALSE_WIDTH))
    for width in wanted:
        middle = rng.uniform(0.9, SIZE - 0.9)
        while min(abs(middle - other) for other, _ in gaps) < APART:
            middle = rng.uniform(0.9, SIZE - 0.9)
        gaps.append((middle, width))
    bottom = 0.0
    for middle, width in sorted(gaps):
        layout.obstacles.append((x0, bottom, x1, middle - width / 2))
        bottom = middle + width / 2
    layout.obstacles.append((x0, bottom, x1, SIZE))
    layout.traps.append((x0, 0.0, x1, SIZE))


def _add_cup(rng: np.random.Generator, layout: _Layout, x0: float, x1: float, y: float) -> None:
    """A cup around ``y``, open towards the start, with a way past it on at least one side."""
    height, t = rng.uniform(*CUP_HEIGHT), rng.uniform(*CUP_THICKNESS)
    y0 = float(np.clip(y + rng.uniform(-1.0, 1.0) - height / 2, 0.0, SIZE - height))
    y1 = y0 + height
    away = rng.random() < AWAY
    back = (x0, x0 + t) if away else (x1 - t, x1)
    low, high = y0, y1
    if min(y0, SIZE - y1) < PASSABLE or rng.random() < JOINED:
        low, high = (0.0, y1) if y0 < SIZE - y1 else (y0, SIZE)
    layout.obstacles += [(x0, y0, x1, y0 + t), (x0, y1 - t, x1, y1), (back[0], low, back[1], high)]
    layout.cups.append((x0, y0, x1, y1))


def _posed(
    rng: np.random.Generator, layout: _Layout, frame: _Frame, starts: Bounds, goals: Bounds
) -> Problem:
    robot = rectangle_robot()
    obstacles = tuple(box(*frame.area(*each)) for each in layout.obstacles)
    environment = Environment((0.0, 0.0, SIZE, SIZE), obstacles)
    space = ConfigurationSpace(robot, environment)
    start, goal = free_pose(space, rng, starts), free_pose(space, rng, goals)
    regions: dict[str, BaseGeometry] = {}
    for name, areas in (("trap", layout.traps), ("cup", layout.cups)):
        if areas:
            regions[name] = unary_union([box(*frame.area(*each)) for each in areas])
    regions["open"] = box(0.0, 0.0, SIZE, SIZE).difference(unary_union(list(regions.values())))
    return Problem(robot, environment, Task(start, goal), NAME, regions)
