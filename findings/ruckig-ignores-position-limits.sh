#!/usr/bin/env bash
# The free version of ruckig takes `max_position` without a word and returns a trajectory that goes beyond
# it.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check ruckig==0.19.4
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

from ruckig import InputParameter, Ruckig, Trajectory

task = InputParameter(1)
task.current_position, task.current_velocity, task.current_acceleration = [0.0], [1.0], [0.0]
task.target_position, task.target_velocity, task.target_acceleration = [0.1], [0.0], [0.0]
task.max_velocity, task.max_acceleration, task.max_jerk = [1.0], [1.0], [5.0]
task.min_position, task.max_position = [-0.1], [0.2]
trajectory = Trajectory(1)
result = Ruckig(1).calculate(task, trajectory)
extrema = trajectory.position_extrema[0]
print("ruckig", version("ruckig"))
print(f"Positions allowed: -0.1 to 0.2. Result: {result}; positions of the trajectory: "
      f"{extrema.min:.3f} to {extrema.max:.3f}")
assert extrema.max > 0.3, "the limit is kept, or refused, now"
PYTHON
