#!/usr/bin/env bash
# stable-baselines3's `VecNormalize` writes its normalised spaces into the Dict space of the environment that it
# wraps. Where that space belongs to a class, as it often does, every later environment of the class has them,
# without the wrapper: images become float32 and are no images for the policy.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check torch==2.13.0 stable-baselines3==2.9.2 gymnasium==1.4.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import gymnasium as gym
import numpy as np
import stable_baselines3
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize


class Camera(gym.Env):
    """An image and a pose."""

    observation_space = gym.spaces.Dict(
        {
            "image": gym.spaces.Box(0, 255, (64, 64, 1), np.uint8),
            "pose": gym.spaces.Box(-1.0, 1.0, (3,), np.float32),
        }
    )
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}


print("stable-baselines3", stable_baselines3.__version__)
print("before:", Camera().observation_space["image"], is_image_space(Camera().observation_space["image"]))
VecNormalize(DummyVecEnv([Camera]))
after = Camera().observation_space["image"]
print("a new environment, after another one was wrapped:", after, is_image_space(after))
assert after.dtype == np.float32 and not is_image_space(after), "the environment's space is left alone now"
PYTHON
