"""An index of the edges of a roadmap, searched by distance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from guided_gym.errors import InvalidInputError
from guided_gym.kernels.metric import Metric
from guided_gym.kernels.nearest import Floats, Ints, State
from guided_gym.kernels.segments import load_segments, node_reach, segments_within
from guided_gym.structures.nearest import GrowingIndex, checked_metric, checked_query, kernel_array


class SegmentIndex:
    """The edges of a roadmap as straight segments (the short way round), searched by distance.

    Edge ids are positions in `edges`. Not safe for use by two threads at once.
    """

    def __init__(self, points: ArrayLike, edges: ArrayLike, metric: Metric) -> None:
        """Index edges (m, 2) between configurations (n, d).

        Raises:
            InvalidInputError: wrong shapes, values that are not finite, or ends that are no vertices.
        """
        w, p = checked_metric(*metric)
        vertices = kernel_array(points, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != len(w) or not np.all(np.isfinite(vertices)):
            raise InvalidInputError(
                f"expected finite points of shape (n, {len(w)}), got shape {vertices.shape} or NaN"
            )
        ends = kernel_array(np.asarray(edges).reshape(-1, 2), np.int32)
        m, n = len(ends), len(vertices)
        if m and (ends.min() < 0 or ends.max() >= n):
            raise InvalidInputError(
                f"expected edges between vertices of 0..{n - 1}, got {ends.min()} to {ends.max()}"
            )
        index = GrowingIndex((w, p), capacity=max(1, m))
        self._halves, self._half_lengths = np.empty((m, len(w))), np.empty(m)
        load_segments(index.state, vertices, ends, self._halves, self._half_lengths)
        self._index = index
        self._reach = np.zeros(len(index.state[1]))
        node_reach(index.state[1], self._half_lengths, self._reach)

    def __len__(self) -> int:
        return len(self._halves)

    @property
    def state(self) -> tuple[State, Floats, Floats, Floats]:
        """The first four arguments of `segments_within`, for fused kernels."""
        return self._index.state, self._halves, self._half_lengths, self._reach

    def within(self, q: ArrayLike, r: float) -> Ints:
        """Return the ids, ascending, of the edges that pass within `r` of configuration `q`.

        Raises:
            InvalidInputError: wrong shape, a query that is not finite, or a NaN radius.
        """
        row = checked_query(q, self._halves.shape[1])
        if math.isnan(r):
            raise InvalidInputError(f"expected a radius, got {r}")
        return segments_within(*self.state, row, float(r))
