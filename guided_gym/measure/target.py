"""The metric: target distributions and sampling efficiency (paper, Evaluation metric). All in nats."""

from __future__ import annotations

import copy
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.kernels.softmin import choice_efficiency as softmin_choice
from guided_gym.measure.oracle import oracle_for
from guided_gym.options import DEFAULT_TARGET, SearchOptions, TargetParameters
from guided_gym.problems import Problem
from guided_gym.search.tree import NO_PARENT, SearchTree


def suboptimality(
    cost_to_come: NDArray[np.float64], cost_to_go: NDArray[np.float64], optimum: float
) -> NDArray[np.float64]:
    """delta_v = d_T(s, v) + d_C(v, t) - d_C(s, t), clipped at 0 against the oracle's error; (n,)."""
    return np.maximum(cost_to_come + cost_to_go - optimum, 0.0)


def target(
    delta: ArrayLike, tau: ArrayLike, scale: float, parameters: TargetParameters = DEFAULT_TARGET
) -> NDArray[np.float64]:
    """The smoothed target Q-bar over the nodes of a tree.

    Args:
        delta: (n,) suboptimality of each node, a length.
        tau: (n,) work remaining at each node, a length; infinite where the goal cannot be reached.
        scale: d_C(s, t), the length that both are divided by (normalisation ``"start"``); nothing is
            divided where it is 0.
        parameters: Temperatures, smoothing and normalisation.

    Returns:
        (n,) probabilities: softmin of delta_v/delta + tau_v/tau, smoothed to at least epsilon.
    """
    delta, tau = np.asarray(delta, np.float64), np.asarray(tau, np.float64)
    if parameters.normalisation == "tree":
        energy = _over_largest(delta) / parameters.delta + _over_largest(tau) / parameters.tau
    else:
        energy = (delta / parameters.delta + tau / parameters.tau) / (scale or 1.0)
    return smooth(np.exp(np.min(energy) - energy), parameters.epsilon)


def _over_largest(values: NDArray[np.float64]) -> NDArray[np.float64]:
    finite = values[np.isfinite(values)]
    largest = float(finite.max()) if finite.size else 0.0
    return values / largest if largest > 0 else values


def smooth(weights: NDArray[np.float64], epsilon: float) -> NDArray[np.float64]:
    """Q-bar = (w + gamma) / (Z + gamma n), with the paper's smallest gamma for which Q-bar >= epsilon.

    When epsilon * n >= 1 no such gamma exists. The limit gamma -> infinity is taken then, the uniform
    distribution: it is the one nearest to what was asked, and continues Q-bar without a jump.

    Args:
        weights: (n,) unnormalised non-negative weights, not all zero.
        epsilon: The floor.
    """
    n = weights.size
    if epsilon * n >= 1:
        return np.full(n, 1.0 / n)
    total = float(weights.sum())
    gamma = max(0.0, (epsilon * total - float(weights.min())) / (1 - epsilon * n))
    return (weights + gamma) / (total + gamma * n)


def sampling_efficiency(p: ArrayLike, q: ArrayLike) -> float:
    """SE_Q(P) = D_KL(P || Q), lower is better; infinite where Q has no mass and P has.

    Args:
        p: (n,) the guiding space's distribution P over the tree.
        q: (n,) the target Q.

    Raises:
        InvalidInputError: The two are over different numbers of nodes.
    """
    p, q = _paired(p, q)
    support = p > 0
    with np.errstate(divide="ignore"):
        divergence = float(np.sum(p[support] * (np.log(p[support]) - np.log(q[support]))))
    return max(divergence, 0.0)


def _paired(p: ArrayLike, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    if p.shape != q.shape or p.ndim != 1:
        raise InvalidInputError(f"expected P and Q over the same nodes, got shapes {p.shape} and {q.shape}")
    return p, q


def choice_efficiency(q: NDArray[np.float64], node: int) -> float:
    """SE of a deterministic choice: -log Q(u)."""
    with np.errstate(divide="ignore"):
        return max(float(-np.log(q[node])), 0.0)


def jensen_shannon(p: ArrayLike, q: ArrayLike) -> float:
    """D_JS(P || Q), between 0 and log 2; same arguments as `sampling_efficiency`."""
    p, q = _paired(p, q)
    m = (p + q) / 2
    return min(0.5 * (sampling_efficiency(p, m) + sampling_efficiency(q, m)), float(np.log(2)))


def entropy(samples: ArrayLike, bins: int, bounds: ArrayLike) -> float:
    """Entropy of an observed sampling distribution over C (the paper's multiple-sample level).

    Args:
        samples: (m, d) configurations sampled over the course of planning.
        bins: Cells along each axis of the histogram.
        bounds: (d, 2) range of each axis.
    """
    ranges = [(float(low), float(high)) for low, high in np.asarray(bounds, np.float64)]
    counts, _ = np.histogramdd(np.asarray(samples, np.float64), bins, ranges)
    p = counts[counts > 0] / counts.sum()
    return float(-np.sum(p * np.log(p)))


def padded(values: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    """A search's SE per sample, continued by 0 to ``length``: after the end, every sample is the goal."""
    out = np.zeros(length)
    out[: min(length, values.size)] = values[:length]
    return out


class Measured(Protocol):
    """What can be measured: a search in progress, or what came of one."""

    @property
    def problem(self) -> Problem:
        """The problem."""

    @property
    def tree(self) -> SearchTree:
        """Its tree."""

    @property
    def options(self) -> SearchOptions:
        """Among them, the parameters of the target distribution."""


class Measure:
    """The metric of one search: work remaining, suboptimality and target over the nodes of its tree.

    Args:
        search: The search; new nodes are taken in when something is asked.
        parameters: Temperatures, smoothing and normalisation; those of the search's options if None.

    Raises:
        NoPathError: No path joins start and goal.
    """

    def __init__(self, search: Measured, parameters: TargetParameters | None = None) -> None:
        problem = search.problem
        self.oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
        self.parameters = search.options.target if parameters is None else parameters
        self._tree = search.tree
        self._tau = np.zeros(256)
        self._energy = np.zeros(256)
        self._n = 0
        self._rewirings = 0
        self.optimum = float(self.oracle.cost_to_go(problem.task.start))
        self._scale = self.optimum or 1.0  # 0 where the search starts at its goal

    def clone(self, search: Measured) -> Measure:
        """The metric of a clone of the search, as far as it has been worked out."""
        other = copy.copy(self)
        other._tree = search.tree
        other._tau, other._energy = self._tau.copy(), self._energy.copy()
        return other

    def _update(self) -> None:
        tree, n = self._tree, len(self._tree)
        if n > self._tau.size:
            self._tau = np.resize(self._tau, 2 * n)
            self._energy = np.resize(self._energy, 2 * n)
        for i in range(self._n, n):
            q = tree.nodes.configurations[i]
            tau = float(self.oracle.cost_to_go(q))
            parent = int(tree.nodes.parents[i])
            if NO_PARENT < parent < i:
                # The edge is free, so d_C can't change by more than its length.
                edge = float(tree.nodes.costs[i] - tree.nodes.costs[parent])
                tau = min(tau, float(self._tau[parent]) + edge)
            self._tau[i] = tau
            self._energy[i] = self._energy_of(float(tree.nodes.costs[i]), tau)
        if tree.rewirings != self._rewirings:
            self._rewirings = tree.rewirings
            delta = suboptimality(tree.cost_to_come, self._tau[:n], self.optimum)
            p = self.parameters
            self._energy[:n] = (delta / p.delta + self._tau[:n] / p.tau) / self._scale
        self._n = n

    def _energy_of(self, cost_to_come: float, tau: float) -> float:
        delta = max(cost_to_come + tau - self.optimum, 0.0)
        return (delta / self.parameters.delta + tau / self.parameters.tau) / self._scale

    @property
    def work_remaining(self) -> NDArray[np.float64]:
        """(n,) tau_v = d_C(v, t) of each node."""
        self._update()
        return self._tau[: self._n].copy()

    @property
    def suboptimality(self) -> NDArray[np.float64]:
        """(n,) delta_v of each node."""
        tau = self.work_remaining
        return suboptimality(self._tree.cost_to_come, tau, self.optimum)

    def distribution(self) -> NDArray[np.float64]:
        """(n,) the smoothed target Q-bar over the tree as it stands."""
        tau = self.work_remaining
        return target(self.suboptimality, tau, self.optimum, self.parameters)

    def choice(self, node: int, size: int | None = None) -> tuple[float, float]:
        """(-log Q(node), -log max Q): SE of choosing ``node``, and the least that any choice could have.

        Args:
            node: The chosen node.
            size: Number of nodes when the choice was made, if the tree has grown since (and was not rewired).
        """
        self._update()
        n = self._n if size is None else size
        if self.parameters.normalisation == "tree":
            delta = suboptimality(self._tree.cost_to_come[:n], self._tau[:n], self.optimum)
            q = target(delta, self._tau[:n], self.optimum, self.parameters)
            return max(0.0, -float(np.log(q[node]))), -float(np.log(q.max()))
        return softmin_choice(self._energy, n, node, self.parameters.epsilon)
