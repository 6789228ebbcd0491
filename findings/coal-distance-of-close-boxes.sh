#!/usr/bin/env bash
# coal's `distance` of two facing boxes some 1e-6 apart can be -1.8e308, and clearly negative for other
# small gaps.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check coal==3.0.3 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import coal
import numpy as np

box = coal.Box(1.0, 1.0, 1.0)
here, there = coal.Transform3s.Identity(), coal.Transform3s.Identity()
gaps = np.geomspace(1e-8, 1e-4, 400)
wrong = []
for gap in gaps:
    there.setTranslation(np.array([1.0 + gap, 0.0, 0.0]))
    distance = coal.distance(box, here, box, there, coal.DistanceRequest(), coal.DistanceResult())
    if abs(distance - gap) > 1e-5:
        wrong.append((float(gap), distance))
print("coal", coal.__version__)
print("Unit boxes face each other, 400 gaps from 1e-8 to 1e-4. Wrong by more than 1e-5:", len(wrong))
print("The first and the least answer:", wrong[0], min(value for _, value in wrong))
assert min(value for _, value in wrong) < -1.0, "the distances are right now"
PYTHON
