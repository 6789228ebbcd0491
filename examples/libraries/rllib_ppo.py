"""RLlib: masked PPO with several env runners, which are processes that make the environments themselves.

python examples/libraries/rllib_ppo.py --iterations 2 --runners 2

A worker has imported nothing, hence "guided_gym:guided_gym/Cup-v0": what stands before the colon is imported
first. Where no mask is needed, as in GuideSelection, such a name is all that RLlib has to know.
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env


def masked(options: dict[str, Any]) -> gymnasium.Env:
    """Nodes as actions, under the two keys that the masking module reads."""
    from guided_gym import MaskedObservation

    env = gymnasium.make("guided_gym:guided_gym/Cup-v0", **options)
    return MaskedObservation(env, parts=("nodes", "start", "goal"))


def settings(name: str, samples: int, runners: int) -> PPOConfig:
    """PPO on an environment, with two searches in each of so many processes."""
    config = PPOConfig().environment(name, env_config={"max_samples": samples})
    config.env_runners(num_env_runners=runners, num_envs_per_env_runner=2, rollout_fragment_length="auto")
    config.training(train_batch_size_per_learner=512, minibatch_size=128, num_epochs=2)
    return config


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--runners", type=int, default=2)
    options = parser.parse_args()
    register_env("masked_cup", masked)
    masking = RLModuleSpec(module_class=ActionMaskingTorchRLModule, model_config={"fcnet_hiddens": [64]})
    algorithms = {
        "nodes, masked": settings("masked_cup", 60, options.runners).rl_module(rl_module_spec=masking),
        "who guides": settings("guided_gym:guided_gym/GuideSelection-v0", 100, options.runners),
    }
    for what, config in algorithms.items():
        algorithm = config.build_algo()
        for _ in range(options.iterations):
            result = algorithm.train()["env_runners"]
        print(
            f"{what}: {result['num_env_steps_sampled_lifetime']:.0f} samples, "
            f"reward of a search {result['episode_return_mean']:.0f}"
        )
        algorithm.stop()


if __name__ == "__main__":
    main()
