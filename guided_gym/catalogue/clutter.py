"""Random clutter: polygons of any shape thrown into the workspace so that a path is always left."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely
from shapely.geometry import Polygon, box

from guided_gym.catalogue.placement import free_pose
from guided_gym.catalogue.shapes import ROBOT_WIDTH, SIZE, rectangle_robot
from guided_gym.errors import NoPathError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.measure.grid import grid_joins
from guided_gym.problems import Problem, Task

NAME: Final = "RandomClutter"
POLYGONS: Final = (14, 30)
CORNERS: Final = (3, 7)
RADIUS: Final = (0.5, 1.5)  # of the circle around a polygon
DENT: Final = 0.45  # its corners are at least this part of the radius from its middle
APART: Final = 5.0  # from start to goal, at least
TRIES: Final = 200

_GRID: Final = (64, 64, 28)
_WORKSPACE = box(0.0, 0.0, SIZE, SIZE)


def random_clutter(rng: np.random.Generator) -> Problem:
    """14 to 30 random polygons, convex or not, that may overlap; start and goal 5 apart and out of sight."""
    for _ in range(TRIES):
        problem = _drawn(rng)
        if problem is not None and _has_path(problem):
            return problem
    raise NoPathError(f"{NAME}: expected a problem that has a path, got none in {TRIES} draws")


def _drawn(rng: np.random.Generator) -> Problem | None:
    """One draw; None if start and goal are near, in sight of each other, or certainly not joined."""
    count = int(rng.integers(POLYGONS[0], POLYGONS[1] + 1))
    obstacles = tuple(_star(rng) for _ in range(count))
    environment = Environment((0.0, 0.0, SIZE, SIZE), obstacles)
    space = ConfigurationSpace(rectangle_robot(), environment)
    try:
        start, goal = free_pose(space, rng), free_pose(space, rng)
    except NoPathError:
        return None
    apart = np.hypot(*(goal - start)[:2]) >= APART and not space.motion_free(start, goal)
    if not (apart and _disc_passes(environment, start, goal)):
        return None
    return Problem(space.robot, environment, Task(start, goal), NAME)


def _star(rng: np.random.Generator) -> Polygon:
    """A polygon with its corners in the order of their angles around its middle."""
    while True:
        corners = int(rng.integers(CORNERS[0], CORNERS[1] + 1))
        middle = rng.uniform(0.0, SIZE, 2)
        # One corner in each of equal sectors: no sector is empty, so the polygon is simple.
        angles = 2.0 * np.pi * (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) / corners
        radii = rng.uniform(*RADIUS) * rng.uniform(DENT, 1.0, corners)
        star = Polygon(middle + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))
        if star.intersects(
            _WORKSPACE
        ):  # a triangle need not contain its middle: at the rim it may lie outside
            return star


def _disc_passes(environment: Environment, start: np.ndarray, goal: np.ndarray) -> bool:
    """Whether the robot's inscribed disc gets from start to goal: cheap, and no path exists where it can't.

    The disc is taken a little smaller, since shapely's round buffers are polygons.
    """
    radius = 0.99 * ROBOT_WIDTH / 2
    free = box(radius, radius, SIZE - radius, SIZE - radius).difference(
        environment.obstacle_union.buffer(radius)
    )
    parts = shapely.get_parts(free)
    ends = [shapely.intersects_xy(parts, *q[:2].tolist()) for q in (start, goal)]
    return bool((ends[0] & ends[1]).any())


def _has_path(problem: Problem) -> bool:
    """Whether a coarse grid has a path: a finer one would take half a second, for other problems."""
    task = problem.task
    return grid_joins(problem.space, task.start, task.goal, _GRID)
