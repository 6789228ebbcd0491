#!/usr/bin/env bash
# OMPL's AORRTC keeps some 2 KiB of each run, with all of its objects given back.
# Expected: after the first runs memory stays as it is, as with RRTConnect, on which it builds
# Seen: it grows run by run, in a straight line
# Exits with 0 if that is still so, with 1 if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ompl==2.0.1
"$folder/venv/bin/python" - <<'PYTHON'
import gc
import importlib.metadata
import resource
import sys
from pathlib import Path

from ompl import base, geometric, util

EARLY, LATE = 500, 1500


def planned(name, seed):
    """One run around a wall, with objects of its own."""
    util.RNG.setSeed(seed)
    plane, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    bounds.setLow(0.0)
    bounds.setHigh(10.0)
    plane.setBounds(bounds)
    setup = geometric.SimpleSetup(plane)
    setup.setStateValidityChecker(lambda state: not (4.9 < state[0] < 5.1 and state[1] < 8))
    setup.setStartAndGoalStates(state(plane, 1.0), state(plane, 9.0), 1e-6)
    setup.setPlanner(getattr(geometric, name)(setup.getSpaceInformation()))
    setup.solve(base.exactSolnPlannerTerminationCondition(setup.getProblemDefinition()))
    return setup.haveExactSolutionPath()


def state(plane, x):
    made = plane.allocState()
    made[0], made[1] = x, 1.0
    return made


def pages():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1])


def grown(name):
    """MiB from run 500 to run 1,500."""
    before = 0
    for seed in range(1, LATE + 1):
        planned(name, seed)
        if seed == EARLY:
            before = pages()
    return (pages() - before) * resource.getpagesize() / 2**20


util.setLogLevel(util.LOG_NONE)
print("ompl", importlib.metadata.version("ompl"))
found = {name: grown(name) for name in ("RRTConnect", "AORRTC")}
for name, size in found.items():
    print(f"{name}: {size:.2f} MiB more after {LATE - EARLY:,} further runs")
seen = found["AORRTC"] > 1.0 > 4 * found["RRTConnect"]
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
