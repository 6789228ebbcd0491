#!/usr/bin/env bash
# PlannerData of OMPL's LBKPIECE1 has edges through walls, after an exact solution.
# Expected: the edges of a planner's data are motions that it found free, as those of BKPIECE1 are
# Seen: LBKPIECE1 checks late, and its data does not say which edges it has checked
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
    shares = {}
    for name in ("BKPIECE1", "LBKPIECE1"):
        setup = planned(name, wall)
        print(name, setup.solve(limit()))
        data, information = data_of(setup), setup.getSpaceInformation()
        pairs = [(i, j) for i in range(data.numVertices()) for j in data.getEdges(i)]
        bad = sum(
            not information.checkMotion(data.getVertex(i).getState(), data.getVertex(j).getState())
            for i, j in pairs
        )
        shares[name] = f"{bad} of {len(pairs)}"
    print("edges that are not free:", shares)
    return shares["BKPIECE1"].startswith("0 ") and not shares["LBKPIECE1"].startswith("0 ")


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
