"""A grid of poses (x, y[, theta]) with the robot's room at each, and waves from the goal through it.

The wave's arrival is a cost-to-go field: the planning layer of the learned guidance, and the heuristic of
`guided_gym.guidance.wavefront`. All is made from a raster of the workspace; no pose or motion is checked for
collision.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import fields

if TYPE_CHECKING:
    from guided_gym.problems import Problem

FloatArray = NDArray[np.float64]
Field = NDArray[np.float32]

_MOTION_PARTS: Final = 8  # poses along a motion at which its room is looked up
_SURE: Final = 60.0  # logit of being free for each cell of room
_NEAR_GOAL: Final = 2  # cells around the goal where the wave may begin
_SURE_PARTS: Final = 32  # poses along a motion to the goal
_FINER: Final = 3  # grids that are tried, each about 3/2 times as fine as the one before
_KEPT: Final = 8  # problems whose fields are kept


def body_discs(robot: Robot, spacing: float) -> FloatArray:
    """(k, 3) discs x, y, radius that fill the robot's outline: points along it and the largest inside.

    Args:
        robot: The robot.
        spacing: Distance between the points (length), at most; a quarter of the robot's radius is enough.
    """
    outline, radius = robot.outline, robot.radius
    if isinstance(outline, shapely.Point) or radius == 0.0:
        return np.array([[*shapely.get_coordinates(outline)[0], 0.0]])
    border = outline.boundary if isinstance(outline, shapely.Polygon) else outline
    points = shapely.get_coordinates(shapely.segmentize(border, min(radius / 4.0, spacing)))
    discs = [np.column_stack([points, np.zeros(len(points))])]
    if isinstance(outline, shapely.Polygon):
        discs.append(_inner_discs(outline, radius / 8.0))
    return np.ascontiguousarray(np.unique(np.concatenate(discs), axis=0))


def _inner_discs(outline: shapely.Polygon, spacing: float) -> FloatArray:
    """Discs inside a polygon, the largest first, none whose centre another covers; none below half."""
    xmin, ymin, xmax, ymax = outline.bounds
    x, y = np.meshgrid(np.arange(xmin, xmax, spacing), np.arange(ymin, ymax, spacing))
    inner = shapely.points(x.ravel() + spacing / 2, y.ravel() + spacing / 2)
    inner = inner[shapely.contains(outline, inner)]
    rooms = shapely.distance(outline.boundary, inner)
    chosen: list[tuple[float, float, float]] = []
    for i in np.argsort(-rooms, kind="stable"):
        x0, y0, room = float(shapely.get_x(inner[i])), float(shapely.get_y(inner[i])), float(rooms[i])
        if chosen and room < 0.5 * chosen[0][2]:
            break
        if all(math.hypot(x0 - x1, y0 - y1) > 0.7 * r1 for x1, y1, r1 in chosen):
            chosen.append((x0, y0, room))
    return np.array(chosen, np.float64).reshape(-1, 3)


def _edges(environment: Environment) -> FloatArray:
    union = environment.obstacle_union
    polygons = getattr(union, "geoms", [union])
    rings = [ring for p in polygons if not p.is_empty for ring in (p.exterior, *p.interiors)]
    if not rings:
        return np.zeros((0, 4))
    parts = [shapely.get_coordinates(ring) for ring in rings]
    return np.ascontiguousarray(np.concatenate([np.hstack([part[:-1], part[1:]]) for part in parts]))


@dataclass(frozen=True, eq=False)
class PoseGrid:
    """What is known of a problem without its goal: the square around the workspace, and the robot in it.

    Attributes:
        frame: Where the cells lie (see `guided_gym.kernels.fields`); its goal is not set.
        side: Side of the square (length).
        room: (n, n, T) room of the robot in cells; T is 1 for a robot that cannot turn.
        workspace: (n, n) room of a point in cells.
        distances: Samples of the distance to the nearest obstacle, in cells, finer than the grid.
        body: (k, 3) discs that fill the robot, in cells.
    """

    frame: FloatArray
    side: float
    room: Field
    workspace: Field
    distances: Field
    body: FloatArray

    @classmethod
    def of(cls, space: ConfigurationSpace, cells: int, headings: int) -> PoseGrid:
        """Rasterise the workspace of a space, as its robot sees it.

        Args:
            space: The configuration space.
            cells: Cells along each side.
            headings: Headings, for a robot that can turn.

        Raises:
            InvalidInputError: A robot that is not planar and rigid.
        """
        if space.dimension not in (2, 3):
            raise InvalidInputError(
                f"grid of poses: expected a robot with configurations (x, y) or (x, y, theta), got "
                f"{space.dimension} dimensions"
            )
        xmin, ymin, xmax, ymax = bounds = space.environment.bounds
        side = max(xmax - xmin, ymax - ymin)
        cell = side / cells
        frame = np.zeros(fields.FRAME)
        frame[fields.ORIGIN_X] = (xmin + xmax - side + cell) / 2
        frame[fields.ORIGIN_Y] = (ymin + ymax - side + cell) / 2
        frame[fields.CELL] = cell
        frame[fields.WEIGHT] = space.weights[2] if space.dimension == 3 else 0.0
        distances = fields.signed_distances(_edges(space.environment), np.array(bounds), frame, cells)
        body = body_discs(space.robot, cell) / cell
        turns = headings if space.dimension == 3 else 1
        room = fields.robot_clearances(distances, body, space.robot.radius / cell, turns)
        fine = fields.FINE
        blocks = distances.reshape(cells, fine, cells, fine)[:, fine // 2 - 1 :, :, fine // 2 - 1 :]
        return cls(frame, side, room, blocks[:, :2, :, :2].mean(axis=(1, 3)), distances, body)

    def towards(self, goal: FloatArray) -> FloatArray:
        """The frame with a goal in it."""
        frame = self.frame.copy()
        frame[fields.GOAL : fields.GOAL + goal.size] = goal
        return frame

    def beginnings(self, frame: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Where the wave begins: flat places (m,) of poses near the goal, and their distance to it (m,).

        Those from which the straight motion to the goal surely has room; if there is none, the likeliest.
        """
        places, poses = fields.poses_near_goal(self.room.shape, frame, _NEAR_GOAL)
        goal = frame[fields.GOAL : fields.GOAL + (3 if self.room.shape[2] > 1 else 2)]
        ends = np.ascontiguousarray(poses[:, : goal.size])
        spare = fields.spare_room(goal, ends, self.distances, self.body, frame, _SURE_PARTS)
        chosen = spare >= 0.0 if (spare >= 0.0).any() else spare == spare.max()
        distances = [fields.goal_distance(x, y, theta, frame) for x, y, theta in poses[chosen].tolist()]
        return places[chosen], np.array(distances)

    def best_motion(
        self, q: FloatArray, candidates: FloatArray, scores: FloatArray, enough: float, penalty: float
    ) -> int:
        """The candidate of the least score; each ``enough`` cells of room that it lacks cost ``penalty``."""
        raster = (self.distances, self.body, self.frame, _MOTION_PARTS)
        return int(fields.best_motion(q, candidates, scores, *raster, enough, penalty))

    def least_room(self, q: FloatArray, candidates: FloatArray) -> FloatArray:
        """(m,) least room, in cells, along the motions from q to candidates (m, d)."""
        return fields.least_room(q, candidates, self.distances, self.body, self.frame, _MOTION_PARTS)


@dataclass(frozen=True, eq=False)
class CostField:
    """A field over the poses of a grid, for one goal.

    Attributes:
        frame: Where the cells lie, and the goal.
        values: (n, n, T) float32 cost-to-go (length), negated where a pose seems blocked.
    """

    frame: FloatArray
    values: Field

    def cost_to_go(self, q: FloatArray) -> FloatArray:
        """(m,) the field at configurations (m, d)."""
        return fields.look_up(np.ascontiguousarray(q, np.float64), self.values, self.frame)


class WaveModel:
    """Which poses are free, by their room, and how long a wave from the goal takes to them.

    Args:
        cells: Cells along each side of the raster.
        headings: Headings of the grid.
        blocked: How many times slower the wave is at most, where a pose is surely blocked.
    """

    plans: bool = True  # whether there is a wave

    def __init__(self, cells: int, headings: int, blocked: float = 300.0) -> None:
        self.cells, self.headings, self.blocked = cells, headings, blocked
        self._kept: OrderedDict[str, tuple[PoseGrid, CostField]] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": OrderedDict()}

    def free(self, grid: PoseGrid) -> Field:
        """(n, n, T) logit of each pose being free."""
        return _SURE * grid.room

    def slowness(self, grid: PoseGrid, logits: Field, effort: Field | None = None) -> Field:
        """(n, n, T) 1/p: as often as one would have to try. ``effort`` multiplies it."""
        slowness = 1 + np.exp(np.minimum(-logits, 30))
        if effort is not None:
            slowness *= effort
        return np.asarray(np.minimum(slowness, self.blocked).astype(np.float32))

    def arrival(
        self, grid: PoseGrid, frame: FloatArray, effort: Field | None = None
    ) -> tuple[Field, NDArray[np.bool_]]:
        """(n, n, T) when the wave from the goal arrives, and which poses seem free."""
        logits = self.free(grid)
        slowness = self.slowness(grid, logits, effort)
        return fields.wave(slowness, *grid.beginnings(frame), frame), logits > 0

    def evaluate(self, grid: PoseGrid, goal: FloatArray, effort: Field | None = None) -> CostField:
        """The cost-to-go field for a goal.

        Args:
            grid: The grid of poses.
            goal: (d,) the goal.
            effort: (n, n, T) how many times slower the wave is than the room lets it be; None for once.
        """
        frame = grid.towards(goal)
        arrival, free = self.arrival(grid, frame, effort)
        values = np.maximum(self.corrected(grid, frame, arrival), np.float32(1e-6))
        return CostField(frame, np.where(free, values, -np.maximum(arrival, np.float32(1e-6))))

    def corrected(self, grid: PoseGrid, frame: FloatArray, arrival: Field) -> Field:
        """(n, n, T) cost-to-go from the arrival: the arrival itself."""
        return arrival

    def solve(self, problem: Problem) -> tuple[PoseGrid, CostField]:
        """The grid and field of a problem, kept for when it comes again.

        Where no way through what seems free leads to the start, a finer grid may see one: gaps narrower than
        a cell can seem blocked.
        """
        key = problem.fingerprint
        if key not in self._kept:
            self._kept[key] = self._solve(problem)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _solve(self, problem: Problem) -> tuple[PoseGrid, CostField]:
        cells = self.cells
        for finer in range(_FINER):
            grid = PoseGrid.of(problem.space, cells, self.headings)
            field = self.evaluate(grid, problem.task.goal)
            if not self.plans or finer == _FINER - 1:
                break
            if not fields.blocked_on_way(problem.task.start, field.values, field.frame):
                break
            cells = max(cells * 3 // 2 // 8 * 8, cells + 8)
        return grid, field
