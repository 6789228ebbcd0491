"""`NodePolicy` for stable-baselines3: a logit for each node by one network that all nodes share.

Importing this module teaches PPO, A2C and MaskablePPO the name ``"NodePolicy"``.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from guided_gym.checks import integer
from guided_gym.errors import InvalidInputError

NAME: Final = "NodePolicy"
HIDDEN: Final = 32
PICTURE: Final = 8
ABSENT: Final = -1e8  # logit of a node that there is not
_BROADCAST: Final = ("start", "goal")  # parts of the observation that each node is told
_LARGE: Final = 5.0  # the logarithm of a large tree's size


class Untouched(BaseFeaturesExtractor):
    """Hands the whole observation on, for modules that want its parts and not one vector."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        super().__init__(observation_space, 1)

    def forward(self, observations: Any) -> Any:
        """The same."""
        return observations


class PerNode:
    """What policies have in common whose network gives a logit for each node, and a summary for the critic.

    To be mixed into a policy of stable-baselines3, before it; `network` says which network.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        options.update(features_extractor_class=Untouched, ortho_init=False)
        super().__init__(*arguments, **options)

    def network(self) -> nn.Module:
        """A module with ``latent_dim_pi`` nodes and ``latent_dim_vf`` numbers of a summary."""
        raise NotImplementedError

    def _build_mlp_extractor(self) -> None:
        setattr(self, "mlp_extractor", self.network())  # noqa: B010  a module of another class than the base's

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)  # type: ignore[misc]
        setattr(self, "action_net", nn.Identity())  # noqa: B010  the network gives logits already
        options = {"lr": lr_schedule(1), **self.optimizer_kwargs}  # type: ignore[attr-defined]
        self.optimizer = self.optimizer_class(self.parameters(), **options)  # type: ignore[attr-defined]


class NodeNetwork(nn.Module):
    """Logits and a summary of a tree, from the default observation.

    Each node is read by one and the same network: its features, start and goal, and what a small convolution
    sees of the workspace where the node is. It is then read again beside the mean and the largest of what all
    nodes gave. So the order of the nodes does not matter, and padding is never looked at: weights learned
    with one ``max_nodes`` serve any other.

    Args:
        space: The observation: ``nodes`` and ``action_mask``; ``start``, ``goal`` and ``raster`` are used
            where they are.
        hidden: Units of each layer.
        picture: Channels of the convolution; 0 to leave the raster out.

    Raises:
        InvalidInputError: Another observation.
    """

    def __init__(self, space: spaces.Dict, hidden: int = HIDDEN, picture: int = PICTURE) -> None:
        super().__init__()
        self.nodes, self.columns = _table(space)
        self._told = [key for key in _BROADCAST if key in space.spaces]
        seen = self.columns + sum(int(np.prod(space[key].shape or ())) for key in self._told)
        self.picture: nn.Module | None = None
        if picture and "raster" in space.spaces:
            self.picture = nn.Sequential(
                nn.Conv2d(1, picture, 4, 4, padding=2),
                nn.ReLU(),
                nn.Conv2d(picture, picture, 3, padding=1),
                nn.ReLU(),
            )
            seen += picture
        self.actor, self.critic = _Reader(seen, hidden), _Reader(seen, hidden)
        self.beside = nn.Linear(self.actor.summary, hidden)  # with `among`, one layer over both
        self.among = nn.Linear(hidden, hidden, bias=False)
        self.logit = nn.Linear(hidden, 1)
        nn.init.zeros_(self.logit.weight)  # begins with all nodes alike
        self.value = nn.Sequential(nn.Linear(self.critic.summary, hidden), nn.ReLU())
        self.latent_dim_pi, self.latent_dim_vf = self.nodes, hidden

    def forward(self, observation: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """(b, nodes) logits and the (b, hidden) summary."""
        seen, tree, mask = self._seen(observation)
        return self._logits(seen, tree, mask), self._summary(seen, tree, mask)

    def forward_actor(self, observation: dict[str, Tensor]) -> Tensor:
        """(b, nodes) logits, `ABSENT` where there is no node."""
        return self._logits(*self._seen(observation))

    def forward_critic(self, observation: dict[str, Tensor]) -> Tensor:
        """(b, hidden) summary."""
        return self._summary(*self._seen(observation))

    def _seen(self, observation: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Rows (m, seen) of the nodes that there are, (m,) the tree of each, (b, nodes) which they are."""
        mask = observation["action_mask"] > 0.5
        table = observation["nodes"].reshape(len(mask), self.nodes, self.columns)
        tree = mask.nonzero()[:, 0]
        parts = [table[mask], *(observation[key].index_select(0, tree) for key in self._told)]
        if self.picture is not None:
            view = self.picture(observation["raster"])
            most = int(mask.any(0).nonzero().max()) + 1
            places = table[:, :most, None, :2]  # x and y, -1 to 1, as grid_sample wants them
            there = nn.functional.grid_sample(view, places, align_corners=False)
            parts.append(there[..., 0].transpose(1, 2)[mask[:, :most]])
        return torch.cat(parts, 1), tree, mask

    def _logits(self, seen: Tensor, tree: Tensor, mask: Tensor) -> Tensor:
        each, whole = self.actor(seen, tree, len(mask))
        told = self.beside(whole).index_select(0, tree)
        scores = self.logit(torch.relu(self.among(each) + told))[:, 0]
        logits = torch.full(mask.shape, ABSENT, dtype=scores.dtype, device=scores.device)
        logits[mask] = scores
        return logits

    def _summary(self, seen: Tensor, tree: Tensor, mask: Tensor) -> Tensor:
        summary: Tensor = self.value(self.critic(seen, tree, len(mask))[1])
        return summary


class _Reader(nn.Module):
    """What there is to say of each node, and of each tree: mean and largest of its nodes, and how many."""

    def __init__(self, seen: int, hidden: int) -> None:
        super().__init__()
        self.read = nn.Sequential(nn.Linear(seen, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.hidden, self.summary = hidden, 2 * hidden + 1

    def forward(self, seen: Tensor, tree: Tensor, trees: int) -> tuple[Tensor, Tensor]:
        """(m, hidden) of m nodes and (trees, summary) of the trees that they are of."""
        each = self.read(seen)
        count = torch.bincount(tree, minlength=trees).to(each.dtype)[:, None]
        zeros = each.new_zeros(trees, self.hidden)
        mean = zeros.index_add(0, tree, each) / count
        largest = zeros.scatter_reduce(0, tree[:, None].expand_as(each), each, "amax")  # none is negative
        return each, torch.cat([mean, largest, torch.log(count) / _LARGE], 1)


class _NodePolicy(PerNode):
    """`NodePolicy`, whatever the algorithm's kind of policy."""

    def __init__(self, *arguments: Any, hidden: int = HIDDEN, picture: int = PICTURE, **options: Any) -> None:
        self.sizes = {
            "hidden": integer("hidden", hidden, least=1),
            "picture": integer("picture", picture, least=0),
        }
        super().__init__(*arguments, **options)

    def network(self) -> nn.Module:
        """A `NodeNetwork`."""
        space, actions = self.observation_space, self.action_space  # type: ignore[attr-defined]
        made = NodeNetwork(space, **self.sizes)
        if not isinstance(actions, spaces.Discrete) or int(actions.n) != made.nodes:
            raise InvalidInputError(
                f"NodePolicy: expected one action for each of {made.nodes} nodes, got {actions}"
            )
        return made

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), **self.sizes}  # type: ignore[misc]


class NodePolicy(_NodePolicy, MultiInputActorCriticPolicy):
    """A policy of PPO and A2C over the default observation: see `NodeNetwork`.

    It takes the mask from the observation, so that algorithms without masks choose valid nodes only.

    Args:
        *arguments: As of its base.
        hidden: Units of each layer.
        picture: Channels of the convolution over the raster; 0 to leave it out.
        **options: As of its base.

    Raises:
        InvalidInputError: Another observation, or other actions than nodes.
    """


class MaskableNodePolicy(_NodePolicy, MaskableMultiInputActorCriticPolicy):
    """The same for MaskablePPO."""


def _table(space: spaces.Space[Any]) -> tuple[int, int]:
    """(nodes, columns) of an observation space."""
    if not (isinstance(space, spaces.Dict) and {"nodes", "action_mask"} <= set(space.spaces)):
        raise InvalidInputError(
            f"NodePolicy: expected a Dict with nodes and action_mask, the default observation, got {space}"
        )
    nodes = int(np.prod(space["action_mask"].shape or ()))
    values = int(np.prod(space["nodes"].shape or ()))
    if not nodes or values % nodes or values < 2 * nodes:
        raise InvalidInputError(
            f"NodePolicy: expected at least x and y of each of {nodes} nodes, got {values} numbers"
        )
    return nodes, values // nodes


for _algorithm, _policy in ((PPO, NodePolicy), (A2C, NodePolicy), (MaskablePPO, MaskableNodePolicy)):
    _algorithm.policy_aliases[NAME] = _policy  # type: ignore[attr-defined]
