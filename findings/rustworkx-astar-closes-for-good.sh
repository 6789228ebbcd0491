#!/usr/bin/env bash
# rustworkx' `astar_shortest_path` needs a *consistent* estimate of the cost that is left. With one that is only
# never too high, which is enough for A* as networkx has it, the path may not be the shortest.
#
# Installs the pinned packages into a temporary folder, shows the behaviour, and fails if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check rustworkx==0.18.1 networkx==3.6.1
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import networkx as nx
import rustworkx as rx

print("rustworkx", rx.__version__, "networkx", nx.__version__)
edges = [("s", "a", 1.0), ("s", "b", 3.0), ("a", "b", 1.0), ("b", "t", 3.0)]
left = {"s": 0.0, "a": 4.0, "b": 0.0, "t": 0.0}  # the true costs are 5, 4, 3 and 0: never too high

graph = rx.PyDiGraph()
index = {name: graph.add_node(name) for name in left}
graph.add_edges_from([(index[u], index[v], w) for u, v, w in edges])
found = rx.astar_shortest_path(graph, index["s"], lambda n: n == "t", float, lambda n: left[n])
path = [graph[i] for i in found]

other = nx.DiGraph()
other.add_weighted_edges_from(edges)
shortest = nx.astar_path(other, "s", "t", lambda u, v: left[u])

print("rustworkx:", " ".join(path), "of length 6; networkx:", " ".join(shortest), "of length 5")
print("A node that was expanded is not opened again when a shorter way to it is found.")
assert path == ["s", "b", "t"], "the shortest path is found now"
assert shortest == ["s", "a", "b", "t"]
PYTHON
