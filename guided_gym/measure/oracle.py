"""The oracle: true shortest-path distances d_C in configuration spaces of up to three dimensions.

Nothing but the oracle guidance and the metric may use it (paper, section "Evaluation metric").
"""

from __future__ import annotations

import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import cost_grid as grid
from guided_gym.kernels.cost_query import OracleState, cost_to_go_many, cost_to_go_one
from guided_gym.kernels.eikonal import PAD, march
from guided_gym.measure.oracle_store import FieldStore

FloatArray = npt.NDArray[np.float64]
Configurations = FloatArray | Sequence[float] | Sequence[Sequence[float]]

SOLVER_VERSION = 2
"""Part of every cache key: raise it with any change that alters a field, its links or their layout."""

_BUDGET = {2: 100_000, 3: 180_000}
"""Vertices of the default grid: some 30 and 70 ms on one core."""
_FINEST = {2: 4, 3: 2}
"""How many times finer than the first grid a search for a path may become before a problem is refused."""
_SIGHT = 8
"""Links around the goal within which distances are made exact."""
_REMEMBERED = 32
"""Oracles that `oracle_for` keeps in memory."""


class Oracle:
    """Shortest-path distances to one goal, d_C(q, t), from one solve on a grid.

    A grid of poses over (x, y) or (x, y, theta), theta periodic, whose links are certified motions; the
    eikonal equation solved over it from exact values around the goal; interpolation between the vertices.
    Nothing leaks through walls, however thin. Distances are in the metric of the space (length), relative
    errors typically below 1 % (see benchmarks/oracle.py).

    Attributes:
        space: The configuration space.
        goal: (d,) the goal t, read-only.
        resolution: (d,) vertices along each axis.
        state: What `guided_gym.kernels.cost_query.cost_to_go_one` takes, for compiled callers.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        goal: Configurations,
        *,
        start: Configurations | None = None,
        resolution: Sequence[int] | None = None,
        cache: bool = True,
    ) -> None:
        """Solve, or load an earlier solution from the disk cache.

        Args:
            space: Configuration space of dimension 2 or 3.
            goal: (d,) a valid configuration.
            start: (d,) a valid configuration; if it is not connected to the goal on the first grid, finer
            ones are
                tried (up to 4 times finer in two dimensions, twice in three).
            resolution: Vertices along each axis of the first grid; by default what takes well under 100 ms.
            cache: Whether to use the disk cache (`guided_gym.measure.oracle_store`).

        Raises:
            InvalidInputError: A dimension above 3, a goal or start that is not valid, or an unusable
            resolution. NoPathError: No path from start to goal, as far as the finest grid can tell.
        """
        if space.dimension not in _BUDGET:
            raise InvalidInputError(
                f"the oracle's grid covers spaces of 2 or 3 dimensions, got one of {space.dimension}"
            )
        self.space = space
        self.goal = _valid_configuration(space, goal, "goal")
        self._cache = cache
        self._first = _checked_resolution(space, resolution)
        self._refinement = 1
        self._solve()
        if start is not None:
            self._reach(_valid_configuration(space, start, "start"))

    def __repr__(self) -> str:
        return f"Oracle({self.space!r}, goal={self.goal.tolist()}, resolution={self.resolution})"

    def cost_to_go(self, q: Configurations) -> FloatArray | float:
        """Distance d_C(q, t) of valid configurations: (n, d) -> (n,) float64, one (d,) -> float.

        Infinite where no path to the goal is known, and for poses that are found to be in collision.

        Raises:
            InvalidInputError: q has another shape.
        """
        qs = q
        if not (type(qs) is np.ndarray and qs.dtype == np.float64 and qs.flags.carray):
            qs = np.require(q, dtype=np.float64, requirements=["C", "W"])
        if qs.ndim not in (1, 2) or qs.shape[-1] != self.space.dimension:
            raise InvalidInputError(
                f"expected configurations of shape ({self.space.dimension},) or (n, {self.space.dimension}), "
                f"got shape {qs.shape}"
            )
        if qs.ndim == 1:
            cost = cost_to_go_one(qs, self.state)
            if cost == math.inf and self.space.valid(qs) and self._finer is not None:
                return self._finer.cost_to_go(qs)
            return float(cost)
        costs = cost_to_go_many(qs, self.state)
        missing = np.isinf(costs)
        if missing.any():
            missing &= self.space.valid(qs)
            if missing.any() and self._finer is not None:
                costs[missing] = self._finer.cost_to_go(qs[missing])
        return costs

    def connects(self, q: Configurations) -> bool:
        """Whether this grid joins the configuration q to the goal; no finer one is tried.

        Raises:
            InvalidInputError: q is not valid.
        """
        return math.isfinite(cost_to_go_one(_valid_configuration(self.space, q, "configuration"), self.state))

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

    def _solve(self) -> None:
        """Solve at the present refinement, or load what an earlier process solved."""
        factor = self._refinement
        self.resolution = tuple(n * factor for n in self._first)
        frame = _frame(self.space, self.goal, self.resolution)
        nx, ny, nt = (int(n) for n in frame[grid.COUNT_X : grid.COUNT_X + 3])
        store = FieldStore.default() if self._cache else FieldStore(None)
        key = self._key()
        stored = store.load(key, (nx + 2 * PAD) * (ny + 2 * PAD) * nt)
        if stored is None:
            stored = _solved(self.space, frame)
            store.save(key, *stored)
        self.state: OracleState = (*stored, frame, self.space.geometry)

    def _key(self) -> str:
        digest = hashlib.sha256(
            f"oracle {SOLVER_VERSION} {self.space.fingerprint()} {self.resolution}\n".encode()
        )
        digest.update(self.goal.astype("<f8").tobytes())
        return digest.hexdigest()

    def _reach(self, start: FloatArray) -> None:
        """Refine the grid until the start is connected.

        Raises:
            NoPathError: Not even the finest grid connects it.
        """
        while math.isinf(cost_to_go_one(start, self.state)):
            if self._refinement >= _FINEST[self.space.dimension]:
                raise NoPathError(
                    f"no path from start {start.tolist()} to goal {self.goal.tolist()}: not connected on "
                    f"a grid of {' x '.join(map(str, self.resolution))} poses, spacing {self._spacing():.3g}"
                )
            self._refinement *= 2
            self._solve()

    def _spacing(self) -> float:
        return float(self.state[2][grid.STEP_X : grid.STEP_X + 2].max())

    @cached_property
    def _finer(self) -> Oracle | None:
        """The same oracle on a finer grid, for valid poses in pockets that this grid does not reach."""
        if self._refinement >= _FINEST[self.space.dimension]:
            return None
        finer = Oracle.__new__(Oracle)
        finer.space, finer.goal, finer._cache, finer._first = self.space, self.goal, self._cache, self._first
        finer._refinement = self._refinement * 2
        finer._solve()
        return finer


def _solved(
    space: ConfigurationSpace, frame: FloatArray
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
    links, denied = grid.draw_obstacles(space.geometry, frame)
    claims = grid.certify_links(space.geometry, frame, links, denied)
    grid.round_boundary(frame, links, claims, np.flatnonzero(claims))
    seeds, values = grid.seed_goal(space.geometry, frame, links)
    nt = int(frame[grid.COUNT_THETA])
    spacing = frame[grid.STEP_X : grid.STEP_X + 3] * [1.0, 1.0, frame[grid.WEIGHT]]
    stride = (int(frame[grid.COUNT_Y]) + 2 * PAD) * nt
    return march(links, stride, nt, spacing, seeds, values), links


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


def _checked_resolution(space: ConfigurationSpace, resolution: Sequence[int] | None) -> tuple[int, ...]:
    if resolution is None:
        return _default_resolution(space)
    counts = tuple(int(n) for n in resolution)
    if len(counts) != space.dimension or min(counts) < 4:
        raise InvalidInputError(
            f"expected {space.dimension} vertex counts of at least 4 each as resolution, got {resolution!r}"
        )
    return counts


def _default_resolution(space: ConfigurationSpace) -> tuple[int, ...]:
    """Square cells, and angles a little finer: what is hard to pass is mostly a matter of turning."""
    sides = space.upper[:2] - space.lower[:2]
    step = float(sides.min()) / (64 if space.dimension == 3 else 320)
    while True:
        counts = [max(4, math.ceil(side / step)) for side in sides]
        if space.dimension == 3:
            angles = 2.0 * math.pi * space.robot.radius / (0.7 * step)
            counts.append(4 * min(max(math.ceil(angles / 4.0), 6), 16))
        if math.prod(counts) <= _BUDGET[space.dimension]:
            return tuple(counts)
        step *= 1.02


def _valid_configuration(space: ConfigurationSpace, q: Configurations, what: str) -> FloatArray:
    pose = np.array(q, dtype=np.float64)
    if pose.shape != (space.dimension,):
        raise InvalidInputError(f"expected a {what} of shape ({space.dimension},), got shape {pose.shape}")
    if not space.valid(pose):
        raise InvalidInputError(
            f"the {what} {pose.tolist()} is not a valid configuration: in collision or out of bounds"
        )
    return pose


_lock = threading.Lock()
_remembered: OrderedDict[tuple[str, bytes, bytes | None], Oracle] = OrderedDict()


def oracle_for(
    space: ConfigurationSpace, goal: Configurations, start: Configurations | None = None
) -> Oracle:
    """The oracle for a goal: from memory, else from the disk cache, else solved.

    Raises:
        InvalidInputError: As `Oracle`.
        NoPathError: As `Oracle`, if a start is given.
    """
    key = _memory_key(space, goal, start)
    with _lock:
        if key in _remembered:
            _remembered.move_to_end(key)
            return _remembered[key]
    oracle = Oracle(space, goal, start=start)
    remember(oracle, start)
    return oracle


def remember(oracle: Oracle, start: Configurations | None = None) -> None:
    """Have `oracle_for` find this oracle in memory, for its goal and a start that it connects.

    For oracles that were solved elsewhere, like in another process; the least recently used are forgotten.
    """
    with _lock:
        _remembered[_memory_key(oracle.space, oracle.goal, start)] = oracle
        while len(_remembered) > _REMEMBERED:
            _remembered.popitem(last=False)


def _memory_key(
    space: ConfigurationSpace, goal: Configurations, start: Configurations | None
) -> tuple[str, bytes, bytes | None]:
    return (
        space.fingerprint(),
        np.asarray(goal, dtype=np.float64).tobytes(),
        None if start is None else np.asarray(start, dtype=np.float64).tobytes(),
    )
