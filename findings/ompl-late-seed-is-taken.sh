#!/usr/bin/env bash
# OMPL says that a late seed "will not lead to deterministic sampling", and then samples
# deterministically.
# Expected: after the error message of a second RNG.setSeed, runs differ
# Seen: the message is an error, and runs with the same late seed are the same, state for state
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


def limit(seconds=2.0):
    return base.timedPlannerTerminationCondition(seconds)


def main():
    paths = []
    for seed in (7, 7, 8):
        setup = planned("RRT", wall, seed=seed)
        util.setLogLevel(util.LOG_ERROR)
        util.RNG.setSeed(seed)  # says that it will not work
        setup.setPlanner(geometric.RRT(setup.getSpaceInformation()))
        util.setLogLevel(util.LOG_NONE)
        setup.solve(limit())
        path = setup.getSolutionPath()
        paths.append([(path.getState(i)[0], path.getState(i)[1]) for i in range(path.getStateCount())])
    print("same seed, same path:", paths[0] == paths[1], "| other seed, other path:", paths[0] != paths[2])
    return paths[0] == paths[1] != paths[2]


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
