"""Processor time of this build and of another one, problem by problem in turn, as ratios.

    python benchmarks/side_by_side.py OTHER_PYTHON [--problems 64] [--rounds 3]

OTHER_PYTHON is the interpreter of an environment in which the other build is installed, such as one of an
older commit. Each build runs the same measurement in a process of its own, `--rounds` times in turn; the
least of its times counts. Searches and preparations meet each problem for the first time, as a user's do.
Of each step of an environment, the least time by the clock over so many equal episodes counts.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from command_line import command_line, write_figures

SEARCHES = {
    "TrapCup": ("lazy_prm", "hybrid"),
    "RandomMaze@test": ("lazy_prm", "hybrid"),
    "RandomPointMaze@test": ("lazy_prm", "hybrid"),
}
PREPARED = {"RandomClutter": ("wavefront",)}
# What an action is: any node of the tree, or any guide.
STEPS = {"TrapCup-v0": "node", "GuideSelection-v0": "guide"}
BUILT = ("SimplePassage", "Cup", "Trap", "TrapCup", "RandomMaze", "RandomClutter")

# Runs under either build, so it takes names that both have.
PROBE = """
import json, sys, time
try:
    from guided_gym import make_distribution
except ImportError:
    from guided_gym.envs.catalogue import make_distribution
from guided_gym import guided_search, make_guidance

def clocked(run, items):
    began = time.process_time()
    for item in items:
        run(item)
    return (time.process_time() - began) / len(items)

def build(problem):
    old, space = problem.environment, problem.space
    type(space)(space.robot, type(old)(old.bounds, old.obstacles))

def stepped(name, kind, episodes, passes):
    import gymnasium, numpy
    env = gymnasium.make("guided_gym/" + name).unwrapped
    def episode(seed):
        env.reset(seed=seed)
        rng, times, done = numpy.random.default_rng(seed), [], False
        while not done:
            action = int(rng.integers(2 if kind == "guide" else len(env.search.tree)))
            began = time.perf_counter()
            _, _, terminated, truncated, _ = env.step(action)
            times.append(time.perf_counter() - began)
            done = terminated or truncated
        return times
    least = [numpy.min([episode(seed) for _ in range(passes)], axis=0) for seed in range(episodes)]
    return float(numpy.concatenate(least).mean())

searches, prepared, built, steps, count = json.loads(sys.argv[1])
out = {}
for limit, rows in ((1000, searches), (1, prepared)):
    for name, guides in rows.items():
        distribution = make_distribution(name)
        problems = [distribution.problem(i) for i in range(count)]
        for text in guides:
            guide = make_guidance(text)
            guided_search(distribution.problem(count), guide, seed=0, max_samples=30, measure=False)
            run = lambda i: guided_search(problems[i], guide, seed=i, max_samples=limit, measure=False)
            what = "search" if limit > 1 else "preparation"
            out[f"{what}, {text}, {name}"] = clocked(run, range(count))
for name in built:
    problem = make_distribution(name).problem(0)
    build(problem)
    out[f"building, {name}"] = clocked(build, [problem] * 50)
for name, kind in steps.items():
    out[f"step, {name}"] = stepped(name, kind, 6, 8)
print(json.dumps(out))
"""


def measured(python: str, problems: int) -> dict[str, float]:
    """Seconds of processor time of each item, under one build."""
    given = (SEARCHES, PREPARED, BUILT) if problems else ({}, {}, ())
    arguments = json.dumps([*given, STEPS, problems])
    done = subprocess.run(
        [python, "-P", "-W", "ignore", "-c", PROBE, arguments],  # -P: not what lies in the current folder
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    times: dict[str, float] = json.loads(done.stdout)
    return times


def main() -> None:
    """Measure both, and print a table."""
    parser = command_line(__doc__)
    parser.add_argument("python", type=Path, nargs="?", help="interpreter of the other build")
    parser.add_argument("--problems", type=int, default=64, help="0 for the steps alone")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    if options.python is None:
        print("no interpreter of another build was given: nothing is compared")
        return
    builds = sys.executable, str(options.python)
    best: list[dict[str, float]] = [{}, {}]
    for _ in range(options.rounds):
        for times, python in zip(best, builds, strict=True):
            for item, seconds in measured(python, options.problems).items():
                times[item] = min(seconds, times.get(item, seconds))
    print(f"{'':44} this ms  other ms  ratio")
    for item, seconds in best[0].items():
        other = best[1][item]
        print(f"{item:44} {1e3 * seconds:7.3f} {1e3 * other:9.3f} {seconds / other:6.2f}")
    write_figures(options.json, {"this": best[0], "other": best[1]})


if __name__ == "__main__":
    main()
