"""A network of your own for MaskablePPO: a set transformer over the nodes of the default observation.

    python examples/custom_network.py [STEPS]

stable-baselines3 wants a features extractor; what comes out of it here is a logit for each node and a summary
for the critic, so that the layers after it have nothing left to do but to tell the two apart.
"""

from __future__ import annotations

import sys
from typing import Any

import gymnasium
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from guided_gym import NodeColumn

FEATURES, HIDDEN = len(NodeColumn), 32


class NodeSetTransformer(BaseFeaturesExtractor):
    """Nodes look at each other, not at padding; the answer does not depend on their order."""

    def __init__(self, observation_space: gymnasium.spaces.Dict) -> None:
        self.nodes = observation_space["action_mask"].shape[0]
        super().__init__(observation_space, self.nodes + HIDDEN)
        self.embed = nn.Linear(FEATURES, HIDDEN)
        self.attend = nn.TransformerEncoderLayer(HIDDEN, 4, 2 * HIDDEN, dropout=0.0, batch_first=True)
        self.score = nn.Linear(HIDDEN, 1)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """(b, nodes + HIDDEN): logits, then the summary."""
        mask = observation["action_mask"] > 0
        nodes = observation["nodes"].reshape(len(mask), self.nodes, FEATURES)
        hidden = self.attend(self.embed(nodes), src_key_padding_mask=~mask)
        logits = self.score(hidden)[..., 0].masked_fill(~mask, 0.0)
        summary = (hidden * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
        return torch.cat([logits, summary], 1)


class LogitsAndSummary(nn.Module):
    """Hands the logits to the actor and the summary to the critic."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = features - HIDDEN, HIDDEN

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """(b, nodes) logits."""
        return features[:, : self.latent_dim_pi]

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """(b, HIDDEN) the summary."""
        return features[:, self.latent_dim_pi :]


class NodePolicy(MaskablePPO.policy_aliases["MultiInputPolicy"]):  # type: ignore[misc]
    """The policy: no layer after the logits."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        options.update(features_extractor_class=NodeSetTransformer, ortho_init=False)
        super().__init__(*arguments, **options)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = LogitsAndSummary(self.features_dim)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def main(steps: int) -> None:
    """Train for some samples."""
    env = gymnasium.make("guided_gym:guided_gym/RandomSimplePassage-v0", split="train", max_nodes=64)
    rollout = min(512, steps)
    model = MaskablePPO(NodePolicy, env, n_steps=rollout, batch_size=min(64, rollout), seed=0, verbose=1)
    model.learn(steps)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
