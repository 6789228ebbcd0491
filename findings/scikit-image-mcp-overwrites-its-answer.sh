#!/usr/bin/env bash
# The costs that scikit-image's `MCP.find_costs` returned change when it is asked again: they are a view of
# its own array.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check scikit-image==0.26.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import skimage
from skimage.graph import MCP

planner = MCP(np.ones((5, 5)))
first, _ = planner.find_costs([(0, 0)])
seen = float(first[4, 4])
planner.find_costs([(4, 4)])
print("skimage", skimage.__version__)
print(f"Cost from (0, 0) to (4, 4): {seen:g}. The same entry after another call, from (4, 4): {first[4, 4]:g}.")
assert seen == 5.0 and first[4, 4] == 1.0, "find_costs returns a copy now"
PYTHON
