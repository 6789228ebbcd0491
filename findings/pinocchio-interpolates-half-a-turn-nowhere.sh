#!/usr/bin/env bash
# Pinocchio's `interpolate` over half a turn of a continuous joint stays at its start for every fraction, 1
# included.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pin==4.1.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import pinocchio

text = (
    '<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>'
)
model = pinocchio.buildModelFromXML(text)
start, end = np.array([1.0, 0.0]), np.array([-1.0, 0.0])  # cosine and sine: 0 and 180 degrees
halfway, last = pinocchio.interpolate(model, start, end, 0.5), pinocchio.interpolate(model, start, end, 1.0)
there = pinocchio.integrate(model, start, pinocchio.difference(model, start, end))
print("pinocchio", pinocchio.__version__)
print("From", start, "to", end, "- halfway:", halfway, "at the end:", last)
print("integrate(start, difference(start, end)):", there.round(12))
assert np.allclose(last, start), "interpolate arrives now"
assert np.allclose(there, end)
PYTHON
