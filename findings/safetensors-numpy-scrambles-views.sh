#!/usr/bin/env bash
# `safetensors.numpy.save` of an array that is not contiguous (transposed, or every other element) keeps its
# shape and stores other values.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check safetensors==0.8.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import safetensors
from safetensors.numpy import load, save

weights = np.arange(6.0).reshape(2, 3)
views = {"transposed": weights.T, "strided": np.arange(8.0)[::2]}
read = load(save(views))
print("safetensors", safetensors.__version__)
for name, view in views.items():
    print(f"{name}: saved {view.tolist()}, loaded {read[name].tolist()}")
    assert read[name].shape == view.shape
    assert not np.array_equal(read[name], view), "views are saved as they are now"
whole = {name: np.ascontiguousarray(view) for name, view in views.items()}
assert all(np.array_equal(load(save(whole))[name], view) for name, view in views.items())
print("Made contiguous first, both come back as they were.")
PYTHON
