"""Speed of the learned guidance and of the wavefront: the field of a problem, and a choice on a tree.

    python benchmarks/learned.py --json learned.json

A field is rasterised and solved for problems that were not seen before. Selections and proposals are timed on
trees of 500 and 2,000 nodes that grew by chance, with lazy_prm beside them for scale. With
`GUIDED_GYM_NEXT_DATA` set, whole searches on the NEXT mazes too, by that benchmark's rule. cpu is the
processor's time, the others are of the clock.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
from command_line import command_line, write_figures
from rich.console import Console
from rich.table import Table

from guided_gym import guided_search, make_guidance
from guided_gym.catalogue.table import make_distribution
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.options import SearchOptions
from guided_gym.randomness import streams
from guided_gym.search.search import Search

FIELDS = (
    ("learned:se2", "RandomTrapCup"),
    ("learned:se2", "RandomMaze"),
    ("learned:se2", "RandomClutter"),
    ("learned:point", "HardPointMaze"),
    ("learned:stick", "HardStickMaze"),
    ("wavefront", "RandomClutter"),
)
CHOICES = ("learned:se2", "wavefront", "lazy_prm")
SIZES = (500, 2000)
FIELD_LIMIT, CHOICE_LIMIT = 50.0, 1.0  # ms
NEXT = (("learned:point", "NextPoint", 229.0), ("learned:stick", "NextStick", 659.0))  # ms of NEXT's own
NEXT_STEP = 0.141


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)


def row(times: list[tuple[float, float]], limit: float | None = None) -> dict[str, float]:
    wall, cpu = np.array(times).T
    figures = {
        "mean": wall.mean(),
        "median": np.median(wall),
        "p99": np.quantile(wall, 0.99),
        "cpu": cpu.mean(),
    }
    if limit is not None:
        figures["limit"] = limit
    return {name: float(value) for name, value in figures.items()}


def field_times(name: str, environment: str, problems: int) -> dict[str, float]:
    """Of raster, encoder and wave, finer grids included where they were needed."""
    guidance = make_guidance(name)
    assert isinstance(guidance, Composed) and isinstance(guidance.solver, Wave)
    distribution = make_distribution(f"{environment}@validation")
    guidance.solver.model.solve(distribution.problem(0))  # compiles
    posed = [distribution.problem(i) for i in range(1, problems + 1)]
    return row([timed(lambda p=problem: guidance.solver.model.solve(p)) for problem in posed], FIELD_LIMIT)


def choice_times(name: str, size: int, choices: int) -> dict[str, dict[str, float]]:
    """Of selecting a node, and of proposing its expansion, on a tree that goes on growing by chance."""
    problem = make_distribution("TrapCup").problem(0)
    _, expansion, own = streams(0)
    search, guidance = Search(problem, expansion, own), make_guidance(name)
    search.attach(guidance)
    walk = np.random.default_rng(0)

    def grow() -> None:
        node = int(walk.integers(len(search.tree)))
        search.expand(node, search.planner.uniform(search.tree.configurations[node]))

    while len(search.tree) < size:
        grow()
    guidance.propose(search.tree, guidance.select(search.tree))  # compiles
    select, propose = [], []
    for _ in range(choices):
        grow()
        select.append(timed(lambda: guidance.select(search.tree)))
        node = guidance.select(search.tree)
        propose.append(timed(lambda n=node: guidance.propose(search.tree, n)))
    limit = CHOICE_LIMIT if size == SIZES[0] and name != "lazy_prm" else None
    return {
        f"select, {name}, {size:,} nodes": row(select, limit),
        f"propose, {name}, {size:,} nodes": row(propose),
    }


def next_times(name: str, environment: str, mazes: int, theirs: float) -> dict[str, float]:
    """Of whole searches on held-out mazes; the limit is a fifth of what NEXT itself takes."""
    guidance, options = make_guidance(name), SearchOptions(step=NEXT_STEP)
    distribution = make_distribution(f"{environment}@validation")

    def search(i: int) -> None:
        guided_search(
            distribution.problem(i), guidance, seed=i, max_samples=500, measure=False, options=options
        )

    search(0)  # compiles
    return row([timed(lambda i=i: search(i)) for i in range(1, mazes)], theirs / 5)


def measure(problems: int, choices: int, mazes: int) -> dict[str, dict[str, float]]:
    rows = {}
    for name, environment in FIELDS:
        rows[f"field, {name} on {environment}"] = field_times(name, environment, problems)
    for size in SIZES:
        for name in CHOICES:
            rows |= choice_times(name, size, choices)
    if os.environ.get("GUIDED_GYM_NEXT_DATA"):
        for name, environment, theirs in NEXT:
            rows[f"search, {name} on {environment}"] = next_times(name, environment, mazes, theirs)
    return rows


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--problems", type=int, default=60, help="problems of each distribution")
    parser.add_argument("--choices", type=int, default=300, help="choices on each tree")
    parser.add_argument("--mazes", type=int, default=300, help="NEXT mazes")
    options = parser.parse_args()
    rows = measure(options.problems, options.choices, options.mazes)
    table = Table("ms", "mean", "median", "99 %", "cpu", "limit")
    for label, r in rows.items():
        table.add_row(
            label, *(f"{r[key]:.3g}" if key in r else "" for key in ("mean", "median", "p99", "cpu", "limit"))
        )
    Console().print(table)
    write_figures(options.json, rows)


if __name__ == "__main__":
    main()
