#!/usr/bin/env bash
# Pinocchio reads a URDF `<capsule>` only where the robot says version="1.1"; otherwise the link loses all
# of its collision shapes, the spheres too.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pin==4.1.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import pinocchio

LINK = '<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
SHAPES = (
    '<collision><geometry><capsule radius="0.1" length="1"/></geometry></collision>'
    '<collision><geometry><sphere radius="0.2"/></geometry></collision></link>'
)
JOINT = '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>'


def shapes(version):
    text = f'<robot name="r"{version}><link name="base"/>{LINK}{SHAPES}{JOINT}</robot>'
    model = pinocchio.buildModelFromXML(text)
    kind = pinocchio.GeometryType.COLLISION
    return pinocchio.buildGeomFromUrdfString(model, text, kind).ngeoms


plain, newer = shapes(""), shapes(' version="1.1"')
print("pinocchio", pinocchio.__version__)
print(f"A link with a capsule and a sphere has {newer} shapes with version=1.1, and {plain} without, no error raised.")
assert (plain, newer) == (0, 2), "capsules are read, or refused, now"
PYTHON
