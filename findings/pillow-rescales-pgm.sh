#!/usr/bin/env bash
# Pillow rescales the grey values of a PGM whose maximum is not 255, so the 205 of a map server's unknown
# cells becomes 206 where the maximum is 254.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pillow==13.0.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import io

import numpy as np
import PIL
from PIL import Image

file = b"P5\n3 1\n254\n" + bytes([0, 205, 254])
values = np.array(Image.open(io.BytesIO(file)))[0].tolist()
print("Pillow", PIL.__version__)
print("Bytes of the file: 0, 205, 254, with 254 as their maximum. What Pillow reads:", values)
assert values == [0, 206, 255], "Pillow keeps the values now"
PYTHON
