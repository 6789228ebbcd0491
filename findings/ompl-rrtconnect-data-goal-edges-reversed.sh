#!/usr/bin/env bash
# Edges of OMPL's RRTConnect data run towards the goal in its goal tree: the goal has no outgoing edge.
# Expected: two trees, each with edges from parent to child, as from the start
# Seen: the goal tree's edges run from child to parent: following edges from the goal leads nowhere
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
    setup = planned("RRTConnect", wall)
    print(setup.solve(limit()))
    data = data_of(setup)
    start, goal = data.getStartIndex(0), data.getGoalIndex(0)
    counts = [(len(data.getEdges(i)), len(data.getIncomingEdges(i))) for i in (start, goal)]
    print("edges out of and into the start, and the goal:", counts)
    return counts[0][0] > 0 and counts[0][1] == 0 and counts[1][0] == 0 and counts[1][1] > 0


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
