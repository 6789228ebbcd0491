"""Speed of the environment: steps, resets, the first use on a machine, and CartPole beside them for scale.

    python benchmarks/environment.py --json environment.json

A step is measured on the unwrapped environment with the default observation of 256 nodes, whole episodes of
valid random nodes, so that the tree is of every size. Mean, median and p99 are wall times, too high on a busy
machine; cpu is the mean of the processor's time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import gymnasium
import numpy as np
from command_line import command_line, write_figures
from rich.console import Console
from rich.table import Table

from guided_gym.catalogue.table import distribution_names, make_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.envs.pool import ProblemPool

FIRST_USE = """
import time
def spent(): return time.perf_counter() - began, time.process_time()
began = time.perf_counter()
import guided_gym
print(*spent())
import gymnasium
gymnasium.make("guided_gym/TrapCup-v0").reset(seed=0)
print(*spent())
"""
DRAWN = [name for name in distribution_names() if not make_distribution(name).fixed]
# What is allowed, in the unit of each row.
LIMITS = {
    "step, uniform expansion": 60.0,
    "reset, cached problem": 2.0,
    **{f"reset, fresh {name}": 150.0 for name in DRAWN},
    "import guided_gym": 1.0,
    "first make + reset": 20.0,
}


def step_times(env: gymnasium.Env, steps: int, choose: Callable[[gymnasium.Env, np.random.Generator], int]):
    """(n, 2) seconds of each step by the clock and of the processor, over episodes one after the other."""
    rng, times, seed, done = np.random.default_rng(0), [], 0, True
    while len(times) < steps:
        if done:
            env.reset(seed=seed)
            seed += 1
        action = choose(env, rng)
        began, worked = time.perf_counter(), time.thread_time()
        _, _, terminated, truncated, _ = env.step(action)
        times.append((time.perf_counter() - began, time.thread_time() - worked))
        done = terminated or truncated
    return np.array(times)


def a_valid_node(env: gymnasium.Env, rng: np.random.Generator) -> int:
    return int(rng.integers(len(env.search.tree)))


def reset_times(env: gymnasium.Env, count: int):
    times = []
    for seed in range(count):
        began, worked = time.perf_counter(), time.thread_time()
        env.reset(seed=seed)
        times.append((time.perf_counter() - began, time.thread_time() - worked))
    return np.array(times)


def pooled_reset_times(count: int):
    with ProblemPool("RandomMaze", workers=1, ahead=count) as pool:
        env = GuidedSearchEnv(pool)
        while pool.ready < count:
            time.sleep(0.1)
        return reset_times(env, count)


def first_use() -> dict[str, dict[str, float | str]]:
    """Importing the package, and all up to the end of the first reset, where nothing was compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder, "GUIDED_GYM_CACHE": "off"}
        output = subprocess.run(
            [sys.executable, "-c", FIRST_USE], env=environment, capture_output=True, text=True, check=True
        )
    times = np.array(output.stdout.split(), np.float64).reshape(2, 1, 2)
    return {"import guided_gym": row(times[0], 1, "s"), "first make + reset": row(times[1], 1, "s")}


def row(times: np.ndarray, scale: float, unit: str) -> dict[str, float | str]:
    wall = times[:, 0] * scale
    return {
        "mean": float(wall.mean()),
        "median": float(np.median(wall)),
        "p99": float(np.quantile(wall, 0.99)),
        "cpu": float(times[:, 1].mean() * scale),
        "unit": unit,
    }


def measure(steps: int) -> dict[str, dict[str, float | str]]:
    os.environ["GUIDED_GYM_CACHE"] = "off"  # a fresh problem is to be solved afresh
    rows = {}
    for label, options in (
        ("step, uniform expansion", {}),
        ("step, rrt expansion", {"expansion": "rrt"}),
        ("step, Jensen-Shannon", {"reward": "jensen_shannon"}),
        ("step, target in info", {"target_in_info": True}),
    ):
        env = gymnasium.make("guided_gym/TrapCup-v0", **options).unwrapped
        step_times(env, 300, a_valid_node)  # compiles
        rows[label] = row(step_times(env, steps, a_valid_node), 1e6, "us")
    rows["step, CartPole-v1"] = row(
        step_times(gymnasium.make("CartPole-v1").unwrapped, steps, lambda env, rng: int(rng.integers(2))),
        1e6,
        "us",
    )
    rows["reset, cached problem"] = row(reset_times(env, 200), 1e3, "ms")
    for name in DRAWN:
        env = GuidedSearchEnv(name)
        env.reset(seed=2**31)  # compiles
        rows[f"reset, fresh {name}"] = row(reset_times(env, 50), 1e3, "ms")
    rows["reset, RandomMaze of a full pool"] = row(pooled_reset_times(30), 1e3, "ms")
    rows |= first_use()
    for label, limit in LIMITS.items():
        rows[label]["limit"] = limit
    return rows


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--steps", type=int, default=5000, help="steps of each kind")
    options = parser.parse_args()
    rows = measure(options.steps)
    table = Table("", "mean", "median", "99 %", "cpu", "limit", "")
    for label, r in rows.items():
        numbers = [f"{r[key]:.3g}" if key in r else "" for key in ("mean", "median", "p99", "cpu", "limit")]
        table.add_row(label, *numbers, str(r["unit"]))
    Console().print(table)
    write_figures(options.json, rows)


if __name__ == "__main__":
    main()
