"""skrl: plain PPO chooses which guiding space guides (GuideSelection: a flat observation, no mask needed).

python examples/libraries/skrl_ppo.py --steps 500
"""

from __future__ import annotations

import argparse

import gymnasium
from skrl.envs.wrappers.torch import wrap_env
from skrl.utils.model_instantiators.torch import categorical_model

import guided_gym  # noqa: F401  registers the ids


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500)
    options = parser.parse_args()
    env = wrap_env(gymnasium.make("guided_gym/GuideSelection-v0", max_samples=100))
    network = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "elu"}]
    policy = categorical_model(
        observation_space=env.observation_space,
        action_space=env.action_space,
        device=env.device,
        network=network,
        output="ACTIONS",
    )
    observations, _ = env.reset()
    total = 0.0
    for _ in range(options.steps):
        actions, _ = policy.act({"observations": observations}, role="policy")
        observations, rewards, terminated, truncated, _ = env.step(actions)
        total += float(rewards.sum())
        if bool(terminated.any() | truncated.any()):
            observations, _ = env.reset()
    print(f"{options.steps} steps, reward {total:.1f}")


if __name__ == "__main__":
    main()
