"""Robots with joints: certified motions against a dense reference, and RRT's nodes a second beside OMPL's.

    python benchmarks/arms.py --motions 1000000 --json arms.json
    python benchmarks/arms.py --rrt

The reference shares nothing with the kernels: it places links by their angles alone, and looks at edges that
cross, corners inside and corners out of bounds at poses so dense that no point of the robot moves more than
1e-4 of the workspace's side between two of them. Half of the motions start near an obstacle. Where it finds a
motion free that was refused, it looks again, a thousand times closer, around the contact that was reported.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
import shapely
from numba import njit
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from guided_gym.catalogue.arms import _polygons
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.options import SearchOptions
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SIDE = 10.0
BOUNDS = (0.0, 0.0, SIDE, SIDE)
STEP = 1e-4 * SIDE
LONGEST = 0.2 * SIDE
NEAR = 0.02 * SIDE
CHUNK = 5_000
STEP_OF_RRT = 0.05  # of the diagonal, on both sides

FIRST_FREE = [None, *[(-2.7, 2.7)] * 6]
ROBOTS: dict[str, tuple[Linkage, float]] = {
    "2 links": (Linkage.arm([2.2, 1.8], 0.3, base=(5, 5)), 0.2),
    "4 links": (Linkage.arm([1.1] * 4, 0.16, base=(5, 5), limits=FIRST_FREE[:4], self_collision=True), 0.3),
    "7 links": (Linkage.arm([0.63] * 7, 0.16, base=(5, 5), limits=FIRST_FREE, self_collision=True), 0.3),
    "7 thin links": (Linkage.arm([0.63] * 7, base=(5, 5)), 0.1),
    "snake of 5": (Linkage.snake([0.5] * 5, 0.1, limits=2.5, self_collision=True), 0.1),
}
"""Robot and share of the motions."""

Scene = tuple[FloatArray, IntArray, FloatArray, FloatArray, IntArray, IntArray]
"""Corners of the links' bars in their frames, (links, 4, 2); whether the base moves; offsets (links, 2);
corners of the obstacles, first of each and end; pairs of links that must not touch."""


def scene_of(robot: Linkage, environment: Environment) -> Scene:
    """The arrays of the reference, for a chain of bars."""
    bars = []
    for body in robot.bodies:
        corners = shapely.get_coordinates(body.outline)
        bars.append(corners[:4] if len(corners) > 2 else corners[[0, 0, 1, 1]])
    offsets = np.array([joint.offset for joint in robot.joints])
    rings = [shapely.get_coordinates(one)[:-1] for one in environment.obstacles]
    starts = np.cumsum([0] + [len(ring) for ring in rings]).astype(np.int64)
    corners = np.concatenate(rings) if rings else np.zeros((0, 2))
    pairs = np.array(robot.pairs, np.int64).reshape(-1, 2)
    return (
        np.array(bars),
        np.array([int(robot.mobile)]),
        offsets,
        np.ascontiguousarray(corners),
        starts,
        pairs,
    )


@njit(cache=True)
def _side(ax, ay, bx, by, px, py):
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@njit(cache=True)
def _cross(a, b, p, q):
    if max(a[0], b[0]) < min(p[0], q[0]) or max(p[0], q[0]) < min(a[0], b[0]):
        return False
    if max(a[1], b[1]) < min(p[1], q[1]) or max(p[1], q[1]) < min(a[1], b[1]):
        return False
    s1, s2 = _side(a[0], a[1], b[0], b[1], p[0], p[1]), _side(a[0], a[1], b[0], b[1], q[0], q[1])
    s3, s4 = _side(p[0], p[1], q[0], q[1], a[0], a[1]), _side(p[0], p[1], q[0], q[1], b[0], b[1])
    apart = (s1 > 0 and s2 > 0) or (s1 < 0 and s2 < 0) or (s3 > 0 and s4 > 0) or (s3 < 0 and s4 < 0)
    return not apart


@njit(cache=True)
def _inside(ring, p):
    odd, j = False, ring.shape[0] - 1
    for i in range(ring.shape[0]):
        if (ring[i, 1] > p[1]) != (ring[j, 1] > p[1]):
            x = ring[i, 0] + (p[1] - ring[i, 1]) * (ring[j, 0] - ring[i, 0]) / (ring[j, 1] - ring[i, 1])
            odd = odd != (p[0] < x)
        j = i
    return odd


@njit(cache=True)
def _touch(one, two):
    """Whether two rings cross, or one holds the other."""
    for i in range(one.shape[0]):
        for j in range(two.shape[0]):
            if _cross(one[i], one[(i + 1) % one.shape[0]], two[j], two[(j + 1) % two.shape[0]]):
                return True
    return _inside(one, two[0]) or _inside(two, one[0])


@njit(cache=True)
def pose_collides(q, bars, mobile, offsets, corners, starts, pairs):
    """Whether a link touches an obstacle, leaves the bounds, or touches another that it must not."""
    first = 2 * mobile[0]
    x, y, heading = 0.0, 0.0, 0.0
    if first > 0:
        x, y = q[0], q[1]
    placed = np.empty_like(bars)
    for k in range(bars.shape[0]):
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * offsets[k, 0] - s * offsets[k, 1], y + s * offsets[k, 0] + c * offsets[k, 1]
        heading += q[first + k]
        c, s = math.cos(heading), math.sin(heading)
        for i in range(4):
            placed[k, i, 0] = x + c * bars[k, i, 0] - s * bars[k, i, 1]
            placed[k, i, 1] = y + s * bars[k, i, 0] + c * bars[k, i, 1]
            if not (0.0 < placed[k, i, 0] < 10.0 and 0.0 < placed[k, i, 1] < 10.0):
                return True
        mx, my = 0.5 * (placed[k, 0, 0] + placed[k, 2, 0]), 0.5 * (placed[k, 0, 1] + placed[k, 2, 1])
        reach = math.hypot(placed[k, 0, 0] - mx, placed[k, 0, 1] - my)
        for o in range(starts.size - 1):
            ring = corners[starts[o] : starts[o + 1]]
            if (
                ring[:, 0].min() <= mx + reach
                and ring[:, 0].max() >= mx - reach
                and ring[:, 1].min() <= my + reach
                and ring[:, 1].max() >= my - reach
                and _touch(placed[k], ring)
            ):
                return True
    hit = False
    for n in range(pairs.shape[0]):
        hit = hit or _touch(placed[pairs[n, 0]], placed[pairs[n, 1]])
    return hit


@njit(cache=True)
def _collides(a, d, low, high, count, scene):
    for k in range(count + 1):
        t = low + (high - low) * k / count
        if pose_collides(a + t * d, *scene):
            return True
    return False


def collides(
    robot: Linkage,
    a: FloatArray,
    d: FloatArray,
    scene: Scene,
    step: float,
    low: float = 0.0,
    high: float = 1.0,
) -> bool:
    """Whether the motion by d from a collides at a pose between two times, dense enough for a step."""
    count = max(1, math.ceil(float(robot.displacement(d)) * (high - low) / step))
    return bool(_collides(a, d, low, high, count, scene))


def judge(robot: Linkage, seed: int, count: int) -> dict[str, float]:
    """Counts over some motions in one workspace."""
    rng = np.random.default_rng(seed)
    space = ConfigurationSpace(robot, Environment(BOUNDS, _polygons(rng)))
    scene = scene_of(robot, space.environment)
    starts = _starts(space, rng, count)
    steps = rng.standard_normal(starts.shape)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    ends = starts + steps * rng.uniform(0, LONGEST, (len(starts), 1)) / space.weights
    fixed = space.periods == 0
    ends[:, fixed] = np.clip(ends, space.lower, space.upper)[:, fixed]
    ends = space.wrap(ends)
    change = space.difference(starts, ends)
    space.motions_free(starts[:2], ends[:2])
    began = time.perf_counter()
    free = space.motions_free(starts, ends)
    seconds = time.perf_counter() - began
    hit = np.array([collides(robot, a, d, scene, STEP) for a, d in zip(starts, change, strict=True)])
    for k in np.flatnonzero(free & hit):
        print(f"WRONGLY FREE: {starts[k].tolist()} -> {ends[k].tolist()}", file=sys.stderr)
    needless = 0
    for k in np.flatnonzero(~free & ~hit):
        reach = 2 * STEP / max(float(robot.displacement(change[k])), STEP)
        t, back = space.first_contact(starts[k], ends[k]), 1.0 - space.first_contact(ends[k], starts[k])
        near = [(max(0.0, at - reach), min(1.0, at + reach)) for at in (t, back)]
        needless += not any(
            collides(robot, starts[k], change[k], scene, 1e-3 * STEP, low, high) for low, high in near
        )
    return {
        "motions": len(starts),
        "free": int(free.sum()),
        "wrongly_free": int((free & hit).sum()),
        "refused_without_collision": int((~free & ~hit).sum()),
        "needlessly_refused": needless,
        "seconds": seconds,
    }


def _starts(space: ConfigurationSpace, rng: np.random.Generator, count: int) -> FloatArray:
    """Valid configurations, half of them near an obstacle."""
    near: list[FloatArray] = []
    some: list[FloatArray] = []
    while sum(map(len, near)) < count // 2 or sum(map(len, some)) < count - count // 2:
        q = space.sample(rng, 4 * count)
        room = np.asarray(space.clearance(q))
        some.append(q[room > 0])
        near.append(q[(room > 0) & (room < NEAR)])
    return np.concatenate([np.concatenate(some)[: count - count // 2], np.concatenate(near)[: count // 2]])


def certified(motions: int, console: Console) -> dict[str, dict[str, float]]:
    """All robots."""
    totals: dict[str, dict[str, float]] = {}
    with Progress(console=console) as progress:
        task = progress.add_task("motions", total=motions)
        for number, (name, (robot, share)) in enumerate(ROBOTS.items()):
            left, seed = math.ceil(motions * share), 0
            while left > 0:
                counts = judge(robot, 1000 * number + seed, min(CHUNK, left))
                total = totals.setdefault(name, dict.fromkeys(counts, 0))
                for key, value in counts.items():
                    total[key] += value
                progress.advance(task, counts["motions"])
                left, seed = left - CHUNK, seed + 1
    table = Table("robot", "motions", "free", "wrongly free", "needlessly refused", "us a motion")
    for name, t in totals.items():
        share = t["needlessly_refused"] / max(t["free"], 1)
        table.add_row(
            name, f"{t['motions']:,.0f}", f"{t['free']:,.0f}", f"{t['wrongly_free']:.0f}",
            f"{t['needlessly_refused']:.0f} ({100 * share:.3f} %)",
            f"{1e6 * t['seconds'] / t['motions']:.2f}",
        )  # fmt: skip
    console.print(table)
    return totals


# RRT --------------------------------------------------------------------------------------------------------


def _problem() -> Problem:
    """The arm of seven links among 20 obstacles, and a goal that no search of the benchmark reaches."""
    robot, _ = ROBOTS["7 links"]
    rng = np.random.default_rng(5)
    polygons: tuple[shapely.Polygon, ...] = ()
    while len(polygons) != 20:
        polygons = _polygons(rng)
    space = ConfigurationSpace(robot, Environment(BOUNDS, polygons))
    q = space.sample(rng, 2000)
    q = q[np.asarray(space.valid(q))]
    # By nearness alone, and so near that no sample is.
    return Problem(robot, space.environment, Task(q[0], q[1], tolerance=1e-9, by_edge=False), "PlanarArm7")


def rrt(seconds: float, console: Console) -> dict[str, float]:
    """Nodes a second of processor time: RRT with certified motions, and OMPL's with the same pose check."""
    problem = _problem()
    options = SearchOptions(step=STEP_OF_RRT * problem.space.extent)
    guided_search(problem, "rrt", seed=0, max_samples=100, measure=False, options=options)
    ours, samples = [], 20_000
    for seed in range(5):
        result = guided_search(problem, "rrt", seed=seed, max_samples=samples, measure=False, options=options)
        ours.append(len(result.tree) / result.processor)
    found = {"ours": float(np.median(ours))}
    console.print(f"ours: {found['ours']:,.0f} nodes/s ({samples:,} samples, median of 5)")
    for resolution in (0.01, 0.003, 0.001):
        rate, colliding = _ompl_rrt(problem, seconds, resolution)
        found[f"ompl {resolution:g}"], found[f"ompl {resolution:g} colliding paths"] = rate, colliding
        console.print(
            f"OMPL's RRT at {resolution:g}: {rate:,.0f} nodes/s, {100 * colliding:.1f} % of paths collide"
        )
    return found


def _ompl_rrt(problem: Problem, seconds: float, resolution: float) -> tuple[float, float]:
    """Nodes a second, and which part of the ways from the root to a leaf has an edge that is not free."""
    from ompl import base, geometric

    space = problem.space
    state_space = base.CompoundStateSpace()
    for k, weight in enumerate(space.weights.tolist()):
        if space.periods[k] > 0:
            part = base.SO2StateSpace()
        else:
            part = base.RealVectorStateSpace(1)
            bounds = base.RealVectorBounds(1)
            bounds.setLow(float(space.lower[k]))
            bounds.setHigh(float(space.upper[k]))
            part.setBounds(bounds)
        state_space.addSubspace(part, weight)
    periodic = (space.periods > 0).tolist()

    def values(state):  # type: ignore[no-untyped-def]
        return np.array([state[k].value if turns else state[k][0] for k, turns in enumerate(periodic)])

    information = base.SpaceInformation(state_space)
    information.setStateValidityChecker(lambda state: bool(space.valid(values(state))))
    information.setStateValidityCheckingResolution(resolution)
    information.setup()
    setup = base.ProblemDefinition(information)
    states = []
    for q in (problem.task.start, problem.task.goal):
        state = state_space.allocState()
        for k, turns in enumerate(periodic):
            if turns:
                state[k].value = float(q[k])
            else:
                state[k][0] = float(q[k])
        states.append(state)
    setup.setStartAndGoalStates(*states, 1e-9)
    planner = geometric.RRT(information)
    planner.setRange(STEP_OF_RRT * space.extent)
    planner.setGoalBias(0.0)
    planner.setProblemDefinition(setup)
    planner.setup()
    began = time.process_time()
    planner.solve(seconds)
    spent = time.process_time() - began
    data = base.PlannerData(information)
    planner.getPlannerData(data)
    n = data.numVertices()
    points = np.array([values(data.getVertex(i).getState()) for i in range(n)])
    parents = np.full(n, -1)
    for i in range(n):
        for j in list(data.getEdges(i)):
            parents[j] = i
    return n / spent, _colliding(space, points, parents)


def _colliding(space: ConfigurationSpace, points: FloatArray, parents: IntArray) -> float:
    """The part of the ways from the root to a leaf that have an edge which is not certified free."""
    children = np.flatnonzero(parents >= 0)
    bad = np.zeros(len(points), bool)
    bad[children] = ~space.motions_free(points[parents[children]], points[children])
    leaves = np.setdiff1d(children, parents)
    wrong = 0
    for leaf in leaves.tolist():
        at, hit = leaf, False
        while at >= 0 and not hit:
            hit, at = bool(bad[at]), int(parents[at])
        wrong += hit
    return wrong / max(len(leaves), 1)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--motions", type=int, default=100_000)
    parser.add_argument("--rrt", action="store_true", help="nodes a second instead, needs ompl")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each of OMPL's runs")
    parser.add_argument("--json", type=Path, default=None, help="where to write the figures")
    arguments = parser.parse_args()
    console = Console()
    figures = rrt(arguments.seconds, console) if arguments.rrt else certified(arguments.motions, console)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    wrong = 0 if arguments.rrt else sum(counts["wrongly_free"] for counts in figures.values())  # type: ignore[union-attr]
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
