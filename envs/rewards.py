"""What a choice of node is worth: rewards compare it with the target distribution Q."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.measure.target import Measure, jensen_shannon
from guided_gym.options import TargetParameters


@dataclass(slots=True)
class Choice:
    """One choice, measured on the tree as it stood when the choice was made, before the expansion.

    Attributes:
        measure: The metric of the search, its tree not yet changed.
        node: The node to expand.
        distribution: (n,) float64 P over the nodes that ``node`` was drawn from; None for a chosen node.
        sampling_efficiency: SE of the choice in nats: D_KL(P || Q), which is -log Q(node) for a node.
        best_possible: -log max Q, the least SE that any choice could have had, in nats.
    """

    measure: Measure
    node: int
    distribution: NDArray[np.float64] | None
    sampling_efficiency: float
    best_possible: float


class Reward(Protocol):
    """A reward: a function of the choice, and what an invalid action gets. Holds no state of an episode."""

    def __call__(self, choice: Choice) -> float:
        """The reward of a valid choice."""

    def worst(self, target: TargetParameters) -> float:
        """The reward of an invalid action: no more than any valid one's."""


class EfficiencyReward:
    """-SE: -log Q(u) for a node u, -D_KL(P || Q) for a distribution P (paper, Sampling Efficiency)."""

    def __call__(self, choice: Choice) -> float:
        """-SE of the choice, in nats."""
        return 0.0 - choice.sampling_efficiency  # never -0.0

    def worst(self, target: TargetParameters) -> float:
        """The log of epsilon, since Q >= epsilon."""
        return math.log(target.epsilon)


class JensenShannonReward:
    """-D_JS(P || Q), between -log 2 and 0; P is one-hot where a node was chosen."""

    def __call__(self, choice: Choice) -> float:
        """-D_JS of the choice, in nats."""
        q = choice.measure.distribution()
        p = choice.distribution
        if p is None:
            p = np.zeros(q.size)
            p[choice.node] = 1.0
        return 0.0 - jensen_shannon(p, q)

    def worst(self, target: TargetParameters) -> float:
        """-log 2, the bound of D_JS."""
        return -math.log(2)


# One row per reward that has a name.
REWARDS: Final[dict[str, Callable[[], Reward]]] = {
    "efficiency": EfficiencyReward,
    "jensen_shannon": JensenShannonReward,
}


def make_reward(reward: str | Reward) -> Reward:
    """A reward from its name; an object with the methods of `Reward` is returned as it is.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
        InvalidInputError: Neither a name nor a reward.
    """
    if isinstance(reward, str):
        if reward not in REWARDS:
            raise UnknownNameError("reward", reward, REWARDS)
        return REWARDS[reward]()
    if not (callable(reward) and hasattr(reward, "worst")):
        raise InvalidInputError(
            f"reward: expected a name ({', '.join(REWARDS)}) or an object with __call__ and worst, "
            f"got {reward!r}"
        )
    return reward
