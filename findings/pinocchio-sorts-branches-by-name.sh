#!/usr/bin/env bash
# Pinocchio orders the joints of branches by their names, as text (j10 before j2); yourdfpy keeps the order
# of the file: the same vector of positions moves other joints.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pin==4.1.0 yourdfpy==0.0.60 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

import pinocchio
import yourdfpy

text = '<robot name="b"><link name="base"/>'
for k in (1, 2, 10):
    text += (
        f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="base"/><child link="l{k}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
Path("b.urdf").write_text(text + "</robot>")
one = list(pinocchio.buildModelFromXML(text + "</robot>").names)[1:]
other = list(yourdfpy.URDF.load("b.urdf").actuated_joint_names)
print("pinocchio", pinocchio.__version__, "yourdfpy", version("yourdfpy"))
print("Joints in the file: j1, j2, j10. Pinocchio:", one, "yourdfpy:", other)
assert one == ["j1", "j10", "j2"] and other == ["j1", "j2", "j10"]
PYTHON
