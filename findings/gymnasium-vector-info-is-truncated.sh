#!/usr/bin/env bash
# A Gymnasium vector environment gives a value of `info` the type that the first environment's value has: where
# that one happens to be a whole number, the others are cut off at the point, without a word.
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


class Priced(gym.Env):
    """Reports its price in `info`."""

    observation_space = gym.spaces.Box(0.0, 1.0, (1,))
    action_space = gym.spaces.Discrete(2)

    def __init__(self, price):
        self.price = price

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, dtype=np.float32), {"price": self.price}


def together(*prices):
    envs = gym.vector.SyncVectorEnv([lambda price=price: Priced(price) for price in prices])
    return envs.reset()[1]["price"].tolist()


print("gymnasium", gym.__version__)
print("Prices 2.5 and 1:", together(2.5, 1), "and the other way round, 1 and 2.5:", together(1, 2.5))
print("Prices True and 7:", together(True, 7))
assert together(2.5, 1) == [2.5, 1.0]
assert together(1, 2.5) == [1, 2], "the second environment's fraction is kept now"
assert together(True, 7) == [True, True], "the second environment's number is kept now"
PYTHON
