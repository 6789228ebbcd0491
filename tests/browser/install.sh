#!/bin/bash
# Installs what the tests in this folder need: playwright for Python into the interpreter named (python3 by
# default), and Debian's chromium. Without them those tests skip, and say so.
#   tests/browser/install.sh .venv-test/bin/python
set -eu
here=$(cd "$(dirname "$0")" && pwd)
python=${1:-python3}
"$python" -m pip install --quiet --constraint "$here/../../constraints.txt" playwright
if ! command -v chromium chromium-browser google-chrome >/dev/null; then
    sudo=$([ "$(id -u)" = 0 ] || echo sudo)
    $sudo apt-get update -qq
    $sudo apt-get install -y -qq chromium
fi
