#!/usr/bin/env bash
# Gymnasium's `NormalizeReward` keeps adding up one return where an episode is truncated and the environment is
# reset: the return by whose spread it divides then belongs to no episode.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check gymnasium==1.4.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import gymnasium as gym
import numpy as np


class Steady(gym.Env):
    """A reward of 1 a step; it never ends by itself."""

    observation_space = gym.spaces.Box(0.0, 1.0, (1,))
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, dtype=np.float32), {}

    def step(self, action):
        return np.zeros(1, dtype=np.float32), 1.0, False, False, {}


print("gymnasium", gym.__version__)
env = gym.wrappers.NormalizeReward(gym.wrappers.TimeLimit(Steady(), max_episode_steps=5), gamma=1.0)
returns = []
for _ in range(3):
    env.reset()
    truncated = False
    while not truncated:
        _, _, _, truncated, _ = env.step(0)
    returns.append(float(np.squeeze(env.discounted_reward)))
print("Three episodes of five steps of reward 1, each truncated and followed by a reset.")
print("The wrapper's return at their ends, with gamma = 1 (each episode's is 5):", returns)
assert returns == [5.0, 10.0, 15.0], "the return begins anew with an episode now"
PYTHON
