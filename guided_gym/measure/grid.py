"""Distances to a goal over a grid of poses, in configuration spaces of two or three dimensions."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Final

import numpy as np
import numpy.typing as npt

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, NoPathError, StorageError
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import cost_grid as grid
from guided_gym.kernels.cost_query import OracleState, cost_to_go_many, cost_to_go_one
from guided_gym.kernels.eikonal import PAD, FieldArray, LinkArray, flood, improve, march
from guided_gym.measure.certified import divided, lengths_left, shortest_down
from guided_gym.measure.oracle_store import FieldStore
from guided_gym.measure.passages import Roadmap, passages
from guided_gym.measure.solution import Kept, OracleError, free_poses, warn_of
from guided_gym.options import OracleOptions

FloatArray = npt.NDArray[np.float64]

KIND = "grid"
SOLVER_VERSION = 4
"""Part of every cache key: raise it with any change that alters a field, its links or their layout."""

_FIRST = {2: 100_000, 3: 180_000}
"""Vertices of the first grid in a small workspace: some 30 and 50 ms on one core."""
_SIDE = {2: 320, 3: 64}
"""Vertices along the shorter side of the first grid in a small workspace."""
_LINK = 0.55
"""Links of the first grid are at most this part of the robot's radius, for one that turns."""
_FINEST = {2: 4, 3: 2}
"""How many times finer a grid may become for a start that is not connected."""
_DEEPEST = {2: 2, 3: 1}
"""Grids, each twice as fine as the one before, that are tried for a pose in a pocket."""
_SIGHT = 8
"""Links around the goal within which distances are made exact."""
_ASKED = (0.01, 0.05)
"""Error that is asked for unless another is: on average, and at the 99th percentile."""
_POSES = 400
"""Free poses at which two grids are compared."""
_TRUST = 0.7
"""Error of a grid as a part of its difference from one of half the resolution, see docs/oracle.md."""
_ROUNDS = 4
"""Waves after the first one, each of which may come through more narrow passages."""
_SHORTER = 0.003
"""Part of its length by which a path must be shorter than the field says to correct it."""
_LOOK_AHEAD = 6
"""Waypoints of a certified path, a link apart, that the vertices beside it are joined to."""
_GAIN = 0.005
"""Part of its cost-to-go by which a passage must bring a vertex nearer for another wave."""

_checked_grid: Final[dict[str, tuple[FieldArray, LinkArray]]] = {}
"""Field and links of the grid by which a path was last looked for, by its key: one or none."""


class GridSolution:
    """Distances to one goal on a grid fine enough for the problem; see `Solution`.

    A grid of poses over (x, y) or (x, y, theta), theta periodic, whose links are certified motions; the
    eikonal equation solved over it from exact values around the goal; certified ways through gaps that the
    grid may miss; interpolation between the vertices. The grid is refined until the error, estimated from a
    grid of half the resolution, is as small as the options ask, or their budget is spent.

    Args:
        space: Configuration space of dimension 2 or 3.
        goal: (d,) a valid configuration.
        start: (d,) a valid configuration, which has to be connected to the goal; None for none.
        options: Resolution, error asked for, budget.
        cache: Whether to use the disk cache.

    Raises:
        InvalidInputError: An unusable resolution.
        NoPathError: No path from start to goal, as far as the finest grid can tell.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        goal: FloatArray,
        start: FloatArray | None,
        options: OracleOptions,
        cache: bool,
    ) -> None:
        estimated = options.resolution is None
        self._begin(space, goal, start, options, cache, estimated)
        if estimated:
            self._refine()
        if start is not None:
            self._tighten(start)

    def _begin(
        self,
        space: ConfigurationSpace,
        goal: FloatArray,
        start: FloatArray | None,
        options: OracleOptions,
        cache: bool,
        estimated: bool,
    ) -> None:
        """Solve the first grid, and finer ones until the start is connected."""
        self.space, self.goal, self.options, self._cache = space, goal, options, cache
        fixed = options.resolution
        self._first = _first_resolution(space, options.budget) if fixed is None else _checked(space, fixed)
        self._refinement, self._depth = 1, 0
        self._error: OracleError | None = None
        self._solve(estimated)
        if start is not None:
            self._reach(start, estimated)

    @classmethod
    def check_path(
        cls, space: ConfigurationSpace, goal: FloatArray, start: FloatArray, options: OracleOptions
    ) -> None:
        """Raise the `NoPathError` that a solution with these options would raise; nothing is refined for it.

        The grid that tells is kept for the next solution, which mostly begins with it.
        """
        _checked_grid.clear()
        own = cls.__new__(cls)
        own._begin(space, goal, start, options, cache=True, estimated=False)
        _checked_grid[own._key()] = own.state[:2]

    def __repr__(self) -> str:
        return f"a grid of {' x '.join(map(str, self.resolution))} poses"

    def cost(self, q: FloatArray) -> float:
        """Distance to the goal of one configuration (d,)."""
        cost = cost_to_go_one(q, self.state)
        if cost == math.inf and self.space.valid(q) and self._finer is not None:
            return self._finer.cost(q)
        return float(cost)

    def costs(self, qs: FloatArray) -> FloatArray:
        """(n,) distances to the goal of configurations (n, d)."""
        costs = cost_to_go_many(qs, self.state)
        missing = np.isinf(costs)
        if missing.any():
            missing &= self.space.valid(qs)
            if missing.any() and self._finer is not None:
                costs[missing] = self._finer.costs(qs[missing])
        return costs

    def connects(self, q: FloatArray) -> bool:
        """Whether this grid joins a valid configuration to the goal; no finer one is tried."""
        return math.isfinite(cost_to_go_one(q, self.state))

    @property
    def field(self) -> npt.NDArray[np.float32]:
        """The solution at the vertices, shape `resolution`; infinite in collision and where not connected."""
        field, links, frame, _ = self.state
        shape = frame[grid.COUNT_X : grid.COUNT_X + 3].astype(int) + np.array([2 * PAD, 2 * PAD, 0])
        values = np.where(links & grid.VALID, field, np.float32(np.inf)).reshape(shape)[PAD:-PAD, PAD:-PAD]
        if self.space.dimension == 2:
            return values[..., 0]
        return np.roll(values, shape[2] // 2, axis=2)

    @property
    def axes(self) -> tuple[FloatArray, ...]:
        """The coordinates of the vertices along each axis of `field`, ascending."""
        frame = self.state[2]
        axes = [
            frame[grid.ORIGIN_X + a] + frame[grid.STEP_X + a] * np.arange(self.resolution[a]) for a in (0, 1)
        ]
        if self.space.dimension == 3:
            n = self.resolution[2]
            axes.append((np.arange(n) - n // 2) * frame[grid.STEP_THETA])
        return tuple(axes)

    @property
    def error(self) -> OracleError:
        """The estimated error; where the resolution was given, this solves half of it when first asked."""
        if self._error is None:
            self._error = self._compared()
        return self._error

    def kept(self) -> Kept:
        """The field and its links."""
        error = None if self._error is None else list(self._error)
        meta = {"version": SOLVER_VERSION, "resolution": list(self.resolution), "error": error}
        return Kept(KIND, meta, {"field": self.state[0], "links": self.state[1]})

    @classmethod
    def restored(
        cls, space: ConfigurationSpace, goal: FloatArray, options: OracleOptions, kept: Kept
    ) -> GridSolution:
        """A solution from what `kept` returned.

        Raises:
            StorageError: It is from another version of the solver, or does not fit the space.
        """
        if kept.meta["version"] != SOLVER_VERSION:
            raise StorageError(
                f"expected an oracle of solver version {SOLVER_VERSION}, got one of version "
                f"{kept.meta['version']}, from another version of guided-gym"
            )
        own = cls.__new__(cls)
        own.space, own.goal, own.options, own._cache = space, goal, options, True
        own._first = own.resolution = tuple(int(n) for n in kept.meta["resolution"])
        own._refinement, own._depth = 1, 0
        own._error = None if kept.meta["error"] is None else OracleError(*kept.meta["error"])
        if len(own.resolution) != space.dimension:
            raise StorageError(f"expected a grid of {space.dimension} axes, got one of {own.resolution}")
        frame = _frame(space, goal, own.resolution)
        nx, ny, nt = (int(n) for n in frame[grid.COUNT_X : grid.COUNT_X + 3])
        size, field, links = (nx + 2 * PAD) * (ny + 2 * PAD) * nt, kept.arrays["field"], kept.arrays["links"]
        right = field.dtype == np.float32 and links.dtype == np.uint8
        if not right or field.shape != (size,) or links.shape != (size,):
            raise StorageError(
                f"expected a field of {size} vertices, got {field.dtype} of {field.shape} and "
                f"{links.dtype} of {links.shape}"
            )
        own.state = (field, links, frame, space.geometry)
        return own

    def _solve(self, estimated: bool, before: OracleState | None = None) -> None:
        """Solve at the present refinement, or load what an earlier process solved; see `_compared`."""
        self.resolution = tuple(n * self._refinement for n in self._first)
        frame = _frame(self.space, self.goal, self.resolution)
        nx, ny, nt = (int(n) for n in frame[grid.COUNT_X : grid.COUNT_X + 3])
        store = FieldStore.default() if self._cache else FieldStore(None)
        key, size = self._key(), (nx + 2 * PAD) * (ny + 2 * PAD) * nt
        stored = store.load(key, size)
        if stored is None and (checked := _checked_grid.pop(key, None)) is not None:
            stored = (*checked, (math.nan, math.nan))
        self.__dict__.pop("_finer", None)
        if stored is not None:
            self.state: OracleState = (*stored[:2], frame, self.space.geometry)
            mean, tail = stored[2]
            self._error = None if math.isnan(mean) else OracleError(mean, tail)
            if self._error is not None or not estimated:
                return
        else:
            self.state = _solved(self.space, frame)
        self._error = self._compared(before) if estimated else None
        if self._error is None:
            store.save(key, *self.state[:2])
        else:
            store.save(key, *self.state[:2], self._error)

    def _compared(self, before: OracleState | None = None) -> OracleError:
        """The error, by how far a grid of half the resolution is from this one at some poses.

        Poses that the coarser grid does not reach tell nothing and are left out. The grid solved before this
        one, if there is any, may be that coarser one.
        """
        poses = free_poses(self.space, np.random.default_rng(0), _POSES)
        coarse = tuple(max(4, (n + 1) // 2) for n in self.resolution)
        if coarse == self.resolution or not len(poses):
            return OracleError(0.0, 0.0) if not len(poses) else OracleError(1.0, 1.0)
        ours = cost_to_go_many(poses, self.state)
        frame = _frame(self.space, self.goal, coarse)
        if before is None or not np.array_equal(before[2], frame):
            before = _solved(self.space, frame)
        theirs = cost_to_go_many(poses, before)
        known = np.isfinite(ours) & np.isfinite(theirs) & (ours > 0.0)
        if not known.any():
            return OracleError(1.0, 1.0) if np.isfinite(ours).any() else OracleError(0.0, 0.0)
        # Beside the goal distances are exact, and relative ones mean little.
        apart = _TRUST * np.abs(theirs[known] - ours[known]) / ours[known]
        return OracleError(float(apart.mean()), float(np.quantile(apart, 0.99)))

    def _excess(self) -> float:
        """How many times larger the error is than asked for."""
        return self.options.excess(self.error, _ASKED)

    def _refine(self) -> None:
        """Refine the grid until the error is as small as asked for, or the budget is spent: then warn."""
        while (excess := self._excess()) > 1.0:
            finer = _scaled(self.resolution, min(max(1.1 * excess, 1.4), 2.0), self.options.budget)
            if finer is None:
                warn_of(self.error, f"on {self!r}", self.options.budget)
                return
            self._first, self._refinement = finer, 1
            self._solve(estimated=True, before=self.state)

    def _key(self) -> str:
        digest = hashlib.sha256(
            f"oracle {SOLVER_VERSION} {self.space.fingerprint()} {self.resolution}\n".encode()
        )
        digest.update(self.goal.astype("<f8").tobytes())
        return digest.hexdigest()

    def _reach(self, start: FloatArray, estimated: bool) -> None:
        """Refine the grid until the start is connected.

        Raises:
            NoPathError: Not even the finest grid connects it.
        """
        while math.isinf(cost_to_go_one(start, self.state)):
            if not self._may_double():
                raise NoPathError(
                    f"no path from start {start.tolist()} to goal {self.goal.tolist()}: none found at "
                    f"spacing {self._spacing():.3g} ({self!r}); one may exist "
                    "through a narrower passage: raise the resolution (OracleOptions)"
                )
            self._refinement *= 2
            self._solve(estimated, before=self.state)

    def _may_double(self) -> bool:
        vertices = math.prod(self.resolution) * 2**self.space.dimension
        return self._refinement < _FINEST[self.space.dimension] and vertices <= self.options.budget

    def _tighten(self, start: FloatArray) -> None:
        """Find a path from the start; if it is shorter than the field says, correct the field along it."""
        space, state = self.space, self.state
        frame = state[2]
        link = float((frame[grid.STEP_X : grid.STEP_X + space.dimension] * space.weights).max())
        gaps = lru_cache(1)(partial(passages, space, *_narrow(space, frame)))
        path = shortest_down(space, state, start, self.goal, link, partial(_stops, space, frame, gaps))
        if path is None or lengths_left(space, path)[0] > (1.0 - _SHORTER) * cost_to_go_one(start, state):
            return
        path = divided(space, path, link)
        field = state[0].copy()  # what was loaded is not ours to change
        work = _Grid(frame, state[1])
        numbers, vertices, lengths = _attached(space, work, path, _LOOK_AHEAD)
        _offer(work, field, vertices, lengths_left(space, path)[numbers] + lengths)
        self.state = (field, *state[1:])

    def _spacing(self) -> float:
        return float(self.state[2][grid.STEP_X : grid.STEP_X + 2].max())

    @cached_property
    def _finer(self) -> GridSolution | None:
        """The same on a finer grid, for valid poses in pockets that this grid does not reach."""
        resolution = _scaled(self.resolution, 2.0, self.options.budget)
        if resolution is None or self._depth >= _DEEPEST[self.space.dimension]:
            return None
        finer = GridSolution.__new__(GridSolution)
        finer.space, finer.goal, finer._cache, finer._first = self.space, self.goal, self._cache, resolution
        finer.options, finer._refinement, finer._depth = self.options, 1, self._depth + 1
        finer._solve(estimated=False)
        return finer


@dataclass(frozen=True, eq=False)
class _Grid:
    """A grid with its certified links, before a wave has run over it."""

    frame: FloatArray
    links: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, space: ConfigurationSpace, frame: FloatArray) -> _Grid:
        """The grid of a space."""
        links, denied = grid.draw_obstacles(space.geometry, frame)
        claims = grid.certify_links(space.geometry, frame, links, denied)
        grid.round_boundary(frame, links, claims, np.flatnonzero(claims))
        return cls(frame, links)

    @property
    def layout(self) -> tuple[int, int]:
        """Number of vertices in a column, and of angles."""
        nt = int(self.frame[grid.COUNT_THETA])
        return (int(self.frame[grid.COUNT_Y]) + 2 * PAD) * nt, nt

    @property
    def spacing(self) -> FloatArray:
        """(3,) lengths of a link along each axis."""
        lengths: FloatArray = self.frame[grid.STEP_X : grid.STEP_X + 3] * [1.0, 1.0, self.frame[grid.WEIGHT]]
        return lengths


def _narrow(space: ConfigurationSpace, frame: FloatArray) -> tuple[float, float]:
    """What `passages` asks of robot and grid: the inradius, and the spacing."""
    return float(grid.inradius(space.geometry)), float(frame[grid.STEP_X : grid.STEP_X + 2].max())


def _lattice(frame: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray]:
    """(d,) the first vertex of a grid, and (d,) the way to the next one along each axis."""
    return np.append(frame[:2], 0.0)[:dimension], frame[grid.STEP_X : grid.STEP_X + dimension]


def _stops(
    space: ConfigurationSpace, frame: FloatArray, gaps: Callable[[], Roadmap], q: FloatArray
) -> FloatArray:
    """Where the field comes from around a pose: the vertices beside it, and the poses in narrow passages.

    Args:
        space: The configuration space.
        frame: The grid.
        gaps: Gives the latter; few descents ask for them.
        q: (d,) the pose.
    """
    d = space.dimension
    origin, step = _lattice(frame, d)
    beside = np.stack(np.meshgrid(*[np.arange(-1, 3)] * d), axis=-1).reshape(-1, d)
    return np.concatenate([origin + (np.floor((q - origin) / step) + beside) * step, gaps().nodes])


def _solved(space: ConfigurationSpace, frame: FloatArray) -> OracleState:
    """The field over a grid, with what comes through narrow passages."""
    work = _Grid.of(space, frame)
    seeds, values = grid.seed_goal(space.geometry, frame, work.links)
    field = march(work.links, *work.layout, work.spacing, seeds, values)
    roadmap = passages(space, *_narrow(space, frame))
    if not len(roadmap.nodes):
        return field, work.links, frame, space.geometry
    nodes, vertices, lengths = _attached(space, work, roadmap.nodes)
    for _ in range(_ROUNDS):
        known = np.full(len(roadmap.nodes), np.inf)
        np.minimum.at(known, nodes, field[vertices] + lengths)
        offered = roadmap.spread(known)[nodes] + lengths
        gained = offered < field[vertices] * (1.0 - _GAIN)
        if not gained.any():
            break
        _offer(work, field, vertices[gained], offered[gained])
    return field, work.links, frame, space.geometry


def _offer(
    work: _Grid, field: npt.NDArray[np.float32], vertices: npt.NDArray[np.int64], values: FloatArray
) -> None:
    """Have vertices, each of which may be named often, take the least of the values if that is less."""
    order = np.lexsort((values, vertices))
    chances, first = np.unique(vertices[order], return_index=True)
    improve(work.links, *work.layout, work.spacing, field, chances, values[order[first]])


def _attached(
    space: ConfigurationSpace, work: _Grid, poses: FloatArray, ahead: int = 0
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], FloatArray]:
    """Certified motions between poses (n, d) and the vertices of their cells: numbers of both, lengths.

    With ``ahead``, also between each of so many poses that follow and the vertices of a pose's cell.
    """
    d, frame = space.dimension, work.frame
    stride, nt = work.layout
    origin, step = _lattice(frame, d)
    counts = frame[grid.COUNT_X : grid.COUNT_X + d].astype(np.int64)
    corners = np.array(np.meshgrid(*[[0, 1]] * d, indexing="ij")).reshape(d, -1).T
    cells = (np.floor((poses - origin) / step).astype(np.int64)[:, None] + corners).reshape(-1, d)
    if d == 3:
        cells[:, 2] %= nt
    number = np.repeat(np.arange(len(poses)), len(corners))
    inside = ((cells >= 0) & (cells < counts)).all(axis=1)
    vertices = (cells[:, 0] + PAD) * stride + (cells[:, 1] + PAD) * nt + (cells[:, 2] if d == 3 else 0)
    inside[inside] = (work.links[vertices[inside]] & grid.VALID) > 0
    number, vertices, cells = number[inside], vertices[inside], cells[inside]
    ends = space.wrap(origin + cells * step)
    if ahead:
        number = (number[:, None] + np.arange(ahead + 1)).ravel()
        vertices, ends = np.repeat(vertices, ahead + 1), np.repeat(ends, ahead + 1, axis=0)
        there = number < len(poses)
        number, vertices, ends = number[there], vertices[there], ends[there]
    free = np.asarray(space.motions_free(poses[number], ends))
    number, vertices, ends = number[free], vertices[free], ends[free]
    return number, vertices, np.atleast_1d(space.distance(poses[number], ends))


def grid_joins(
    space: ConfigurationSpace, start: FloatArray, goal: FloatArray, resolution: tuple[int, ...]
) -> bool:
    """Whether a plain grid joins two free poses: looks only at its certified links, and runs no wave.

    Distributions that keep only problems with a path decide by it, so that their problems stay the same
    whatever becomes of the oracle.
    """
    frame = _frame(space, goal, resolution)
    work = _Grid.of(space, frame)
    seeds, _ = grid.seed_goal(space.geometry, frame, work.links)
    field = flood(work.links, *work.layout, seeds)
    return math.isfinite(cost_to_go_one(start, (field, work.links, frame, space.geometry)))


def _scaled(resolution: tuple[int, ...], factor: float, budget: int) -> tuple[int, ...] | None:
    """The resolution times a factor, or as much of it as the budget allows; None for less than 1.15 times."""
    factor = min(factor, (budget / math.prod(resolution)) ** (1.0 / len(resolution)))
    if factor < 1.15:
        return None
    finer = [int(n * factor) for n in resolution]
    if len(finer) == 3:
        finer[2] = max(resolution[2], 4 * (finer[2] // 4))
    return tuple(finer)


def _frame(space: ConfigurationSpace, goal: FloatArray, resolution: tuple[int, ...]) -> FloatArray:
    """Where the vertices lie: as close to the bounds as the robot's reference point can come."""
    frame = np.zeros(grid.FRAME)
    low, high = space.lower[:2].copy(), space.upper[:2].copy()
    inset = grid.inradius(space.geometry) + 2.0 * space.geometry[0][1]
    if (high - low > 4.0 * inset).all():
        low, high = low + inset, high - inset
    counts = [*resolution, 1][:3]
    frame[grid.ORIGIN_X : grid.ORIGIN_X + 2] = low
    frame[grid.STEP_X : grid.STEP_X + 2] = (high - low) / (np.array(counts[:2]) - 1)
    frame[grid.STEP_THETA] = 2.0 * math.pi / counts[2]
    frame[grid.COUNT_X : grid.COUNT_X + 3] = counts
    frame[grid.GOAL : grid.GOAL + goal.size] = goal
    frame[grid.WEIGHT] = space.weights[2] if space.dimension == 3 else 1.0
    links = frame[grid.STEP_X : grid.STEP_X + space.dimension] * space.weights
    frame[grid.SIGHT] = _SIGHT * float(links.max())
    return frame


def _checked(space: ConfigurationSpace, resolution: Sequence[int]) -> tuple[int, ...]:
    counts = tuple(int(n) for n in resolution)
    if len(counts) != space.dimension or min(counts) < 4:
        raise InvalidInputError(
            f"expected {space.dimension} vertex counts of at least 4 each as resolution, "
            f"got {shown(resolution)}"
        )
    return counts


def _first_resolution(space: ConfigurationSpace, budget: int) -> tuple[int, ...]:
    """Square cells, and angles a little finer: what is hard to pass is mostly a matter of turning.

    A small workspace gets a certain number of vertices; a large one, links that are small beside the robot.
    """
    sides = space.upper[:2] - space.lower[:2]
    step, most = float(sides.min()) / _SIDE[space.dimension], _FIRST[space.dimension]
    if space.dimension == 3 and step > _LINK * space.robot.radius:
        step, most = _LINK * space.robot.radius, budget
    while True:
        counts = [max(4, math.ceil(side / step)) for side in sides]
        if space.dimension == 3:
            angles = 2.0 * math.pi * space.robot.radius / (0.7 * step)
            counts.append(4 * min(max(math.ceil(angles / 4.0), 6), 16))
        if math.prod(counts) <= min(most, budget):
            return tuple(counts)
        step *= 1.02
