"""Geometry and numbers against references that share no code with the package: shapely, and 50 digits."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import shapely
import shapely.affinity

import guided_gym as gg
from faults.tally import Tally
from guided_gym.registration import ENVIRONMENTS

_GUIDANCES = (
    "uninformed", "goal_distance", "rrt", "prm", "lazy_prm", "medial_axis", "wavefront", "hybrid", "oracle",
    "wave(robot=disc)", "searched(robot=point, guidance=skeleton)",
    "hybrid(wave(robot=disc), lazy_prm(vertices=500), rule=bandit)",
)  # fmt: skip
_POSES = 200  # along a motion, at which shapely looks


def _room(rng: np.random.Generator) -> gg.Environment:
    """A box with some polygons, most of them not convex, some of them needles."""
    obstacles = []
    for _ in range(rng.integers(3, 9)):
        count, centre = int(rng.integers(3, 9)), rng.uniform(1, 9, 2)
        angles = np.sort(rng.uniform(0, 2 * math.pi, count))
        radii = rng.uniform(0.2, 2.0, count) * (1e-3 if rng.random() < 0.1 else 1.0)
        radii[0] = rng.uniform(0.5, 2.0)
        ring = shapely.Polygon(centre + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))
        if ring.is_valid and ring.area > 0:
            obstacles.append(ring)
    return gg.Environment((0, 0, 10, 10), tuple(obstacles))


def _robot(rng: np.random.Generator) -> gg.Robot:
    size = float(rng.uniform(0.1, 1.0))
    corner = [(-size, -size), (size, -size), (size, 0), (0, 0), (0, size), (-size, size)]
    made = [gg.Robot.point, lambda: gg.Robot.segment(2 * size),
            lambda: gg.Robot.rectangle(2 * size, size / 3), lambda: gg.Robot.polygon(corner)]  # fmt: skip
    return made[rng.integers(len(made))]()


def motions(seed: int, share: float) -> list[Tally]:
    """Random motions and poses, swept by shapely."""
    free = Tally("motions", "no motion is wrongly free (shapely, 200 poses along each)")
    poses = Tally("poses", "no pose is wrongly valid, and none with room is refused (shapely)")
    rng = np.random.default_rng(seed)
    with free.timed():
        for number in range(max(1, round(150 * share))):
            room, robot = _room(rng), _robot(rng)
            space = gg.ConfigurationSpace(robot, room)
            union, box = room.obstacle_union, shapely.box(*room.bounds)
            starts = space.sample(rng, 400)
            valid = np.asarray(space.valid(starts))
            for q, said in zip(starts[:100], valid[:100], strict=True):
                body = robot.placed(q)
                gap = min(union.distance(body) if room.obstacles else math.inf, box.exterior.distance(body))
                hit = union.intersects(body) or not box.contains(body)
                poses.check(not (said and hit), f"seed {seed}, room {number}: {q.tolist()} in collision")
                poses.check(
                    said or hit or gap <= 2e-6 * room.extent,
                    f"seed {seed}, room {number}: {q.tolist()} has {gap}",
                )
            ends = starts + rng.normal(0, 0.6, starts.shape)
            certain = np.asarray(space.motions_free(starts, space.wrap(ends)))
            for a, b in zip(starts[certain][:60], space.wrap(ends)[certain][:60], strict=True):
                along = a + np.linspace(0, 1, _POSES)[:, None] * space.difference(a, b)
                bodies = [robot.placed(q) for q in along]
                hit = bool(shapely.intersects(union, bodies).any()) or not bool(
                    shapely.contains(box, bodies).all()
                )
                free.check(not hit, f"seed {seed}, room {number}: {a.tolist()} to {b.tolist()}")
    return [free, poses]


def numbers(seed: int, share: float) -> list[Tally]:
    """The target distribution and SE, worked out with 50 digits."""
    tally = Tally("target and SE", "Q and SE agree with 50-digit arithmetic to 1e-9")
    rng = np.random.default_rng(seed)
    with tally.timed(), mpmath.workdps(50):
        for number in range(max(5, round(400 * share))):
            n = int(rng.integers(1, 12))
            spread = 10.0 ** rng.uniform(-3, 3)
            delta, tau = rng.uniform(0, spread, n), rng.uniform(0, spread, n)
            scale = float(rng.uniform(0.1, 10))
            q = gg.target(delta, tau, scale)
            options = gg.TargetParameters()
            energies = [
                mpmath.mpf(d) / (scale * options.delta) + mpmath.mpf(t) / (scale * options.tau)
                for d, t in zip(delta.tolist(), tau.tolist(), strict=True)
            ]
            least = min(energies)
            weights = [mpmath.exp(least - e) for e in energies]
            exact = [w / mpmath.fsum(weights) for w in weights]
            # Smoothed as the paper does: mixed with the uniform distribution so that the least is epsilon.
            low, epsilon = min(exact), mpmath.mpf(options.epsilon)
            if low < epsilon and n > 1:
                gamma = (epsilon - low) / (mpmath.mpf(1) / n - low)
                exact = [(1 - gamma) * e + gamma / n for e in exact]
            said = f"seed {seed}, number {number}: {delta.tolist()}, {tau.tolist()}, {scale}"
            tally.check(all(abs(float(e) - v) <= 1e-9 for e, v in zip(exact, q, strict=True)), said)
            p = rng.dirichlet(np.ones(n))
            bits = [
                mpmath.mpf(x) * mpmath.log(mpmath.mpf(x) / e)
                for x, e in zip(p.tolist(), exact, strict=True)
                if x > 0
            ]
            tally.check(abs(float(mpmath.fsum(bits)) - gg.sampling_efficiency(p, q)) <= 1e-8, said)
    return [tally]


def distances(seed: int, share: float) -> list[Tally]:
    """The oracle of a point against the visibility graph, which is exact."""
    tally = Tally("d_C of a point", "within 1 % on average, 5 % for each, of the visibility graph")
    rng, errors = np.random.default_rng(seed), []
    with tally.timed():
        for number in range(max(1, round(20 * share))):
            room = _room(rng)
            space = gg.ConfigurationSpace(gg.Robot.point(), room)
            free = [q for q in space.sample(rng, 60) if space.valid(q)]
            if len(free) < 5:
                continue
            goal = free[0]
            oracle = gg.Oracle(space, goal, cache=False)
            for q in free[1:5]:
                exact, said = _shortest(room, q, goal), float(oracle.cost_to_go(q))
                if not (math.isfinite(exact) and math.isfinite(said)) or exact < 0.5:
                    continue  # a way through a gap that touches: closed for a search, open for the graph
                errors.append(abs(said / exact - 1))
                tally.check(
                    errors[-1] <= 0.05,
                    f"seed {seed}, room {number}: {q.tolist()} to {goal.tolist()}: {said} for {exact}",
                )
        if errors:
            tally.check(float(np.mean(errors)) <= 0.01, f"seed {seed}: mean error {np.mean(errors)}")
    return [tally]


def _walls(rng: np.random.Generator) -> gg.Environment:
    """A box with long bars across it, which part it now and then."""
    bars = []
    for _ in range(rng.integers(2, 6)):
        (x, y), turn = rng.uniform(1, 9, 2), rng.uniform(0, 180)
        bar = shapely.box(-rng.uniform(2, 9), -rng.uniform(0, 0.3), rng.uniform(2, 9), 0.02)
        bars.append(shapely.affinity.translate(shapely.affinity.rotate(bar, turn, (0, 0)), x, y))
    inside = [bar.intersection(shapely.box(0, 0, 10, 10)) for bar in bars]
    return gg.Environment((0, 0, 10, 10), tuple(b for b in inside if b.area > 0))


def proofs(seed: int, share: float) -> list[Tally]:
    """Proofs that there is no path, against the oracle, whose every path is of certified motions."""
    from guided_gym.guidance.proof import parted_cells, parted_workspace

    sound = Tally("proofs of no path", "where one is given, the oracle knows no path either")
    found, rng = 0, np.random.default_rng(seed)
    with sound.timed():
        for number in range(max(4, round(60 * share))):
            space = gg.ConfigurationSpace(_robot(rng), _walls(rng))
            free = [q for q in space.sample(rng, 60) if space.valid(q)][:4]
            oracle = gg.Oracle(space, free[0], cache=False) if free else None
            for q in free[1:]:
                task = gg.Task(q, free[0])
                why = parted_workspace(space, task), parted_cells(space, task)
                if oracle is None or why == (None, None):
                    continue
                found += 1
                there = math.isfinite(float(oracle.cost_to_go(q)))
                sound.check(not there, f"seed {seed}, room {number}: {q.tolist()}: {why}")
    sound.note = "" if found else "no such problem was drawn"
    return [sound]


def _shortest(room: gg.Environment, start: np.ndarray, goal: np.ndarray) -> float:
    """Length of the shortest way of a point, over the corners of the obstacles."""
    union = room.obstacle_union
    corners = [c for part in shapely.get_parts(union) for c in shapely.get_coordinates(part)[:-1]]
    places = np.array([start, goal, *[c for c in corners if (c >= 0).all() and (c <= 10).all()]])
    i, j = np.triu_indices(len(places), 1)
    lines = shapely.linestrings(np.stack([places[i], places[j]], axis=1))
    inside = union.buffer(-1e-7)
    shapely.prepare(inside)
    seen = ~shapely.intersects(inside, lines)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    lengths = np.hypot(*(places[i] - places[j]).T)[seen]
    graph = coo_array((lengths, (i[seen], j[seen])), shape=(len(places),) * 2)
    return float(dijkstra(graph, directed=False, indices=0)[1])


def trees(seed: int, share: float) -> list[Tally]:
    """Searches of pairs of problem and guidance, made again after others: the same trees, bit for bit."""
    tally = Tally("trees of pairs of problem and guidance", "the same seed gives the same tree, bit for bit")
    rng = np.random.default_rng(seed)
    names = [name.removeprefix("guided_gym/").removesuffix("-v0") for name in ENVIRONMENTS]
    rigid = [name for name in names if "Arm" not in name and "Snake" not in name]
    pairs = [(problem, guidance) for problem in rigid for guidance in _GUIDANCES]
    with tally.timed():
        chosen = [pairs[i] for i in rng.permutation(len(pairs))[: max(2, round(len(pairs) * share))]]
        first = [_tree(*pair, seed) for pair in chosen]
        again = {k: _tree(*chosen[k], seed) for k in rng.permutation(len(chosen))}
        for k, pair in enumerate(chosen):
            tally.check(first[k] == again[k], f"seed {seed}: {pair}")
    return [tally]


def _tree(problem: str, guidance: str, seed: int) -> tuple[bytes, ...]:
    task = gg.make_distribution(problem).problem(seed % 1000)
    result = gg.guided_search(task, guidance, seed=seed, max_samples=150)
    tree, record = result.tree, result.record
    return tuple(part.tobytes() for part in (tree.configurations, tree.parents, record.efficiency))
