"""Accuracy and speed of the oracle, beside scikit-fmm on the same grids.

    python benchmarks/oracle.py --json oracle.json

Point robots among polygons are compared with the exact visibility-graph distance; the rectangle, which
has no exact reference, with a solve at four times the default resolution. scikit-fmm (left out if it is not
installed) gets the same poses and the same mask of free vertices, second order, and the exact distance to a
small sphere around the goal as its start; it knows nothing of walls between vertices. It is interpolated
linearly, and only poses where all corners are finite count in the columns "%" of both ("all %" counts every
valid pose). Times of solves are of the processor, in ms, after compilation; the oracle's include finding the
free vertices, which scikit-fmm is given for nothing.

Then floors of buildings against grids four times finer, and for random problems certified paths (of wavefront
searches, shortened) against the optimum, and the cost-to-go along the edges of the trees, which are free.

    python benchmarks/oracle.py --roadmaps

Roadmaps in two and three dimensions against grids whose estimated error is 0.3 % on average, instead.
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import tempfile
import time

import numpy as np
import shapely
from command_line import command_line, write_figures
from rich.console import Console
from rich.table import Table
from scipy.interpolate import RegularGridInterpolator
from visibility_graph import visibility_distances

from guided_gym.catalogue.table import make_distribution
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.cost_query import cost_to_go_many, cost_to_go_one
from guided_gym.measure.certified import lengths_left, shortest_down
from guided_gym.measure.oracle import Oracle, oracle_for
from guided_gym.options import OracleOptions
from guided_gym.planning import guided_search
from guided_gym.train.paths import shortcut

try:
    import skfmm
except ImportError:
    skfmm = None

BOUNDS = (0.0, 0.0, 10.0, 10.0)


def clutter(rng, n=12):
    """Disjoint random convex polygons."""
    kept = []
    while len(kept) < n:
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        ring = rng.uniform(0, 10, 2) + rng.uniform(0.4, 1.2) * np.c_[np.cos(angles), np.sin(angles)]
        polygon = shapely.Polygon(ring).convex_hull.intersection(shapely.box(*BOUNDS))
        if polygon.area > 0.05 and all(polygon.distance(other) > 0.1 for other in kept):
            kept.append(polygon)
    return kept


def wall(rng):
    """A thick wall with one gap, at a random place."""
    x, y, width = rng.uniform(3.5, 5), rng.uniform(2, 8), rng.uniform(0.7, 0.8)
    return [shapely.box(x, -1, x + 1.5, y - width / 2), shapely.box(x, y + width / 2, x + 1.5, 11)]


def cup(rng):
    """A C-shaped dead end that opens to the left."""
    x, y, s = rng.uniform(4, 5), rng.uniform(4.5, 5.5), 1.8
    return [
        shapely.box(x, y - s, x + 3, y - s + 0.4),
        shapely.box(x, y + s - 0.4, x + 3, y + s),
        shapely.box(x + 2.6, y - s, x + 3, y + s),
    ]


def peer_costs(oracle, q):
    """scikit-fmm on the oracle's grid: costs (NaN where a corner is missing) and solving time."""
    space, axes = oracle.space, oracle.axes
    poses = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    exact = space.distance(poses, oracle.goal)
    steps = [axis[1] - axis[0] for axis in axes] * space.weights
    sphere = 2.0 * max(steps)
    phi = np.ma.MaskedArray(exact - sphere, ~np.isfinite(oracle.field))
    periodic = [period > 0 for period in space.periods]
    start = time.process_time()
    solved = skfmm.distance(phi, dx=steps.tolist(), order=2, periodic=periodic)
    took = time.process_time() - start
    field = np.ma.filled(solved, np.nan) + sphere
    if space.dimension == 3:  # close the circle for the interpolator
        axes = (*axes[:2], np.append(axes[2], axes[2][0] + 2 * np.pi))
        field = np.concatenate([field, field[..., :1]], axis=-1)
    read = RegularGridInterpolator(axes, field, bounds_error=False)
    return read(q), took


def compare(space, goal, q, exact):
    """One problem: relative errors and times of the oracle and its peer."""
    start = time.process_time()
    oracle = Oracle(space, goal, cache=False)
    row = {"oracle ms": 1e3 * (time.process_time() - start)}
    cost = oracle.cost_to_go(q)
    row["oracle infinite"] = int(np.isinf(cost).sum())
    row["oracle all %"] = 100 * float(np.mean(np.abs(cost / exact - 1)))
    if skfmm is not None:
        peer, took = peer_costs(oracle, q)
        both = np.isfinite(peer) & np.isfinite(cost)
        row["oracle %"] = 100 * float(np.mean(np.abs(cost / exact - 1)[both]))
        row["scikit-fmm %"] = 100 * float(np.mean(np.abs(peer / exact - 1)[both]))
        row["scikit-fmm ms"] = 1e3 * took
    return row


def accuracy(kind, problems):
    """Mean errors and times over random problems of one kind."""
    rows = []
    for seed in range(problems):
        rng = np.random.default_rng(seed)
        if kind == "point, clutter":
            obstacles, robot = clutter(rng), Robot.point()
        else:
            obstacles = wall(rng) if kind == "rectangle, passage" else cup(rng)
            robot = Robot.rectangle(1.0, 0.4)
        space = ConfigurationSpace(robot, Environment(BOUNDS, tuple(obstacles)))
        q = space.sample(rng, 4000)
        q = q[space.valid(q)]
        goal, q = q[0], q[1:]
        if space.dimension == 2:
            exact = visibility_distances(obstacles, BOUNDS, goal, q)
        else:
            fine = [4 * n for n in Oracle(space, goal, cache=False).resolution]
            exact = Oracle(space, goal, resolution=fine, cache=False).cost_to_go(q)
        reached = np.isfinite(exact) & (exact > 0.5)
        rows.append(compare(space, goal, q[reached], exact[reached]))
    mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    return {
        "kind": kind,
        "problems": problems,
        "oracle worst %": max(r["oracle all %"] for r in rows),
        **mean,
    }


def building(seed, finer):
    """A floor of the catalogue against a finer grid: what was estimated, what is true, and the time."""
    problem = make_distribution("Building" if seed is None else "RandomBuilding").problem(seed or 0)
    space, task = problem.space, problem.task
    start = time.process_time()
    oracle = Oracle(space, task.goal, start=task.start, cache=False)
    took = time.process_time() - start
    q = space.sample(np.random.default_rng(3), 16_000)
    q = q[space.valid(q)][:8000]
    fine = Oracle(space, task.goal, resolution=[finer * n for n in oracle.resolution], cache=False)
    exact, cost = fine.cost_to_go(q), oracle.cost_to_go(q)
    known = np.isfinite(exact) & (exact > 0)
    error = np.abs(cost / exact - 1)[known]
    return {
        "floor": problem.name if seed is None else f"{problem.name} {seed}",
        "obstacles": len(problem.environment.obstacles),
        "poses": " x ".join(map(str, oracle.resolution)),
        "s": took,
        "estimated mean %": 100 * oracle.error.mean,
        "true mean %": 100 * float(error.mean()),
        "estimated tail %": 100 * oracle.error.tail,
        "true tail %": 100 * float(np.quantile(error, 0.99)),
    }


def certified(name, problems):
    """Certified paths of wavefront searches against the optimum, and cost-to-go along the trees' edges."""
    shorter, excess, seconds = [], [], []
    for seed in range(problems):
        problem = make_distribution(name).problem(seed)
        space, task = problem.space, problem.task
        start = time.process_time()
        oracle = Oracle(space, task.goal, start=task.start, cache=False)
        seconds.append(time.process_time() - start)
        result = guided_search(problem, "wavefront", seed=seed, max_samples=1500, measure=False)
        if result.path is not None:
            length = tight_length(space, result.path, np.random.default_rng(seed))
            shorter.append(1 - length / oracle.cost_to_go(task.start))
        n = len(result.tree)
        q, parents = result.tree.nodes.configurations[:n].copy(), result.tree.nodes.parents[1:n]
        cost, edges = oracle.cost_to_go(q), space.distance(q[1:], q[parents])
        excess += ((np.abs(cost[1:] - cost[parents]) - edges) / np.maximum(cost[1:], cost[parents])).tolist()
    return {
        "problems": name,
        "paths": len(shorter),
        "shorter by more than 1 %": int(np.sum(np.array(shorter) > 0.01)),
        "most %": 100 * max(shorter),
        "edges": len(excess),
        "off by more than 1 %": int(np.sum(~(np.array(excess) <= 0.01))),
        "worst %": 100 * float(np.max(excess)),
        "oracle s": float(np.mean(seconds)),
    }


def hardest(name, problems):
    """The optimum against the shortest path down the field of a much finer grid, pulled tight."""
    over = []
    for seed in range(problems):
        problem = make_distribution(name).problem(seed)
        space, task = problem.space, problem.task
        fine = Oracle(space, task.goal, resolution=(160, 160, 72), cache=False)
        link = float(np.max((fine.axes[0][1] - fine.axes[0][0]) * space.weights[:2]))
        path = shortest_down(space, fine.state, task.start, task.goal, link)
        if path is not None:  # the finer grid, too, may miss the way
            optimum = Oracle(space, task.goal, start=task.start, cache=False).cost_to_go(task.start)
            over.append(optimum / lengths_left(space, path)[0] - 1.0)
    return {
        "problems": name,
        "compared": len(over),
        "too long by more than 1 %": int(np.sum(np.array(over) > 0.01)),
        "most %": 100 * max(over),
        "mean %": 100 * float(np.mean(over)),
    }


TWO_AND_THREE = {
    "RandomClutter": 8,
    "RandomMaze": 2,
    "RandomTrapCup": 2,
    "HardStickMaze": 1,
    "SimplePassage": 1,
    "RandomPointMaze": 2,
    "HardPointMaze": 2,
}
"""Problems of each, for roadmaps beside grids."""


def beside_grid(name, seed, vertices):
    """Roadmaps of so many vertices, and the one of the default options, against a fine grid, at 400 poses."""
    problem = make_distribution(name).problem(seed)
    space, task = problem.space, problem.task
    fine = Oracle(
        space, task.goal, options=OracleOptions(mean=0.003, tail=0.03, budget=8_000_000), cache=False
    )
    q = space.sample(np.random.default_rng(seed), 4000)
    q = q[space.valid(q)]
    exact = fine.cost_to_go(q)
    known = np.flatnonzero(np.isfinite(exact) & (exact > 0))[:400]
    row = {"problem": f"{name} {seed}", "C": space.dimension, "grid, error %": 100 * fine.error.mean}
    for count in (*vertices, None):
        options = OracleOptions(method="roadmap", resolution=None if count is None else (count,))
        oracle = Oracle(space, task.goal, start=task.start, options=options, cache=False)
        error = np.abs(oracle.cost_to_go(q[known]) / exact[known] - 1)
        reached = np.isfinite(error)
        label = "chosen" if count is None else f"{count:,}"
        row[label] = 100 * float(error[reached].mean())
        row[f"{label}, estimated"] = 100 * oracle.error.mean
        row[f"{label}, vertices"] = oracle.resolution[0]
        row[f"{label}, not reached"] = int((~reached).sum())
    return row


def tight_length(space, path, rng):
    """Length of a path after three rounds of shortcuts between points along it."""
    for _ in range(3):
        parts = [path[:1]]
        for a, b in itertools.pairwise(path):
            count = max(1, math.ceil(float(space.distance(a, b)) / (0.25 * space.robot.radius)))
            parts.append(space.interpolate(a, b, np.arange(1, count + 1) / count))
        path = shortcut(space, np.concatenate(parts), rng, 400)
    return float(space.distance(path[:-1], path[1:]).sum())


def show(console, rows):
    """Rows with the same keys, as a table."""
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*[f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()])
    console.print(table)


def timed(action, repeats):
    """Median wall time of an action in seconds."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def speed():
    """A fresh problem, a cached one, one in memory, and queries; wall times."""
    space = ConfigurationSpace(
        Robot.rectangle(1.0, 0.4), Environment(BOUNDS, tuple(wall(np.random.default_rng(0))))
    )
    goal = np.array([9.0, 5.0, 0.0])
    oracle = oracle_for(space, goal)
    q = space.sample(np.random.default_rng(1), 20_000)
    q = q[space.valid(q)]
    cost_to_go_many(q, oracle.state)
    one = q[0].copy()
    cost_to_go_one(one, oracle.state)
    return {
        "fresh problem ms": 1e3 * timed(lambda: Oracle(space, goal, cache=False), 11),
        "from the disk cache ms": 1e3 * timed(lambda: Oracle(space, goal), 51),
        "from memory us": 1e6 * timed(lambda: oracle_for(space, goal), 101),
        "query in a batch us": 1e6 * timed(lambda: cost_to_go_many(q, oracle.state), 11) / len(q),
        "one query, compiled, called from Python us": 1e6
        * timed(lambda: cost_to_go_one(one, oracle.state), 2001),
        "one query, cost_to_go us": 1e6 * timed(lambda: oracle.cost_to_go(one), 2001),
    }


def main() -> int:
    """Run the benchmark."""
    parser = command_line(__doc__)
    parser.add_argument("--problems", type=int, default=8, help="random problems of each kind")
    parser.add_argument(
        "--certified", type=int, default=16, help="problems of each kind with certified paths"
    )
    parser.add_argument(
        "--hardest", type=int, default=4, help="problems of each kind with paths over a much finer grid"
    )
    parser.add_argument(
        "--finer", type=int, default=4, help="of buildings' reference; 4 takes 3 GB and a minute"
    )
    parser.add_argument("--roadmaps", action="store_true", help="roadmaps beside grids, and nothing else")
    options = parser.parse_args()
    console = Console()
    if options.roadmaps:
        rows = [beside_grid(name, k, (10_000,)) for name, n in TWO_AND_THREE.items() for k in range(n)]
        show(console, rows)
        errors = {key: float(np.mean([row[key] for row in rows])) for key in ("10,000", "chosen")}
        console.print("mean over the problems, %:", errors)
        return 0 if max(errors.values()) <= 2.0 else 1
    with tempfile.TemporaryDirectory() as folder:
        os.environ["GUIDED_GYM_CACHE"] = folder
        speeds = speed()
        kinds = ("point, clutter", "rectangle, passage", "rectangle, cup")
        results = [accuracy(kind, options.problems) for kind in kinds]
        floors = [building(seed, options.finer) for seed in (None, 0)]
        names = ("RandomClutter", "RandomTrapCup", "RandomMaze", "HardStickMaze")
        paths = [certified(name, options.certified) for name in names]
        hard = [hardest(name, options.hardest) for name in names if options.hardest]
    show(console, floors)
    show(console, paths)
    if hard:
        show(console, hard)
    if skfmm is None:
        console.print("scikit-fmm is not installed: no comparison")
    table = Table("", *[row["kind"] for row in results])
    for key in list(results[0])[1:]:
        table.add_row(key, *[f"{row[key]:.3g}" for row in results])
    console.print(table)
    for name, value in speeds.items():
        console.print(f"{name:45} {value:8.2f}")
    found = {
        "accuracy": results,
        "speed": speeds,
        "floors": floors,
        "certified": paths,
        "hardest": hard,
    }
    write_figures(options.json, found)
    return 0 if all(row["oracle all %"] <= 1.0 for row in results) else 1


if __name__ == "__main__":
    sys.exit(main())
