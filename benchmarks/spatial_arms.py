"""Arms in space: certified motions against pinocchio and coal, and RRT's nodes a second beside pyroboplan's.

    python benchmarks/spatial_arms.py --motions 100000 --json spatial.json
    python benchmarks/spatial_arms.py --motions 1000000 --poses
    python benchmarks/spatial_arms.py --rrt

Needs pin, coal and example-robot-data; ``--rrt`` needs pyroboplan 1.3.1, too. Pinocchio places the bodies,
and coal says how far they are apart. A pair of bodies is looked at again after the time that it needs to
meet, by its gap and by the sum of |dq| times reach of the joints before it; or after it may have moved by a
ten-thousandth of the arm's reach, if that is later. Half of the motions start near an obstacle.

With ``--poses``, compiled code does the same: it places the bodies by itself, and has the distance of two
bodies by itself, and that of a body and a solid from the search that our kernel for poses uses, 20 times as
exact. The gap of each pair is held against pinocchio's and coal's at some of the poses.

coal 3.0.3 answers -2 or -1.8e308 for some gaps that are nearly 0. So it is asked for capsules half as thick:
they are still apart where ours touch.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from arms import valid_starts
from chunks import judged
from command_line import command_line, write_figures
from example_robots import installed
from numba import njit
from rich.console import Console
from rich.table import Table

from guided_gym.catalogue.spatial import arm as our_arm
from guided_gym.geometry.solids import Box, Capsule, Cylinder, Solid, SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm
from guided_gym.kernels.spatial import gap
from guided_gym.options import SearchOptions
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

STEP = 1e-4  # of the reach
LONGEST = 0.2  # likewise
NEAR = 0.02  # likewise
SOLIDS = (5, 10)
CHUNK = 2_000
LOOKED_AT = 20  # of the motions that are refused, one in so many
CLOSE = 1e-5  # of the reach: how far a gap may be from coal's
STEP_OF_RRT = 0.05  # of the diagonal, on both sides
STEP_OF_CHECKS = 0.05  # radians: the default of pyroboplan


def arms() -> dict[str, tuple[SpatialArm, Any]]:
    """Each arm, and pinocchio's model of it."""
    ours = our_arm()
    found = {ours.name: (ours, _model(ours))}
    files = installed()
    if not files:
        raise SystemExit("expected the package example-robot-data, found none")
    for name, (path, tip) in files.items():
        arm = SpatialArm.from_urdf(path, tip, self_collision=True)
        found[name] = arm, pin.buildModelFromUrdf(str(path))
    return found


def _model(arm: SpatialArm) -> Any:
    """Pinocchio's model of an arm whose joints all turn."""
    model, parent = pin.Model(), 0
    for joint in arm.joints:
        place = pin.SE3(np.array(joint.turned), np.array(joint.offset))
        parent = model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(np.array(joint.axis)), place, joint.name
        )
    return model


class Reference:
    """Gaps of an arm's bodies from solids and from each other, along motions.

    Args:
        arm: The arm.
        model: Pinocchio's model of it.
        world: The solids.
    """

    def __init__(self, arm: SpatialArm, model: Any, world: SpatialEnvironment) -> None:
        self.model, self.data = model, model.createData()
        self.geometry, self.step = pin.GeometryModel(), STEP * arm.radius
        self.columns = np.array([model.joints[model.getJointId(name)].idx_q for name in arm.names])
        ids = [model.getJointId(joint.name) for joint in arm.joints]
        excess, bodies = [], []
        for body in arm.bodies:
            parent = 0 if body.joint < 0 else ids[body.joint]
            excess.append(self._add(body.shape, parent))
            bodies.append(body.joint)
        for solid in (*world.solids, *_walls(world)):
            excess.append(self._add(solid, 0))
        count = len(bodies)
        pairs = [(b, s) for b in range(count) if bodies[b] >= 0 for s in range(count, len(excess))]
        pairs += [(min(i, k), max(i, k)) for i, k in arm.pairs]
        for i, k in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(i, k))
        self.found = self.geometry.createData()
        self.pairs = pairs
        self.excess = np.array([excess[i] + excess[k] for i, k in pairs])
        moves = np.zeros((len(excess), len(arm.names)))
        for b, joint in enumerate(bodies):
            if joint >= 0:
                moves[b] = self._moves(ids[: joint + 1], arm, b)
        # A body sees another one move by the joints between them alone; the sum of both is more than that.
        self.moves = np.array([moves[i] + moves[k] for i, k in pairs])

    def _add(self, shape: Solid, parent: int) -> float:
        """Add a shape, a capsule half as thick; by how much coal's distances are then too large."""
        numbers, less = shape.numbers(), 0.0
        if isinstance(shape, Capsule):
            less = 0.5 * shape.radius
            made = coal.Capsule(shape.radius - less, shape.length)
        elif isinstance(shape, Cylinder):
            made = coal.Cylinder(shape.radius, shape.length)
        else:
            assert isinstance(shape, Box)
            made = coal.Box(*shape.sides)
        place = pin.SE3(numbers[3:12].reshape(3, 3).T, numbers[:3])
        name = str(len(self.geometry.geometryObjects))
        self.geometry.addGeometryObject(pin.GeometryObject(name, parent, place, made))
        return less

    def _moves(self, ids: list[int], arm: SpatialArm, body: int) -> FloatArray:
        """(d,) how far a body moves at most, by each joint's radian."""
        shape = arm.bodies[body].shape
        reach = max(np.linalg.norm(shape.start), np.linalg.norm(shape.end)) + shape.radius
        moves = np.zeros(len(arm.names))
        for joint, at in zip(reversed(arm.joints[: len(ids)]), reversed(ids), strict=True):
            if joint.name in arm.names:
                moves[arm.names.index(joint.name)] = reach
            reach += np.linalg.norm(self.model.jointPlacements[at].translation)
        return moves

    def _configuration(self, q: FloatArray) -> FloatArray:
        full: FloatArray = pin.neutral(self.model)
        full[self.columns] = q
        return full

    def gaps(self, q: FloatArray) -> FloatArray:
        """The gap of each pair at a configuration."""
        pin.computeDistances(self.model, self.data, self.geometry, self.found, self._configuration(q))
        found = np.array([each.min_distance for each in self.found.distanceResults])
        return np.asarray(found - self.excess)

    def touches(self, a: FloatArray, d: FloatArray) -> bool:
        """Whether bodies touch along the motion by d from a."""
        speeds = self.moves @ np.abs(d) + 1e-300
        pin.computeDistances(self.model, self.data, self.geometry, self.found, self._configuration(a))
        gaps = np.array([each.min_distance for each in self.found.distanceResults]) - self.excess
        if gaps.min() <= 0.0:
            return True
        due = np.maximum(0.999 * gaps, self.step) / speeds
        open_pairs = np.flatnonzero(due < 1.0)
        while open_pairs.size:
            t = float(due[open_pairs].min())
            pin.updateGeometryPlacements(
                self.model, self.data, self.geometry, self.found, self._configuration(a + t * d)
            )
            for k in open_pairs[due[open_pairs] <= t].tolist():
                gap = pin.computeDistance(self.geometry, self.found, k).min_distance - self.excess[k]
                if gap <= 0.0:
                    return True
                due[k] = t + max(0.999 * gap, self.step) / speeds[k]
            open_pairs = open_pairs[due[open_pairs] < 1.0]
        pin.computeDistances(self.model, self.data, self.geometry, self.found, self._configuration(a + d))
        gaps = np.array([each.min_distance for each in self.found.distanceResults]) - self.excess
        return bool(gaps.min() <= 0.0)


def _walls(world: SpatialEnvironment) -> list[Box]:
    """The sides of the room, as boxes outside of it."""
    low, high = np.array(world.room[:3]), np.array(world.room[3:])
    thick = float((high - low).max())
    walls = []
    for axis in range(3):
        for side in (0, 1):
            a, b = low - thick, high + thick
            a[axis] = high[axis] if side else low[axis] - thick
            b[axis] = high[axis] + thick if side else low[axis]
            walls.append(Box.between(a, b))
    return walls


def world_of(rng: np.random.Generator, arm: SpatialArm) -> SpatialEnvironment:
    """Random solids of every kind, off the axis of the first joint."""
    size, solids = arm.radius, list[Solid]()
    while len(solids) < rng.integers(*SOLIDS):
        away, turn = rng.uniform(0.35, 0.95) * size, rng.uniform(-np.pi, np.pi)
        centre = np.array([away * np.cos(turn), away * np.sin(turn), rng.uniform(0.0, 0.9) * size])
        along = rng.normal(size=3)
        along *= rng.uniform(0.05, 0.2) * size / np.linalg.norm(along)
        ends = tuple((centre - along).tolist()), tuple((centre + along).tolist())
        radius = rng.uniform(0.03, 0.1) * size
        solids.append(
            [
                lambda c=centre: Box(
                    tuple(c.tolist()),
                    tuple((rng.uniform(0.06, 0.3, 3) * size).tolist()),
                    tuple(rng.uniform(-np.pi, np.pi, 3).tolist()),
                ),
                lambda e=ends, r=radius: Cylinder(*e, r),
                lambda e=ends, r=radius: Capsule(*e, r),
                lambda c=centre, r=radius: Capsule.sphere(tuple(c.tolist()), r),
            ][rng.integers(4)]()
        )
    edge = 1.05 * size
    return SpatialEnvironment((-edge, -edge, -0.6 * size, edge, edge, 1.3 * size), solids)


def some_motions(
    arm: SpatialArm, seed: int, count: int
) -> tuple[ConfigurationSpace, FloatArray, FloatArray, npt.NDArray[np.bool_], float]:
    """A world, motions in it (starts and changes), which are certified, and how long that took (s)."""
    rng = np.random.default_rng(seed)
    space = ConfigurationSpace(arm, world_of(rng, arm))
    starts = valid_starts(space, rng, count, NEAR * space.robot.size)
    steps = rng.standard_normal(starts.shape)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    ends = starts + steps * rng.uniform(0, LONGEST * arm.radius, (len(starts), 1)) / space.weights
    fixed = space.periods == 0
    ends[:, fixed] = np.clip(ends, space.lower, space.upper)[:, fixed]
    ends = space.wrap(ends)
    change = space.difference(starts, ends)
    began = time.process_time()
    free = np.asarray(space.motions_free(starts, ends))
    return space, starts, change, free, time.process_time() - began


def judge(arm: SpatialArm, model: Any, seed: int, count: int) -> dict[str, float]:
    """Counts over some motions in one world."""
    space, starts, change, free, seconds = some_motions(arm, seed, count)
    reference = Reference(arm, model, space.environment)
    hit = np.zeros(len(starts), np.bool_)
    looked = free | (np.arange(len(starts)) % LOOKED_AT == 0)
    for k in np.flatnonzero(looked):
        hit[k] = reference.touches(starts[k], change[k])
    return _counts(seed, starts, change, (free, looked, hit), seconds)


def _counts(
    seed: int,
    starts: FloatArray,
    change: FloatArray,
    answers: tuple[npt.NDArray[np.bool_], ...],
    seconds: float,
) -> dict[str, float]:
    free, looked, hit = answers
    for k in np.flatnonzero(free & hit):
        print(f"WRONGLY FREE: {seed} {starts[k].tolist()} by {change[k].tolist()}", file=sys.stderr)
    return {
        "motions": len(starts),
        "free": int(free.sum()),
        "wrongly_free": int((free & hit).sum()),
        "refused_and_looked_at": int((looked & ~free).sum()),
        "refused_without_contact": int((looked & ~free & ~hit).sum()),
        "seconds": seconds,
    }


Tables = tuple[FloatArray, IntArray, FloatArray, FloatArray, IntArray, IntArray]
"""Of joints: rotation, offset, factor and shift (n, 14), and coordinate (n,). Of bodies: ends and radius
(b, 7). Of solids: numbers (s, 19). Of pairs: body and other body, or -1 - solid (p, 2). Joints of the bodies
and kinds of the solids (b + s,)."""


def tables(arm: SpatialArm, world: SpatialEnvironment, pairs: list[tuple[int, int]]) -> Tables:
    """Arm and world as arrays, for an arm whose joints all turn."""
    joints, columns = [], []
    for slides, column, factor, shift, turned, offset in arm.chain_rows():
        assert not slides
        joints.append([*turned.ravel(), *offset, factor, shift])
        columns.append(column)
    bodies = [[*start, *end, radius] for _, start, end, radius in arm.body_rows()]
    solids = [*world.solids, *_walls(world)]
    count = len(bodies)
    ends = [(i, k if k < count else count - 1 - k) for i, k in pairs]
    places = [body.joint for body in arm.bodies] + [solid.kind for solid in solids]
    # The first number says how exact the search for the nearest point has to be.
    numbers = [[1e-7 * arm.radius, 0.0, *solid.numbers()] for solid in solids]
    return (
        np.array(joints),
        np.array(columns),
        np.array(bodies),
        np.array(numbers),
        np.array(ends),
        np.array(places),
    )


@njit(cache=True)
def placed(q, joints, columns, bodies, places):
    """Ends of the bodies (b, 6) at a configuration."""
    frames = np.empty((columns.size, 3, 4))
    before = np.zeros((3, 4))
    before[0, 0] = before[1, 1] = before[2, 2] = 1.0
    for j in range(columns.size):
        angle = joints[j, 12] * q[columns[j]] + joints[j, 13]
        c, s = math.cos(angle), math.sin(angle)
        for i in range(3):
            x = y = z = 0.0
            shift = before[i, 3]
            for m in range(3):
                x += before[i, m] * joints[j, 3 * m]
                y += before[i, m] * joints[j, 3 * m + 1]
                z += before[i, m] * joints[j, 3 * m + 2]
                shift += before[i, m] * joints[j, 9 + m]
            frames[j, i, 0], frames[j, i, 1] = c * x + s * y, c * y - s * x
            frames[j, i, 2], frames[j, i, 3] = z, shift
        before = frames[j]
    ends = np.empty((bodies.shape[0], 6))
    for b in range(bodies.shape[0]):
        for i in range(6):
            ends[b, i] = bodies[b, i]
            if places[b] >= 0:
                row, first = frames[places[b], i % 3], 3 * (i // 3)
                ends[b, i] = row[3]
                for m in range(3):
                    ends[b, i] += row[m] * bodies[b, first + m]
    return ends


@njit(cache=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
def _apart(rr, a, e, f, c, b, s, t):
    """The squared length of r + s d1 - t d2."""
    return rr + s * s * a + t * t * e + 2.0 * (s * c - t * f - s * t * b)


@njit(cache=True)
def between_segments(p, q):
    """The distance of two segments (6,): the least of end to segment, and of the lines where both are met."""
    d1, d2, r = _less(p[3:], p[:3]), _less(q[3:], q[:3]), _less(p[:3], q[:3])
    a, e, f, c, b = _dot(d1, d1), _dot(d2, d2), _dot(d2, r), _dot(d1, r), _dot(d1, d2)
    rr, least = _dot(r, r), np.inf
    for s in (0.0, 1.0):
        t = 0.0 if e == 0.0 else min(1.0, max(0.0, (b * s + f) / e))
        least = min(least, _apart(rr, a, e, f, c, b, s, t))
    for t in (0.0, 1.0):
        s = 0.0 if a == 0.0 else min(1.0, max(0.0, (b * t - c) / a))
        least = min(least, _apart(rr, a, e, f, c, b, s, t))
    across = a * e - b * b
    if across > 1e-12 * a * e:
        s, t = (b * f - c * e) / across, (a * f - b * c) / across
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            least = min(least, _apart(rr, a, e, f, c, b, s, t))
    return math.sqrt(max(least, 0.0))


@njit(cache=True)
def pair_gap(ends, k, bodies, solids, pairs, places):
    """How far the two of a pair are apart."""
    i, other = pairs[k, 0], pairs[k, 1]
    if other >= 0:
        return between_segments(ends[i], ends[other]) - bodies[i, 6] - bodies[other, 6]
    solid = -1 - other
    kind = places[bodies.shape[0] + solid]
    return gap(solids[solid], kind, ends[i, :3], ends[i, 3:]) - bodies[i, 6]


@njit(cache=True)
def poses_touch(starts, change, moves, step, arrays):
    """Whether a pair touches at one of the poses of each motion (n, d), (n, d).

    A pair is looked at again once its two may have met, or moved by a step.
    """
    joints, columns, bodies, solids, pairs, places = arrays
    hit, due = np.zeros(starts.shape[0], np.bool_), np.empty(pairs.shape[0])
    for n in range(starts.shape[0]):
        speeds = moves @ np.abs(change[n]) + 1e-300
        due[:] = 0.0
        t = 0.0
        while t <= 1.0 and not hit[n]:
            ends = placed(starts[n] + t * change[n], joints, columns, bodies, places)
            for k in range(pairs.shape[0]):
                if due[k] <= t:
                    room = pair_gap(ends, k, bodies, solids, pairs, places)
                    hit[n] = hit[n] or room <= 0.0
                    due[k] = t + max(0.999 * room, step) / speeds[k]
                    due[k] = 1.0 if t < 1.0 < due[k] else due[k]
            t = due.min()
    return hit


def judge_by_poses(arm: SpatialArm, model: Any, seed: int, count: int) -> dict[str, float]:
    """Counts over some motions in one world, and over some poses."""
    space, starts, change, free, seconds = some_motions(arm, seed, count)
    looked = free | (np.arange(len(starts)) % LOOKED_AT == 0)
    reference = Reference(arm, model, space.environment)
    arrays = tables(arm, space.environment, reference.pairs)
    hit = np.zeros(len(starts), np.bool_)
    step = STEP * arm.radius
    hit[looked] = poses_touch(starts[looked], change[looked], reference.moves, step, arrays)
    poses = np.concatenate([starts[:: 50 * LOOKED_AT], (starts + change)[1 :: 50 * LOOKED_AT]])
    apart = 0
    for q in poses:
        ends = placed(q, *arrays[:3], arrays[5])
        ours = np.array([pair_gap(ends, k, *arrays[2:]) for k in range(len(arrays[4]))])
        theirs = reference.gaps(q)
        unlike = np.abs(np.maximum(ours, 0.0) - np.maximum(theirs, 0.0)) > CLOSE * arm.radius
        apart += int(unlike.sum())
        for k in np.flatnonzero(unlike):
            print(f"GAP: {seed} {q.tolist()} {reference.pairs[k]}: {ours[k]}, {theirs[k]}", file=sys.stderr)
    return _counts(seed, starts, change, (free, looked, hit), seconds) | {
        "poses": len(poses) * len(reference.pairs),
        "poses_apart": apart,
    }


def certified(motions: int, seconds: float, poses: bool, console: Console) -> dict[str, dict[str, float]]:
    """So many motions of each arm, or as many as the time allows."""

    def chunk(pair: tuple[SpatialArm, Any], number: int, seed: int, count: int) -> dict[str, float]:
        return (judge_by_poses if poses else judge)(*pair, 100_000 * number + seed, count)

    totals = judged(arms(), motions, CHUNK, chunk, console, seconds)
    columns = ["arm", "motions", "free", "wrongly free", "refused without contact", "us a motion"]
    table = Table(*columns, *(["gaps unlike coal's"] if poses else []))
    for name, t in totals.items():
        table.add_row(
            name, f"{t['motions']:,.0f}", f"{t['free']:,.0f}", f"{t['wrongly_free']:.0f}",
            f"{t['refused_without_contact']:.0f} of {t['refused_and_looked_at']:,.0f}",
            f"{1e6 * t['seconds'] / t['motions']:.2f}",
            *([f"{t['poses_apart']:.0f} of {t['poses']:,.0f}"] if poses else []),
        )  # fmt: skip
    console.print(table)
    return totals


# RRT --------------------------------------------------------------------------------------------------------


def rrt(seconds: float, console: Console) -> dict[str, float]:
    """Nodes a second of processor time on pyroboplan's Panda and in its world: ours, and its own."""
    from pyroboplan.models import panda
    from pyroboplan.models.utils import get_example_models_folder

    model, collisions, visuals = panda.load_models(use_sphere_collisions=True)
    panda.add_self_collisions(model, collisions)
    panda.add_object_collisions(model, collisions, visuals)
    path = Path(get_example_models_folder()) / "panda_description" / "urdf" / "panda_spheres.urdf"
    arm = SpatialArm.from_urdf(path, "panda_hand", self_collision=True)
    world = _world_of(collisions)
    space = ConfigurationSpace(arm, world)
    found: dict[str, float] = {}
    q = space.sample(np.random.default_rng(0), 4000)
    q = q[np.asarray(space.valid(q))]
    console.print(
        f"{len(arm.bodies)} bodies, {len(arm.pairs)} pairs of them; pyroboplan has "
        f"{len(collisions.collisionPairs)} pairs; {len(q)} of 4,000 configurations are free"
    )
    start, goal = q[0], q[1]
    problem = Problem(arm, world, Task(start, goal, tolerance=1e-9, by_edge=False), "Panda")
    options = SearchOptions(step=STEP_OF_RRT * space.extent)
    guided_search(problem, "rrt", seed=0, max_samples=100, measure=False, options=options)
    ours = []
    for seed in range(5):
        result = guided_search(problem, "rrt", seed=seed, max_samples=20_000, measure=False, options=options)
        ours.append(len(result.tree) / result.processor)
    found["ours"] = float(np.median(ours))
    console.print(f"ours: {found['ours']:,.0f} nodes/s (20,000 samples, median of 5)")
    length = options.step / float(np.mean(space.weights))
    found["pyroboplan"] = _pyroboplan(model, collisions, arm, (start, goal), length, seconds)
    found["ratio"] = found["ours"] / found["pyroboplan"]
    console.print(
        f"pyroboplan: {found['pyroboplan']:,.0f} nodes/s ({seconds:g} s); {found['ratio']:,.0f} times"
    )
    return found


def _world_of(collisions: Any) -> SpatialEnvironment:
    """The solids of pyroboplan's world: what is fixed to the universe and no part of the arm."""
    solids: list[Solid] = []
    for each in collisions.geometryObjects:
        if "panda" in each.name:
            continue
        centre = tuple(each.placement.translation.tolist())
        if isinstance(each.geometry, coal.Sphere):
            solids.append(Capsule.sphere(centre, each.geometry.radius))
        else:
            solids.append(Box(centre, tuple((2.0 * each.geometry.halfSide).tolist())))
    return SpatialEnvironment((-2.0, -2.0, -1.0, 2.0, 2.0, 2.0), solids)


def _pyroboplan(
    model: Any,
    collisions: Any,
    arm: SpatialArm,
    ends: tuple[FloatArray, FloatArray],
    length: float,
    seconds: float,
) -> float:
    """Nodes a second of processor time of its RRT."""
    from pyroboplan.planning.rrt import RRTPlanner, RRTPlannerOptions

    def full(q: FloatArray) -> FloatArray:
        other: FloatArray = pin.neutral(model)
        for name, value in zip(arm.names, q, strict=True):
            other[model.joints[model.getJointId(name)].idx_q] = value
        return other

    planner = RRTPlanner(
        model,
        collisions,
        RRTPlannerOptions(
            max_step_size=STEP_OF_CHECKS,
            max_connection_dist=length,
            max_planning_time=seconds,
            rng_seed=0,
            fast_return=False,
        ),
    )
    began = time.process_time()
    planner.plan(full(ends[0]), full(ends[1]))
    return float(len(planner.start_tree.nodes) / (time.process_time() - began))


def main() -> int:
    parser = command_line(__doc__)
    parser.add_argument("--motions", type=int, default=10_000, help="of each arm")
    parser.add_argument("--poses", action="store_true", help="by compiled code, which is held against coal")
    parser.add_argument("--rrt", action="store_true", help="nodes a second instead, needs pyroboplan")
    parser.add_argument(
        "--seconds", type=float, default=0.0, help="of pyroboplan's run (10), or of each arm's motions (any)"
    )
    arguments = parser.parse_args()
    console = Console()
    if arguments.rrt:
        figures: dict[str, Any] = dict(rrt(arguments.seconds or 10.0, console))
    else:
        figures = dict(certified(arguments.motions, arguments.seconds or np.inf, arguments.poses, console))
    write_figures(arguments.json, figures)
    return 1 if not arguments.rrt and any(counts["wrongly_free"] for counts in figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
