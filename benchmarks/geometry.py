"""Build problems, check poses and motions, measure clearance, as the pieces grow in number.

    python benchmarks/geometry.py --json geometry.json
    python benchmarks/geometry.py --peer /path/to/another/python

With `--peer`, the same file runs under another interpreter, with another build of this package, in turns with
this one; figures are the least of the turns, in processor time. Problems come from the catalogue and from
worlds of 10 x sqrt(n / 30) a side with n octagons or with n / 1.5 stars, so that the density is the same.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from command_line import command_line, write_figures

CATALOGUE = ("TrapCup", "RandomMaze", "RandomPointMaze", "HardStickMaze", "RandomClutter")
LARGE = (300, 31_000)
TURNS = 3


def worlds() -> dict[str, dict[str, Any]]:
    """Bounds, obstacles and robot of each problem, as text that any build can read."""
    from guided_gym.catalogue.table import make_distribution

    found = {}
    for name in CATALOGUE:
        problem = make_distribution(name).sample(np.random.default_rng(0))
        found[name] = _text(problem.environment.bounds, problem.environment.obstacles, problem.robot.outline)
    found["union of 1,000 octagons"] = _text(
        (0, 0, 100, 100),
        [part for part in shapely.get_parts(shapely.union_all(octagons(1000, 100.0, 1.0)))],
        shapely.box(-0.5, -0.2, 0.5, 0.2),
    )
    for n in LARGE:
        side = 10.0 * float(np.sqrt(n / 30))
        robot, bounds = shapely.box(-0.5, -0.2, 0.5, 0.2), (0.0, 0.0, side, side)
        found[f"{n:,} octagons"] = _text(bounds, octagons(n, side, 0.5), robot)
        found[f"{n:,} pieces of stars"] = _text(bounds, stars(int(n / 1.5), side, 0.5), robot)
    return found


def _text(bounds: Any, obstacles: Any, outline: shapely.Geometry) -> dict[str, Any]:
    shapes = [shapely.to_wkb(shape, hex=True) for shape in obstacles]
    return {"bounds": list(bounds), "obstacles": shapes, "robot": shapely.to_wkb(outline, hex=True)}


def octagons(n: int, side: float, radius: float) -> list[shapely.Polygon]:
    """N octagons anywhere in a square."""
    return _rings(n, side, np.full((n, 8), radius), np.random.default_rng(0))


def stars(n: int, side: float, radius: float) -> list[shapely.Polygon]:
    """N octagons with corners drawn in by up to a half, most of them not convex."""
    rng = np.random.default_rng(1)
    return _rings(n, side, radius * rng.uniform(0.5, 1.0, (n, 8)), rng)


def _rings(n: int, side: float, radii: np.ndarray, rng: np.random.Generator) -> list[shapely.Polygon]:
    angles = 2 * np.pi * (np.arange(8) + 0.5) / 8
    corners = radii[:, :, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    return list(shapely.polygons(rng.uniform(0, side, (n, 1, 2)) + corners))


def least(call: Callable[[], object], turns: int) -> float:
    """The least processor time of some calls, in seconds."""
    times = []
    for _ in range(turns):
        began = time.thread_time()
        call()
        times.append(time.thread_time() - began)
    return min(times)


def measure(world: dict[str, Any]) -> dict[str, float]:
    """Milliseconds to build a problem's space, and nanoseconds of each check in a batch."""
    try:
        from guided_gym.geometry.environment import Environment
        from guided_gym.geometry.robots import Robot
        from guided_gym.geometry.space import ConfigurationSpace
    except ImportError:  # a build from before the rooms
        from guided_gym.environment import Environment  # type: ignore[no-redef]
        from guided_gym.robots import Robot  # type: ignore[no-redef]
        from guided_gym.space import ConfigurationSpace  # type: ignore[no-redef]
    shapes = tuple(shapely.from_wkb(world["obstacles"]))
    outline, bounds = shapely.from_wkb(world["robot"]), tuple(world["bounds"])
    dimension = 2 if outline.geom_type == "Point" else 3
    many = len(shapes) > 2000

    def build() -> Any:
        return ConfigurationSpace(Robot(outline, dimension), Environment(bounds, shapes))

    space = build()
    figures = {
        "pieces": float(len(space.environment.pieces)),
        "build, ms": 1e3 * least(build, 1 if many else 20),
    }
    rng = np.random.default_rng(0)
    poses = np.empty((0, dimension))
    while len(poses) < 1000:
        drawn = space.sample(rng, 2000)
        poses = np.concatenate((poses, drawn[space.valid(drawn)]))
    poses = poses[:1000]
    away = rng.normal(size=poses.shape)
    away *= (
        rng.uniform(0, 0.05 * min(14.0, space.extent), (len(away), 1)) / np.linalg.norm(away, axis=1)[:, None]
    )
    near, far = space.wrap(poses + away / space.weights), np.roll(poses, 1, axis=0)
    drawn, few = space.sample(rng, 1000), poses[: 200 if many else 1000]
    calls: dict[str, tuple[int, Callable[[], object]]] = {
        "pose, ns": (1000, lambda: space.valid(drawn)),
        "free pose, ns": (1000, lambda: space.valid(poses)),
        "motion, ns": (1000, lambda: space.motions_free(poses, near)),
        "first contact, ns": (1000, lambda: space.first_contacts(poses, near)),
        "motion across, ns": (len(few), lambda: space.motions_free(few, far[: len(few)])),
        "clearance, ns": (len(few), lambda: space.clearance(few)),
    }
    for name, (n, call) in calls.items():
        call()
        figures[name] = 1e9 * least(call, 3 if many else 30) / n
    return figures


def _run(python: str, file: str) -> dict[str, dict[str, float]]:
    command = [python, __file__, "--worlds", file]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tempfile.gettempdir())
    return json.loads(done.stdout.splitlines()[-1])  # type: ignore[no-any-return]


def compare(pythons: dict[str, str], turns: int) -> dict[str, dict[str, dict[str, float]]]:
    """The least figures of each build, the builds taking turns."""
    result: dict[str, dict[str, dict[str, float]]] = {name: {} for name in pythons}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "worlds.json"
        file.write_text(json.dumps(worlds()))
        for _ in range(turns):
            for name, python in pythons.items():
                for world, figures in _run(python, str(file)).items():
                    held = result[name].setdefault(world, figures)
                    result[name][world] = {key: min(value, held[key]) for key, value in figures.items()}
    return result


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--peer", help="a Python interpreter that has another build")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--worlds", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worlds:
        print(json.dumps({k: measure(w) for k, w in json.loads(Path(options.worlds).read_text()).items()}))
        return
    pythons = {"this": sys.executable} | ({"peer": options.peer} if options.peer else {})
    result = compare(pythons, options.turns)
    for world, figures in result["this"].items():
        print(world)
        for key, value in figures.items():
            line = f"  {key:18s} {value:12.3f}"
            if options.peer:
                other = result["peer"][world][key]
                line += f"   peer {other:12.3f}   {value / other:6.3f} of it"
            print(line)
    write_figures(options.json, result)


if __name__ == "__main__":
    main()
