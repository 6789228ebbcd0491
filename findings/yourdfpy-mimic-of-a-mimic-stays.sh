#!/usr/bin/env bash
# In yourdfpy a joint that mimics a joint which is a mimic itself does not move.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check yourdfpy==0.0.60 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yourdfpy

text = '<robot name="m"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/>'
for k, mimic in ((1, ""), (2, '<mimic joint="j1"/>'), (3, '<mimic joint="j2"/>')):
    text += (
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="0 0 1"/>'
        f'<limit lower="-3" upper="3" effort="1" velocity="1"/>{mimic}</joint>'
    )
Path("m.urdf").write_text(text + "</robot>")
robot = yourdfpy.URDF.load("m.urdf")
robot.update_cfg([0.5])
turns = []
for k in (1, 2, 3):
    pose = robot.get_transform(f"l{k}", f"l{k - 1}")
    turns.append(round(float(np.arctan2(pose[1, 0], pose[0, 0])), 6))
print("yourdfpy", version("yourdfpy"))
print("j1 is set to 0.5; j2 mimics j1, j3 mimics j2. Their angles:", turns)
assert turns == [0.5, 0.5, 0.0], "j3 follows now"
PYTHON
