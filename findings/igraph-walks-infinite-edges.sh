#!/usr/bin/env bash
# igraph's `get_shortest_path` returns a path over an edge of infinite weight, as if there were a way.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check igraph==1.0.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import igraph

graph = igraph.Graph(edges=[(0, 1), (1, 2)])
weights = [1.0, float("inf")]  # the second edge is closed
length, path = graph.distances(0, 2, weights=weights)[0][0], graph.get_shortest_path(0, 2, weights=weights)
print("igraph", igraph.__version__)
print(f"Length of the shortest way from 0 to 2 over a closed edge: {length}. The path: {path}")
assert length == float("inf") and path == [0, 1, 2], "no path is returned now"
PYTHON
