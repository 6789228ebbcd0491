#!/usr/bin/env bash
# Gymnasium's vector `RecordEpisodeStatistics` forgets the running episodes of *all* environments when only some
# of them are reset: the wrapped environment takes `reset_mask` out of the caller's options before it looks there.
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
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

print("gymnasium", gym.__version__)
manual = {"autoreset_mode": AutoresetMode.DISABLED}
env = RecordEpisodeStatistics(
    gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync", vector_kwargs=manual)
)
env.reset(seed=0)
for _ in range(5):
    env.step(np.array([0, 1]))
print("Lengths of the two running episodes after five steps:", env.episode_lengths.tolist())
options = {"reset_mask": np.array([True, False])}
env.reset(options=options)
print("After a reset of the first environment alone:", env.episode_lengths.tolist())
print("The second one was not reset, and its five steps are forgotten. The caller's options are now", options)
assert env.episode_lengths.tolist() == [0, 0], "the other environment's episode is remembered now"
assert not options, "the caller's options keep their mask now"
PYTHON
