"""MaskablePPO of sb3-contrib: it asks the environment for `action_masks` by itself.

python examples/libraries/maskable_ppo.py --steps 2000
"""

from __future__ import annotations

import argparse

import gymnasium
from sb3_contrib import MaskablePPO

import guided_gym  # noqa: F401  registers the ids


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2000)
    options = parser.parse_args()
    env = gymnasium.make("guided_gym/SimplePassage-v0", max_samples=100)
    model = MaskablePPO("MultiInputPolicy", env, n_steps=128, batch_size=128, n_epochs=2, seed=0)
    model.learn(options.steps)
    observation, info = env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        # predict() needs the mask by hand
        action, _ = model.predict(observation, action_masks=env.get_wrapper_attr("action_masks")())
        observation, _, terminated, truncated, info = env.step(int(action))
    print(f"solved: {info['solved']}, samples: {info['samples']}")


if __name__ == "__main__":
    main()
