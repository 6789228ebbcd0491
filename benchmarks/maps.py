"""Plans on a map of 1,000 x 1,000 cells: the whole command, a second one, a hundred tasks.

    python benchmarks/maps.py --json maps.json

The map is a ROS one of a few thousand boxes. Commands run in processes of their own, first with nothing kept
on disk (cold; kernels are compiled before), then with what the first one prepared (warm). Times are processor
times, but for those that say "wall". A hundred tasks on one map, with `--tasks`, stand beside a hundred
commands (the mean of a few, times a hundred). Beside the commands stand the same steps within a process:
reading the map, the first plan, and the next.
"""

from __future__ import annotations

import csv
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from command_line import command_line, write_figures

CELLS, BOXES, RESOLUTION = 1000, 3000, 0.05
ROBOT = "rectangle:0.3,0.2"
FIRST = ("1.5,48.5,0", "48.5,1.5,0")
TASKS, COMMANDS = 100, 3


def make_map(folder: Path, seed: int = 0) -> Path:
    """A ROS map of boxes of 3 to 11 cells, with two corners left free."""
    rng = np.random.default_rng(seed)
    pixels = np.full((CELLS, CELLS), 254, np.uint8)
    for _ in range(BOXES):
        width, height = rng.integers(3, 12, 2)
        x, y = rng.integers(0, CELLS - width), rng.integers(0, CELLS - height)
        if not ((x < 60 and y < 60) or (x > CELLS - 70 and y > CELLS - 70)):
            pixels[y : y + height, x : x + width] = 0
    pixels[:3] = pixels[-3:] = pixels[:, :3] = pixels[:, -3:] = 0
    (folder / "big.pgm").write_bytes(f"P5\n{CELLS} {CELLS}\n255\n".encode() + pixels.tobytes())
    (folder / "big.yaml").write_text(
        f"image: big.pgm\nresolution: {RESOLUTION}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return folder / "big.yaml"


def draw_tasks(map_file: Path, count: int) -> list[tuple[list[float], list[float]]]:
    """Pairs of free poses that a plan joins; not those shut in between boxes."""
    from guided_gym.catalogue.maps import read_map
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.problems import Problem, Task
    from guided_gym.train.plan_cli import parse_pose, parse_robot
    from guided_gym.train.plans import Planner

    space = ConfigurationSpace(parse_robot(ROBOT), read_map(map_file))
    task = Task(*(parse_pose("task", text) for text in FIRST))
    planner = Planner(Problem(space.robot, space.environment, task), max_samples=500)
    rng, found = np.random.default_rng(1), []
    while len(found) < count:
        start, goal = space.sample(rng, 2)
        if space.valid(start) and space.valid(goal) and planner.plan(Task(start, goal)).solved:
            found.append((start.tolist(), goal.tolist()))
    return found


def command(words: list[str], cache: Path) -> dict[str, float]:
    """Processor time, wall time and peak memory of a `guided-gym plan`; it has to find all paths."""
    environment = {**os.environ, "GUIDED_GYM_CACHE": str(cache)}
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "guided_gym.train.cli", "plan", *words],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    text = process.stdout.read() if process.stdout else ""
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"guided-gym plan {' '.join(words)}\n{text}")
    return {
        "processor, s": used.ru_utime + used.ru_stime,
        "wall, s": time.perf_counter() - began,
        "peak, MiB": used.ru_maxrss / 1024,
    }


def in_process(map_file: Path, tasks: list[tuple[list[float], list[float]]]) -> dict[str, float]:
    """Processor seconds of the steps of a plan once Python, packages and kernels are there."""
    from guided_gym.catalogue.maps import MapOptions, read_map
    from guided_gym.problems import Task
    from guided_gym.storage.preparations import PreparationStore
    from guided_gym.train.plan_cli import _problems
    from guided_gym.train.plans import Planner

    rows: dict[str, list[float]] = {"read the map": [], "a plan, all of it": [], "a further task": []}
    for _ in range(3):
        began = time.process_time()
        read_map(map_file)
        rows["read the map"].append(time.process_time() - began)
        began = time.process_time()
        (problem,) = _problems(map_file, ROBOT, *FIRST, MapOptions())
        planner = Planner(problem, store=PreparationStore(None))
        assert planner.plan().solved
        rows["a plan, all of it"].append(time.process_time() - began)
        for start, goal in tasks[:20]:
            began = time.process_time()
            planner.plan(Task(start, goal))
            rows["a further task"].append(time.process_time() - began)
    return {
        "read the map, s": min(rows["read the map"]),
        "a plan, all of it, s": min(rows["a plan, all of it"]),
        "a further task, median s": statistics.median(rows["a further task"]),
        "a further task, most s": max(rows["a further task"]),
    }


def occupancy_grid() -> dict[str, float]:
    """Processor seconds to make convex pieces of a 400 x 400 grid of 24,000 occupied cells."""
    from guided_gym.geometry.environment import Environment

    rng = np.random.default_rng(0)
    cells = np.zeros(400 * 400, bool)
    cells[rng.choice(cells.size, 24_000, replace=False)] = True
    times, pieces = [], 0
    for _ in range(4):
        began = time.process_time()
        pieces = len(Environment.from_occupancy(cells.reshape(400, 400), 0.05).pieces)
        times.append(time.process_time() - began)
    return {"24,000 cells, s": min(times), "pieces": float(pieces)}


def measure(folder: Path) -> dict[str, Any]:
    """All figures."""
    map_file = make_map(folder)
    tasks = draw_tasks(map_file, TASKS)
    with (folder / "tasks.csv").open("w", newline="") as file:
        csv.writer(file).writerows([*start, *goal] for start, goal in tasks)
    once = [str(map_file), "--robot", ROBOT]
    words = [[*once, "--start", ",".join(map(str, s)), "--goal", ",".join(map(str, g))] for s, g in tasks]
    command(words[0], folder / "compile")
    cold = [command(row, folder / f"cold {k}") for k, row in enumerate(words[:COMMANDS])]
    warm = [command(row, folder / "cold 0") for row in words[:COMMANDS]]
    hundred = command([*once, "--tasks", str(folder / "tasks.csv")], folder / "hundred")
    result: dict[str, Any] = {"in a process": in_process(map_file, tasks), "grid": occupancy_grid()}
    for name, rows in (("command, cold", cold), ("command, warm", warm)):
        result[name] = {key: statistics.mean(row[key] for row in rows) for key in rows[0]}
    result["100 tasks"] = hundred
    for name in ("command, cold", "command, warm"):
        share = hundred["processor, s"] / (TASKS * result[name]["processor, s"])
        result["100 tasks"][f"of 100 times the {name}"] = share
    return result


def main() -> None:
    parser = command_line(__doc__)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder))
    for name, figures in result.items():
        print(name)
        for key, value in figures.items():
            print(f"  {key:40s} {value:10.3f}")
    print(f"peak of this process, MiB {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}")
    write_figures(options.json, result)


if __name__ == "__main__":
    main()
