#!/usr/bin/env bash
# A URDF joint whose lower and upper limits are equal, which fixes it for other readers, turns freely in MuJoCo:
# the limits are read and kept in the model, but not enforced, as a warning says.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np

ROBOT = """<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="{}" upper="{}" effort="1" velocity="1"/></joint>
</robot>"""


def turned(lower, upper):
    """(is limited, where a steady push takes the joint in a second)."""
    model = mujoco.MjModel.from_xml_string(ROBOT.format(lower, upper))
    data = mujoco.MjData(model)
    data.qpos[0] = lower
    data.qfrc_applied[:] = 2.0
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    return bool(model.jnt_limited[0]), float(data.qpos[0])


print("mujoco", mujoco.__version__)
for lower, upper in ((0.5, 0.51), (0.5, 0.5)):
    limited, angle = turned(lower, upper)
    print(f"limits {lower} and {upper}: limited {limited}; pushed for a second, it stands at {angle:.2f}")
narrow, equal = turned(0.5, 0.51), turned(0.5, 0.5)
assert narrow[0] and narrow[1] < 0.6
assert not equal[0] and equal[1] > 1.0, "equal limits hold the joint now"
PYTHON
