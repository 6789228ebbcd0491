"""Proofs that no path exists in C, by optimistic guiding spaces in which every path is accounted for.

Where a path exists in C, one exists in every guiding space that only leaves constraints out (paper, Robot and
Environment Modification). So if such a space, solved completely, has none, C has none. Two are tried:

- **A disc in the workspace.** The largest disc inside the robot (of a robot with joints, a corner of each of
  its bodies) moves without a break from where it is at the start to where it is at the goal, off the
  obstacles by its radius. If the free space, so much smaller, is in parts that hold one each, there is no
  way.
- **Cells of poses** (rigid robots). A cell all of whose poses are certified to collide cannot be crossed: at
  its middle, some disc inside the robot overlaps the obstacles by more than any of its points moves within
  the cell. If start and goal are apart in what is left, there is no way.

Not every problem without a path is found out: a gap that only a turn makes too narrow may need finer cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import is_affordable
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.solvers.wave import body_discs, obstacle_edges, square_frame
from guided_gym.kernels import fields

if TYPE_CHECKING:
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.problems import Task

_SURE: Final = 0.98  # of a radius: GEOS's buffers may be a hundredth too wide where the outline is hollow
_CELLS: Final = 128  # along each side
_HEADINGS: Final = 64
_MARGIN: Final = 0.02  # cells, for single precision
_BYTES: Final = 40  # of a pose, while its cells are labelled


def parted_workspace(space: ConfigurationSpace, task: Task) -> str | None:
    """Why no path joins start and goal, by a disc in the workspace; None if that proves nothing."""
    box = shapely.box(*space.environment.bounds)
    for start, goal, radius, nearness in _discs(space, task):
        wide = _SURE * radius + 0.5 * space.tolerance
        free = box.buffer(-wide).difference(space.environment.obstacle_union.buffer(wide))
        parts = shapely.get_parts(free)
        holds = [np.flatnonzero(shapely.intersects(parts, place)) for place in (start, goal)]
        if not all(len(held) == 1 for held in holds) or holds[0][0] == holds[1][0]:
            continue
        if nearness > 0 and shapely.distance(parts[holds[0][0]], goal) <= nearness:
            continue
        what = f"a disc of radius {radius:.4g} inside the robot" if radius > 0 else "a point of the robot"
        return f"the free workspace is in parts, and {what} is in one at the start and in another at the goal"
    return None


def _discs(
    space: ConfigurationSpace, task: Task
) -> Iterator[tuple[shapely.Point, shapely.Point, float, float]]:
    """Discs inside the robot: where each is at start and goal, its radius, and how near the goal will do."""
    robot = space.robot
    if isinstance(robot, Robot):
        x, y, radius = largest_disc(robot.outline)
        offset = math.hypot(x, y)
        turn = offset / float(space.weights[2]) if space.dimension == 3 else 0.0
        places = []
        for q in (task.start, task.goal):
            c, s = (math.cos(q[2]), math.sin(q[2])) if space.dimension == 3 else (1.0, 0.0)
            places.append(shapely.Point(q[0] + c * x - s * y, q[1] + s * x + c * y))
        yield places[0], places[1], radius, task.tolerance * (1.0 + turn)
    elif isinstance(robot, Linkage) and task.tolerance == 0:
        for one, other in zip(robot.place(task.start), robot.place(task.goal), strict=True):
            corners = [shapely.Point(shapely.get_coordinates(body)[0]) for body in (one, other)]
            yield corners[0], corners[1], 0.0, 0.0


def largest_disc(outline: shapely.Geometry) -> tuple[float, float, float]:
    """x, y and radius of about the largest disc inside an outline; a point of it where it has no inside."""
    if isinstance(outline, shapely.Polygon):
        middle = shapely.get_point(shapely.maximum_inscribed_circle(outline), 0)
        if shapely.contains(outline, middle):
            radius = float(shapely.distance(outline.boundary, middle))
            return float(middle.x), float(middle.y), radius
    x, y = shapely.get_coordinates(outline)[0].tolist()
    return x, y, 0.0


def parted_cells(space: ConfigurationSpace, task: Task) -> str | None:
    """Why no path joins start and goal, by cells of poses; None if that proves nothing."""
    robot = space.robot
    turns = _HEADINGS if space.dimension == 3 else 1
    if not isinstance(robot, Robot) or not is_affordable(_CELLS**2 * turns * _BYTES):
        return None
    frame, cell = _frame(space)
    edges, bounds = obstacle_edges(space.environment), np.array(space.environment.bounds)
    body, radius = body_discs(robot, cell) / cell, robot.radius / cell
    ground = fields.unseen(edges, bounds, frame, _CELLS, turns, body, radius, fields.FINE)
    fields.look_everywhere(ground)
    # How far a point of the robot may be from where it is at the middle of its cell, and how far the samples
    # that tell its distance to the obstacles may be from it.
    turned = radius * math.pi / turns if turns > 1 else 0.0
    off = math.sqrt(0.5) + turned + math.sqrt(2.0) / fields.FINE + _MARGIN
    labels = _labelled(ground.room >= -off)
    start, goal = (_cell_of(q, frame, turns) for q in (task.start, task.goal))
    ends = _near(goal, task.tolerance / cell) if task.tolerance > 0 else (goal[0], goal[1], goal[2])
    here, there = int(labels[start]), np.atleast_1d(labels[ends])
    if here == 0 or labels[goal] == 0 or (there == here).any():
        return None
    count = f"{_CELLS} x {_CELLS}" + (f" x {turns}" if turns > 1 else "")
    return f"of {count} cells of poses, those that are certified to collide part the start from the goal"


def _frame(space: ConfigurationSpace) -> tuple[NDArray[np.float64], float]:
    """Cells around the bounds, wide enough that no robot near them reaches beyond the samples; their side."""
    xmin, ymin, xmax, ymax = space.environment.bounds
    side = (max(xmax - xmin, ymax - ymin) + 4.0 * space.robot.radius) * _CELLS / (_CELLS - 4)
    frame = square_frame(space.environment.bounds, side, _CELLS)
    return frame, float(frame[fields.CELL])


def _cell_of(q: NDArray[np.float64], frame: NDArray[np.float64], turns: int) -> tuple[int, int, int]:
    """Row, column and heading of the cell that a configuration lies in."""
    column = round((float(q[0]) - frame[fields.ORIGIN_X]) / frame[fields.CELL])
    row = round((float(q[1]) - frame[fields.ORIGIN_Y]) / frame[fields.CELL])
    return row, column, round(float(q[2]) * turns / (2.0 * math.pi)) % turns if turns > 1 else 0


def _near(goal: tuple[int, int, int], reach: float) -> Any:
    """The cells, of all headings, that hold a pose within ``reach`` cells of one in the goal's."""
    wide = math.ceil(reach) + 1
    rows, columns = (slice(max(i - wide, 0), i + wide + 1) for i in goal[:2])
    return rows, columns, slice(None)


def _labelled(passable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(n, n, T) number of the part that each passable cell belongs to, 0 for others; corners join, too."""
    from scipy import ndimage
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    around = np.concatenate([passable, passable[:, :, :1]], axis=2)  # the first heading again, after the last
    labels, count = ndimage.label(around, np.ones((3, 3, 3), bool))
    pairs = labels[:, :, 0][passable[:, :, 0]], labels[:, :, -1][passable[:, :, 0]]
    joined = coo_array((np.ones(len(pairs[0]), np.int8), pairs), shape=(count + 1,) * 2)
    _, parts = connected_components(joined, directed=False)
    named = np.where(labels > 0, parts[labels] + 1, 0)
    found: NDArray[np.int32] = named[:, :, :-1].astype(np.int32)
    return found
