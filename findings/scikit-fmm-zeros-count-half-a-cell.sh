#!/usr/bin/env bash
# scikit-fmm puts the front half a cell outside of a block of zeros, so all distances from a goal drawn as
# zeros are too short by about half a cell.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check scikit-fmm==2025.6.23 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
import skfmm

start = np.ones((101, 101))
start[45:56, 45:56] = 0.0  # the goal: its last cell has index 55
near, far = (float(skfmm.distance(start)[i, 50]) for i in (60, 90))
first = float(skfmm.distance(start, order=1)[60, 50])
print("scikit-fmm", version("scikit-fmm"))
print("A goal of 11 x 11 cells is drawn as zeros, all other cells as ones; cells have side 1.")
print(f"Distance of the cells 5 and 35 beyond its last cell: {near:.3f} and {far:.3f} at order 2 (default), "
      f"{first:.3f} for the first at order 1.")
assert abs(near - 4.5) < 0.01 and abs(far - 34.5) < 0.01, "zeros are where the front is now"
assert abs(first - 5.0) < 1e-6
PYTHON
