"""The metric: target distributions and sampling efficiency (paper, Evaluation metric). All in nats."""

from __future__ import annotations

import copy
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.checks import integer, number, shown
from guided_gym.doors import door, doors
from guided_gym.errors import InvalidInputError
from guided_gym.kernels.softmin import choice_efficiencies, settle_energies
from guided_gym.kernels.softmin import choice_efficiency as softmin_choice
from guided_gym.measure.oracle import oracle_for
from guided_gym.options import DEFAULT_TARGET, SearchOptions, TargetParameters
from guided_gym.problems import Problem
from guided_gym.search.tree import SearchTree

SUM_TOLERANCE = 1e-6  # of probabilities that add up to 1, as those in float32 do


@door
def suboptimality(
    cost_to_come: NDArray[np.float64], cost_to_go: NDArray[np.float64], optimum: float
) -> NDArray[np.float64]:
    """delta_v = d_T(s, v) + d_C(v, t) - d_C(s, t), clipped at 0 against the oracle's error; (n,).

    Raises:
        InvalidInputError: The two are not over the same nodes.
    """
    if np.shape(cost_to_come) != np.shape(cost_to_go):
        raise InvalidInputError(
            "expected cost_to_come and cost_to_go over the same nodes, got shapes "
            f"{np.shape(cost_to_come)} and {np.shape(cost_to_go)}"
        )
    return np.maximum(cost_to_come + cost_to_go - optimum, 0.0)


@door
def target(
    delta: ArrayLike, tau: ArrayLike, scale: float, parameters: TargetParameters = DEFAULT_TARGET
) -> NDArray[np.float64]:
    """The smoothed target Q-bar over the nodes of a tree.

    Args:
        delta: (n,) suboptimality of each node, a length >= 0.
        tau: (n,) work remaining at each node, a length >= 0; infinite where the goal cannot be reached.
        scale: d_C(s, t), the length that both are divided by (normalisation ``"start"``); nothing is
            divided where it is 0.
        parameters: Temperatures, smoothing and normalisation.

    Returns:
        (n,) probabilities: softmin of delta_v/delta + tau_v/tau, smoothed to at least epsilon. A node that
        cannot reach the goal has only the probability that smoothing gives it.

    Raises:
        InvalidInputError: The two are not over the same nodes, a length is negative or NaN, no node can reach
            the goal, or the scale is negative or not finite.
    """
    delta, tau = _lengths("delta", delta), _lengths("tau", tau)
    if delta.shape != tau.shape:
        raise InvalidInputError(
            f"expected delta and tau over the same nodes, got shapes {delta.shape} and {tau.shape}"
        )
    scale = number("scale", scale, least=0, what="length")
    if parameters.normalisation == "tree":
        energy = _over_largest(delta) / parameters.delta + _over_largest(tau) / parameters.tau
    else:
        energy = (delta / parameters.delta + tau / parameters.tau) / (scale or 1.0)
    lowest = np.min(energy)
    if not np.isfinite(lowest):
        raise InvalidInputError("expected a node that can reach the goal (finite delta and tau), got none")
    return smooth(np.exp(lowest - energy), parameters.epsilon)


def _lengths(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, np.float64)
    if array.ndim != 1 or not array.size:
        raise InvalidInputError(f"{name}: expected one length per node, got shape {array.shape}")
    if not (array >= 0).all():  # nor is NaN
        bad = int(np.argmin(array >= 0))
        raise InvalidInputError(f"{name}: expected lengths >= 0, got {array[bad]} for node {bad}")
    return array


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
        epsilon: The floor, in [0, 1).

    Raises:
        InvalidInputError: Weights or a floor of another kind.
    """
    weights = np.asarray(weights, np.float64)
    if weights.ndim != 1 or not weights.size:
        raise InvalidInputError(f"weights: expected one weight per node, got shape {weights.shape}")
    largest = float(weights.max())
    if not (np.isfinite(largest) and largest > 0 and (weights >= 0).all()):
        raise InvalidInputError(f"weights: expected finite numbers >= 0, not all zero, got {shown(weights)}")
    if not 0 <= epsilon < 1:
        raise InvalidInputError(f"epsilon: expected a number in [0, 1), got {shown(epsilon)}")
    n = weights.size
    if epsilon * n >= 1:
        return np.full(n, 1.0 / n)
    if largest != 1.0:
        weights = weights / largest  # their sum could overflow
    total = float(weights.sum())
    gamma = max(0.0, (epsilon * total - float(weights.min())) / (1 - epsilon * n))
    smoothed: NDArray[np.float64] = (weights + gamma) / (total + gamma * n)
    return smoothed


@door
def sampling_efficiency(p: ArrayLike, q: ArrayLike) -> float:
    """SE_Q(P) = D_KL(P || Q), lower is better; infinite where Q has no mass and P has.

    Args:
        p: (n,) the guiding space's distribution P over the tree.
        q: (n,) the target Q.

    Raises:
        InvalidInputError: One is not a distribution, or the two are over different numbers of nodes.
    """
    p, q = _paired(p, q)
    log_q = np.log(q, out=np.full(q.size, -np.inf), where=q > 0)
    return max(_divergence(p, log_q), 0.0) + 0.0  # never -0.0


def _divergence(p: NDArray[np.float64], log_q: NDArray[np.float64]) -> float:
    support = p > 0
    return float(np.sum(p[support] * (np.log(p[support]) - log_q[support])))


def _paired(p: ArrayLike, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    if p.shape != q.shape or p.ndim != 1:
        raise InvalidInputError(f"expected P and Q over the same nodes, got shapes {p.shape} and {q.shape}")
    for name, values in (("P", p), ("Q", q)):
        total = float(values.sum())
        if not ((values >= 0).all() and abs(total - 1.0) <= SUM_TOLERANCE):
            raise InvalidInputError(
                f"{name}: expected probabilities >= 0 that add up to 1, got the sum {total:.9g} and "
                f"the least {values.min(initial=np.inf):.9g}"
            )
    return p, q


def choice_efficiency(q: ArrayLike, node: int) -> float:
    """SE of a deterministic choice: -log Q(u).

    Raises:
        InvalidInputError: There is no such node, or Q(u) is no probability.
    """
    q = np.asarray(q, np.float64)
    if q.ndim != 1 or not 0 <= node < q.size:
        raise InvalidInputError(f"node: expected an integer, 0 to {q.size - 1}, got {shown(node)}")
    if not 0 <= q[node] <= 1 + SUM_TOLERANCE:
        raise InvalidInputError(f"Q: expected a probability of node {node}, got {q[node]}")
    with np.errstate(divide="ignore"):
        return max(float(-np.log(q[node])), 0.0) + 0.0  # never -0.0


@door
def jensen_shannon(p: ArrayLike, q: ArrayLike) -> float:
    """D_JS(P || Q), between 0 and log 2; same arguments and errors as `sampling_efficiency`."""
    p, q = _paired(p, q)
    # log M by way of the sum: half of the least positive number is 0.
    log_m = np.log(p + q, out=np.full(p.size, -np.inf), where=p + q > 0) - np.log(2)
    return min(max(0.5 * (_divergence(p, log_m) + _divergence(q, log_m)), 0.0), float(np.log(2)))


@door
def entropy(samples: ArrayLike, bins: int, bounds: ArrayLike) -> float:
    """Entropy of an observed sampling distribution over C (the paper's multiple-sample level), in nats.

    It is at most the logarithm of the number of samples: compare equal numbers.

    Args:
        samples: (m, d) configurations sampled over the course of planning, all within the bounds.
        bins: Cells along each axis of the histogram.
        bounds: (d, 2) range of each axis.

    Raises:
        InvalidInputError: No samples, one that is not finite or lies outside, or bounds of another form.
    """
    samples, bounds = np.asarray(samples, np.float64), np.asarray(bounds, np.float64)
    integer("bins", bins, least=1)
    if samples.ndim != 2 or not samples.size:
        raise InvalidInputError(f"samples: expected shape (m >= 1, d >= 1), got {samples.shape}")
    if bounds.shape != (samples.shape[1], 2) or not (bounds[:, 0] < bounds[:, 1]).all():
        raise InvalidInputError(
            f"bounds: expected {samples.shape[1]} pairs (low, high), got {bounds.tolist()}"
        )
    outside = ~((samples >= bounds[:, 0]) & (samples <= bounds[:, 1])).all(axis=1)  # NaN is
    if outside.any():
        raise InvalidInputError(
            f"samples: expected finite configurations within the bounds, got {int(outside.sum())} of "
            f"{len(samples)} outside, the first {samples[outside][0].tolist()}"
        )
    cells = ((samples - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0]) * bins).astype(np.int64)
    _, counts = np.unique(np.minimum(cells, bins - 1), axis=0, return_counts=True)
    p = counts / counts.sum()
    return max(float(-np.sum(p * np.log(p))), 0.0) + 0.0  # never -0.0


def padded(values: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    """A search's SE per sample, continued by 0 to ``length``: after the end, every sample is the goal."""
    out = np.zeros(length)
    out[: min(length, values.size)] = values[:length]
    return out


class Measured(Protocol):
    """What can be measured: a search in progress, or its result."""

    @property
    def problem(self) -> Problem:
        """The problem."""

    @property
    def tree(self) -> SearchTree:
        """Its tree."""

    @property
    def options(self) -> SearchOptions:
        """The options, with the parameters of the target distribution."""


@doors
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
        task, options = problem.task, search.options
        self.oracle = oracle_for(problem.space, task.goal, start=task.start, options=options.oracle)
        self.parameters = search.options.target if parameters is None else parameters
        self._tree = search.tree
        self._tau = np.zeros(256)
        self._energy = np.zeros(256)
        self._n = 0
        self._rewirings = 0
        self.optimum = float(self.oracle.cost_to_go(problem.task.start))
        self._scale = self.optimum or 1.0  # 0 where the search starts at its goal

    def clone(self, search: Measured) -> Measure:
        """The metric of a clone of the search, as far as it has been computed."""
        other = copy.copy(self)
        other._tree = search.tree
        other._tau, other._energy = self._tau.copy(), self._energy.copy()
        return other

    def _update(self) -> None:
        tree, n = self._tree, len(self._tree)
        if n > self._tau.size:
            self._tau = np.resize(self._tau, 2 * n)
            self._energy = np.resize(self._energy, 2 * n)
        if n > self._n:
            # Where all edges are free, d_C can't change along one by more than its length.
            nodes, first, p = tree.nodes, self._n, self.parameters
            new = first if n == first + 1 else slice(first, n)
            self._tau[new] = self.oracle.cost_to_go(nodes.configurations[new])
            bounds, lengths = (first, n, tree.certified), (self.optimum, self._scale)
            temperatures = float(p.delta), float(p.tau)
            settle_energies(
                self._tau, nodes.costs, nodes.parents, bounds, lengths, temperatures, self._energy
            )
        if tree.rewirings != self._rewirings:
            self._rewirings = tree.rewirings
            delta = suboptimality(tree.cost_to_come, self._tau[:n], self.optimum)
            p = self.parameters
            self._energy[:n] = (delta / p.delta + self._tau[:n] / p.tau) / self._scale
        self._n = n

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

        Raises:
            InvalidInputError: There was no such node, or there have never been so many.
        """
        self._update()
        n = self._n if size is None else size
        if not 0 <= node < n <= self._n:  # the kernel checks no bounds
            raise InvalidInputError(
                f"expected a node of a tree of {self._n} nodes at most, got {shown(node)} of {n}"
            )
        if self.parameters.normalisation == "tree":
            delta = suboptimality(self._tree.cost_to_come[:n], self._tau[:n], self.optimum)
            q = target(delta, self._tau[:n], self.optimum, self.parameters)
            return max(0.0, -float(np.log(q[node]))), -float(np.log(q.max()))
        return softmin_choice(self._energy, n, node, self.parameters.epsilon)

    def choices(self, nodes: ArrayLike, sizes: ArrayLike) -> NDArray[np.float64]:
        """`choice` for several nodes, one after the other, in hindsight; much quicker in one go.

        Args:
            nodes: (k,) the chosen nodes.
            sizes: (k,) number of nodes when each was chosen, never fewer than before.

        Returns:
            (k, 2) what `choice` returns of each.

        Raises:
            InvalidInputError: There was no such node, there have never been so many nodes, or ``sizes`` fall.
        """
        self._update()
        nodes, sizes = np.asarray(nodes, np.float64), np.asarray(sizes, np.float64)
        if nodes.ndim != 1 or nodes.shape != sizes.shape:
            raise InvalidInputError(
                f"expected as many nodes as sizes, got shapes {nodes.shape} and {sizes.shape}"
            )
        if not nodes.size:
            return np.zeros((0, 2))
        known = (sizes[1:] >= sizes[:-1]).all() and sizes[-1] <= self._n and (nodes < sizes).all()
        whole = (nodes == np.floor(nodes)).all() and (sizes == np.floor(sizes)).all()
        if not (known and whole and (nodes >= 0).all()):  # nor is NaN; the kernel checks no bounds
            raise InvalidInputError(
                f"expected nodes of a tree that grew to {self._n} nodes, got {shown(nodes)} of {shown(sizes)}"
            )
        nodes, sizes = nodes.astype(np.int64), sizes.astype(np.int64)
        if self.parameters.normalisation == "tree":
            pairs = zip(nodes.tolist(), sizes.tolist(), strict=True)
            return np.array([self.choice(node, size) for node, size in pairs])
        return choice_efficiencies(self._energy, nodes, sizes, self.parameters.epsilon)

    def expansion(
        self, node: int, children: NDArray[np.float64], chosen: int, size: int | None = None
    ) -> tuple[float, float]:
        """SE of expanding a node by one of several children: they are added to the tree, and each is judged.

        The paper's way to evaluate node expansion (paper, Evaluation metric). A child that no free motion
        reaches has only the probability that smoothing gives it.

        Args:
            node: The node that was selected.
            children: (k, d) members of N_C(node).
            chosen: Row of the child that the guidance chose.
            size: Number of nodes when it was chosen, if the tree has grown since (and was not rewired).

        Returns:
            -log Q of the chosen child, and -log max Q over the children, in nats.

        Raises:
            InvalidInputError: No such node or child, or there have never been so many nodes.
        """
        self._update()
        n = self._n if size is None else size
        if not (0 <= node < n <= self._n and 0 <= chosen < len(children)):
            raise InvalidInputError(
                f"expected a node of {n} and a child of {len(children)}, got {shown(node)} and {chosen!r}"
            )
        tree = self._tree
        q = tree.nodes.configurations[node]
        lengths = np.asarray(tree.space.distance(children, q))
        free = tree.space.motions_free(np.broadcast_to(q, children.shape), children)
        tau = np.minimum(self.oracle.cost_to_go(children), self._tau[node] + lengths)
        tau[~free] = np.inf
        cost = float(tree.nodes.costs[node]) + lengths
        delta = suboptimality(cost, tau, self.optimum)
        if self.parameters.normalisation == "tree":
            own = suboptimality(tree.cost_to_come[:n], self._tau[:n], self.optimum)
            both = np.concatenate([own, delta]), np.concatenate([self._tau[:n], tau])
            q_children = target(*both, self.optimum, self.parameters)[n:]
            with np.errstate(divide="ignore"):
                return -float(np.log(q_children[chosen])), -float(np.log(q_children.max()))
        p = self.parameters
        energy = np.concatenate([self._energy[:n], (delta / p.delta + tau / p.tau) / self._scale])
        best = n + int(np.argmin(energy[n:]))
        return (
            softmin_choice(energy, energy.size, n + chosen, p.epsilon)[0],
            softmin_choice(energy, energy.size, best, p.epsilon)[0],
        )
