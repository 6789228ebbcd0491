"""Time the nearest-neighbour and shortest-path kernels beside their peers, all in one run.

    python benchmarks/kernels.py --json kernels.json

Configurations are uniform in a 10 x 10 workspace with an angle weighted by 0.54 (a 1.0 x 0.4 rectangle).
Peers: scipy's cKDTree, rebuilt for each insertion as a growing tree would need, and linear scans in numpy and
in numba; scipy's Dijkstra, run anew after each deletion. Answers are compared as well as times. Figures are
microseconds of CPU time: means, and for the fused kernel medians of rounds, unless they say otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from command_line import command_line, write_figures
from numba import njit
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from guided_gym.kernels.nearest import State
from guided_gym.kernels.nearest import insert as insert_kernel
from guided_gym.kernels.nearest import nearest as nearest_kernel
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.segments import SegmentIndex
from guided_gym.structures.shortest_paths import RoadmapGraph, ShortestPathTree, nearest_graph

WEIGHTS = np.array([1.0, 1.0, 0.54])
PERIODS = np.array([0.0, 0.0, 2 * np.pi])
LOWER, UPPER = np.array([0.0, 0.0, -np.pi]), np.array([10.0, 10.0, np.pi])
COLLISION_RADIUS = 0.35


def sample(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(LOWER, UPPER, (n, 3))


def mean_us(call: Callable[[int], object], repeats: int) -> float:
    """Mean time of call(0), call(1), ..., in microseconds."""
    start = time.thread_time()
    for i in range(repeats):
        call(i)
    return (time.thread_time() - start) / repeats * 1e6


def scan(points: np.ndarray, q: np.ndarray) -> int:
    delta = np.abs(points - q)
    delta[:, 2] = np.minimum(delta[:, 2], 2 * np.pi - delta[:, 2])
    delta *= WEIGHTS
    return int(np.einsum("ij,ij->i", delta, delta).argmin())


def rebuilt(points: np.ndarray, q: np.ndarray) -> int:
    """One query of a cKDTree built for it; coordinates that do not wrap get a period too long to matter."""
    box = np.array([100.0, 100.0, 2 * np.pi * WEIGHTS[2]])
    shifted = (points - LOWER) * WEIGHTS
    return int(cKDTree(shifted, boxsize=box).query((q - LOWER) * WEIGHTS)[1])


@njit
def grow(state: State, queries: np.ndarray) -> int:
    """What a fused search does: a query, then an insertion; returns a checksum."""
    total = 0
    for row in range(queries.shape[0]):
        total += nearest_kernel(state, queries[row])[0]
        insert_kernel(state, queries[row])
    return total


@njit
def grow_scanning(points: np.ndarray, queries: np.ndarray, weights: np.ndarray, periods: np.ndarray) -> int:
    """The same by a compiled linear scan of the n points (those inserted are left out)."""
    total = 0
    for row in range(queries.shape[0]):
        best, best_d2 = 0, np.inf
        for i in range(points.shape[0]):
            d2 = 0.0
            for j in range(points.shape[1]):
                delta = abs(points[i, j] - queries[row, j])
                delta = min(delta, periods[j] - delta) * weights[j]
                d2 += delta * delta
            if d2 < best_d2:
                best, best_d2 = i, d2
        total += best
    return total


def time_fused(points: np.ndarray, steps: np.ndarray) -> float:
    """Mean microseconds of query and insertion inside one kernel."""
    index = GrowingIndex((WEIGHTS, PERIODS))
    index.add_many(points)
    index.reserve(len(steps))
    start = time.thread_time()
    grow(index.state, steps)
    return (time.thread_time() - start) / len(steps) * 1e6


def time_nearest(n: int, rng: np.random.Generator) -> dict[str, float]:
    """One query and one insertion at n configurations (the index grows by a tenth at most)."""
    points, queries = sample(rng, n), sample(rng, 2000)
    index = GrowingIndex((WEIGHTS, PERIODS))
    index.add_many(points)
    for q in queries[:100]:
        found = index.nearest(q)[0]
        if not found == scan(points, q) == rebuilt(points, q):
            raise SystemExit(f"the structures disagree on the neighbour of {q}")
    steps = queries[: n // 10]
    rounds = 3 + 2000 // len(steps)
    periods = np.where(PERIODS > 0, PERIODS, np.inf)
    few = queries[: max(2, 10**6 // n)]
    start = time.thread_time()
    grow_scanning(points, few, WEIGHTS, periods)
    scanning = (time.thread_time() - start) / len(few) * 1e6
    ordered = points[np.argsort(points[:, 0])]
    figures = {
        "fused in a kernel": float(np.median([time_fused(points, steps) for _ in range(rounds)])),
        "fused, points came in sorted": float(np.median([time_fused(ordered, steps) for _ in range(rounds)])),
        "called from Python": mean_us(lambda i: (index.nearest(steps[i]), index.add(steps[i])), len(steps)),
        "linear scan (numba)": scanning,
        "linear scan (numpy)": mean_us(lambda i: scan(points, queries[i]), 30),
        "cKDTree rebuilt": mean_us(lambda i: rebuilt(points, queries[i]), 5),
    }
    tree = cKDTree((points - LOWER) * WEIGHTS, boxsize=[100.0, 100.0, 2 * np.pi * WEIGHTS[2]])
    shifted = (queries - LOWER) * WEIGHTS
    figures["cKDTree query only, never rebuilt"] = mean_us(lambda i: tree.query(shifted[i]), 500)
    return figures


def scipy_distances(graph: RoadmapGraph, weights: np.ndarray, source: int) -> np.ndarray:
    n = len(graph.indptr) - 1
    kept = np.isfinite(weights)
    ends = graph.edges[kept]
    matrix = csr_array((weights[kept], (ends[:, 0], ends[:, 1])), shape=(n, n))
    return dijkstra(matrix, directed=False, indices=source)


def time_repair(n: int, k: int, deletions: int, rng: np.random.Generator) -> dict[str, float]:
    """Delete the edges within the collision radius of random configurations, one after the other."""
    points, figures = sample(rng, n), {}
    nearest_graph(points[:50], (WEIGHTS, PERIODS), k)
    figures["build the graph"] = mean_us(lambda _: nearest_graph(points, (WEIGHTS, PERIODS), k), 5)
    graph = nearest_graph(points, (WEIGHTS, PERIODS), k)
    figures["build the edge index"] = mean_us(
        lambda _: SegmentIndex(points, graph.edges, (WEIGHTS, PERIODS)), 3
    )
    segments = SegmentIndex(points, graph.edges, (WEIGHTS, PERIODS))
    tree = ShortestPathTree.of(graph, 0)
    hits = sample(rng, deletions)
    removed = [segments.within(q, COLLISION_RADIUS) for q in hits]
    figures["edges near a collision"] = mean_us(
        lambda i: segments.within(hits[i], COLLISION_RADIUS), deletions
    )
    times, changed, peer = [], [], []
    for step, edges in enumerate(removed):
        start = time.thread_time()
        changed.append(tree.remove_edges(edges))
        times.append(time.thread_time() - start)
        if step % 10 == 0:
            start = time.thread_time()
            expected = scipy_distances(graph, tree.weights, 0)
            peer.append(time.thread_time() - start)
            np.testing.assert_allclose(tree.distance, expected, rtol=1e-12)
    figures["repair, mean"] = float(np.mean(times)) * 1e6
    figures["repair, 99 %"] = float(np.quantile(times, 0.99)) * 1e6
    figures["repair, worst"] = float(np.max(times)) * 1e6
    figures["own Dijkstra from scratch"] = mean_us(lambda _: tree.reset(0), 20)
    figures["scipy's Dijkstra from scratch"] = float(np.mean(peer)) * 1e6
    figures["edges"] = float(len(graph.edges))
    figures["edges removed at a time"] = float(np.mean([len(e) for e in removed]))
    figures["distances changed at a time"] = float(np.mean(changed))
    return figures


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    time_nearest(100, rng)  # compiles
    report = {f"nearest, {n} configurations": time_nearest(n, rng) for n in (100, 1000, 10_000, 50_000)}
    time_repair(100, 12, 5, rng)
    for n, k in ((2000, 12), (10_000, 12)):
        report[f"roadmap, {n} vertices, k = {k}"] = time_repair(n, k, 300, rng)
    for title, figures in report.items():
        print(title)
        for name, value in figures.items():
            print(f"  {name:36s} {value:12.1f}")
    write_figures(options.json, report)


if __name__ == "__main__":
    main()
