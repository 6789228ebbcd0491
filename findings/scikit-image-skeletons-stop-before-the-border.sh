#!/usr/bin/env bash
# scikit-image's `skeletonize` and `thin` end half the width of a corridor before the border of the image,
# `medial_axis` does not: a roadmap made of the former has no way out of the map.
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
from skimage.morphology import medial_axis, skeletonize, thin

corridor = np.zeros((21, 60), bool)
corridor[5:16] = True  # 11 cells wide, from border to border
spans = {}
for method in (skeletonize, thin, medial_axis):
    columns = np.nonzero(method(corridor))[1]
    spans[method.__name__] = int(columns.min()), int(columns.max())
print("scikit-image", skimage.__version__)
print("A corridor of 11 cells runs from column 0 to column 59. First and last column of its skeleton:")
print(spans)
assert spans["medial_axis"] == (0, 59)
assert spans["skeletonize"][0] >= 3 and spans["skeletonize"][1] <= 56, "skeletonize reaches the border now"
assert spans["thin"][0] >= 3 and spans["thin"][1] <= 56, "thin reaches the border now"
PYTHON
