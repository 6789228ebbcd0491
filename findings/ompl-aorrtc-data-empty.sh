#!/usr/bin/env bash
# PlannerData of OMPL's AORRTC is empty after it has found a path.
# Expected: an exact solution: the data holds the trees that led to it
# Seen: no vertices and no edges
# Exits with 0 if that is still so, with 1 if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ompl==2.0.1
"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

from ompl import base, geometric, util


def planned(name, valid=lambda state: True, start=(1.0, 1.0), goal=(9.0, 9.0), seed=1):
    """A set-up in a square of 10 by 10 with one planner."""
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed)
    plane, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    bounds.setLow(0.0)
    bounds.setHigh(10.0)
    plane.setBounds(bounds)
    setup = geometric.SimpleSetup(plane)
    setup.setStateValidityChecker(valid)
    setup.setStartAndGoalStates(state(plane, start), state(plane, goal), 1e-9)
    setup.setPlanner(getattr(geometric, name)(setup.getSpaceInformation()))
    return setup


def state(plane, values):
    made = plane.allocState()
    made[0], made[1] = values
    return made


def wall(state):
    """Free beside a wall from below that leaves a gap."""
    return not (4.5 < state[0] < 5.5 and state[1] < 8)


def data_of(setup):
    data = base.PlannerData(setup.getSpaceInformation())
    setup.getPlanner().getPlannerData(data)
    return data


def limit(seconds=2.0):
    return base.timedPlannerTerminationCondition(seconds)


def main():
    setup = planned("AORRTC", wall)
    status, data = str(setup.solve(limit(1.0))), data_of(setup)
    print(status, "| states of the path:", setup.getSolutionPath().getStateCount())
    print("vertices:", data.numVertices(), "edges:", data.numEdges())
    return status == "Exact solution" and data.numVertices() == 0


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
