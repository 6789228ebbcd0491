#!/usr/bin/env bash
# shapely's `make_valid` on a MultiPolygon whose members overlap makes a hole of what they share: a point inside
# both of two obstacles is free afterwards. Only `method="structure"` gives the union.
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

print("shapely", shapely.__version__, "GEOS", shapely.geos_version_string)
obstacles = shapely.MultiPolygon([shapely.box(0, 0, 2, 2), shapely.box(1, 1, 3, 3)])
inside_both = shapely.Point(1.5, 1.5)
mended = shapely.make_valid(obstacles)
union = shapely.make_valid(obstacles, method="structure", keep_collapsed=False)
print("Two squares of area 4 share a square of area 1. The area of their union is 7.")
print("make_valid: area", mended.area, "- a point inside both is covered:", mended.covers(inside_both))
print('make_valid(method="structure"): area', union.area, "- covered:", union.covers(inside_both))
assert mended.area == 6.0 and not mended.covers(inside_both), "the overlap is kept now"
assert union.area == 7.0 and union.covers(inside_both)
PYTHON
