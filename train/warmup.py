"""Compile every kernel that searches, environments and the oracle use, before anyone has to wait."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final

import numpy as np

from guided_gym.catalogue.table import make_distribution
from guided_gym.options import OracleOptions, SearchOptions
from guided_gym.planning import guided_search

PROBLEMS: Final = ("TrapCup", "HardStickMaze", "RandomPointMaze")
"""A body that turns, a segment and a point."""
GUIDANCES: Final = (
    "rrt",
    "uninformed",
    "goal_distance",
    "oracle",
    "prm",
    "lazy_prm",
    "medial_axis",
    "hybrid",
    "wavefront",
    "learned:se2",
)
_SAMPLES: Final = 40


def steps() -> Iterator[tuple[str, Callable[[], object]]]:
    """(what it is, what to run), in the order in which they are needed."""
    for name in PROBLEMS:
        yield f"environment over {name}", partial(_environments, name)
    for name in PROBLEMS:
        for guidance in GUIDANCES:
            if not (guidance.startswith("learned") and name != "TrapCup"):
                yield f"{guidance} on {name}", partial(_search, name, guidance)
    yield "choosing who guides", _selection
    yield "robots with joints", _arm


def warm_up(said: Callable[[str, float], None]) -> float:
    """Run all steps; ``said`` is told each one's name and seconds. Returns the seconds in all."""
    began = time.perf_counter()
    for name, run in steps():
        before = time.perf_counter()
        run()
        said(name, time.perf_counter() - before)
    return time.perf_counter() - began


def _environments(name: str) -> None:
    from guided_gym.envs.guided_search_env import GuidedSearchEnv
    from guided_gym.envs.vector_env import make_vector

    for options in ({}, {"rewire": True}, {"action": "distribution"}):
        env = GuidedSearchEnv(name, max_nodes=32, **options)  # type: ignore[arg-type]
        env.reset(seed=0)
        for _ in range(20):
            env.step(np.ones(32) if options.get("action") else 0)
    envs = make_vector(2, distribution=name, max_nodes=32)
    envs.reset(seed=0)
    for _ in range(20):
        envs.step(np.zeros(2, np.int64))


def _search(name: str, guidance: str) -> None:
    guided_search(make_distribution(name).problem(0), guidance, seed=0, max_samples=_SAMPLES)


def _arm() -> None:
    # Its oracle takes seconds and compiles nothing that a few vertices do not.
    options = SearchOptions(oracle=OracleOptions(resolution=(200,)))
    problem = make_distribution("PlanarArm2").problem(0)
    for guidance in ("rrt", "lazy_prm", "roadmap(environment=predicted,vertices=500)"):
        guided_search(problem, guidance, seed=0, max_samples=_SAMPLES, options=options)


def _selection() -> None:
    from guided_gym.envs.guide_selection_env import GuideSelectionEnv

    env = GuideSelectionEnv(max_samples=_SAMPLES)
    env.reset(seed=0)
    for k in range(_SAMPLES):
        env.step(k % 2)
