"""Certified motions against a dense reference: wrongly free, needlessly refused, missed by sampling.

    python benchmarks/certified_motions.py --motions 1000000 --json certified_motions.json
    python benchmarks/certified_motions.py --motions 1000000 --large

Half of the motions run through workspaces like the paper's problems, half through random polygon clutter. All
start at a valid pose, half of them close to an obstacle, and reach up to 20 % of the workspace's side. The
reference (`dense_reference.py`) checks each at steps of 1e-4 of the side. Where it finds a motion free that
was refused, it looks again, ten thousand times closer, around the contact that was reported.

For comparison, a checker that samples each motion at 1 % of the space's extent judges the same motions, and
paths of ten edges built as a planner would: each edge accepted by that checker.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import dense_reference
import numpy as np
import numpy.typing as npt
import shapely
from command_line import command_line, write_figures
from numba import njit
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from guided_gym.catalogue.table import make_distribution, rectangle_robot
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import collision

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

PAPER = ("SimplePassage", "Cup", "Trap", "TrapCup", "RandomSimplePassage")
SIDE = 10.0
BOUNDS = (0.0, 0.0, SIDE, SIDE)
STEP = 1e-4 * SIDE
LONGEST = 0.2 * SIDE
NEAR = 0.02 * SIDE
CHUNK = 5_000
PATHS_PER_CHUNK = 250
EDGES = 10


@dataclass
class Tally:
    """Counts over the motions of one kind of scene."""

    motions: int = 0
    free: int = 0
    wrongly_free: int = 0
    refused: int = 0
    refused_in_fact_colliding: int = 0
    colliding: int = 0
    let_through_by_sampling: int = 0
    paths: int = 0
    paths_colliding: int = 0
    reference_poses: int = 0
    reference_disagreements_with_shapely: int = 0
    certified_seconds: float = 0.0
    sampled_seconds: float = 0.0

    def add(self, other: Tally) -> None:
        """Add another tally's counts to these."""
        for name, value in asdict(other).items():
            setattr(self, name, getattr(self, name) + value)

    @property
    def needlessly_refused(self) -> int:
        """Refused motions in which even the close look found no collision."""
        return self.refused - self.refused_in_fact_colliding


def catalogue(name: str) -> Callable[[np.random.Generator], Environment]:
    """The workspaces of a problem of the catalogue."""
    return lambda rng: make_distribution(name).sample(rng).environment


def clutter(rng: np.random.Generator) -> Environment:
    """Thirty random star-shaped polygons, convex or not, that may overlap."""
    rings = []
    for _ in range(30):
        n = int(rng.integers(3, 10))
        angles = 2 * math.pi * (np.arange(n) + rng.uniform(0.05, 0.95, n)) / n
        radii = rng.uniform(0.15, 0.9) * rng.uniform(0.35, 1.0, n)
        centre = rng.uniform(0, SIDE, 2)
        rings.append(centre + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))
    polygons = [polygon for polygon in map(shapely.Polygon, rings) if polygon.is_valid]
    return Environment(BOUNDS, tuple(polygons))


def large(rng: np.random.Generator) -> Environment:
    """Three thousand obstacles in a hundred times the area: stars, needles and long thin walls."""
    shapes = []
    for _ in range(3000):
        centre, kind = rng.uniform(0, 10 * SIDE, 2), rng.random()
        n = 3 if kind < 0.1 else int(rng.integers(3, 10))
        angles = 2 * math.pi * (np.arange(n) + rng.uniform(0.05, 0.95, n)) / n
        radii = rng.uniform(0.15, 0.9) * rng.uniform(0.35, 1.0, n)
        ring = radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        if kind < 0.1:  # squeezed to a needle, and turned
            ring, turn = ring * [1.0, 10.0 ** rng.uniform(-4, -1)], rng.uniform(0, 2 * math.pi)
            ring = ring @ [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
        elif kind < 0.12:
            ring = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * rng.permutation([rng.uniform(2, 8), 0.02])
        shapes.append(shapely.Polygon(centre + ring))
    bounds = (0.0, 0.0, 10 * SIDE, 10 * SIDE)
    inside = shapely.box(*bounds)
    return Environment(bounds, tuple(s for s in shapes if s.is_valid and s.intersects(inside)))


L_SHAPE = [(-0.2, -0.2), (0.8, -0.2), (0.8, 0.1), (0.1, 0.1), (0.1, 0.8), (-0.2, 0.8)]
RECTANGLE = rectangle_robot()

Scene = tuple[Robot, Callable[[np.random.Generator], Environment], float]
SCENES: dict[str, Scene] = {
    **{f"{name}, rectangle": (RECTANGLE, catalogue(name), 1 / 10) for name in PAPER},
    "clutter, rectangle": (RECTANGLE, clutter, 1 / 8),
    "clutter, L": (Robot.polygon(L_SHAPE), clutter, 1 / 8),
    "clutter, segment": (Robot.segment(1.0), clutter, 1 / 8),
    "clutter, point": (Robot.point(), clutter, 1 / 8),
}
"""Robot, workspace and share of the motions."""
LARGE: dict[str, Scene] = {
    "large, rectangle": (RECTANGLE, large, 1 / 4),
    "large, L": (Robot.polygon(L_SHAPE), large, 1 / 4),
    "large, segment": (Robot.segment(1.0), large, 1 / 4),
    "large, point": (Robot.point(), large, 1 / 4),
}
"""The same in large worlds."""


def _valid_poses(space: ConfigurationSpace, rng: np.random.Generator, n: int, near: float) -> FloatArray:
    """Draw n valid poses, with a clearance of at most `near`."""
    found: list[FloatArray] = []
    while sum(map(len, found)) < n:
        poses = space.sample(rng, 4 * n)
        clearance = np.asarray(space.clearance(poses))
        found.append(poses[(clearance > 0) & (clearance <= near)])
    return np.concatenate(found)[:n]


def _moved(space: ConfigurationSpace, rng: np.random.Generator, poses: FloatArray) -> FloatArray:
    """Each pose moved in a random direction of the metric by up to `LONGEST`."""
    direction = rng.normal(size=poses.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return space.wrap(poses + direction * rng.uniform(0, LONGEST, (len(poses), 1)) / space.weights)


@njit(cache=True)
def _sampled_free(starts, ends, lengths, resolution, geometry):
    """A resolution-based check: poses at most `resolution` apart, the end included."""
    free = np.ones(starts.shape[0], dtype=np.bool_)
    q = np.empty(starts.shape[1])
    for i in range(starts.shape[0]):
        count = max(1, math.ceil(lengths[i] / resolution))
        for k in range(1, count + 1):
            for j in range(starts.shape[1]):
                change = ends[i, j] - starts[i, j]
                if j == 2 and abs(change) > math.pi:
                    change -= 2.0 * math.pi * np.rint(change / (2.0 * math.pi))
                q[j] = starts[i, j] + change * k / count
            if not collision.pose_free(q, geometry):
                free[i] = False
                break
    return free


def sampled_free(space: ConfigurationSpace, starts: FloatArray, ends: FloatArray) -> BoolArray:
    """The comparison: OMPL's default, 1 % of the largest distance in the space."""
    largest = math.hypot(space.extent, math.pi * space.weights[2]) if space.dimension == 3 else space.extent
    return _sampled_free(starts, ends, space.distance(starts, ends), 0.01 * largest, space.geometry)


def judge_motions(
    space: ConfigurationSpace, scene: dense_reference.Scene, rng: np.random.Generator, n: int
) -> Tally:
    """Certified checker, sampling checker and reference on n random motions."""
    starts = np.concatenate(
        (_valid_poses(space, rng, n - n // 2, np.inf), _valid_poses(space, rng, n // 2, NEAR))
    )
    ends = _moved(space, rng, starts)
    began = time.perf_counter()
    certified = space.motions_free(starts, ends)
    between = time.perf_counter()
    sampled = sampled_free(space, starts, ends)
    ended = time.perf_counter()
    collides = dense_reference.motions_collide(starts, ends, STEP, scene) >= 0
    for i in np.flatnonzero(certified & collides):
        print(f"WRONGLY FREE: {starts[i].tolist()} -> {ends[i].tolist()}", file=sys.stderr)
    refused = np.flatnonzero(~certified & ~collides)
    in_fact = sum(_collides_at_contact(space, scene, starts[i], ends[i]) for i in refused)
    return Tally(
        motions=n,
        free=int(certified.sum()),
        wrongly_free=int((certified & collides).sum()),
        refused=len(refused),
        refused_in_fact_colliding=in_fact,
        colliding=int(collides.sum()),
        let_through_by_sampling=int((sampled & collides).sum()),
        certified_seconds=between - began,
        sampled_seconds=ended - between,
    )


def _collides_at_contact(
    space: ConfigurationSpace, scene: dense_reference.Scene, a: FloatArray, b: FloatArray
) -> bool:
    """Whether the reference finds a collision after all, looking closer where contact was reported."""
    reach = 2 * STEP / max(float(space.distance(a, b)), STEP)
    for start, end in ((a, b), (b, a)):
        t = space.first_contact(start, end)
        low, high = max(0.0, t - reach), min(1.0, t + reach)
        if dense_reference.motion_collides(start, end, 1e-4 * STEP, scene, low, high) >= 0:
            return True
    return False


def judge_paths(
    space: ConfigurationSpace, scene: dense_reference.Scene, rng: np.random.Generator, n: int
) -> Tally:
    """How many of n paths collide, each of ten edges that the sampling checker let pass."""
    at = _valid_poses(space, rng, n, np.inf)
    hit = np.zeros(n, dtype=bool)
    for _ in range(EDGES):
        ends = at.copy()
        todo = np.arange(n)
        while len(todo):
            ends[todo] = _moved(space, rng, at[todo])
            todo = todo[~sampled_free(space, at[todo], ends[todo])]
        hit |= dense_reference.motions_collide(at, ends, STEP, scene) >= 0
        at = ends
    return Tally(paths=n, paths_colliding=int(hit.sum()))


def check_reference(
    space: ConfigurationSpace, scene: dense_reference.Scene, rng: np.random.Generator, n: int
) -> Tally:
    """The reference itself against shapely, on n random poses."""
    workspace, obstacles = shapely.box(*space.environment.bounds), space.environment.obstacle_union
    poses = space.sample(rng, n)
    wrong = 0
    for q in poses:
        placed = space.robot.placed(q)
        expected = placed.intersects(obstacles) or not workspace.contains_properly(placed)
        wrong += bool(expected) != bool(dense_reference.pose_collides(q, scene))
    return Tally(reference_poses=n, reference_disagreements_with_shapely=wrong)


def chunks(scenes: dict[str, Scene], motions: int) -> Iterator[tuple[str, int, int]]:
    """(scene, seed, motions) of each chunk; each chunk has a workspace of its own."""
    for name, (_, _, share) in scenes.items():
        left = math.ceil(motions * share)
        for seed in range(math.ceil(left / CHUNK)):
            yield name, seed, min(CHUNK, left - seed * CHUNK)


def run(scenes: dict[str, Scene], motions: int, seed: int, console: Console) -> dict[str, Tally]:
    """Judge all scenes."""
    tallies = {name: Tally() for name in scenes}
    for robot, build, _ in (SCENES["Cup, rectangle"], SCENES["clutter, point"]):  # compile before timing
        rng = np.random.default_rng(seed)
        space = ConfigurationSpace(robot, build(rng))
        judge_motions(space, dense_reference.scene_of(robot, space.environment), rng, 2)
    with Progress(console=console) as progress:
        task = progress.add_task("motions", total=motions)
        for number, (name, chunk, n) in enumerate(chunks(scenes, motions)):
            robot, build, _ = scenes[name]
            rng = np.random.default_rng([seed, number, chunk])
            space = ConfigurationSpace(robot, build(rng))
            scene = dense_reference.scene_of(robot, space.environment)
            tallies[name].add(judge_motions(space, scene, rng, n))
            tallies[name].add(judge_paths(space, scene, rng, max(1, PATHS_PER_CHUNK * n // CHUNK)))
            tallies[name].add(check_reference(space, scene, rng, max(1, n // 25)))
            progress.advance(task, n)
    return tallies


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.3f} %" if whole else "-"


def table(tallies: dict[str, Tally]) -> Table:
    """The result for people."""
    columns = ["scene", "motions", "free", "wrongly free", "refused", "needlessly", "certified"]
    columns += ["sampled at 1 %", "collisions missed", "10-edge paths colliding", "reference vs shapely"]
    result = Table(*columns, title="Certified motions against a dense reference")
    for name, t in tallies.items():
        result.add_row(
            name,
            f"{t.motions:,}",
            f"{t.free:,}",
            str(t.wrongly_free),
            f"{t.refused} ({_percent(t.refused, t.free)})",
            f"{t.needlessly_refused} ({_percent(t.needlessly_refused, t.free)})",
            f"{1e6 * t.certified_seconds / t.motions:.2f} us",
            f"{1e6 * t.sampled_seconds / t.motions:.2f} us",
            _percent(t.let_through_by_sampling, t.colliding),
            _percent(t.paths_colliding, t.paths),
            f"{t.reference_disagreements_with_shapely} of {t.reference_poses:,}",
        )
    return result


def main() -> int:
    parser = command_line(__doc__)
    parser.add_argument("--motions", type=int, default=1_000_000)
    parser.add_argument("--large", action="store_true", help="large worlds only, of some 4,000 pieces")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    console = Console()
    began = time.perf_counter()
    tallies = run(LARGE if arguments.large else SCENES, arguments.motions, arguments.seed, console)
    total = Tally()
    for tally in tallies.values():
        total.add(tally)
    tallies["all"] = total
    console.print(table(tallies))
    result = {"seed": arguments.seed, "step": STEP, "seconds": time.perf_counter() - began}
    scenes = {name: asdict(t) | {"needlessly_refused": t.needlessly_refused} for name, t in tallies.items()}
    write_figures(arguments.json, result | {"scenes": scenes})
    return 1 if total.wrongly_free or total.needlessly_refused > 1e-3 * total.free else 0


if __name__ == "__main__":
    sys.exit(main())
