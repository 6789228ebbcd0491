"""An index of nearest neighbours that grows, and the checks of what goes into the kernels."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.kernels.metric import Metric
from guided_gym.kernels.nearest import (
    BUCKET,
    FREE,
    FULL,
    LEAF_SIZE,
    LOWEST,
    MAX_DIMENSION,
    NODES,
    NONE,
    NOT_FINITE,
    POINTS,
    STACK,
    STACK_SIZE,
    Floats,
    Ints,
    State,
    clear_node,
    insert,
    insert_many,
    k_nearest,
    k_nearest_many,
    nearest,
    nearest_many,
    within,
)

_Number = TypeVar("_Number", bound=np.number)


def kernel_array(values: ArrayLike, dtype: type[_Number]) -> NDArray[_Number]:
    """Return C-contiguous writable values, copied if necessary: numba compiles anew for read-only arrays."""
    out = np.ascontiguousarray(values, dtype=dtype)
    return out if out.flags.writeable else out.copy()


def checked_metric(weights: ArrayLike, periods: ArrayLike) -> Metric:
    """The metric of weights and periods (d,), 0 where a coordinate is not periodic.

    Raises:
        InvalidInputError: shapes differ, d is not in 1..16, a weight is not positive, a period is negative.
    """
    w = np.ascontiguousarray(weights, dtype=np.float64)
    p = np.ascontiguousarray(periods, dtype=np.float64)
    if w.ndim == 1 and w.shape[0] > MAX_DIMENSION:
        raise InvalidInputError(f"expected a space of at most {MAX_DIMENSION} dimensions, got {w.shape[0]}")
    if w.ndim != 1 or w.shape != p.shape or not w.shape[0]:
        raise InvalidInputError(
            f"expected weights and periods of one shape (d,) with 1 <= d <= {MAX_DIMENSION}, "
            f"got shapes {w.shape} and {p.shape}"
        )
    if not (np.all(np.isfinite(w)) and np.all(w > 0)):
        raise InvalidInputError(f"expected finite positive weights, got {w.tolist()}")
    if not (np.all(np.isfinite(p)) and np.all(p >= 0)):
        raise InvalidInputError(f"expected finite periods >= 0 (0: not periodic), got {p.tolist()}")
    return w, p


def checked_query(q: ArrayLike, d: int) -> Floats:
    """Return a configuration (d,) as kernels take it.

    Raises:
        InvalidInputError: wrong shape, NaN or an infinity.
    """
    row = kernel_array(q, np.float64)
    if row.shape != (d,) or not all(map(math.isfinite, row.tolist())):
        raise InvalidInputError(f"expected a finite configuration of shape ({d},), got {row.tolist()}")
    return row


class GrowingIndex:
    """Exact, deterministic nearest neighbours under insertion (periodic, weighted; see the module).

    Not safe for use by two threads at once: queries share scratch space.

    Attributes:
        state: the arrays that the compiled functions take; replaced whenever the index grows.
    """

    state: State

    def __init__(self, metric: Metric, capacity: int = 1024) -> None:
        """Make an empty index; `capacity` is only a first guess, it doubles when needed."""
        w, p = checked_metric(*metric)
        d = w.shape[0]
        work = np.empty(3 * d + STACK_SIZE)
        work[:d], work[d : 2 * d] = w, np.where(p > 0, p, np.inf)
        counters = np.zeros(STACK + STACK_SIZE, np.int64)
        counters[NODES], counters[FREE] = 1, NONE
        rows = max(int(capacity), 1)
        points, nodes, boxes = self._arrays(rows, d)
        clear_node(nodes, boxes, 0)
        nodes[0, LOWEST] = 0
        self.state = (points, nodes, boxes, work, counters)

    @staticmethod
    def _arrays(rows: int, d: int) -> tuple[Floats, NDArray[np.int32], Floats]:
        # Every leaf but a lone root holds at least half a bucket.
        node_rows = 4 * rows // LEAF_SIZE + 4
        return (
            np.empty((rows, d)),
            np.empty((node_rows, BUCKET + LEAF_SIZE), np.int32),
            np.empty((node_rows, 2 * d + 1)),
        )

    def __len__(self) -> int:
        return int(self.state[4][POINTS])

    @property
    def points(self) -> Floats:
        """Read-only view (n, d) of the configurations in order of insertion, periodic coordinates wrapped."""
        view = self.state[0][: len(self)]
        view.flags.writeable = False
        return view

    def reserve(self, extra: int) -> None:
        """Make room for `extra` more configurations; `state` is replaced if the arrays must grow."""
        points, nodes, boxes, work, counters = self.state
        wanted = len(self) + extra
        if wanted <= points.shape[0]:
            return
        wider = self._arrays(max(wanted, 2 * points.shape[0]), points.shape[1])
        wider[0][: len(points)] = points
        wider[1][: len(nodes)] = nodes
        wider[2][: len(boxes)] = boxes
        self.state = (*wider, work, counters)

    def _query(self, q: ArrayLike) -> Floats:
        out = kernel_array(q, np.float64)
        if out.shape != self.state[0].shape[1:]:
            raise InvalidInputError(
                f"expected a configuration of shape {self.state[0].shape[1:]}, got shape {out.shape}"
            )
        return out

    def _queries(self, Q: ArrayLike) -> Floats:
        out = kernel_array(Q, np.float64)
        if out.ndim != 2 or out.shape[1:] != self.state[0].shape[1:]:
            raise InvalidInputError(
                f"expected configurations of shape (n, {self.state[0].shape[1]}), got shape {out.shape}"
            )
        if not np.all(np.isfinite(out)):
            raise InvalidInputError("expected finite configurations, got NaN or an infinity")
        return out

    def add(self, q: ArrayLike) -> int:
        """Insert a configuration (d,) and return its index.

        Raises:
            InvalidInputError: wrong shape, NaN or an infinity.
        """
        row = self._query(q)
        status = insert(self.state, row)
        if status == FULL:
            self.reserve(1)
            status = insert(self.state, row)
        if status == NOT_FINITE:
            raise InvalidInputError(f"expected a finite configuration, got {row.tolist()}")
        return int(status)

    def add_many(self, Q: ArrayLike) -> None:
        """Insert configurations (n, d) in order.

        Raises:
            InvalidInputError: wrong shape, NaN or an infinity (then nothing is inserted).
        """
        rows = self._queries(Q)
        self.reserve(len(rows))
        insert_many(self.state, rows)

    def nearest(self, q: ArrayLike) -> tuple[int, float]:
        """Return the index of the nearest configuration (the lower of equals) and its distance.

        Raises:
            InvalidInputError: wrong shape, a query that is not finite, or an empty index.
        """
        index, distance = nearest(self.state, self._query(q))
        if index < 0:
            came = "an empty index" if len(self) == 0 else f"{np.asarray(q).tolist()}"
            raise InvalidInputError(f"expected a finite query and a non-empty index, got {came}")
        return int(index), float(distance)

    def k_nearest(self, q: ArrayLike, k: int) -> tuple[Ints, Floats]:
        """Return indices (k,) and distances (k,), nearest first, ties by index; fewer if fewer exist.

        Raises:
            InvalidInputError: wrong shape, a query that is not finite, or k < 1.
        """
        if k < 1:
            raise InvalidInputError(f"expected k >= 1, got {k}")
        row = checked_query(q, self.state[0].shape[1])
        return k_nearest(self.state, row, k)

    def within(self, q: ArrayLike, r: float) -> Ints:
        """Return the indices, ascending, of all configurations at a distance of at most `r`.

        Raises:
            InvalidInputError: wrong shape, a query that is not finite, or a NaN radius.
        """
        row = checked_query(q, self.state[0].shape[1])
        if math.isnan(r):
            raise InvalidInputError(f"expected a radius, got {r}")
        return within(self.state, row, float(r))

    def nearest_many(self, Q: ArrayLike) -> tuple[Ints, Floats]:
        """Return indices (n,) and distances (n,) of the nearest configuration of each row of Q (n, d).

        Raises:
            InvalidInputError: wrong shape, not finite, or an empty index.
        """
        rows = self._queries(Q)
        if len(self) == 0:
            raise InvalidInputError("expected a non-empty index, got an empty index")
        return nearest_many(self.state, rows)

    def k_nearest_many(self, Q: ArrayLike, k: int) -> tuple[Ints, Floats]:
        """Return indices (n, k) and distances (n, k) for each row of Q (n, d), as `k_nearest`.

        Raises:
            InvalidInputError: wrong shape, not finite, or k not in 1..len(self).
        """
        rows = self._queries(Q)
        if not 1 <= k <= len(self):
            raise InvalidInputError(f"expected 1 <= k <= {len(self)} (the number of configurations), got {k}")
        return k_nearest_many(self.state, rows, k)
