"""Distance and interpolation of single configurations: weighted, with periodic coordinates."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]


Metric = tuple[Floats, Floats]
"""d(a, b)^2 = sum_i (w_i * wrapped difference_i)^2: weights w (d,), length per unit of each coordinate, and
periods (d,), 0 where a coordinate has none. Both float64. A tuple with names would add half a microsecond to
each call of a kernel."""


@borrowing
def shortest(delta: float, period: float) -> float:
    """``delta`` taken the short way round; a period of 0 means not periodic."""
    if period > 0.0:
        return delta - period * np.floor(delta / period + 0.5)
    return delta


@borrowing
def placed(value: float, period: float) -> float:
    """``value`` in [-period / 2, period / 2), where rounding would leave it a hair outside, too."""
    value = shortest(value, period)
    half = 0.5 * period
    return -half if period > 0.0 and not -half <= value < half else value


@borrowing
def separation(a: Floats, b: Floats, metric: Metric) -> float:
    """Distance between configurations: sqrt(sum (w_i * wrapped difference_i)^2)."""
    weights, periods = metric
    total = 0.0
    for i in range(a.size):
        step = weights[i] * shortest(b[i] - a[i], periods[i])
        total += step * step
    return np.sqrt(total)


@njit(cache=True)
def separations(points: Floats, q: Floats, metric: Metric) -> Floats:
    """(m,) distances from (m, d) configurations to one (d,)."""
    out = np.empty(points.shape[0])
    for m in range(points.shape[0]):
        out[m] = separation(points[m], q, metric)
    return out


@njit(cache=True)
def interpolate(a: Floats, b: Floats, t: float, metric: Metric) -> Floats:
    """The configuration at fraction ``t`` of the straight motion from ``a`` to ``b``; (d,) float64.

    Periodic coordinates come back in [-period / 2, period / 2).
    """
    periods = metric[1]
    out = np.empty(a.size)
    for i in range(a.size):
        out[i] = placed(a[i] + t * shortest(b[i] - a[i], periods[i]), periods[i])
    return out


@njit(cache=True)
def steer(
    a: Floats,
    b: Floats,
    step: float,
    metric: Metric,
) -> Floats:
    """The configuration at most ``step`` from ``a`` on the straight motion to ``b``; (d,) float64.

    Periodic coordinates come back in [-period / 2, period / 2).
    """
    length = separation(a, b, metric)
    return interpolate(a, b, 1.0 if length <= step else step / length, metric)


@borrowing
def segment_separation(
    a: Floats,
    b: Floats,
    q: Floats,
    metric: Metric,
) -> float:
    """Distance from ``q`` to the straight motion from ``a`` to ``b``.

    Everything is unrolled around ``a``: exact while the distance and the motion's length add up to less than
    half a period, and never too small.
    """
    weights, periods = metric
    along, squared, offset = 0.0, 0.0, 0.0
    for i in range(a.size):
        u = weights[i] * shortest(b[i] - a[i], periods[i])
        p = weights[i] * shortest(q[i] - a[i], periods[i])
        along += u * p
        squared += u * u
        offset += p * p
    t = 0.0 if squared == 0.0 else min(1.0, max(0.0, along / squared))
    return np.sqrt(max(0.0, offset - 2.0 * t * along + t * t * squared))


@njit(cache=True)
def ball_samples(
    q: Floats,
    normals: Floats,
    radii: Floats,
    step: float,
    metric: Metric,
) -> Floats:
    """(k, d) points of the ball of radius ``step`` around ``q``.

    Args:
        q: (d,) centre.
        normals: (k, d) standard normal numbers, giving directions.
        radii: (k,) uniform numbers in [0, 1).
        step: Radius in the weighted distance.
        metric: Weights and periods of the distance.
    """
    weights, periods = metric
    k, d = normals.shape
    out = np.empty((k, d))
    for j in range(k):
        norm = 0.0
        for i in range(d):
            norm += normals[j, i] * normals[j, i]
        scale = step * radii[j] ** (1.0 / d) / np.sqrt(norm)
        for i in range(d):
            out[j, i] = placed(q[i] + scale * normals[j, i] / weights[i], periods[i])
    return out
