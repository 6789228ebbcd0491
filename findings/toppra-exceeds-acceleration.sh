#!/usr/bin/env bash
# toppra's default parametrizer gives trajectories that exceed the acceleration limits which the
# parametrization was computed for; `ParametrizeConstAccel` keeps them.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check toppra==0.6.10 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
import toppra
from toppra import algorithm, constraint

toppra.setup_logging("ERROR")
points = np.array([[0, 0], [1, 0.2], [1.2, 1], [2, 1.2], [3, 0]], float)
path = toppra.SplineInterpolator(np.linspace(0, 1, len(points)), points)
ones = np.array([[-1.0, 1.0], [-1.0, 1.0]])
limits = [constraint.JointVelocityConstraint(ones), constraint.JointAccelerationConstraint(ones)]


def worst(**options):
    trajectory = algorithm.TOPPRA(limits, path, **options).compute_trajectory(0, 0)
    return float(np.abs(trajectory(np.linspace(0, trajectory.duration, 4001), 2)).max())


default, constant = worst(), worst(parametrizer="ParametrizeConstAccel")
print("toppra", version("toppra"))
print("Five waypoints, two joints, velocity and acceleration limited to 1 each.")
print(f"Largest acceleration on the trajectory: {default:.4f} by default, "
      f"{constant:.4f} with ParametrizeConstAccel.")
assert default > 1.05, "the default keeps the limit now"
assert constant < 1.01, "ParametrizeConstAccel does not keep the limit any more"
PYTHON
