#!/usr/bin/env bash
# manifold3d draws a circle with as many corners as its radius in absolute units asks for: one of radius 0.5 or
# less is a square inside the circle, a third too small, and so are cylinders; a sphere becomes an octahedron.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check manifold3d==3.5.4 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import math
from importlib.metadata import version

from manifold3d import CrossSection, Manifold

print("manifold3d", version("manifold3d"))
for radius in (0.3, 0.5, 1.0, 5.0):
    circle = CrossSection.circle(radius)
    corners, share = len(circle.to_polygons()[0]), circle.area() / (math.pi * radius**2)
    print(f"circle of radius {radius}: {corners} corners, {share:.2f} of the area")
cylinder = Manifold.cylinder(1.0, 0.4).volume() / (math.pi * 0.4**2)
sphere = Manifold.sphere(0.4).volume() / (4 / 3 * math.pi * 0.4**3)
print(f"cylinder and sphere of radius 0.4: {cylinder:.2f} and {sphere:.2f} of the volume")
print("In metres, the links of most robots are that small. The number of segments has to be given.")
assert len(CrossSection.circle(0.5).to_polygons()[0]) == 4, "small circles have more corners now"
assert cylinder < 0.65 and sphere < 0.35
assert Manifold.sphere(0.4, circular_segments=64).volume() / (4 / 3 * math.pi * 0.4**3) > 0.98
PYTHON
