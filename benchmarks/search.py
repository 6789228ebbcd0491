"""Speed of searches: RRT beside OMPL's, failed expansions beside a full Dijkstra, and growth with the tree.

    python benchmarks/search.py --json search.json

OMPL's RRT is called from Python with the same compiled pose check, step, goal bias and goal rule, in the same
world, in which the goal is walled in, so that neither finds it. The two take turns; the ratio is taken turn
by turn, of the processor's time. OMPL checks motions at its usual 1 % of the extent; how many of its edges
are not free is counted with the certified check. Without `ompl` (extra `[bench]`) that part is left out.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from command_line import command_line, write_figures
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from shapely.geometry import box

from guided_gym.catalogue.table import cup, make_distribution, rectangle_robot, wall
from guided_gym.geometry.environment import Environment
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.graph import GraphCostToGo
from guided_gym.kernels.collision import pose_free
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search


def walled_in() -> Problem:
    """Two rooms and a passage; nobody gets to the goal."""
    closed = [*cup(7.0, 9.6, 6.8, 9.2, 0.2), box(7.0, 7.0, 7.2, 9.0)]
    environment = Environment((0, 0, 10, 10), (*wall(4.7, 5.3, (5.0, 0.9)), *closed))
    return Problem(rectangle_robot(), environment, Task((1.5, 2, 0), (8.5, 8, 0)), "walled in")


def ours(problem: Problem, samples: int, seed: int, bias: float) -> float:
    """Nodes per second of RRT in `guided_search`, certified motions and goal tests included."""
    began = time.process_time()
    guidance = make_guidance("rrt", goal_bias=bias)
    result = guided_search(problem, guidance, seed=seed, max_samples=samples, measure=False)
    return len(result.tree) / (time.process_time() - began)


def theirs(problem: Problem, samples: int, bias: float) -> tuple[float, float]:
    """Nodes per second of OMPL's RRT, and the share of its edges that are not free."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    space, step = problem.space, 0.05 * problem.space.extent
    se2, bounds = base.SE2StateSpace(), base.RealVectorBounds(2)
    bounds.setLow(0)
    bounds.setHigh(10)
    se2.setBounds(bounds)
    se2.setSubspaceWeight(1, float(space.weights[2]))
    q, geometry = np.zeros(3), space.geometry

    def valid(state: Any) -> bool:
        q[0], q[1], q[2] = state.getX(), state.getY(), state.getYaw()
        return pose_free(q, geometry)

    setup = geometric.SimpleSetup(se2)
    setup.setStateValidityChecker(valid)
    ends = []
    for x, y, theta in (problem.task.start, problem.task.goal):
        state = se2.allocState()
        state.setX(x)
        state.setY(y)
        state.setYaw(theta)
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRT(setup.getSpaceInformation())
    planner.setRange(step)
    planner.setGoalBias(bias)
    setup.setPlanner(planner)
    setup.setup()
    calls = 0

    def enough() -> bool:
        nonlocal calls
        calls += 1
        return calls > samples

    began = time.process_time()
    setup.solve(base.PlannerTerminationCondition(enough))
    seconds = time.process_time() - began
    data = base.PlannerData(setup.getSpaceInformation())
    planner.getPlannerData(data)
    return data.numVertices() / seconds, colliding(problem, data)


def colliding(problem: Problem, data: Any) -> float:
    """Share of the edges of a planner's data whose motion is not free."""

    def pose(vertex: Any) -> list[float]:
        state = data.getVertex(vertex).getState()
        return [state.getX(), state.getY(), state.getYaw()]

    pairs = []
    for i in range(data.numVertices()):
        pairs += [(pose(i), pose(j)) for j in data.getEdges(i)]
    starts, ends = np.array(pairs).transpose(1, 0, 2)
    return float(np.mean(~problem.space.motions_free(starts.copy(), ends.copy())))


def against_ompl(samples: int, turns: int, bias: float, by_edge: bool) -> dict[str, Any]:
    """Both planners in turn. With ``by_edge`` ours looks at the motion to the goal from each node, too."""
    problem = walled_in()
    rule = problem if by_edge else problem.ending(np.finfo(np.float64).eps, by_edge=False)  # as OMPL's
    ours(rule, 2000, 0, bias)
    theirs(problem, 100, bias)
    rows = [(ours(rule, samples, k, bias), *theirs(problem, samples, bias)) for k in range(turns)]
    mine, peer, share = np.array(rows).T
    return {
        "nodes_per_second": float(np.median(mine)),
        "ompl_nodes_per_second": float(np.median(peer)),
        "ratio_median": float(np.median(mine / peer)),
        "ratio_min": float(np.min(mine / peer)),
        "ompl_edges_not_free": float(share.mean()),
    }


def growth(guidance: str, sizes: tuple[int, ...], window: int) -> dict[str, float]:
    """Microseconds a sample (median) when the tree has about each of the given sizes."""
    problem = walled_in() if guidance == "rrt" else make_distribution("Cup").problem(0)
    guided_search(problem, guidance, seed=0, max_samples=100, measure=False)  # load what is compiled
    _, expansion_rng, guidance_rng = streams(0)
    search = Search(problem, expansion_rng, guidance_rng)
    guide = make_guidance(guidance)
    search.attach(guide)
    rng, out = np.random.default_rng(1), {}
    for size in sizes:
        while len(search.tree) < size:
            search.extend_towards(search.space.sample(rng, 1024))
        guide.select(search.tree)
        out[str(size)] = float(np.median([one_sample(search, guide) for _ in range(window)])) * 1e6
    return out


def one_sample(search: Search, guide: GuidingSpace) -> float:
    """Seconds of the processor for one sample, or for each sample of a burst."""
    began = time.thread_time()
    rows = guide.burst(100)
    if rows is None:
        node = guide.select(search.tree)
        search.expand(node, guide.propose(search.tree, node))
    return (time.thread_time() - began) / (1 if rows is None else len(rows))


def failed_expansions(guide: GuidingSpace, name: str, seeds: int) -> dict[str, float]:
    """Microseconds that a guiding space takes to learn from a failed expansion, on a catalogue problem."""
    problem = make_distribution(name).problem(0)
    times: list[float] = []
    full: list[float] = []
    for seed in range(seeds):
        _, expansion_rng, guidance_rng = streams(seed)
        search = Search(problem, expansion_rng, guidance_rng)
        guide.reset(search)
        while not search.solved and search.samples < 1000:
            node = guide.select(search.tree)
            expansion = search.expand(node, guide.propose(search.tree, node))
            began = time.thread_time()
            guide.feedback(expansion)
            if expansion.failed:
                times.append(time.thread_time() - began)
        full.append(full_dijkstra(guide))
    return {
        "failures": len(times),
        "mean_us": float(np.mean(times[5:])) * 1e6,
        "median_us": float(np.median(times)) * 1e6,
        "full_dijkstra_us": float(np.median(full)) * 1e6,
    }


def full_dijkstra(guide: GuidingSpace) -> float:
    """Seconds that scipy's Dijkstra takes on the roadmap as it stands."""
    assert isinstance(guide, Composed) and isinstance(guide.solver, GraphCostToGo)
    roadmap = guide.solver.graph
    alive = np.isfinite(roadmap.multipliers)
    a, b = roadmap.edges[alive].T
    weights, n = (roadmap.lengths * roadmap.multipliers)[alive], len(roadmap.points)
    graph = csr_array((weights, (a, b)), shape=(n, n))
    began = time.thread_time()
    dijkstra(graph, directed=False, indices=roadmap.goal)
    return time.thread_time() - began


def main() -> None:
    """Measure, print, and write JSON if asked to."""
    parser = command_line(__doc__)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    results: dict[str, Any] = {}
    try:
        for bias in (0.0, 0.05):
            found = against_ompl(options.samples, options.turns, bias, by_edge=False)
            results[f"rrt against OMPL, goal bias {bias}"] = found
        found = against_ompl(options.samples, options.turns, 0.0, by_edge=True)
        results["rrt against OMPL, ours looks at the goal from each node"] = found
    except ImportError:
        Console().print("ompl is not installed: that part is left out (pip install '.[bench]' here)")
    results["us a sample, rrt"] = growth("rrt", (1_000, 10_000, 50_000), 1000)
    for name in ("goal_distance", "lazy_prm", "medial_axis"):
        results[f"us a sample, {name}"] = growth(name, (1_000, 10_000, 50_000), 50)
    results["lazy_prm, failed expansion"] = failed_expansions(make_guidance("lazy_prm"), "Cup", 8)
    results["medial_axis, failed expansion"] = failed_expansions(make_guidance("medial_axis"), "Trap", 8)
    table = Table("what", "figure", "value")
    for what, figures in results.items():
        for figure, value in figures.items():
            table.add_row(what, figure, f"{value:.4g}")
    Console().print(table)
    write_figures(options.json, results)


if __name__ == "__main__":
    main()
