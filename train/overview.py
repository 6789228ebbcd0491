"""Overviews: names with one line each, a database's content, versions and folders."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np

from guided_gym.errors import InvalidInputError
from guided_gym.storage.path_file import PathDatabase

Rows = list[tuple[str, str]]

_ROBOTS = ("point", "segment", "rectangle", "polygon")
_PACKAGES = (
    "guided-gym", "numpy", "scipy", "shapely", "networkx", "numba", "gymnasium", "pydantic", "matplotlib",
    "rich", "typer", "pygame", "torch", "stable-baselines3", "sb3-contrib", "ompl",
)  # fmt: skip


def overview() -> dict[str, Rows]:
    """Title to (name, one line) of the environments, the guidances and the robots, by kind."""
    from guided_gym.catalogue.table import distribution_names, make_distribution
    from guided_gym.geometry.robots import Robot
    from guided_gym.guidance.registry import GUIDANCES
    from guided_gym.registration import SELECTIONS

    return {
        "Environments": [(name, make_distribution(name).summary) for name in distribution_names()],
        "Guidances": [(name, GUIDANCES.summary(name)) for name in GUIDANCES],
        "Learned guidances": _shipped(),
        "Learning who guides": [
            (name, f"On problems of {problems}; the action is the guiding space that guides.")
            for name, problems in SELECTIONS.items()
        ],
        "OMPL's planners": _ompl(),
        "Robots": [(name, _first_line(getattr(Robot, name).__doc__)) for name in _ROBOTS],
    }


def _shipped() -> Rows:
    """The agents that come with the package: what each is and what it learned on, as its card says."""
    from guided_gym.guidance.learned import motion_agent as motions
    from guided_gym.guidance.learned import rule as rules
    from guided_gym.guidance.learned import weights
    from guided_gym.guidance.learned.folders import agent_folder, shipped_agents

    rows = []
    for name in shipped_agents():
        folder = agent_folder(name)
        if weights.card_kind(folder) == rules.RULE_KIND:
            card = rules.load_rule_card(folder)
            what = f"A hybrid of {' and '.join(card['guides'])}"
        elif weights.card_kind(folder) == motions.MOTION_KIND:
            card, what = motions.load_motion_card(folder), "Belief in motions, cost-to-go and a node scorer"
        else:
            card, what = weights.load_card(folder), "A field and a node scorer"
        problems = ", ".join(card["training"]["environments"])
        rows.append((f"learned:{name}", f"{what}, for problems like {problems}."))
    return rows


def _ompl() -> Rows:
    """The planners of OMPL that its wheel binds, and those that it lacks."""
    from guided_gym.planners import ompl

    try:
        names, missing = ompl.planner_names(), ompl.missing_planners()
    except InvalidInputError as error:
        return [("ompl:...", str(error))]
    rows = [(f"ompl:{name}", ompl.SUMMARIES.get(name, "")) for name in names]
    return [*rows, ("not in this wheel", ", ".join(missing))]


def _first_line(text: str | None) -> str:
    return (text or "").strip().partition("\n")[0]


def database_rows(file: Path) -> Rows:
    """What a path database holds.

    Raises:
        StorageError: There is no such file, or it is foreign or damaged.
    """
    with PathDatabase.open(file, readonly=True) as database:
        library, header = database.load(), database.header
        unsolved = len(database.unsolved_seeds())
    sizes = np.diff(library.offsets)
    rows = [
        ("environment", header.name),
        ("paths", f"{len(library)}"),
        ("not solved", f"{unsolved}"),
        ("dimension", f"{header.dimension}"),
        ("robot", header.robot),
        ("weights", ", ".join(f"{weight:g}" for weight in header.weights)),
    ]
    if len(library):
        rows.append(("waypoints a path", f"{sizes.mean():.1f} on average, {sizes.max()} at most"))
        rows.append(("length of a path", f"{library.lengths.mean():.2f} on average"))
    rows.append(("size", f"{file.stat().st_size / 1024:.0f} KiB"))
    return rows


def problem_set_rows(file: Path) -> Rows:
    """What a problem set holds.

    Raises:
        StorageError: There is no such file, or it is foreign, damaged or unfinished.
    """
    from guided_gym.catalogue.problem_set import open_problem_set

    problems = open_problem_set(file)
    header, first = problems.header, problems.header["first"]
    rules = [(name, header[name]) for name in ("goal_tolerance", "goal_edge")]
    ending = [f"{name} {value}" for name, value in rules if value is not None]
    return [
        ("environment", problems.name),
        ("problems", f"{len(problems)}, of the seeds {first} to {first + len(problems) - 1}"),
        ("goal", ", ".join(ending) or "as the problems say"),
        ("robot", header["robot"]["name"] if header["robot"] else "several"),
        ("built by", f"guided-gym {header['package']}"),
        ("size", f"{file.stat().st_size / 2**20:.1f} MiB"),
    ]


def doctor_rows() -> dict[str, Rows]:
    """Versions and folders, for a bug report."""
    versions = [(name, _version(name)) for name in _PACKAGES]
    system = [
        ("python", f"{sys.version.split()[0]} at {sys.executable}"),
        ("platform", platform.platform()),
        ("processors", f"{os.cpu_count()}"),
        ("display", "yes" if _has_display() else "no: render_mode='human' needs one"),
    ]
    return {"System": system, "Packages": versions, "Folders": _folders()}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _has_display() -> bool:
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _kernel_cache() -> str:
    """Where numba says that it keeps a kernel."""
    from guided_gym.kernels.metric import steer

    stats: Any = steer.stats
    return str(getattr(stats, "cache_path", None) or "unknown")


def _folders() -> Rows:
    import guided_gym
    from guided_gym.measure.oracle_store import FieldStore

    store = FieldStore.default()
    folder, trouble = store.folder, store.trouble()
    if folder is None:
        cache = "switched off by GUIDED_GYM_CACHE"
    else:
        files = [file for file in folder.rglob("*") if file.is_file()] if folder.is_dir() else []
        size = sum(file.stat().st_size for file in files) / 2**20
        state = "writable"
        if trouble is not None:
            state = f"NOT usable, works without it: {trouble.strerror or trouble}"
        cache = f"{folder} ({len(files)} files, {size:.1f} MiB, {state})"
    package = Path(guided_gym.__file__).parent
    return [
        ("package", str(package)),
        ("oracle cache", cache),
        ("compiled kernels", _kernel_cache()),
    ]
