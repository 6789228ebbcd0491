#!/usr/bin/env bash
# dtaidistance's `dtw.distance_fast` prunes by default and answers infinity for many pairs of series that
# are almost the same.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check dtaidistance==2.5.1 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
from dtaidistance import dtw

rng = np.random.default_rng(0)
series = rng.random((1000, 30))
near = series + 1e-9 * rng.random(series.shape)
fast = np.array([dtw.distance_fast(a, b) for a, b in zip(series, near)])
whole = np.array([dtw.distance_fast(a, b, use_pruning=False) for a, b in zip(series, near)])
print("dtaidistance", version("dtaidistance"))
print("1,000 series of 30 numbers, each with a copy that differs by at most 1e-9 in each number.")
print("Infinite distances:", int(np.isinf(fast).sum()), "of 1,000 by default,", int(np.isinf(whole).sum()), "without pruning")
print("Largest distance without pruning:", f"{whole.max():.2g}")
assert np.isinf(fast).sum() > 50, "pruning no longer loses near copies"
assert np.isfinite(whole).all() and whole.max() < 1e-7
PYTHON
