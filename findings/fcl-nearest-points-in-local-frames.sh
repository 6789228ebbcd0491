#!/usr/bin/env bash
# python-fcl gives the nearest points of a mesh and a sphere in the frame of each object; those of two boxes, of
# two meshes, and of a mesh and a box are in the frame of the world. Nothing in the result says which it is.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check python-fcl==0.7.0.11 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import itertools
from importlib.metadata import version

import fcl
import numpy as np

print("python-fcl", version("python-fcl"))
corners = np.array(list(itertools.product([-0.5, 0.5], repeat=3)))
faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
mesh = fcl.BVHModel()
mesh.beginModel(len(corners), len(faces))
mesh.addSubModel(corners, np.array(faces))
mesh.endModel()


def points(first, second):
    """Nearest points of one shape at x = 5 and another at x = 8."""
    objects = [
        fcl.CollisionObject(shape, fcl.Transform(np.eye(3), np.array([x, 0.0, 0.0])))
        for shape, x in ((first, 5.0), (second, 8.0))
    ]
    result = fcl.DistanceResult()
    distance = fcl.distance(*objects, fcl.DistanceRequest(enable_nearest_points=True), result)
    return distance, [float(point[0]) for point in result.nearest_points]


box, ball = fcl.Box(1, 1, 1), fcl.Sphere(0.5)
print("A unit cube at x = 5 and something half as wide at x = 8; x of the nearest points, 5.5 and 7.5 in the world:")
for name, pair in {"box, sphere": (box, ball), "mesh, box": (mesh, box), "mesh, mesh": (mesh, mesh)}.items():
    print(f"  {name}: distance and points", *points(*pair))
    assert points(*pair)[1] == [5.5, 7.5], "this pair has another frame now"
print("  mesh, sphere: distance and points", *points(mesh, ball))
assert points(mesh, ball)[1] == [0.5, -0.5], "mesh and sphere are in the frame of the world now"
PYTHON
