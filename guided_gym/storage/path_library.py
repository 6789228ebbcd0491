"""Solved paths held in memory, and the query that finds those of the most similar tasks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.structures.nearest import checked_metric

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The k-d tree rounds in its own way: candidates this much (relatively) beyond its radius are looked at too.
_RADIUS_SLACK = 1e-9


@doors
@dataclass(frozen=True, eq=False)
class PathLibrary:
    """Paths of solved problems, flat, read-only and in ascending order of their seeds.

    Waypoint i of path p is row `offsets[p] + i` of `waypoints`. Build one with `PathLibrary.from_paths` or
    `PathDatabase.load`.
    """

    waypoints: FloatArray  # (W, d) all waypoints, path after path
    offsets: IntArray  # (P + 1,) first row of each path; the last entry is W
    remaining: FloatArray  # (W,) length from each waypoint to the end of its own path
    seeds: IntArray  # (P,) index of each path's problem in its distribution, ascending
    weights: FloatArray  # (d,) length per unit of each coordinate
    periods: FloatArray  # (d,) period of each coordinate, 0 where it is not periodic

    @classmethod
    def from_paths(
        cls,
        paths: Sequence[ArrayLike],
        weights: ArrayLike,
        periods: ArrayLike,
        seeds: ArrayLike | None = None,
    ) -> PathLibrary:
        """Build a library from waypoint arrays.

        Args:
            paths: one (n, d) array per path, n >= 1.
            weights: (d,) length per unit of each coordinate.
            periods: (d,) period of each coordinate, 0 where it is not periodic.
            seeds: (P,) seeds, strictly ascending; 0, 1, ... when left out.

        Raises:
            InvalidInputError: a path is empty, not finite or not of dimension d, or the seeds do not ascend.
        """
        weights, periods = checked_metric(weights, periods)
        arrays = [checked_path(path, weights.size) for path in paths]
        offsets = np.zeros(len(arrays) + 1, dtype=np.int64)
        np.cumsum([len(path) for path in arrays], out=offsets[1:])
        flat = np.concatenate(arrays) if arrays else np.empty((0, weights.size))
        return cls.from_flat(flat, offsets, weights, periods, seeds)

    @classmethod
    def from_flat(
        cls,
        waypoints: FloatArray,
        offsets: IntArray,
        weights: ArrayLike,
        periods: ArrayLike,
        seeds: ArrayLike | None = None,
    ) -> PathLibrary:
        """Build a library from waypoints that lie in one array already (see the fields for the shapes)."""
        weights, periods = checked_metric(weights, periods)
        n_paths = offsets.size - 1
        seeds = np.arange(n_paths) if seeds is None else np.asarray(seeds)
        seeds = np.ascontiguousarray(seeds, dtype=np.int64)
        if seeds.shape != (n_paths,) or np.any(np.diff(seeds) <= 0):
            raise InvalidInputError(f"expected {n_paths} strictly ascending seeds, got {seeds.tolist()[:20]}")
        remaining = _remaining_lengths(waypoints, offsets, weights, periods)
        fields = (waypoints, offsets, remaining, seeds, weights, periods)
        return cls(*(_frozen(field) for field in fields))

    def __len__(self) -> int:
        """Return the number of paths."""
        return self.seeds.size

    @property
    def dimension(self) -> int:
        """Dimension d of the configurations."""
        return self.weights.size

    @cached_property
    def lengths(self) -> FloatArray:
        """(P,) length of each path."""
        return self.remaining[self.offsets[:-1]]

    @cached_property
    def starts(self) -> FloatArray:
        """(P, d) first waypoint of each path."""
        return self.waypoints[self.offsets[:-1]]

    @cached_property
    def goals(self) -> FloatArray:
        """(P, d) last waypoint of each path."""
        return self.waypoints[self.offsets[1:] - 1]

    def path(self, index: int) -> FloatArray:
        """Return the (n, d) waypoints of path `index` (a read-only view).

        Raises:
            InvalidInputError: there is no such path.
        """
        if not 0 <= index < len(self):
            raise InvalidInputError(f"expected a path index in [0, {len(self)}), got {index}")
        return self.waypoints[self.offsets[index] : self.offsets[index + 1]]

    def subset(self, n: int) -> PathLibrary:
        """Return the library of the first `n` paths (all of them when there are fewer).

        Raises:
            InvalidInputError: n is negative.
        """
        if n < 0:
            raise InvalidInputError(f"expected a number of paths >= 0, got {n}")
        n = min(n, len(self))
        end = self.offsets[n]
        return PathLibrary(
            self.waypoints[:end],
            self.offsets[: n + 1],
            self.remaining[:end],
            self.seeds[:n],
            self.weights,
            self.periods,
        )

    def task_distances(self, start: ArrayLike, goal: ArrayLike) -> FloatArray:
        """Return d(start, start of p) + d(goal, goal of p) for every path p, shape (P,)."""
        return self._task_distances(slice(None), *self._checked_task(start, goal))

    def most_similar(self, start: ArrayLike, goal: ArrayLike, k: int) -> IntArray:
        """Return the indices of the `k` paths whose tasks are most similar, the most similar first.

        Similar means a small distance between the starts plus distance between the goals. The answer is exact
        and ties go to the lower index; with fewer than k paths all are returned. (Paper, section "Refactoring
        Existing Algorithms", PathDatabase.)

        Args:
            start: (d,) start of the task at hand.
            goal: (d,) goal of the task at hand.
            k: how many paths to return, at least 1.

        Raises:
            InvalidInputError: k < 1, or start or goal is not a finite configuration of dimension d.
        """
        if k < 1:
            raise InvalidInputError(f"expected k >= 1 paths to look up, got {k}")
        start, goal = self._checked_task(start, goal)
        k = min(k, len(self))
        if k == 0:
            return np.empty(0, dtype=np.int64)
        # The tree measures sqrt(a^2 + b^2) where similarity is a + b >= sqrt(a^2 + b^2): the k nearest by the
        # one bound the k-th best of the other, and a ball of that radius holds all that can be as good.
        key = self._tree_key(np.concatenate((start, goal))[None])[0]
        nearest = np.atleast_1d(self._tree.query(key, k=k)[1])
        bound = float(self._task_distances(nearest, start, goal).max())
        radius = bound * (1.0 + _RADIUS_SLACK) + _RADIUS_SLACK * self._scale
        near = np.array(self._tree.query_ball_point(key, radius, return_sorted=True), dtype=np.int64)
        order = np.argsort(self._task_distances(near, start, goal), kind="stable")
        return near[order[:k]]

    def _task_distances(self, index: slice | IntArray, start: FloatArray, goal: FloatArray) -> FloatArray:
        to_starts = weighted_norm(self.starts[index] - start, self.weights, self.periods)
        return to_starts + weighted_norm(self.goals[index] - goal, self.weights, self.periods)

    def _checked_task(self, start: ArrayLike, goal: ArrayLike) -> tuple[FloatArray, FloatArray]:
        return (
            checked_path([start], self.dimension, "start")[0],
            checked_path([goal], self.dimension, "goal")[0],
        )

    def _tree_key(self, tasks: FloatArray) -> FloatArray:
        """Weighted coordinates for the k-d tree, (n, 2d); periodic ones moved into [0, period)."""
        periods = np.tile(self.periods, 2)
        wraps = periods > 0.0
        key = tasks.copy()
        key[:, wraps] = np.mod(key[:, wraps], periods[wraps])
        key *= np.tile(self.weights, 2)
        key[:, wraps] = np.where(key[:, wraps] >= self._box[wraps], 0.0, key[:, wraps])
        return key

    @cached_property
    def _box(self) -> FloatArray:
        return np.tile(self.periods * self.weights, 2)

    @cached_property
    def _scale(self) -> float:
        """Largest weighted coordinate among the tasks: what the tree's rounding is relative to."""
        ends = np.concatenate((self.starts, self.goals)) * self.weights
        return float(np.abs(ends).max(initial=0.0))

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree  # imported here: it is slow to load and few programs need it

        tasks = np.concatenate((self.starts, self.goals), axis=1)
        return cKDTree(self._tree_key(tasks), boxsize=self._box)


def weighted_norm(difference: FloatArray, weights: FloatArray, periods: FloatArray) -> FloatArray:
    """Return the weighted length of differences (..., d), periodic coordinates the short way round."""
    wraps = periods > 0.0
    difference = difference.copy()
    turns = np.rint(difference[..., wraps] / periods[wraps])
    difference[..., wraps] -= turns * periods[wraps]
    return np.asarray(np.sqrt(np.sum((difference * weights) ** 2, axis=-1)), dtype=np.float64)


def path_length(path: FloatArray, weights: FloatArray, periods: FloatArray) -> float:
    """Return the weighted length of an (n, d) path."""
    return float(weighted_norm(np.diff(path, axis=0), weights, periods).sum())


def checked_path(path: ArrayLike | Sequence[ArrayLike], dimension: int, what: str = "path") -> FloatArray:
    """Return `path` as a C-contiguous (n, dimension) float64 array, n >= 1.

    Raises:
        InvalidInputError: it has another shape, no waypoint, or a coordinate that is not finite.
    """
    try:
        array = np.ascontiguousarray(path, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"expected a {what} of numbers of dimension {dimension}: {error}") from error
    if array.ndim != 2 or array.shape[1] != dimension or array.shape[0] == 0:
        raise InvalidInputError(
            f"expected a {what} of shape (n >= 1, {dimension}) in this store of dimension {dimension}, "
            f"got shape {array.shape}"
        )
    if not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise InvalidInputError(
            f"expected finite coordinates in a {what}, got {array[row]} at waypoint {row}"
        )
    return array


def _remaining_lengths(
    waypoints: FloatArray, offsets: IntArray, weights: FloatArray, periods: FloatArray
) -> FloatArray:
    remaining = np.zeros(len(waypoints))
    if len(waypoints) < 2:
        return remaining
    steps = weighted_norm(np.diff(waypoints, axis=0), weights, periods)
    # Path by path, from the end: one running sum over all of them would lose digits to the other paths.
    for first, end in itertools.pairwise(offsets):
        remaining[first : end - 1] = np.cumsum(steps[first : end - 1][::-1])[::-1]
    return remaining


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array = np.array(array, order="C")  # a copy: the caller's own array stays writable
    array.flags.writeable = False
    return array
