"""The oracle on MovingAI's scenarios, beside their published lengths and exact any-angle paths.

    python benchmarks/movingai.py arena.map.scen lak110d.map.scen

The maps lie beside the scenarios; both come from movingai.com, and none is in this repository. Published
lengths are those over a grid's eight directions, so a point's shortest path is never longer. The exact one
comes from a visibility graph, whose size is the square of the map's corners: a few hundred are quick.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from command_line import command_line, write_figures
from visibility_graph import visibility_distances

HAIR = 1e-4  # cells: what the exact path keeps from corners


def measure(scenario: Path, most: int) -> dict[str, float]:
    """How far the oracle is from exact and published lengths, over up to ``most`` tasks of a scenario."""
    from guided_gym.catalogue.table import make_distribution
    from guided_gym.measure.oracle import Oracle

    problems = make_distribution(str(scenario))
    chosen = np.unique(np.linspace(0, len(problems.tasks) - 1, most).astype(int))
    rows = []
    for index in chosen[problems.lengths[chosen] > 0].tolist():
        problem = problems.problem(index)
        oracle = Oracle(problem.space, problem.task.goal)
        length = float(oracle.cost_to_go(problem.task.start))
        world, start = problem.environment, problem.task.start[None]
        (exact,) = visibility_distances(world.obstacles, world.bounds, problem.task.goal, start, HAIR)
        rows.append((length, exact, problems.lengths[index], oracle.error.mean))
    length, exact, published, stated = np.array(rows).T
    over = length / published - 1.0
    return {
        "tasks": float(len(rows)),
        "oracle / exact, least": float((length / exact).min()),
        "oracle / exact, mean": float((length / exact).mean()),
        "oracle / exact, most": float((length / exact).max()),
        "oracle / published, least": float((length / published).min()),
        "oracle / published, most": float((length / published).max()),
        "above published": float((over > 0).sum()),
        "above published by more than the stated mean error": float((over > stated).sum()),
    }


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("scenarios", type=Path, nargs="*", help="files *.scen")
    parser.add_argument("--tasks", type=int, default=100, help="how many of each, spread over all")
    options = parser.parse_args()
    if not options.scenarios:
        print("no scenario was given: nothing is compared")
    result = {scenario.name: measure(scenario, options.tasks) for scenario in options.scenarios}
    for name, figures in result.items():
        print(name)
        for key, value in figures.items():
            print(f"  {key:52s} {value:9.4f}")
    write_figures(options.json, result)


if __name__ == "__main__":
    main()
