"""Robots with joints: planar arms among obstacles (paper, Figure 1)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point, Polygon, box

from guided_gym.catalogue.placement import free_pose
from guided_gym.errors import NoPathError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.problems import Problem, Task

SIZE: Final = 10.0
BASE: Final = (5.0, 5.0)
REACH: Final = 4.4  # of the arms of 4 and 7 links: the workspace's sides are 5 away
WIDTH: Final = 0.16
BEND: Final = 2.7  # radians either way, for all joints but the first, which turns freely
ROOM: Final = 0.7  # around the base that random obstacles leave free
OBSTACLES: Final = (12, 20)
CORNERS: Final = (3, 6)
RADII: Final = (0.25, 0.8)
TRIES: Final = 200

Array = NDArray[np.float64]


def arm(links: int) -> Linkage:
    """The arm of so many links, all alike, on a base in the middle."""
    limits = [None, *[(-BEND, BEND)] * (links - 1)]
    return Linkage.arm([REACH / links] * links, WIDTH, base=BASE, limits=limits, self_collision=True)


def planar_arm_2() -> Problem:
    """A two-joint arm and two obstacles; the way around the second is hidden (paper, Figure 1)."""
    robot = Linkage.arm([2.2, 1.8], 0.3, base=BASE, name="arm of 2 links")
    obstacles = (box(3.4, 6.9, 5.6, 7.6), box(7.6, 4.6, 8.6, 5.4))
    environment = Environment((0.0, 0.0, SIZE, SIZE), obstacles)
    task = Task((-0.9, 0.5), (0.75, -0.3))
    regions = {"o1": obstacles[0].buffer(0.5), "o2": obstacles[1].buffer(0.5)}
    return Problem(robot, environment, task, "PlanarArm2", regions)


def planar_arm_4() -> Problem:
    """An arm of four links reaches out of one window: it has to fold, turn round and reach out of another."""
    return _two_windows(4)


def planar_arm_7() -> Problem:
    """The same with seven links."""
    return _two_windows(7)


def _two_windows(links: int) -> Problem:
    walls = [(2.2, 2.7), (7.3, 7.8)]
    obstacles = [box(a, low, b, high) for a, b in walls for low, high in ((0.0, 4.3), (5.7, SIZE))]
    environment = Environment((0.0, 0.0, SIZE, SIZE), tuple(obstacles))
    start, goal = np.zeros(links), np.zeros(links)
    goal[0] = -math.pi
    regions = {"right": box(7.3, 0, SIZE, SIZE), "left": box(0, 0, 2.7, SIZE), "room": box(2.7, 0, 7.3, SIZE)}
    return Problem(arm(links), environment, Task(start, goal), f"PlanarArm{links}", regions)


def random_planar_arm_4(rng: np.random.Generator) -> Problem:
    """An arm of four links among 12 to 20 random polygons."""
    return _random_arm(rng, 4)


def random_planar_arm_7(rng: np.random.Generator) -> Problem:
    """An arm of seven links among 12 to 20 random polygons."""
    return _random_arm(rng, 7)


def _random_arm(rng: np.random.Generator, links: int) -> Problem:
    """Start and goal do not see each other, and the tool is at opposite sides of something."""
    robot = arm(links)
    for _ in range(TRIES):
        environment = Environment((0.0, 0.0, SIZE, SIZE), _polygons(rng))
        space = ConfigurationSpace(robot, environment)
        try:
            start, goal = free_pose(space, rng), free_pose(space, rng)
        except NoPathError:
            continue
        apart = float(np.hypot(*(robot.position(start) - robot.position(goal))))
        if apart >= 0.5 * REACH and not space.motion_free(start, goal):
            return Problem(robot, environment, Task(start, goal), f"RandomPlanarArm{links}")
    raise NoPathError(f"RandomPlanarArm{links}: expected free configurations, got none in {TRIES} draws")


def _polygons(rng: np.random.Generator) -> tuple[Polygon, ...]:
    """Convex or star-shaped polygons off the base, inside the bounds."""
    count = int(rng.integers(OBSTACLES[0], OBSTACLES[1] + 1))
    found: list[Polygon] = []
    while len(found) < count:
        corners = int(rng.integers(CORNERS[0], CORNERS[1] + 1))
        turns = 2.0 * math.pi * (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) / corners
        radii = rng.uniform(*RADII) * rng.uniform(0.6, 1.0, corners)
        ring = rng.uniform(0.0, SIZE, 2) + radii[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
        polygon = Polygon(ring)
        if polygon.is_valid and polygon.area > 0.02 and polygon.distance(Point(BASE)) > ROOM:
            found.append(polygon)
    inside = box(0.0, 0.0, SIZE, SIZE)
    return tuple(polygon for polygon in found if polygon.intersection(inside).area > 0.0)
