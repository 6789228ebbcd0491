"""Robots with joints: certified motions against a dense reference, and RRT's nodes a second beside OMPL's.

    python benchmarks/arms.py --motions 1000000 --json arms.json
    python benchmarks/arms.py --rrt

The reference shares nothing with the kernels: it places links by their angles alone, and looks at edges that
cross, corners inside, corners out of bounds and distances of edges. No point of the robot moves more than
1e-4 of the workspace's side between two poses that it looks at, but where the distances say that nothing can
touch. Half of the motions start near an obstacle. Where it finds a motion free that was refused, it looks
again, a thousand times closer, around the contact that was reported.
"""

from __future__ import annotations

import math
import sys
import time

import numpy as np
import numpy.typing as npt
import shapely
from chunks import judged
from command_line import command_line, write_figures
from numba import njit
from rich.console import Console
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
ROBOTS: dict[str, Linkage] = {
    "2 links": Linkage.arm([2.2, 1.8], 0.3, base=(5, 5)),
    "4 links": Linkage.arm([1.1] * 4, 0.16, base=(5, 5), limits=FIRST_FREE[:4], self_collision=True),
    "7 links": Linkage.arm([0.63] * 7, 0.16, base=(5, 5), limits=FIRST_FREE, self_collision=True),
    "7 thin links": Linkage.arm([0.63] * 7, base=(5, 5)),
    "snake of 5": Linkage.snake([0.5] * 5, 0.1, limits=2.5, self_collision=True),
}
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
def _from_edge(p, a, b):
    """Squared distance of a point from an edge."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    t = 0.0 if length == 0.0 else ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length
    t = min(1.0, max(0.0, t))
    x, y = p[0] - a[0] - t * dx, p[1] - a[1] - t * dy
    return x * x + y * y


@njit(cache=True)
def _gap(one, two):
    """The distance of two rings; 0 where they touch."""
    if _touch(one, two):
        return 0.0
    smallest = np.inf
    for i in range(one.shape[0]):
        a, b = one[i], one[(i + 1) % one.shape[0]]
        for j in range(two.shape[0]):
            p, q = two[j], two[(j + 1) % two.shape[0]]
            smallest = min(smallest, _from_edge(a, p, q), _from_edge(p, a, b))
    return math.sqrt(smallest)


@njit(cache=True)
def _box_of(ring):
    return ring[:, 0].min(), ring[:, 1].min(), ring[:, 0].max(), ring[:, 1].max()


@njit(cache=True)
def _between_boxes(a, b):
    """A distance that what two boxes hold is not nearer than."""
    return max(a[0] - b[2], b[0] - a[2], a[1] - b[3], b[1] - a[3], 0.0)


@njit(cache=True)
def speeds(d, bars, mobile, offsets, corners, starts, pairs):
    """How far any point of each link moves at most, in a motion by d."""
    first = 2 * mobile[0]
    speed, rate = math.hypot(d[0], d[1]) if first > 0 else 0.0, 0.0
    found = np.empty(bars.shape[0])
    for k in range(bars.shape[0]):
        speed += abs(rate) * math.hypot(offsets[k, 0], offsets[k, 1])
        rate += d[first + k]
        far = 0.0
        for i in range(4):
            far = max(far, math.hypot(bars[k, i, 0], bars[k, i, 1]))
        found[k] = speed + abs(rate) * far
    return found


@njit(cache=True)
def _placed(q, bars, mobile, offsets):
    """The corners of the links at a configuration."""
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
    return placed


@njit(cache=True)
def ahead(q, speed, boxes, bars, mobile, offsets, corners, starts, pairs):
    """For which part of a motion nothing can touch after a pose: gaps over speeds; -1 if something does."""
    placed = _placed(q, bars, mobile, offsets)
    count = bars.shape[0]
    soonest = np.inf
    own = np.empty((count, 4))
    for k in range(count):
        box = _box_of(placed[k])
        own[k, 0], own[k, 1], own[k, 2], own[k, 3] = box
        gap = min(box[0], box[1], 10.0 - box[2], 10.0 - box[3])
        if gap <= 0.0:
            return -1.0
        soonest = min(soonest, gap / (speed[k] + 1e-300))
        for o in range(starts.size - 1):
            if _between_boxes(box, boxes[o]) < max(soonest * speed[k], 1e-9):
                gap = _gap(placed[k], corners[starts[o] : starts[o + 1]])
                if gap <= 0.0:
                    return -1.0
                soonest = min(soonest, gap / (speed[k] + 1e-300))
    for n in range(pairs.shape[0]):
        one, two = pairs[n, 0], pairs[n, 1]
        both = speed[one] + speed[two]
        if _between_boxes(own[one], own[two]) < max(soonest * both, 1e-9):
            gap = _gap(placed[one], placed[two])
            if gap <= 0.0:
                return -1.0
            soonest = min(soonest, gap / (both + 1e-300))
    return soonest


@njit(cache=True)
def collides(a, d, step, low, high, scene):
    """Whether the motion by d from a collides at one of its poses from a time to another.

    No point moves farther between two poses than a step, but where the gaps say that nothing can touch.
    """
    speed = speeds(d, *scene)
    starts, corners = scene[4], scene[3]
    boxes = np.empty((starts.size - 1, 4))
    for o in range(starts.size - 1):
        ring = corners[starts[o] : starts[o + 1]]
        boxes[o, 0], boxes[o, 1], boxes[o, 2], boxes[o, 3] = _box_of(ring)
    least, t = step / (speed.max() + 1e-300), low
    while True:
        free = ahead(a + t * d, speed, boxes, *scene)
        if free < 0.0:
            return True
        if t >= high:
            return False
        t = min(high, t + max(least, 0.999 * free))


@njit(cache=True)
def all_collide(starts, change, step, scene):
    """`collides` for each of the motions (n, d), (n, d)."""
    hit = np.empty(starts.shape[0], np.bool_)
    for k in range(starts.shape[0]):
        hit[k] = collides(starts[k], change[k], step, 0.0, 1.0, scene)
    return hit


def judge(robot: Linkage, seed: int, count: int) -> dict[str, float]:
    """Counts over some motions in one workspace."""
    rng = np.random.default_rng(seed)
    space = ConfigurationSpace(robot, Environment(BOUNDS, _polygons(rng)))
    scene = scene_of(robot, space.environment)
    starts = valid_starts(space, rng, count, NEAR)
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
    hit = all_collide(starts, change, STEP, scene)
    for k in np.flatnonzero(free & hit):
        print(f"WRONGLY FREE: {starts[k].tolist()} -> {ends[k].tolist()}", file=sys.stderr)
    needless = 0
    for k in np.flatnonzero(~free & ~hit):
        reach = 2 * STEP / max(float(speeds(change[k], *scene).max()), STEP)
        t, back = space.first_contact(starts[k], ends[k]), 1.0 - space.first_contact(ends[k], starts[k])
        near = [(max(0.0, at - reach), min(1.0, at + reach)) for at in (t, back)]
        needless += not any(
            collides(starts[k], change[k], 1e-3 * STEP, low, high, scene) for low, high in near
        )
    return {
        "motions": len(starts),
        "free": int(free.sum()),
        "wrongly_free": int((free & hit).sum()),
        "refused_without_collision": int((~free & ~hit).sum()),
        "needlessly_refused": needless,
        "seconds": seconds,
    }


def valid_starts(
    space: ConfigurationSpace, rng: np.random.Generator, count: int, within: float
) -> FloatArray:
    """Valid configurations, half of them within a distance of an obstacle."""
    near: list[FloatArray] = []
    some: list[FloatArray] = []
    while sum(map(len, near)) < count // 2 or sum(map(len, some)) < count - count // 2:
        q = space.sample(rng, 4 * count)
        room = np.asarray(space.clearance(q))
        some.append(q[room > 0])
        near.append(q[(room > 0) & (room < within)])
    return np.concatenate([np.concatenate(some)[: count - count // 2], np.concatenate(near)[: count // 2]])


def certified(motions: int, console: Console) -> dict[str, dict[str, float]]:
    """So many motions of each robot."""
    totals = judged(
        ROBOTS, motions, CHUNK, lambda r, n, seed, count: judge(r, 1000 * n + seed, count), console
    )
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
    robot = ROBOTS["7 links"]
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
    parser = command_line(__doc__)
    parser.add_argument("--motions", type=int, default=100_000, help="of each robot")
    parser.add_argument("--rrt", action="store_true", help="nodes a second instead, needs ompl")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each of OMPL's runs")
    arguments = parser.parse_args()
    console = Console()
    figures = rrt(arguments.seconds, console) if arguments.rrt else certified(arguments.motions, console)
    write_figures(arguments.json, figures)
    wrong = 0 if arguments.rrt else sum(counts["wrongly_free"] for counts in figures.values())  # type: ignore[union-attr]
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
