#!/usr/bin/env bash
# scipy's `distance_transform_edt` of a map without any obstacle is not infinite: it measures to a cell
# outside of the map.
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
from scipy.ndimage import distance_transform_edt

free = np.ones((3, 4), bool)
distances = distance_transform_edt(free)
print("scipy", scipy.__version__)
print("Distance to the nearest obstacle on a map of 3 x 4 free cells, without an obstacle:")
print(distances.round(3))
rows, columns = np.indices(free.shape)
phantom = np.hypot(rows + 1, columns)
print("These are the distances to a cell at (-1, 0), which there is not.")
assert np.allclose(distances, phantom), "the phantom obstacle has gone or moved"
PYTHON
