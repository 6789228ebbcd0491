"""Voronoi cells by counting samples: which node each sample is nearest to."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.kernels.metric import Metric, separation
from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@borrowing
def assign_cells(
    samples: Floats,
    nodes: Floats,
    first: int,
    last: int,
    metric: Metric,
    owner: Ints,
    distance: Floats,
) -> None:
    """Let ``nodes[first:last]`` take over the samples that are nearer to them than to their owner.

    Args:
        samples: (m, d) fixed samples.
        nodes: (>= last, d) configurations of the tree.
        first: First new node.
        last: One past the last new node.
        metric: Weights and periods of the distance.
        owner: (m,) int64, changed in place.
        distance: (m,) distance to the owner, changed in place.
    """
    weights, periods = metric
    for v in range(first, last):
        q = nodes[v]
        for j in range(samples.shape[0]):
            # One coordinate alone often shows that the owner stays.
            if np.abs(samples[j, 0] - q[0]) * weights[0] >= distance[j] and periods[0] == 0.0:
                continue
            d = separation(q, samples[j], metric)
            if d < distance[j]:
                distance[j] = d
                owner[j] = v
