#!/usr/bin/env bash
# shapely keeps the grid of `set_precision` on a geometry, and a later `buffer` rounds to it: the buffer of
# a square may be empty.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check shapely==2.2.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import shapely

square = shapely.box(0, 0, 10, 10)
rounded = shapely.set_precision(square, 1.0)
print("shapely", shapely.__version__, "GEOS", shapely.geos_version_string)
print("A square of 10 x 10 whose corners lie on the grid of size 1 anyway:", rounded.equals(square))
before, after = square.buffer(0.3), rounded.buffer(0.3)
print("Area of its buffer of 0.3 without the grid:", round(before.area, 3))
print("Area of its buffer of 0.3 with the grid:", round(after.area, 3), "-", after.wkt)
free = shapely.set_precision(rounded, 0.0).buffer(0.3)
print("After set_precision(..., 0) again:", round(free.area, 3))
assert before.area > 112 and free.area > 112
assert after.is_empty, "the buffer is not empty any more"
PYTHON
