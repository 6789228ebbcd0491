"""TorchRL: `ActionMask` reads the observation's mask, `MaskedCategorical` draws among valid nodes.

python examples/libraries/torchrl_masked.py --steps 200
"""

from __future__ import annotations

import argparse

import torch
from tensordict.nn import ProbabilisticTensorDictModule, ProbabilisticTensorDictSequential, TensorDictModule
from torchrl.envs import ActionMask, Compose, DTypeCastTransform, GymEnv, TransformedEnv
from torchrl.modules import MaskedCategorical

import guided_gym  # noqa: F401  registers the ids


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200)
    options = parser.parse_args()
    # MaskedCategorical takes bool; our mask is int8, as gymnasium samples with it.
    boolean = DTypeCastTransform(torch.int8, torch.bool, in_keys=["action_mask"])
    env = TransformedEnv(
        GymEnv("guided_gym/Cup-v0", categorical_action_encoding=True, on_invalid="raise"),
        Compose(boolean, ActionMask()),
    )
    nodes = env.observation_spec["action_mask"].shape[-1]
    logits = TensorDictModule(torch.nn.LazyLinear(nodes), in_keys=["nodes"], out_keys=["logits"])
    draw = ProbabilisticTensorDictModule(
        in_keys={"logits": "logits", "mask": "action_mask"},
        out_keys=["action"],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )
    policy = ProbabilisticTensorDictSequential(logits, draw)
    steps = env.rollout(options.steps, policy)
    print(f"{len(steps)} steps, reward {steps['next', 'reward'].sum():.1f}, samples of valid nodes only")


if __name__ == "__main__":
    main()
