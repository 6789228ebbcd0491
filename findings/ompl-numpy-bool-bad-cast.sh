#!/usr/bin/env bash
# A validity check that returns numpy's bool ends OMPL's planners with "std::bad_cast".
# Expected: np.bool_ is taken for a bool, as a comparison of two numpy numbers gives one
# Seen: RuntimeError: std::bad_cast, without a word of what was cast; Python's bool works
# Exits with 0 if that is still so, with 1 if it has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ompl==2.0.1 numpy==2.4.6
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


def limit(seconds=2.0):
    return base.timedPlannerTerminationCondition(seconds)


def main():
    import numpy as np

    setup = planned("RRT", lambda s: np.float64(s[0]) < 100)
    try:
        print(setup.solve(limit()))
    except RuntimeError as error:
        print("RuntimeError:", error)
        return str(error) == "std::bad_cast"
    return False


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
