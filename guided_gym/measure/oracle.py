"""The oracle: true shortest-path distances d_C, over a grid of up to three dimensions or over a roadmap.

Nothing but the oracle guidance and the metric may use it (paper, section "Evaluation metric").
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.robots import Robot, rigid
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.cost_query import OracleState
from guided_gym.measure import grid, roadmap
from guided_gym.measure.grid import GridSolution
from guided_gym.measure.roadmap import RoadmapSolution
from guided_gym.measure.solution import (
    Configurations,
    FloatArray,
    Kept,
    OracleError,
    Solution,
    valid_configuration,
)
from guided_gym.options import DEFAULT_ORACLE, OracleOptions

_REMEMBERED = 32
"""Oracles that `oracle_for` keeps in memory."""
_VERTICES = 5_000_000
"""Vertices that these may have together: 25 MB of grids, however fine each is."""
_JOINED = 4096
"""Tasks that `check_path` remembers to have a path."""

_KINDS: Final[dict[str, type[GridSolution] | type[RoadmapSolution]]] = {
    grid.KIND: GridSolution,
    roadmap.KIND: RoadmapSolution,
}


@doors
class Oracle:
    """Shortest-path distances to one goal, d_C(q, t), as exact as its options ask or its budget allows.

    A grid covers rigid planar robots (`guided_gym.measure.grid`), and a roadmap all others
    (`guided_gym.measure.roadmap`). Motions are certified, so nothing leaks through walls, however thin.
    Distances are in the metric of the space (length).

    Attributes:
        space: The configuration space.
        goal: (d,) the goal t.
        options: Method, resolution, the error that is asked for, and budget.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        goal: Configurations,
        *,
        start: Configurations | None = None,
        resolution: Sequence[int] | None = None,
        options: OracleOptions | None = None,
        cache: bool = True,
    ) -> None:
        """Solve, or load an earlier solution from the disk cache.

        Args:
            space: The configuration space.
            goal: (d,) a valid configuration.
            start: (d,) a valid configuration; if it is not connected to the goal, finer grids are tried (up
                to 4 times finer in two dimensions, twice in three), or larger roadmaps, within the budget.
            resolution: Vertices along each axis of the grid, or of the roadmap, instead of what the options
                say.
            options: Method, resolution, error asked for, budget; the default ones if None.
            cache: Whether to use the disk cache (`guided_gym.measure.oracle_store`).

        Raises:
            InvalidInputError: A grid for a robot with joints, a goal or start that is not valid, or an
                unusable resolution.
            NoPathError: No path from start to goal, as far as the finest grid or largest roadmap can tell.
        """
        self.space = space
        self.options = DEFAULT_ORACLE if options is None else options
        method = self.options.method or (grid.KIND if isinstance(space.robot, Robot) else roadmap.KIND)
        if method == grid.KIND:
            rigid(space.robot, "the oracle's grid")
        self.goal = valid_configuration(space, goal, "goal")
        begin = None if start is None else valid_configuration(space, start, "start")
        asked = self.options if resolution is None else replace(self.options, resolution=tuple(resolution))
        self._solution: Solution = _KINDS[method](space, self.goal, begin, asked, cache)

    def __repr__(self) -> str:
        return f"Oracle({self.space!r}, goal={self.goal.tolist()}, resolution={self.resolution})"

    def kept(self) -> Kept:
        """What a file keeps of the oracle, for `restored`."""
        return self._solution.kept()

    @classmethod
    def restored(
        cls, space: ConfigurationSpace, goal: FloatArray, kept: Kept, options: OracleOptions | None = None
    ) -> Oracle:
        """An oracle made of what `kept` returned. Nothing is solved if the distances are in it.

        Raises:
            StorageError: Its kind is not known, or it comes from another version of the solver or another
                space.
        """
        if kept.kind not in _KINDS:
            raise StorageError(f"expected an oracle over a {' or '.join(_KINDS)}, got one over a {kept.kind}")
        oracle = cls.__new__(cls)
        oracle.space, oracle.goal = space, np.array(goal, np.float64)
        oracle.options = DEFAULT_ORACLE if options is None else options
        oracle._solution = _KINDS[kept.kind].restored(space, oracle.goal, oracle.options, kept)
        return oracle

    @property
    def resolution(self) -> tuple[int, ...]:
        """(d,) vertices along each axis of a grid; (1,) vertices of a roadmap."""
        return self._solution.resolution

    @property
    def state(self) -> OracleState:
        """What `guided_gym.kernels.cost_query.cost_to_go_one` takes, for compiled callers.

        Without a grid it knows no way from anywhere: such callers then ask `cost_to_go`.
        """
        return self._solution.state

    @property
    def error(self) -> OracleError:
        """The estimated error. If the resolution was given, this first solves something coarser."""
        return self._solution.error

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
        return self._solution.cost(qs) if qs.ndim == 1 else self._solution.costs(qs)

    def connects(self, q: Configurations) -> bool:
        """Whether this grid or roadmap joins the configuration q to the goal; no finer one is tried.

        Raises:
            InvalidInputError: q is not valid.
        """
        return self._solution.connects(valid_configuration(self.space, q, "configuration"))

    @property
    def field(self) -> npt.NDArray[np.float32]:
        """The solution at the vertices of a grid; see `GridSolution.field`.

        Raises:
            InvalidInputError: There is no grid.
        """
        return self._grid.field

    @property
    def axes(self) -> tuple[FloatArray, ...]:
        """The coordinates of the vertices along each axis of `field`, ascending.

        Raises:
            InvalidInputError: There is no grid.
        """
        return self._grid.axes

    @property
    def _grid(self) -> GridSolution:
        if not isinstance(self._solution, GridSolution):
            raise InvalidInputError(f"expected an oracle over a grid, got one over {self._solution!r}")
        return self._solution


_lock = threading.Lock()
_remembered: OrderedDict[tuple[object, ...], Oracle] = OrderedDict()
_joined: OrderedDict[tuple[object, ...], None] = OrderedDict()


def oracle_for(
    space: ConfigurationSpace,
    goal: Configurations,
    start: Configurations | None = None,
    options: OracleOptions | None = None,
) -> Oracle:
    """The oracle for a goal: from memory, else from the disk cache, else solved.

    Raises:
        InvalidInputError: As `Oracle`.
        NoPathError: As `Oracle`, if a start is given.
    """
    key = _memory_key(space, goal, start, options)
    with _lock:
        if key in _remembered:
            _remembered.move_to_end(key)
            return _remembered[key]
    oracle = Oracle(space, goal, start=start, options=options)
    remember(oracle, start)
    return oracle


def check_path(space: ConfigurationSpace, goal: Configurations, start: Configurations) -> None:
    """Refuse a task that has no path, as `oracle_for` with its default options does, in less time.

    For rigid planar robots: what refines an oracle for its error alone is not done. An oracle that is asked
    for next begins with what was solved.

    Raises:
        InvalidInputError: As `Oracle`.
        NoPathError: As `Oracle`.
    """
    key = _memory_key(space, goal, start, None)
    with _lock:
        if key in _remembered or key in _joined:
            return
    begin, end = valid_configuration(space, start, "start"), valid_configuration(space, goal, "goal")
    GridSolution.check_path(space, end, begin, DEFAULT_ORACLE)
    with _lock:
        _joined[key] = None
        while len(_joined) > _JOINED:
            _joined.popitem(last=False)


def remember(oracle: Oracle, start: Configurations | None = None) -> None:
    """Have `oracle_for` find this oracle in memory, for its goal, its options and a start that it connects.

    For oracles that were solved elsewhere, like in another process; the least recently used are forgotten.
    The latest stays, whatever its size.
    """
    with _lock:
        _remembered[_memory_key(oracle.space, oracle.goal, start, oracle.options)] = oracle
        vertices = sum(math.prod(kept.resolution) for kept in _remembered.values())
        while len(_remembered) > 1 and (len(_remembered) > _REMEMBERED or vertices > _VERTICES):
            vertices -= math.prod(_remembered.popitem(last=False)[1].resolution)


def _memory_key(
    space: ConfigurationSpace,
    goal: Configurations,
    start: Configurations | None,
    options: OracleOptions | None,
) -> tuple[object, ...]:
    return (
        space.fingerprint(),
        np.asarray(goal, dtype=np.float64).tobytes(),
        None if start is None else np.asarray(start, dtype=np.float64).tobytes(),
        DEFAULT_ORACLE if options is None else options,
    )
