"""The target distribution Q over a growing tree, kept up to date as nodes are added."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.efficiency import TargetParameters, suboptimality, target
from guided_gym.kernels.softmin import choice_efficiency
from guided_gym.problems import Problem
from guided_gym.tree import NO_PARENT, SearchTree


class TargetTracker:
    """Work remaining, suboptimality and target over the nodes of one tree.

    Args:
        problem: The problem whose oracle is asked.
        tree: The tree; new nodes are taken in when something is asked.
        parameters: Temperatures, smoothing and normalisation.

    Raises:
        NoPathError: No path joins start and goal.
    """

    def __init__(self, problem: Problem, tree: SearchTree, parameters: TargetParameters) -> None:
        from guided_gym.oracle import oracle_for

        self.oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
        self.parameters = parameters
        self._tree = tree
        self._tau = np.zeros(256)
        self._energy = np.zeros(256)
        self._n = 0
        self._rewirings = 0
        self.optimum = float(self.oracle.cost_to_go(problem.task.start))
        self._scale = self.optimum or 1.0  # 0 where the search starts at its goal

    def _update(self) -> None:
        tree, n = self._tree, len(self._tree)
        if n > self._tau.size:
            self._tau = np.resize(self._tau, 2 * n)
            self._energy = np.resize(self._energy, 2 * n)
        for i in range(self._n, n):
            q = tree._configurations[i]
            tau = float(self.oracle.cost_to_go(q))
            parent = int(tree._parents[i])
            if NO_PARENT < parent < i:
                # The edge is free, so d_C can't change by more than its length.
                edge = float(tree._costs[i] - tree._costs[parent])
                tau = min(tau, float(self._tau[parent]) + edge)
            self._tau[i] = tau
            self._energy[i] = self._energy_of(float(tree._costs[i]), tau)
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
        return choice_efficiency(self._energy, n, node, self.parameters.epsilon)
