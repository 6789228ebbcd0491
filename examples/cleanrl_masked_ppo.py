"""Masked PPO in one file, in the manner of CleanRL: choose the node to expand, with torch and nothing else.

    python examples/cleanrl_masked_ppo.py [--total-steps N] [--env ID]

The policy scores each node by itself, so that it does not mind how many there are; the mask leaves out those
that there are not. Read `Policy` for the network, `update` for the loss.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

from guided_gym import NodeColumn

FEATURES = len(NodeColumn)


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--env", default="guided_gym/SimplePassage-v0")
    parser.add_argument("--total-steps", type=int, default=100_000)
    parser.add_argument("--environments", type=int, default=4)
    parser.add_argument("--rollout", type=int, default=256)
    parser.add_argument("--max-nodes", type=int, default=128)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--gamma", type=float, default=0.99)
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--clip", type=float, default=0.2)
    parser.add_argument("--entropy", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


class Policy(nn.Module):
    """Logits of nodes from their features and a summary of the tree; the summary's value for the critic."""

    def __init__(self, hidden: int = 64) -> None:
        super().__init__()
        self.node = nn.Sequential(
            nn.Linear(FEATURES, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh()
        )
        self.score = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.value = nn.Sequential(nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, 1))

    def forward(self, nodes: torch.Tensor, mask: torch.Tensor) -> tuple[Categorical, torch.Tensor]:
        """(b, n, F) features and (b, n) mask to the distribution over nodes and the (b,) values."""
        hidden = self.node(nodes)
        share = mask / mask.sum(1, keepdim=True)
        summary = (hidden * share[..., None]).sum(1)
        both = torch.cat([hidden, summary[:, None].expand_as(hidden)], -1)
        logits = self.score(both)[..., 0].masked_fill(mask == 0, -1e8)
        return Categorical(logits=logits), self.value(summary)[:, 0]


def tensors(observation: dict[str, np.ndarray]) -> tuple[torch.Tensor, torch.Tensor]:
    """The two parts of a batch of observations that this policy looks at."""
    mask = torch.from_numpy(observation["action_mask"]).float()
    return torch.from_numpy(observation["nodes"]).reshape(*mask.shape, FEATURES), mask


def advantages(
    rewards: torch.Tensor,
    values: torch.Tensor,
    ends: torch.Tensor,
    last: torch.Tensor,
    gamma: float,
    lam: float,
) -> torch.Tensor:
    """(t, e) generalised advantage estimates."""
    out, following, next_value = torch.zeros_like(rewards), torch.zeros_like(last), last
    for t in reversed(range(len(rewards))):
        delta = rewards[t] + gamma * next_value * (1 - ends[t]) - values[t]
        following = delta + gamma * lam * (1 - ends[t]) * following
        out[t], next_value = following, values[t]
    return out


def update(
    policy: Policy, optimizer: torch.optim.Optimizer, data: dict[str, torch.Tensor], args: Any
) -> None:
    """Some epochs of the clipped loss; steps that only reset an environment are none, so left out."""
    kept = torch.nonzero(data["counts"])[:, 0]
    for _ in range(args.epochs):
        for rows in kept[torch.randperm(len(kept))].split(args.batch):
            distribution, values = policy(data["nodes"][rows], data["mask"][rows])
            ratio = (distribution.log_prob(data["actions"][rows]) - data["log_probs"][rows]).exp()
            advantage = data["advantages"][rows]
            advantage = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-8)
            clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
            policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
            value_loss = (values - data["returns"][rows]).pow(2).mean()
            # The entropy of nodes that there are not is none: their probability is 0.
            loss = policy_loss + 0.5 * value_loss - args.entropy * distribution.entropy().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()


def main() -> None:
    """Rollouts and updates, until there were enough steps."""
    args = arguments()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(
        f"guided_gym:{args.env}", args.environments, vectorization_mode="sync", max_nodes=args.max_nodes
    )
    policy = Policy()
    optimizer = torch.optim.Adam(policy.parameters(), args.learning_rate)
    observation, _ = envs.reset(seed=args.seed)
    ended = np.zeros(args.environments, bool)  # the next step of these only resets
    totals, finished, begun, steps = np.zeros(args.environments), [], time.monotonic(), 0
    while steps < args.total_steps:
        rows: dict[str, list[torch.Tensor]] = {}
        for _ in range(args.rollout):
            nodes, mask = tensors(observation)
            with torch.no_grad():
                distribution, values = policy(nodes, mask)
                actions = distribution.sample()
            counts = torch.from_numpy(~ended).float()
            observation, reward, terminated, truncated, _ = envs.step(actions.numpy())
            totals += np.where(ended, 0.0, reward)
            ended = terminated | truncated
            finished += totals[ended].tolist()
            totals[ended] = 0.0
            row = {
                "nodes": nodes, "mask": mask, "actions": actions, "values": values, "counts": counts,
                "log_probs": distribution.log_prob(actions), "ends": torch.from_numpy(ended).float(),
                "rewards": torch.from_numpy(reward).float() * 0.1,
            }  # fmt: skip
            for name, value in row.items():
                rows.setdefault(name, []).append(value)
            steps += args.environments
        data = {name: torch.stack(values) for name, values in rows.items()}
        with torch.no_grad():
            last = policy(*tensors(observation))[1]
        data["advantages"] = advantages(
            data["rewards"], data["values"], data["ends"], last, args.gamma, args.gae_lambda
        )
        data["returns"] = data["advantages"] + data["values"]
        update(policy, optimizer, {name: value.flatten(0, 1) for name, value in data.items()}, args)
        recent = f"{-np.mean(finished[-20:]):.1f}" if finished else "-"
        speed = steps / (time.monotonic() - begun)
        print(f"{steps} samples, total SE of the last 20 searches {recent}, {speed:.0f} samples/s")


if __name__ == "__main__":
    main()
