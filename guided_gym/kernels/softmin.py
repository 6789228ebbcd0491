"""Target probabilities of single nodes without building the whole distribution."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def choice_efficiency(energy: NDArray[np.float64], n: int, node: int, epsilon: float) -> tuple[float, float]:
    """(-log Q(node), -log max Q) of the smoothed softmin over ``energy[:n]``.

    Args:
        energy: (>= n,) float64, delta_v/delta + tau_v/tau.
        n: Number of nodes.
        node: The chosen node.
        epsilon: Floor of the smoothed target; uniform when epsilon * n >= 1.
    """
    if epsilon * n >= 1.0:
        return np.log(n), np.log(n)
    lowest, highest = energy[0], energy[0]
    for i in range(1, n):
        lowest = min(lowest, energy[i])
        highest = max(highest, energy[i])
    total = 0.0
    for i in range(n):
        total += np.exp(lowest - energy[i])
    gamma = max(0.0, (epsilon * total - np.exp(lowest - highest)) / (1.0 - epsilon * n))
    whole = np.log(total + gamma * n)
    if gamma == 0.0:
        return max(0.0, whole - (lowest - energy[node])), max(0.0, whole)
    chosen = whole - np.log(np.exp(lowest - energy[node]) + gamma)
    return max(0.0, chosen), max(0.0, whole - np.log(1.0 + gamma))
