#!/usr/bin/env bash
# A motion validator written in Python that checks as OMPL's own does gives KPIECE1 another tree.
# Expected: the same states are looked at, the same answers given, the same seed: the same tree, as RRT
#   grows
# Seen: KPIECE1 also keeps the free part of a motion that collides, which a Python validator cannot hand
#   over: it is asked for yes or no
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
    class Same(base.MotionValidator):
        """What OMPL's DiscreteMotionValidator does."""

        def __init__(self, information):
            super().__init__(information)

        def checkMotion(self, a, b):
            pieces = plane[0].validSegmentCount(a, b)
            between = plane[0].allocState()
            if not wall(b):
                return False
            for i in range(1, pieces):
                plane[0].interpolate(a, b, i / pieces, between)
                if not wall(between):
                    return False
            return True

    plane, same = [None], {}
    for name in ("RRT", "KPIECE1"):
        trees = []
        for own in (True, False):
            setup = planned(name, wall)
            plane[0] = setup.getStateSpace()
            if not own:
                setup.getSpaceInformation().setMotionValidator(Same(setup.getSpaceInformation()))
            setup.solve(limit())
            data = data_of(setup)
            states = [data.getVertex(i).getState() for i in range(data.numVertices())]
            trees.append(sorted((s[0], s[1]) for s in states))
        same[name] = trees[0] == trees[1]
    plane[0] = None
    print("same tree with OMPL's check and with ours:", same)
    return same["RRT"] and not same["KPIECE1"]


print("ompl", importlib.metadata.version("ompl"))
seen = main()
print("as described" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
PYTHON
