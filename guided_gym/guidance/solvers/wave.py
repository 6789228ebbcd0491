"""A grid of poses (x, y[, theta]) with the robot's room at each, and waves from the goal through it.

The wave's arrival is a cost-to-go field: the planning layer of the learned guidance, and the heuristic of
`guided_gym.guidance.wavefront`. It is made from a raster of the workspace. Checked for collision are only the
motions to the goal, and those between poses of the grid by which a thin robot could jump over a wall unseen.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import affordable, integer, is_affordable, number
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot, rigid
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.solvers.base import Query, Valid
from guided_gym.kernels import collision, fields
from guided_gym.kernels.collision import Geometry
from guided_gym.storage.preparations import Arrays, fits, prepared

if TYPE_CHECKING:
    from guided_gym.problems import Problem

FloatArray = NDArray[np.float64]
Field = NDArray[np.float32]

_SURE: Final = 60.0  # logit of being free for each cell of room
_NEAR_GOAL: Final = 2  # cells around the goal where the wave may begin
_SURE_PARTS: Final = 32  # poses along a motion to the goal
_FINER: Final = 3  # grids that are tried, each about 3/2 times as fine as the one before
_LEAST: Final = 1e-6  # cells; a value of 0 would have no sign
_ROUGH: Final = 1.1  # lengths: the grid is no more exact than that
_SLOWEST: Final = 1e3  # times that failures may slow down a pose
_KEPT: Final = 8  # problems whose fields are kept
_KEPT_GRIDS: Final = 4  # grids that are kept for other tasks in the same space
_POSE: Final = 64  # bytes of a pose: room, links, slowness, effort, arrivals, and what a wave takes
_RUNS_A_RAISE: Final = 4  # runs over poses that turn, after each so many of which one more rise has to come


@lru_cache(maxsize=64)
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


@lru_cache(maxsize=64)
def _least_width(robot: Robot) -> float:
    """Of the robot's convex pieces, the least width.

    What lies between two poses that are less apart is met by the body at one of them, but for what only a
    corner would touch. A body that is thinner may jump over a wall.
    """
    widths = [0.0 if len(piece) < 3 else math.inf for piece in robot.pieces]
    for piece in robot.pieces:
        for side in np.roll(piece, -1, axis=0) - piece:
            across = piece @ np.array([-side[1], side[0]]) / max(math.hypot(*side), 1e-300)
            widths.append(float(np.ptp(across)))
    return min(widths)


def obstacle_edges(environment: Environment) -> FloatArray:
    """(e, 4) edges x0, y0, x1, y1 of the union of the obstacles."""
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
        closed: (n, n, T) links between poses that are not free (see `fields.closed_links`); (0, 0, 0) where
            none can be.
        link_looks: How many links were checked for collision.
        geometry: What the collision kernels take; None if it is not at hand, as in a lesson from a file.
    """

    frame: FloatArray
    side: float
    room: Field
    workspace: Field
    distances: Field
    body: FloatArray
    closed: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), np.uint8))
    link_looks: int = 0
    geometry: Geometry | None = None

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
        robot = rigid(space.robot, "grid of poses")
        xmin, ymin, xmax, ymax = space.environment.bounds
        side = max(xmax - xmin, ymax - ymin)
        cell = side / cells
        frame = np.zeros(fields.FRAME)
        frame[fields.ORIGIN_X] = (xmin + xmax - side + cell) / 2
        frame[fields.ORIGIN_Y] = (ymin + ymax - side + cell) / 2
        frame[fields.CELL] = cell
        frame[fields.WEIGHT] = space.weights[2] if space.dimension == 3 else 0.0
        body = body_discs(robot, cell) / cell
        turns, fine = headings if space.dimension == 3 else 1, fields.FINE
        kept = prepared(
            "wave 1",
            f"{space.fingerprint()} {cells} {headings}",
            lambda: _rasterised(space, robot, frame, (cells, turns), body),
            lambda kept: _is_raster(kept, cells, turns),
        )
        blocks = kept["distances"].reshape(cells, fine, cells, fine)[:, fine // 2 - 1 :, :, fine // 2 - 1 :]
        workspace = blocks[:, :2, :, :2].mean(axis=(1, 3))
        rooms, links = (
            (kept["room"], workspace, kept["distances"], body),
            (kept["closed"], int(kept["looks"][0])),
        )
        return cls(frame, side, *rooms, *links, space.geometry)

    def towards(self, goal: FloatArray) -> FloatArray:
        """The frame with a goal in it."""
        frame = self.frame.copy()
        frame[fields.GOAL : fields.GOAL + goal.size] = goal
        return frame

    def beginnings(self, frame: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Where the wave begins: flat places (m,) of poses near the goal, and their distance to it (m,).

        Those from which the straight motion to the goal is free; if there is none, the likeliest.
        """
        places, poses = fields.poses_near_goal(self.room.shape, frame, _NEAR_GOAL)
        goal = frame[fields.GOAL : fields.GOAL + (3 if self.room.shape[2] > 1 else 2)]
        ends = np.ascontiguousarray(poses[:, : goal.size])
        chosen = np.zeros(len(ends), np.bool_)
        if self.geometry is not None:
            chosen = collision.motions_free(np.repeat(goal[None], len(ends), axis=0), ends, self.geometry)
        if not chosen.any():
            spare = fields.spare_room(goal, ends, self.distances, self.body, frame, _SURE_PARTS)
            chosen = spare >= 0.0 if (spare >= 0.0).any() else spare == spare.max()
        distances = [fields.goal_distance(x, y, theta, frame) for x, y, theta in poses[chosen].tolist()]
        return places[chosen], np.array(distances)

    def looks(self, frame: FloatArray) -> int:
        """How many motions have been checked for collision: those of links, and those to the goal."""
        return self.link_looks + len(fields.poses_near_goal(self.room.shape, frame, _NEAR_GOAL)[0])


def _rasterised(
    space: ConfigurationSpace, robot: Robot, frame: FloatArray, shape: tuple[int, int], body: FloatArray
) -> Arrays:
    """Of a grid of (cells, headings), what depends on the workspace; see `PoseGrid`."""
    (cells, turns), cell = shape, float(frame[fields.CELL])
    bounds = np.array(space.environment.bounds)
    distances = fields.signed_distances(obstacle_edges(space.environment), bounds, frame, cells)
    room = fields.robot_clearances(distances, body, robot.radius / cell, turns)
    closed, looks = np.zeros((0, 0, 0), np.uint8), 0
    if _least_width(robot) < max(cell, 2.0 * math.pi / turns * robot.radius):
        closed, looks = fields.closed_links(room, frame, space.geometry)
    return {"distances": distances, "room": room, "closed": closed, "looks": np.array([looks])}


def _is_raster(kept: Arrays, cells: int, turns: int) -> bool:
    """Whether arrays from a file have the types and shapes of those that `_rasterised` makes."""
    closed = (cells, cells, turns) if kept["closed"].size else (0, 0, 0)
    return (
        fits(kept["distances"], np.float32, cells * fields.FINE, cells * fields.FINE)
        and fits(kept["room"], np.float32, cells, cells, turns)
        and fits(kept["closed"], np.uint8, *closed)
        and fits(kept["looks"], np.int64, 1)
    )


@dataclass(frozen=True, eq=False)
class CostField:
    """A field over the poses of a grid, for one goal.

    Attributes:
        frame: Where the cells lie, and the goal.
        values: (n, n, T) float32 cost-to-go (length), negated where a pose seems blocked.
    """

    frame: FloatArray
    values: Field

    @classmethod
    def of(cls, frame: FloatArray, free: NDArray[np.bool_], values: Field, blocked: Field) -> CostField:
        """The field of (n, n, T) ``values`` where poses seem free, and of ``blocked`` ones elsewhere."""
        least = np.float32(_LEAST * frame[fields.CELL])
        return cls(frame, np.where(free, np.maximum(values, least), -np.maximum(blocked, least)))

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
        self._kept: OrderedDict[bytes, tuple[PoseGrid, CostField]] = OrderedDict()
        self._grids: OrderedDict[tuple[str, int], PoseGrid] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": OrderedDict(), "_grids": OrderedDict()}

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
        jump = self.blocked * float(frame[fields.CELL])
        return (
            fields.wave(slowness, logits >= 0, grid.closed, jump, *grid.beginnings(frame), frame),
            logits > 0,
        )

    def evaluate(self, grid: PoseGrid, goal: FloatArray, effort: Field | None = None) -> CostField:
        """The cost-to-go field for a goal.

        Args:
            grid: The grid of poses.
            goal: (d,) the goal.
            effort: (n, n, T) how many times slower the wave is than the room lets it be; None for once.
        """
        frame = grid.towards(goal)
        arrival, free = self.arrival(grid, frame, effort)
        return CostField.of(frame, free, self.corrected(grid, frame, arrival), arrival)

    def corrected(self, grid: PoseGrid, frame: FloatArray, arrival: Field) -> Field:
        """(n, n, T) cost-to-go from the arrival: the arrival itself."""
        return arrival

    def solve(self, problem: Problem) -> tuple[PoseGrid, CostField]:
        """The grid and field of a problem, kept for when it comes again.

        Where no way through what seems free leads to the start, a finer grid may see one: gaps narrower than
        a cell can seem blocked.
        """
        return self.solve_query(problem.space, problem.task.start, problem.task.goal)

    def solve_query(
        self, space: ConfigurationSpace, start: FloatArray, goal: FloatArray
    ) -> tuple[PoseGrid, CostField]:
        """`solve` for a start and a goal in a space; either may be in collision there."""
        key = space.fingerprint().encode() + start.tobytes() + goal.tobytes()
        if key not in self._kept:
            self._kept[key] = self._solve(space, start, goal)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _grid(self, space: ConfigurationSpace, cells: int) -> PoseGrid:
        """The grid of a space, kept for other tasks in it."""
        key = space.fingerprint(), cells
        if key not in self._grids:
            self._grids[key] = PoseGrid.of(space, cells, self.headings)
            while len(self._grids) > _KEPT_GRIDS:
                self._grids.popitem(last=False)
        self._grids.move_to_end(key)
        return self._grids[key]

    def _solve(
        self, space: ConfigurationSpace, start: FloatArray, goal: FloatArray
    ) -> tuple[PoseGrid, CostField]:
        cells = self.cells
        for finer in range(_FINER):
            grid = self._grid(space, cells)
            found = self.evaluate(grid, goal)
            if not self.plans or finer == _FINER - 1:
                break
            if not fields.blocked_on_way(start, found.values, grid.closed, found.frame):
                break
            cells = max(cells * 3 // 2 // 8 * 8, cells + 8)
            if not is_affordable(_grid_bytes(cells, self.headings)):
                break
        return grid, found


class Wave:
    """A solver: h is when a wave from the goal arrives, on a grid of poses, slow where there is no room.

    The grid cannot see all: a gap narrower than a cell may seem blocked. The wave passes through what seems
    blocked, ``blocked`` times slower: h is finite wherever the state is free and nothing is forbidden.

    Args:
        cells: Cells along each side of the raster.
        headings: Headings of the grid, for a robot that can turn.
        blocked: How many times slower the wave is at most, where a pose is surely blocked.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    looks: int
    sees = True  # each pose is looked up in the grid

    def __init__(self, *, cells: int = 56, headings: int = 16, blocked: float = 300.0) -> None:
        check_grid(cells, headings)
        self.model = WaveModel(cells, headings, number("blocked", blocked, least=1))

    @classmethod
    def of(cls, model: WaveModel) -> Wave:
        """A wave that another model slows down and corrects."""
        wave = cls.__new__(cls)
        wave.model = model
        return wave

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Run the wave for a query; see `CostToGo`.

        Raises:
            InvalidInputError: A space of other than 2 or 3 dimensions.
        """
        if query.space.dimension not in (2, 3):
            raise InvalidInputError(
                f"wave: expected a space of 2 or 3 dimensions, got {query.space.dimension} dimensions"
            )
        self._space, self._start = query.space, query.start
        self._grid, self._field = self.model.solve_query(query.space, query.start, query.goal)
        frame, logits = self._field.frame, self.model.free(self._grid)
        self.looks = self._grid.looks(frame)
        self._free = logits > 0
        self._sources = self._grid.beginnings(frame)
        self._arrival = self._first = np.abs(self._field.values)  # now, and before anything was raised
        self._slowness = self.model.slowness(self._grid, logits)
        self._effort = np.ones_like(self._slowness)  # how many times slower poses have become
        self._waiting = self._runs = 0  # raised since the last run, and runs since the beginning
        self._joined = self._join(query.start[None])  # of the nodes; spare rows included
        self._values = np.zeros(1)
        self._nodes = self._upheld = 0  # how many are joined, and how many of the values are up to date

    def __call__(self, states: FloatArray) -> FloatArray:
        """(n, d') states to (n,) cost-to-go (length); infinite in collision and where all is forbidden."""
        self._run_again()
        self._asked = self._join(states)
        return fields.joined_values(self._asked, self._arrival, self._effort)

    @property
    def sees_way(self) -> bool:
        """Whether the way from the start runs only through what seems free, before anything is raised."""
        grid, found = self._grid, self._field
        return fields.blocked_on_way(self._start, found.values, grid.closed, found.frame) == 0

    def plausible(self, node: int, lengths: FloatArray) -> NDArray[np.bool_]:
        """Which of the states asked for last a free motion from a node can reach.

        No free motion brings the goal nearer than by its length: what seems to lies behind a wall.

        Args:
            node: The node, among those that `follow` has seen.
            lengths: (n,) length of the motion to each.
        """
        even = np.ones_like(self._effort)
        row, (places, shares, lines) = slice(node, node + 1), self._joined
        here = fields.Joined(places[row], shares[row], lines[row])
        ways = [fields.joined_values(some, self._first, even) for some in (here, self._asked)]
        return np.asarray(ways[1] >= ways[0][0] - _ROUGH * lengths)

    def follow(self, states: FloatArray) -> FloatArray:
        """(n,) cost-to-go of the nodes; all of them anew once the wave has run again."""
        self._run_again()
        n = len(states)
        if n > len(self._values):
            self._values = np.resize(self._values, 2 * n)
            j = self._joined
            self._joined = fields.Joined(
                np.resize(j.places, (2 * n, 9)),
                np.resize(j.shares, (2 * n, 8)),
                np.resize(j.lengths, (2 * n, 10)),
            )
        if n > self._nodes:
            rows, fresh = slice(self._nodes, n), self._join(states[self._nodes : n])
            self._joined.places[rows], self._joined.shares[rows] = fresh.places, fresh.shares
            self._joined.lengths[rows] = fresh.lengths
            self._nodes = n
        if n > self._upheld:
            rows = slice(self._upheld, n)
            places, shares, lengths = self._joined
            some = fields.Joined(places[rows], shares[rows], lengths[rows])
            self._values[rows] = fields.joined_values(some, self._arrival, self._effort)
            self._upheld = n
        values = self._values[:n]
        values.flags.writeable = False
        return values

    def raise_near(self, state: FloatArray, reach: float, factor: float) -> None:
        """Make the poses within ``reach``, and the nearest in any case, ``factor`` times slower.

        Up to `_SLOWEST` times: a wave through what is slower yet would take for ever.
        """
        q = np.ascontiguousarray(state)
        for factors in (self._slowness, self._effort):
            fields.multiply_near(factors, q, self._field.frame, reach, factor)
            if np.isfinite(factor):
                np.minimum(factors, np.float32(_SLOWEST), out=factors, where=np.isfinite(factors))
        self._waiting += 1

    def inspect(self, state: FloatArray, reach: float, valid: Valid) -> None:
        """Nothing: the grid's poses have been looked at."""

    def drawing(self, values: bool = True) -> dict[str, Any]:
        """What a figure shows: ``field`` (n, n), when the wave arrives, and its ``bounds``.

        At the best heading; infinite where none has room.
        """
        arrival = np.where(self._free, self._arrival, np.inf).min(axis=2).astype(np.float64)
        frame = self._field.frame
        left, low = (float(frame[i] - frame[fields.CELL] / 2) for i in (fields.ORIGIN_X, fields.ORIGIN_Y))
        side = float(frame[fields.CELL]) * len(arrival)
        return {"field": arrival, "bounds": [left, low, left + side, low + side]}

    def _join(self, states: FloatArray) -> fields.Joined:
        q = np.require(states, np.float64, ["C", "W"])
        return fields.join(q, self._grid.room, self._free, self._field.frame, self._space.geometry)

    def _run_again(self) -> None:
        """Run the wave again if costs have risen; over many poses only after some more of it each time."""
        flat = self._grid.room.shape[2] == 1
        if self._waiting <= (0 if flat else self._runs // _RUNS_A_RAISE):
            return
        frame, jump = self._field.frame, self.model.blocked * float(self._field.frame[fields.CELL])
        arrival = fields.wave(self._slowness, self._free, self._grid.closed, jump, *self._sources, frame)
        self._arrival = np.maximum(arrival, self._arrival)  # the wave's queue is a little untidy
        self._waiting, self._upheld = 0, 0
        self._runs += 1


def check_grid(cells: int, headings: int) -> None:
    """Refuse sizes of a grid that networks and symmetries cannot halve.

    Raises:
        InvalidInputError: Cells that are no multiple of 8, or headings that are none of 4.
    """
    for name, value, part in (("cells", cells, 8), ("headings", headings, 4)):
        if integer(name, value, least=part) % part:
            raise InvalidInputError(f"{name}: expected a multiple of {part}, got {value!r}")
    affordable("cells, headings", (cells, headings), _grid_bytes(cells, headings), "the grid of poses")


def _grid_bytes(cells: int, headings: int) -> int:
    return int(cells) ** 2 * (_POSE * int(headings) + 8 * 8 * fields.FINE**2)
