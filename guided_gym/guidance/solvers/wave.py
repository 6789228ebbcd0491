"""A grid of poses (x, y[, theta]) with the robot's room at each, and waves from the goal through it.

The wave's arrival is a cost-to-go field: the planning layer of the learned guidance, and the heuristic of
`wavefront`. It is made from a raster of the workspace. Checked for collision are only the motions to the
goal, and those between poses of the grid by which a thin robot could jump over a wall unseen.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import affordable, integer, is_affordable, number
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot, rigid
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.solvers.base import Query, Valid
from guided_gym.kernels import collision, fields, marching, wave_growth
from guided_gym.kernels.collision import Geometry
from guided_gym.kernels.fields import Ground
from guided_gym.kernels.marching import Front
from guided_gym.search.search import Search
from guided_gym.storage.preparations import Arrays, fits, is_keeping, prepared

FloatArray = NDArray[np.float64]
Field = NDArray[np.float32]

_NEAR_GOAL: Final = 2  # cells around the goal where the wave may begin
_SURE_PARTS: Final = 32  # poses along a motion to the goal
_FINER: Final = 3  # grids that are tried, each about 3/2 times as fine as the one before
_LEAST: Final = 1e-6  # cells; a value of 0 would have no sign
_FEW: Final = 8  # headings
_ROUND: Final = 0.99  # of the circumradius inside which a robot is: it is as good as a disc
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
    if robot.inner_radius >= _ROUND * radius:
        return np.array([[0.0, 0.0, robot.inner_radius]])
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


def _headings(robot: Robot, apart: float, most: int) -> int:
    """As few headings as keep the robot's farthest point no further apart than that (length)."""
    needed = math.ceil(2.0 * math.pi * robot.radius / apart / 4.0) * 4
    return min(max(needed, _FEW), most)


def square_frame(bounds: Sequence[float], side: float, cells: int) -> FloatArray:
    """The frame of a square of cells around the middle of the bounds; without weight and goal."""
    xmin, ymin, xmax, ymax = bounds
    frame, cell = np.zeros(fields.FRAME), side / cells
    frame[fields.ORIGIN_X] = (xmin + xmax - side + cell) / 2
    frame[fields.ORIGIN_Y] = (ymin + ymax - side + cell) / 2
    frame[fields.CELL] = cell
    return frame


def obstacle_edges(environment: Environment) -> FloatArray:
    """(e, 4) edges x0, y0, x1, y1 of the obstacles' union."""
    rings = shapely.get_rings(shapely.get_parts(environment.obstacle_union))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    if not rings.size:
        return np.zeros((0, 4))
    edges: FloatArray = np.hstack([corners[:-1], corners[1:]])[ring[:-1] == ring[1:]]
    return edges


class Beginnings(NamedTuple):
    """Where a wave begins.

    Attributes:
        places: (m,) flat places of poses in the grid.
        distances: (m,) how far they are from the goal.
        looks: How many motions to the goal have been checked for collision.
    """

    places: NDArray[np.int64]
    distances: FloatArray
    looks: int


@dataclass(frozen=True, eq=False)
class PoseGrid:
    """What is known of a problem apart from its goal: the square around the workspace, and the robot in it.

    Attributes:
        ground: The workspace and the robot's room in it; see `fields.Ground`.
        workspace: (n, n) room of a point in cells; (0, 0) unless the whole grid has been looked at.
        closed: (n, n, T) links between poses that are not free (see `fields.closed_links`); (0, 0, 0) where
            none can be. T is 1 for a robot that cannot turn.
        link_looks: How many links were checked for collision.
        geometry: What the collision kernels take; None if it is not at hand, as in a lesson from a file.
    """

    ground: Ground
    workspace: Field
    closed: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), np.uint8))
    link_looks: int = 0
    geometry: Geometry | None = None

    @classmethod
    def of(cls, space: ConfigurationSpace, cells: int, headings: int, whole: bool = True) -> PoseGrid:
        """Rasterise the workspace of a space, as its robot sees it.

        Args:
            space: The configuration space.
            cells: Cells along each side.
            headings: Headings, for a robot that can turn; fewer do for a stout one, unless the grid is whole.
            whole: Whether to look everywhere at once; otherwise where it is asked for.

        Raises:
            InvalidInputError: A robot that is not planar and rigid.
        """
        robot = rigid(space.robot, "grid of poses")
        xmin, ymin, xmax, ymax = bounds = space.environment.bounds
        side = max(xmax - xmin, ymax - ymin)
        cell = side / cells
        frame = square_frame(bounds, side, cells)
        frame[fields.WEIGHT] = space.weights[2] if space.dimension == 3 else 0.0
        turns, width = 1, _least_width(robot)
        if space.dimension == 3:
            turns = headings if whole or width < cell else _headings(robot, min(2.0 * cell, width), headings)
        body, radius = body_discs(robot, cell) / cell, robot.radius / cell
        thin = width < (max(cell, 2.0 * math.pi / turns * robot.radius) if space.dimension == 3 else cell)
        edges = obstacle_edges(space.environment), np.array(bounds)
        # Of a disc around the reference point the room at the middle of a cell is what one sample tells.
        fine = 1 if len(body) == 1 and not body[0, :2].any() and not whole else fields.FINE
        made = partial(fields.unseen, *edges, frame, cells, turns, body, radius, fine)
        if not (whole or thin or is_keeping()):
            return cls(made(), np.zeros((0, 0), np.float32), geometry=space.geometry)

        def looked_at() -> Arrays:
            ground = made()
            fields.look_everywhere(ground)
            closed, looks = np.zeros((0, 0, 0), np.uint8), 0
            if thin:
                closed, looks = fields.closed_links(ground.room, frame, space.geometry)
            found = {"closed": closed, "looks": np.array([looks])}
            return {"distances": ground.distances, "room": ground.room, **found}

        key = f"{space.fingerprint()} {cells} {turns} {fine}"
        kept = prepared("wave 3", key, looked_at, lambda kept: _is_raster(kept, cells, turns, fine))
        workspace = _workspace(kept["distances"], cells)
        known = cls.known(frame, kept["room"], workspace, kept["distances"], body)
        return replace(
            known, closed=kept["closed"], link_looks=int(kept["looks"][0]), geometry=space.geometry
        )

    @classmethod
    def known(
        cls, frame: FloatArray, room: Field, workspace: Field, distances: Field, body: FloatArray
    ) -> PoseGrid:
        """A grid from an earlier look, without the geometry behind it."""
        room, distances = (np.require(array, np.float32, ["C", "W"]) for array in (room, distances))
        nothing, seen = np.zeros((0, 4)), np.ones((len(room), len(room)), np.bool_)
        ground = Ground(nothing, np.zeros(4), frame, distances, seen, body, np.zeros(1), room, seen)
        return cls(ground, workspace)

    @property
    def frame(self) -> FloatArray:
        """Where the cells lie (see `guided_gym.kernels.fields`); its goal is not set."""
        return self.ground.frame

    @property
    def room(self) -> Field:
        """(n, n, T) room of the robot in cells; NaN where nobody has looked."""
        return self.ground.room

    @property
    def side(self) -> float:
        """Side of the square (length)."""
        return float(self.frame[fields.CELL] * len(self.room))

    def towards(self, goal: FloatArray) -> FloatArray:
        """The frame with a goal in it."""
        frame = self.frame.copy()
        frame[fields.GOAL : fields.GOAL + goal.size] = goal
        return frame

    def beginnings(self, frame: FloatArray) -> Beginnings:
        """Where the wave begins.

        At poses near the goal from which the straight motion to it is free; if there is none, the likeliest.
        """
        places, poses, distances = fields.poses_near_goal(self.room.shape, frame, _NEAR_GOAL)
        goal = frame[fields.GOAL : fields.GOAL + (3 if self.room.shape[2] > 1 else 2)]
        ends = np.ascontiguousarray(poses[:, : goal.size])
        chosen = np.zeros(len(ends), np.bool_)
        if self.geometry is not None:
            chosen = collision.motions_free(np.repeat(goal[None], len(ends), axis=0), ends, self.geometry)
        if not chosen.any():
            fields.look_around(self.ground, places)
            spare = fields.spare_room(goal, ends, self.ground, frame, _SURE_PARTS)
            chosen = spare >= 0.0 if (spare >= 0.0).any() else spare == spare.max()
        return Beginnings(places[chosen], distances[chosen], len(places))


def _is_raster(kept: Arrays, cells: int, turns: int, fine: int) -> bool:
    """Whether arrays from a file have the types and shapes of those of a grid."""
    closed = (cells, cells, turns) if kept["closed"].size else (0, 0, 0)
    return (
        fits(kept["distances"], np.float32, cells * fine, cells * fine)
        and fits(kept["room"], np.float32, cells, cells, turns)
        and fits(kept["closed"], np.uint8, *closed)
        and fits(kept["looks"], np.int64, 1)
    )


def _workspace(distances: Field, cells: int) -> Field:
    """(n, n) distances at the middles of the cells."""
    fine = len(distances) // cells
    if fine == 1:
        return distances
    blocks = distances.reshape(cells, fine, cells, fine)[:, fine // 2 - 1 :, :, fine // 2 - 1 :]
    return np.asarray(blocks[:, :2, :, :2].mean(axis=(1, 3)))


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


class Arrivals(NamedTuple):
    """When a wave from the goal arrives at the poses of a grid; computed where it is asked for.

    Attributes:
        grid: The grid.
        frame: Where the cells lie, and the goal.
        seems: (n, n, T) above 0 where a pose seems free.
        front: The wave as far as it has run.
        floor: (p,) when it came at the latest before: it comes no earlier.
        sources: Where the wave begins.
        blocked: Whether something seemed blocked on the way from the start, when it was first asked for; None
            before.
    """

    grid: PoseGrid
    frame: FloatArray
    seems: Field
    front: Front
    floor: Field
    sources: Beginnings
    blocked: bool | None = None

    @property
    def looks(self) -> int:
        """How many motions have been checked for collision: those of links, and those to the goal."""
        return self.grid.link_looks + self.sources.looks

    def at(self, joined: fields.Joined) -> FloatArray:
        """(m,) cost-to-go of configurations that are joined to the grid."""
        return marching.values(self.front, self.grid.ground, self.floor, joined)

    def arrive(self, q: FloatArray) -> tuple[fields.Joined, FloatArray]:
        """How configurations (m, d) are joined to the grid, and their cost-to-go (m,)."""
        q = np.require(q, np.float64, ["C", "W"])
        geometry = self.grid.geometry
        assert geometry is not None
        where = self.grid.ground, self.floor, self.seems, self.frame
        return marching.arrive(self.front, *where, geometry, q)

    def join(self, q: FloatArray) -> fields.Joined:
        """How configurations (m, d) are joined to the grid."""
        q = np.require(q, np.float64, ["C", "W"])
        geometry = self.grid.geometry
        assert geometry is not None
        return fields.join(q, self.grid.ground, self.seems, self.frame, geometry)

    def inner(self, values: Field) -> Field:
        """(n, n, T) (p,) values without the border."""
        n, _, turns = self.grid.room.shape
        return values.reshape(n + 2, n + 2, turns)[1:-1, 1:-1]

    def everywhere(self) -> Field:
        """(n, n, T) the arrivals, as far as a pose that seems free; what is behind comes last."""
        front, ground = self.front, self.grid.ground
        fields.look_everywhere(ground)
        n = len(ground.room)
        wanted = marching.bordered(self.seems >= 0, False)
        marching.reach(front, ground, np.flatnonzero(wanted & (front.slow != np.inf)))
        taken = front.known[np.isfinite(front.known)]
        last = np.float32(taken.max() + n * self.frame[fields.CELL]) if taken.size else np.float32(np.inf)
        return self.inner(np.maximum(np.minimum(front.least, last), self.floor))

    def blocked_from(self, start: FloatArray) -> bool:
        """Whether something seems blocked on the way from a configuration (d,)."""
        self.arrive(start[None])
        known = self.inner(self.front.known)
        return bool(fields.blocked_on_way(start, known, self.seems, self.grid.closed, self.frame))


class WaveModel:
    """Which poses are free, by their room, and how long a wave from the goal takes to them.

    Args:
        cells: Cells along each side of the raster.
        headings: Headings of the grid.
        blocked: How many times slower the wave is at most, where a pose is surely blocked.
    """

    plans: bool = True  # whether there is a wave
    whole: bool = False  # whether it has to see the whole grid

    def __init__(self, cells: int, headings: int, blocked: float = 300.0) -> None:
        self.cells, self.headings, self.blocked = cells, headings, blocked
        self._kept: OrderedDict[bytes, Arrivals] = OrderedDict()
        self._grids: OrderedDict[tuple[str, int], PoseGrid] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": OrderedDict(), "_grids": OrderedDict()}

    def free(self, grid: PoseGrid) -> Field:
        """(n, n, T) logit of each pose being free, or what has its sign."""
        return grid.room

    def slowness(self, grid: PoseGrid) -> Field:
        """(n, n, T) 1/p: the expected number of tries; NaN where the room decides, if it is asked for."""
        return np.broadcast_to(np.float32(np.nan), grid.room.shape)

    def begin(self, grid: PoseGrid, goal: FloatArray, start: FloatArray | None = None) -> Arrivals:
        """A wave that has not run.

        Args:
            grid: The grid of poses.
            goal: (d,) where it begins.
            start: (d,) what it heads for; None for nothing, which is faster where it has to come everywhere.
        """
        slow = marching.bordered(self.slowness(grid), np.inf)
        frame = grid.towards(goal)
        sources, even = grid.beginnings(frame), np.ones_like(slow)
        front = self._begun(grid, frame, sources, start, slow, even, self.blocked)
        return Arrivals(grid, frame, self.free(grid), front, np.zeros_like(slow), sources)

    def slowed(self, before: Arrivals, start: FloatArray, slow: Field, effort: Field) -> Arrivals:
        """Another wave, over (p,) slower poses, that arrives nowhere earlier than the wave before."""
        known, slowest = before.front.known, max(self.blocked, _SLOWEST)
        floor = np.maximum(before.floor, np.where(known < np.inf, known, np.float32(0.0)))
        front = self._begun(before.grid, before.frame, before.sources, start, slow, effort, slowest)
        return before._replace(front=front, floor=floor)

    def _begun(
        self,
        grid: PoseGrid,
        frame: FloatArray,
        sources: Beginnings,
        start: FloatArray | None,
        slow: Field,
        effort: Field,
        slowest: float,
    ) -> Front:
        target = np.zeros(0) if start is None else np.append(start, 0.0)[:3]
        doors = marching.bordered(grid.closed, 0) if grid.closed.size else grid.closed.reshape(-1)
        limits, places, distances = (self.blocked, slowest), sources.places, sources.distances
        return marching.begin(slow, effort, grid.room.shape, doors, limits, places, distances, frame, target)

    def evaluate(self, grid: PoseGrid, goal: FloatArray) -> CostField:
        """The cost-to-go field for a goal."""
        return self.field(self.begin(grid, goal))

    def field(self, found: Arrivals) -> CostField:
        """The cost-to-go field of a wave."""
        arrival = self.arrival(found)
        values = self.corrected(found.grid, found.frame, arrival)
        return CostField.of(found.frame, found.seems > 0, values, arrival)

    def arrival(self, found: Arrivals) -> Field:
        """(n, n, T) when the wave from the goal arrives."""
        return found.everywhere()

    def corrected(self, grid: PoseGrid, frame: FloatArray, arrival: Field) -> Field:
        """(n, n, T) cost-to-go from the arrival: the arrival itself."""
        return arrival

    def solve(self, space: ConfigurationSpace, start: FloatArray, goal: FloatArray) -> Arrivals:
        """The wave for a start and a goal in a space, either of which may be in collision; kept for later.

        Where no way through what seems free leads to the start, a finer grid may see one: gaps narrower than
        a cell can seem blocked.
        """
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
            self._grids[key] = PoseGrid.of(space, cells, self.headings, self.whole)
            while len(self._grids) > _KEPT_GRIDS:
                self._grids.popitem(last=False)
        self._grids.move_to_end(key)
        return self._grids[key]

    def _solve(self, space: ConfigurationSpace, start: FloatArray, goal: FloatArray) -> Arrivals:
        cells = self.cells
        for finer in range(_FINER):
            found = self.begin(self._grid(space, cells), goal, start)
            if not self.plans:
                break
            found = found._replace(blocked=found.blocked_from(start))
            if finer == _FINER - 1 or not found.blocked:
                break
            cells = max(cells * 3 // 2 // 8 * 8, cells + 8)
            if not is_affordable(_grid_bytes(cells, self.headings)):
                break
        return found


class Burst(NamedTuple):
    """Samples that a kernel has drawn and written behind the last nodes and failures of a tree.

    Attributes:
        rows: (k, 2) selected node and new node of each; see `Search.extend_towards`.
        outcome: Of the last; see `guided_gym.kernels.extend.attempt`.
        looks: States that were looked up in the grid.
    """

    rows: NDArray[np.int32]
    outcome: int
    looks: int


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
    hopeless: bool  # the only ways from the start lead through what seems blocked, on the finest grid, too
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
        """Begin the wave for a query; see `CostToGo`.

        Raises:
            InvalidInputError: A space of other than 2 or 3 dimensions.
        """
        if query.space.dimension not in (2, 3):
            raise InvalidInputError(
                f"wave: expected a space of 2 or 3 dimensions, got {query.space.dimension} dimensions"
            )
        self._space, self._start = query.space, query.start
        # Now, and before anything was raised.
        self._now = self._first = self.model.solve(query.space, query.start, query.goal)
        self._slow, self._effort = self._now.front.slow, self._now.front.effort
        blocked = self._now.blocked
        self.hopeless = self._now.blocked_from(query.start) if blocked is None else blocked
        self.looks = self._now.looks
        self._forbidden = np.zeros((0, query.space.dimension)), np.zeros(0)  # states, and how far around them
        self._waiting = self._runs = 0  # raised since the last run, and runs since the beginning
        self._joined = self._now.join(query.start[None])  # of the nodes; spare rows included
        self._values = np.zeros(1)
        self._nodes = self._upheld = 0  # how many are joined, and how many of the values are up to date

    def __call__(self, states: FloatArray) -> FloatArray:
        """(n, d') states to (n,) cost-to-go (length); infinite in collision and where it is forbidden."""
        self._run_again()
        self._asked, self._heard = self._now.arrive(states)
        return self._allowed(states, self._heard)

    def _allowed(self, states: FloatArray, values: FloatArray) -> FloatArray:
        """(n,) values, infinite where states are forbidden."""
        centres, reaches = self._forbidden
        if reaches.size:
            values = values.copy()
            away = self._space.distance(states[:, None], centres)
            values[(away <= reaches).any(axis=1)] = np.inf
        return values

    @property
    def sees_way(self) -> bool:
        """Whether the way from the start runs only through what seems free, before anything is raised."""
        return not self._first.blocked_from(self._start)

    def plausible(self, node: int, lengths: FloatArray) -> NDArray[np.bool_]:
        """Which of the states asked for last can be reached from a node; see `wave_growth.plausible`.

        Args:
            node: The node, among those that `follow` has seen.
            lengths: (n,) length of the motion to each.
        """
        here = self._first.at(self._rows(node, node + 1))[0]
        there = self._heard if self._now is self._first else self._first.at(self._asked)
        return wave_growth.plausible(there, here, lengths)

    def grow(self, search: Search, terms: wave_growth.Terms, most: int) -> Burst | None:
        """Many samples of a search in one go, as this cost-to-go guides them; see `Composed.burst`."""
        tree, task, ground = search.tree, search.task, self._now.grid.ground
        tree.reserve(most)
        n, failed = len(tree), tree.failure_count
        self.follow(np.ascontiguousarray(tree.nodes.configurations[:n, : terms.leading]))
        if self._forbidden[1].size:
            return None
        self._reserve(n + most)
        geometry = self._now.grid.geometry
        assert geometry is not None
        first, now = self._first, self._now
        record = np.empty(most, np.int32), np.empty(most, np.int32)
        used, outcome, self._nodes, proposals = wave_growth.grow_by_wave(
            search.planner.rng,
            wave_growth.Waves(
                now.front, now.floor, first.front, first.floor, now is not first, ground, now.seems,
                now.frame, geometry,
            ),
            wave_growth.Known(self._joined, self._values),
            (n, failed, n),
            tree.nodes,
            tree.failed,
            terms,
            search.goal,
            wave_growth.Limits(search.planner.step, float(task.tolerance), task.by_edge),
            search.space.geometry,
            search.space.metric,
            record,
        )  # fmt: skip
        self._upheld = self._nodes
        return Burst(np.stack(record, axis=1)[:used], outcome, proposals * terms.candidates)

    def _reserve(self, count: int) -> None:
        """Have room for so many nodes."""
        if count > len(self._values):
            self._values = _longer(self._values, 2 * count)
            self._joined = fields.Joined(*(_longer(rows, 2 * count) for rows in self._joined))

    def _rows(self, first: int, last: int) -> fields.Joined:
        places, shares, lengths = self._joined
        return fields.Joined(places[first:last], shares[first:last], lengths[first:last])

    def follow(self, states: FloatArray) -> FloatArray:
        """(n,) cost-to-go of the nodes; all of them anew once the wave has run again."""
        self._run_again()
        n = len(states)
        self._reserve(n)
        if n > self._nodes:
            fresh, values = self._now.arrive(states[self._nodes : n])
            rows = self._rows(self._nodes, n)
            rows.places[:], rows.shares[:], rows.lengths[:] = fresh
            if self._upheld == self._nodes:
                self._values[self._upheld : n] = self._allowed(states[self._upheld : n], values)
                self._upheld = n
            self._nodes = n
        if n > self._upheld:
            values = self._now.at(self._rows(self._upheld, n))
            self._values[self._upheld : n] = self._allowed(states[self._upheld : n], values)
            self._upheld = n
        values = self._values[:n]
        values.flags.writeable = False
        return values

    def raise_near(self, state: FloatArray, reach: float, factor: float) -> None:
        """Make the poses within ``reach``, and the nearest in any case, ``factor`` times slower.

        Up to `_SLOWEST` times: a wave through what is slower yet would take for ever. An infinite factor
        forbids the states within reach, too, however near to other poses they are.
        """
        if self._slow is self._now.front.slow:
            self._slow, self._effort = self._slow.copy(), self._effort.copy()
        q = np.ascontiguousarray(state)
        for factors in (self._slow, self._effort):
            fields.multiply_near(self._first.inner(factors), q, self._first.frame, reach, factor)
            if np.isfinite(factor):
                np.minimum(factors, np.float32(_SLOWEST), out=factors, where=np.isfinite(factors))
        if not np.isfinite(factor):
            centres, reaches = self._forbidden
            self._forbidden = np.vstack([centres, q]), np.append(reaches, reach)
            self._upheld = 0
        self._waiting += 1

    def inspect(self, state: FloatArray, reach: float, valid: Valid) -> None:
        """Nothing: the grid's poses have been looked at."""

    def drawing(self, values: bool = True) -> dict[str, Any]:
        """What a figure shows: ``field`` (n, n), when the wave arrives, and its ``bounds``.

        At the best heading; infinite where none has room.
        """
        now, frame = self._now, self._now.frame
        arrival = now.everywhere()
        field = np.where(now.seems > 0, arrival, np.inf).min(axis=2).astype(np.float64)
        left, low = (float(frame[i] - frame[fields.CELL] / 2) for i in (fields.ORIGIN_X, fields.ORIGIN_Y))
        return {"field": field, "bounds": [left, low, left + now.grid.side, low + now.grid.side]}

    def _run_again(self) -> None:
        """Begin the wave again if costs have risen; over many poses only after some more of it each time."""
        flat = self._now.grid.room.shape[2] == 1
        if self._waiting <= (0 if flat else self._runs // _RUNS_A_RAISE):
            return
        self._now = self.model.slowed(self._now, self._start, self._slow, self._effort)
        self._slow, self._effort = self._now.front.slow, self._now.front.effort
        self._waiting, self._upheld = 0, 0
        self._runs += 1


def _longer(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """An array of so many rows that begins with these."""
    longer = np.zeros((count, *rows.shape[1:]), rows.dtype)
    longer[: len(rows)] = rows
    return longer


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
