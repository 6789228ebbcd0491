#!/usr/bin/env bash
# scipy's `KDTree.query_ball_point` with exactly the distance that `query` returned often leaves out that
# very neighbour.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import scipy
from scipy.spatial import KDTree

rng = np.random.default_rng(0)
tree = KDTree(rng.random((1000, 2)))
missed = 0
for q in rng.random((1000, 2)):
    distances, rows = tree.query(q, k=5)
    missed += int(rows[-1]) not in tree.query_ball_point(q, distances[-1])
print("scipy", scipy.__version__)
print("1,000 queries for the five nearest of 1,000 points, then for all within the fifth distance.")
print("The fifth neighbour is not within its own distance in", missed, "of 1,000 cases.")
assert missed > 100, "the ball holds its neighbour now"
PYTHON
