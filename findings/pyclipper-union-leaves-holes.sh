#!/usr/bin/env bash
# pyclipper's union is by even-odd unless told otherwise: where two of the polygons overlap, the union has a hole.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pyclipper==1.4.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import pyclipper

print("pyclipper", version("pyclipper"))
clipper = pyclipper.Pyclipper()
for square in ([(0, 0), (20, 0), (20, 20), (0, 20)], [(10, 10), (30, 10), (30, 30), (10, 30)]):
    clipper.AddPath(square, pyclipper.PT_SUBJECT, True)


def area(*rule):
    return sum(pyclipper.Area(path) for path in clipper.Execute(pyclipper.CT_UNION, *rule))


both = pyclipper.PFT_NONZERO, pyclipper.PFT_NONZERO
print("Two squares of area 400 share one of area 100: their union has 700.")
print("CT_UNION:", area(), "- with the rule non-zero:", area(*both))
assert area() == 600.0, "the union is whole now"
assert area(*both) == 700.0
PYTHON
