"""OMPL's planners, watched: is its RRT ours, what does watching cost, who is faster, and does memory grow?

    python benchmarks/ompl_planners.py --json ompl.json

*Alike*: OMPL's RRT and `rrt` on the paper's five problems, with the same step, goal bias, certified motions
and rule for the goal. OMPL's metric of a robot that turns is another (it adds up), so both plan with angles
cut at half a turn, in the weighted Euclidean metric. Kolmogorov-Smirnov's test compares the samples to the
goal, Welch's the SE per sample; its 95 % interval says how far apart the means can be.

*Cost*: processor time a motion of a watched planner over that of the same planner with the same check and no
watch; with the metric, and without. The watch also looks for the goal from each node.

*Reach*: processor time a problem of the random distributions, our guidances (their preparation included, no
metric) and the fastest of OMPL in turns; and the share of its paths that collide when looked at closely.

*Memory*: what the process has grown by over the last three quarters of so many runs.
"""

from __future__ import annotations

import copy
import gc
import time
from pathlib import Path
from typing import Any

import numpy as np
from command_line import command_line, write_figures
from rich.console import Console
from scipy.stats import ks_2samp, ttest_ind

from guided_gym.catalogue.table import make_distribution
from guided_gym.measure.target import Measure
from guided_gym.planners.ompl import OmplPlanner, planner_names, setters
from guided_gym.planning import _Recorder, guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.train.claims import DRAWN, PROBLEMS
from guided_gym.train.ompl_report import BY_STATES, unprepared

GOAL_BIAS = 0.05
DRAWN_ALL = ("RandomSimplePassage", "RandomTrapCup", "RandomMaze", "RandomPointMaze", "RandomClutter")
OURS = ("medial_axis", "wavefront", "wave(robot=disc)", "wave(robot=point)", "roadmap(robot=disc)")
OURS += ("lazy_prm", "hybrid")
THEIRS = (
    *(("RRTConnect", resolution) for resolution in (0.0001, 0.0002, 0.0005, 0.002, 0.0)),
    ("BITstar", 0.0005),
)
MISSED = 0.05  # the chance that the test calls equals different


def cut(problem: Problem) -> Problem:
    """The problem with angles that are numbers like any other: nothing grows across half a turn."""
    other, space = copy.copy(problem), copy.copy(problem.space)
    space.metric = (space.weights, np.zeros(space.dimension))
    other.__dict__["space"] = space
    return other


def alike(environment: str, seeds: int, max_samples: int = 1000) -> dict[str, Any]:
    """Both RRTs on one problem, or on as many drawn ones."""
    theirs = OmplPlanner("RRT", {"goal_bias": GOAL_BIAS}, angles="cut")
    rows = []
    for seed in range(seeds):
        problem = cut(make_distribution(environment).problem(seed))
        row = []
        for planner in (f"rrt(goal_bias={GOAL_BIAS})", theirs):
            result = guided_search(problem, planner, seed=seed, max_samples=max_samples)
            row += [result.samples, result.efficiency_per_sample, result.solved]
        rows.append(row)
    ours, our_se, our_solved, their, their_se, their_solved = np.array(rows, float).T
    interval = ttest_ind(our_se, their_se, equal_var=False).confidence_interval()
    return {
        "seeds": seeds,
        "samples": float(np.mean(ours)),
        "ompl_samples": float(np.mean(their)),
        "solved": float(our_solved.mean()),
        "ompl_solved": float(their_solved.mean()),
        "p_samples": float(ks_2samp(ours, their).pvalue),
        "se_per_sample": float(our_se.mean()),
        "ompl_se_per_sample": float(their_se.mean()),
        "p_se": float(ttest_ind(our_se, their_se, equal_var=False).pvalue),
        "se_difference": [float(interval.low), float(interval.high)],
    }


def cost_of_watching(planner: str, tries: int, turns: int) -> dict[str, float]:
    """Time a motion, watched and not, in turns."""
    problem = make_distribution("TrapCup").problem(0)
    ratios, measured = [], []
    for seed in range(turns + 1):
        bare = _tries_alone(planner, problem, seed, tries)
        watched = _tries_watched(planner, problem, seed, tries, measure=False)
        with_metric = _tries_watched(planner, problem, seed, tries, measure=True)
        if seed:  # the first one loads what is compiled
            ratios.append(watched / bare)
            measured.append(with_metric / bare)
    return {"watched": float(np.median(ratios)), "measured": float(np.median(measured))}


def _tries_alone(planner: str, problem: Problem, seed: int, tries: int) -> float:
    """Seconds a motion without a watch: the planner with our check alone, until so many were asked for."""
    _, expansion, rng = streams(seed)
    search = Search(problem, expansion, rng)
    made = _short(planner)
    made.prepare(search)
    query = made._query
    assert query is not None
    answers = _Counted(query.states, problem, tries)
    began = time.process_time()
    query.solve(60.0, answers)
    return (time.process_time() - began) / answers.asked


def _short(planner: str) -> OmplPlanner:
    """A planner whose steps are so short that it does not get to the goal, if it has a step."""
    return OmplPlanner(planner, {"range": 0.2} if "range" in setters(planner) else {})


class _Counted:
    """Our check and no notes, for so many motions; nobody looks for the goal, as the watch does."""

    def __init__(self, states: Any, problem: Problem, tries: int) -> None:
        self._configuration, self._free, self._tries = states.configuration, problem.space.motion_free, tries
        self.asked = 0
        self.over = False

    def look(self, state: object) -> None:
        """Nothing is done about it."""

    def motion(self, first: Any, second: Any) -> bool:
        """Whether a motion is free."""
        self.asked += 1
        self.over = self.asked >= self._tries
        return self._free(self._configuration(first), self._configuration(second))


def _tries_watched(planner: str, problem: Problem, seed: int, tries: int, *, measure: bool) -> float:
    """Seconds a motion with the watch, and the metric if asked for: what `guided_search` does."""
    _, expansion, rng = streams(seed)
    search = Search(problem, expansion, rng)
    made, recorder = _short(planner), None
    if measure:
        recorder = _Recorder(search, None, Measure(search), distributions=False)
    made.prepare(search)
    began = time.process_time()
    made.run(search, tries, watcher=recorder)
    if recorder is not None:
        recorder.record()
    spent = time.process_time() - began
    asked = search.samples + sum(search.tries[kind] for kind in ("elsewhere", "joining", "within"))
    return spent / max(asked, 1)


def reach(environment: str, problems: int) -> dict[str, dict[str, float]]:
    """Processor time of ours and of OMPL's, problem by problem in turns."""
    distribution = make_distribution(environment)
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(-1, problems):  # the first one loads what is compiled
        problem = distribution.problem(max(seed, 0))
        done = [(name, _ours(unprepared(problem), name, max(seed, 0))) for name in OURS]
        for planner, resolution in THEIRS:
            alone = OmplPlanner(planner, resolution=resolution, seconds=10.0).alone(
                problem, seed=max(seed, 0), by_states=resolution >= BY_STATES
            )
            found = alone.path is not None
            check = f"{100 * resolution:g} %" if resolution else "certified"
            done.append((f"ompl:{planner}, {check}", (alone.processor, found, found and not alone.free)))
        for name, row in done if seed >= 0 else ():
            rows.setdefault(name, []).append(row)
    table = {}
    for name, runs in rows.items():
        seconds, solved, colliding = np.array(runs, float).T
        table[name] = {
            "median_ms": 1e3 * float(np.median(seconds)),
            "mean_ms": 1e3 * float(seconds.mean()),
            "solved": float(solved.mean()),
            "colliding": float(colliding.sum() / max(solved.sum(), 1)),
        }
    return table


def _ours(problem: Problem, guidance: str, seed: int) -> tuple[float, float, float]:
    assert problem.space.scale > 0  # the space and the step are known by now, as they are for OMPL
    began = time.process_time()
    result = guided_search(problem, guidance, seed=seed, measure=False)
    return time.process_time() - began, result.solved, False


def memory(planner: str, runs: int) -> float:
    """MiB that the process grows by over the last three quarters of the runs."""
    problem = make_distribution("Cup").problem(0)

    def pages() -> int:
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1])

    before = 0
    for run in range(runs):
        if run == runs // 4:
            before = pages()
        guided_search(problem, f"ompl:{planner}", seed=run, max_samples=100, measure=False)
    return (pages() - before) * 4096 / 2**20


def main() -> None:
    """Measure, print, and write JSON if asked to."""
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=500)
    parser.add_argument("--turns", type=int, default=10)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--part", choices=("alike", "cost", "reach", "memory"), action="append")
    parser.add_argument("--problems", type=int, default=128)
    parser.add_argument("--environment", action="append", help="of the part reach; all the random ones")
    options = parser.parse_args()
    parts, screen = options.part or ["alike", "cost", "reach", "memory"], Console(highlight=False)
    found: dict[str, Any] = {}
    if "alike" in parts:
        for environment in (*PROBLEMS, DRAWN):
            found[f"alike, {environment}"] = alike(environment, options.seeds)
            screen.print(environment, found[f"alike, {environment}"])
    if "cost" in parts:
        for planner in planner_names():
            found[f"cost, {planner}"] = cost_of_watching(planner, 600, options.turns)
            screen.print(planner, found[f"cost, {planner}"])
    if "reach" in parts:
        for environment in options.environment or DRAWN_ALL:
            found[f"reach, {environment}"] = reach(environment, options.problems)
            for name, row in found[f"reach, {environment}"].items():
                screen.print(environment, name, {key: round(value, 3) for key, value in row.items()})
    if "memory" in parts:
        for planner in ("RRT", "RRTConnect", "BITstar", "PRM", "AORRTC"):
            found[f"memory, {planner}"] = memory(planner, options.runs)
            screen.print(planner, f"{found[f'memory, {planner}']:.2f} MiB")
    write_figures(options.json, found)


if __name__ == "__main__":
    main()
