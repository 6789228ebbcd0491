"""A guiding space of ours as a planner of OMPL: what OMPL has around a planner works with it.

    pip install '.[ompl]'
    python examples/ompl_guided.py --guidance medial_axis

OMPL 2.0.1's Python wheel lets a program write planners, goals, objectives, checks of motions and samplers of
valid states, and no sampler of the kind that RRT draws from: a guiding space cannot take the place of RRT's
samples there. It can be the planner. OMPL then asks for a path, simplifies it, and keeps it as its own.
"""

from __future__ import annotations

import argparse

from guided_gym import Problem, guided_search, make_distribution


def planned(problem: Problem, guidance: str, seed: int) -> tuple[float, float]:
    """Length of the path that OMPL has from its guided planner, and of what its simplifier makes of it."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_WARN)
    space = base.SE2StateSpace()
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(problem.space.lower[axis]))
        bounds.setHigh(axis, float(problem.space.upper[axis]))
    space.setBounds(bounds)
    space.setSubspaceWeight(1, float(problem.space.weights[2]))

    def state(q: list[float]) -> base.State:
        made = space.allocState()
        made.setX(q[0])
        made.setY(q[1])
        made.setYaw(q[2])
        return made

    class Guided(base.Planner):
        """Guided search with a guiding space of guided-gym."""

        def __init__(self, information: base.SpaceInformation) -> None:
            super().__init__(information, f"guided by {guidance}")

        def solve(self, ending: base.PlannerTerminationCondition) -> base.PlannerStatus:
            result = guided_search(problem, guidance, seed=seed, measure=False)
            if result.path is None:
                return base.PlannerStatus(False, False)
            path = geometric.PathGeometric(self.getSpaceInformation())
            for q in result.path.tolist():
                path.append(state(q))
            self.getProblemDefinition().addSolutionPath(path, False, 0.0, self.getName())
            return base.PlannerStatus(True, False)

        def clear(self) -> None:
            super().clear()

    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda s: bool(problem.space.valid([s.getX(), s.getY(), s.getYaw()])))
    setup.setStartAndGoalStates(state(problem.task.start.tolist()), state(problem.task.goal.tolist()))
    setup.setPlanner(Guided(setup.getSpaceInformation()))
    print(setup.solve(10.0))
    found = setup.getSolutionPath().length()
    setup.simplifySolution()
    return found, setup.getSolutionPath().length()


def main() -> None:
    """Plan, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--env", default="TrapCup")
    parser.add_argument("--guidance", default="hybrid")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    problem = make_distribution(options.env).problem(options.seed)
    found, simplified = planned(problem, options.guidance, options.seed)
    print(f"length {found:.2f} in OMPL's metric, {simplified:.2f} simplified by OMPL")


if __name__ == "__main__":
    main()
