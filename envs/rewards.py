"""What a choice of node is worth: rewards compare it with the target distribution Q."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import number, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.measure.target import Measure, jensen_shannon
from guided_gym.options import TargetParameters

Numbers = TypeVar("Numbers", float, NDArray[np.float64])


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
    """A reward: a function of the choice, and a value for invalid actions. It holds no episode's state."""

    def __call__(self, choice: Choice) -> float:
        """The reward of a valid choice."""

    def worst(self, target: TargetParameters) -> float:
        """The reward of an invalid action: no more than any valid one's."""


@runtime_checkable
class MeasuredReward(Reward, Protocol):
    """A reward that needs only the two numbers of a choice; vector environments take it as it is."""

    def of(self, efficiency: Numbers, best: Numbers) -> Numbers:
        """The reward of SE and the best possible SE of a choice, or of many (n,), in nats."""


@doors
class EfficiencyReward:
    """-SE: -log Q(u) for a node u, -D_KL(P || Q) for a distribution P (paper, Sampling Efficiency).

    Added up over an episode it is the paper's total SE. The least sum does not mean the fewest samples:
    choices on a small tree are cheap, and so are steps that leave it small.
    """

    def __call__(self, choice: Choice) -> float:
        """-SE of the choice, in nats."""
        return self.of(choice.sampling_efficiency, choice.best_possible)

    def of(self, efficiency: Numbers, best: Numbers) -> Numbers:
        """-SE."""
        return 0.0 - efficiency  # never -0.0

    def worst(self, target: TargetParameters) -> float:
        """The log of epsilon, since Q >= epsilon."""
        return math.log(target.epsilon)


class RegretReward:
    """Best possible SE - SE: what a choice loses against the node with the largest Q; 0 for that node.

    Unlike -SE it does not depend on how many nodes are nearly as good. Its best policy is known: always the
    node of the largest Q, on which nothing is lost, whatever becomes of the tree.
    """

    def __call__(self, choice: Choice) -> float:
        """The negative regret, in nats."""
        return self.of(choice.sampling_efficiency, choice.best_possible)

    def of(self, efficiency: Numbers, best: Numbers) -> Numbers:
        """Best possible - SE, at most 0."""
        lost: Numbers = np.minimum(best - efficiency, 0.0) + 0.0  # never -0.0
        return lost

    def worst(self, target: TargetParameters) -> float:
        """The log of epsilon: SE is at most -log epsilon, and the best possible at least 0."""
        return math.log(target.epsilon)


class SampleReward:
    """-1 for each sample: its best policy has the goal in the fewest samples, in expectation."""

    def __call__(self, choice: Choice) -> float:
        """-1."""
        return -1.0

    def of(self, efficiency: Numbers, best: Numbers) -> Numbers:
        """-1 for each."""
        return efficiency * 0.0 - 1.0

    def worst(self, target: TargetParameters) -> float:
        """-1: a sample is lost."""
        return -1.0


@doors
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
    "regret": RegretReward,
    "sample": SampleReward,
    "jensen_shannon": JensenShannonReward,
}


class WeightedReward:
    """A sum of rewards, each with a weight: ``{"regret": 1, "sample": 0.1}``.

    Between its parts: regret alone is content with any tree, a cost per sample alone has no opinion on a
    single choice; the weight is what a sample may cost in nats.

    Args:
        weights: Weights >= 0 of the names in `REWARDS`.

    Raises:
        UnknownNameError: No such name.
        InvalidInputError: No names, or a weight that is negative or no number.
    """

    def __init__(self, weights: Mapping[str, float]) -> None:
        if not weights:
            raise InvalidInputError("reward: expected names with weights, got none")
        self.weights = {
            name: number(f"reward[{name!r}]", weight, least=0) for name, weight in weights.items()
        }
        self._parts = [(weight, make_reward(name)) for name, weight in self.weights.items()]

    def __call__(self, choice: Choice) -> float:
        """The weighted sum of what the parts say of the choice."""
        total = 0.0
        for weight, part in self._parts:
            total = total + weight * part(choice)
        return total

    def worst(self, target: TargetParameters) -> float:
        """The weighted sum of the worst: no more than any valid choice's, since no weight is negative."""
        return sum(weight * part.worst(target) for weight, part in self._parts)


class MeasuredSum(WeightedReward):
    """A `WeightedReward` whose parts are all `MeasuredReward`, and which is one itself, therefore."""

    def of(self, efficiency: Numbers, best: Numbers) -> Numbers:
        """The weighted sum."""
        total: Numbers = efficiency * 0.0
        for weight, part in self._parts:
            assert isinstance(part, MeasuredReward)
            total = total + weight * part.of(efficiency, best)
        return total


def _weighted(weights: Mapping[str, float]) -> WeightedReward:
    measured = all(isinstance(make_reward(name), MeasuredReward) for name in weights)
    return MeasuredSum(weights) if measured else WeightedReward(weights)


def make_reward(reward: str | Mapping[str, float] | Reward) -> Reward:
    """A reward from its name, or from weights of names; an object like `Reward` is returned as it is.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
        InvalidInputError: Neither a name nor weights nor a reward.
    """
    if isinstance(reward, Mapping):
        return _weighted(reward)
    if isinstance(reward, str):
        if reward not in REWARDS:
            raise UnknownNameError("reward", reward, REWARDS)
        return REWARDS[reward]()
    if not (callable(reward) and hasattr(reward, "worst")):
        raise InvalidInputError(
            f"reward: expected a name ({', '.join(REWARDS)}) or an object with __call__ and worst, "
            f"got {shown(reward)}"
        )
    return reward
