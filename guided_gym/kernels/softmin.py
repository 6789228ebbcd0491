"""Target probabilities of single nodes without building the whole distribution."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.plain import borrowing


@borrowing
def choice_efficiency(energy: NDArray[np.float64], n: int, node: int, epsilon: float) -> tuple[float, float]:
    """(-log Q(node), -log max Q) of the smoothed softmin over ``energy[:n]``.

    Args:
        energy: (>= n,) float64, delta_v/delta + tau_v/tau.
        n: Number of nodes.
        node: The chosen node.
        epsilon: Floor of the smoothed target; uniform when epsilon * n >= 1.
    """
    lowest, highest = energy[0], energy[0]
    for i in range(1, n):
        lowest = min(lowest, energy[i])
        highest = max(highest, energy[i])
    total = 0.0
    for i in range(n):
        total += np.exp(lowest - energy[i])
    return _efficiency(energy[node], n, lowest, highest, total, epsilon)


@njit(cache=True)
def choice_efficiencies(
    energy: NDArray[np.float64], nodes: NDArray[np.int64], sizes: NDArray[np.int64], epsilon: float
) -> NDArray[np.float64]:
    """`choice_efficiency` of one choice after the other while a tree grows, to the last bit; (k, 2).

    The sum over the nodes is kept from choice to choice, unless a new node has less energy than all before.

    Args:
        energy: (>= n,) float64, delta_v/delta + tau_v/tau.
        nodes: (k,) the chosen nodes.
        sizes: (k,) number of nodes when each was chosen, never fewer than before.
        epsilon: Floor of the smoothed target; uniform when epsilon * n >= 1.
    """
    out = np.empty((nodes.size, 2))
    lowest, highest, total, n = energy[0], energy[0], 0.0, 0
    for k in range(nodes.size):
        before = lowest
        for i in range(n, sizes[k]):
            lowest = min(lowest, energy[i])
            highest = max(highest, energy[i])
        if lowest != before:
            total, n = 0.0, 0
        for i in range(n, sizes[k]):
            total += np.exp(lowest - energy[i])
        n = sizes[k]
        chosen = energy[nodes[k]]
        out[k, 0], out[k, 1] = _efficiency(chosen, n, lowest, highest, total, epsilon)
    return out


@borrowing
def _efficiency(
    chosen: float, n: int, lowest: float, highest: float, total: float, epsilon: float
) -> tuple[float, float]:
    """`choice_efficiency` of a node of energy ``chosen``; ``total`` is the sum of exp(lowest - energy)."""
    if epsilon * n >= 1.0:
        return np.log(n), np.log(n)
    gamma = max(0.0, (epsilon * total - np.exp(lowest - highest)) / (1.0 - epsilon * n))
    whole = np.log(total + gamma * n)
    if gamma == 0.0:
        return max(0.0, whole - (lowest - chosen)), max(0.0, whole)
    share = whole - np.log(np.exp(lowest - chosen) + gamma)
    return max(0.0, share), max(0.0, whole - np.log(1.0 + gamma))


@borrowing
def energy_of(
    cost: float, tau: float, optimum: float, scale: float, temperatures: tuple[float, float]
) -> float:
    """delta_v/delta + tau_v/tau of one node, in units of ``scale``."""
    delta = max(cost + tau - optimum, 0.0)
    return (delta / temperatures[0] + tau / temperatures[1]) / scale


@borrowing
def settle_energies(
    taus: NDArray[np.float64],
    costs: NDArray[np.float64],
    parents: NDArray[np.int32],
    bounds: tuple[int, int, bool],
    lengths: tuple[float, float],
    temperatures: tuple[float, float],
    energy: NDArray[np.float64],
) -> None:
    """Work remaining and energy of the nodes that a tree has gained; both written.

    Args:
        taus: (>= n,) float64, work remaining; what the oracle says of the new nodes.
        costs: (>= n,) float64, d_T(s, v).
        parents: (>= n,) int32.
        bounds: The first new node; n; and whether d_C changes along an edge by no more than its length.
        lengths: d_C(s, t), and the unit.
        temperatures: Those of the target distribution.
        energy: (>= n,) float64.
    """
    first, n, certified = bounds
    for i in range(first, n):
        parent = parents[i]
        if certified and 0 <= parent < i:
            taus[i] = min(taus[i], taus[parent] + (costs[i] - costs[parent]))
        energy[i] = energy_of(costs[i], taus[i], lengths[0], lengths[1], temperatures)
