"""The metric: target distributions and sampling efficiency (paper, Evaluation metric). All in nats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.checks import number
from guided_gym.errors import InvalidInputError


@dataclass(frozen=True)
class TargetParameters:
    """Parameters of the target distribution Q (paper, Sampling Efficiency).

    Attributes:
        delta: Temperature of the suboptimality, in units of ``normalisation``.
        tau: Temperature of the work remaining, in the same units.
        epsilon: Smallest probability of a node under the smoothed target.
        normalisation: ``"start"`` divides delta_v and tau_v by d_C(s, t); ``"tree"`` by the largest value
            in the tree, each by its own.

    Raises:
        InvalidInputError: A temperature that is not positive, an epsilon outside [0, 1), another word.
    """

    delta: float = 0.1
    tau: float = 0.1
    epsilon: float = 1e-4
    normalisation: str = "start"

    def __post_init__(self) -> None:
        for name in ("delta", "tau"):
            number(name, getattr(self, name), above=0)
        number("epsilon", self.epsilon, least=0, below=1)
        if self.normalisation not in ("start", "tree"):
            raise InvalidInputError(f"normalisation: expected 'start' or 'tree', got {self.normalisation!r}")


DEFAULT_TARGET = TargetParameters()


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
