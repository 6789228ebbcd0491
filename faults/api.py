"""Calls of everything public with arguments of every kind, by signature: only our errors may come."""

from __future__ import annotations

import contextlib
import inspect
import io
import math
import tempfile
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import shapely

import guided_gym as gg
from faults.tally import Overtime, Tally, limited

# What runs searches by the hundred, or has no arguments of its own to check.
_LEFT_OUT = {"evaluate", "reproduce", "check_claims", "single_step", "figures", "build_path_database"}
_NASTY: list[Any] = [
    None, True, False, 0, -1, 1, 3, 2**31, 10**30, 10**5000, 0.0, -0.5, 0.5, 1e-320, 1e308, math.nan,
    math.inf,
    -math.inf, 1j, "", "a", "rrt", "0123", "learned:", "a\0b", "((", b"ab", [], (), {}, set(), [1, 2],
    [1, 2, 3],
    ["1", "2"], [True, False], [math.nan, 0, 0], [[1, 2], [3, 4]], [None], {"a": 1}, np.zeros(0), np.zeros(3),
    np.zeros((2, 3)), np.zeros((0, 3)), np.full(3, np.nan), np.array(["a"]), np.array([None]), np.int64(2),
    np.float32(0.5), np.bool_(True), range(3), object(), int, len, shapely.Point(), shapely.Point(0, 0),
    shapely.LineString([(0, 0), (1, 1)]), shapely.box(0, 0, 1, 1), shapely.box(0, 0, 1, 1).boundary,
    shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), Path("no such file"), Path("/"),
    np.random.default_rng(0),
]  # fmt: skip


def _good() -> dict[str, list[Any]]:
    """Values that fit, by the name of the parameter: so that calls come past the first check."""
    room = gg.Environment.from_polygons((0, 0, 10, 10), [[(4, 0), (5, 0), (5, 8), (4, 8)]])
    robot = gg.Robot.rectangle(0.8, 0.3)
    problem = gg.Problem(robot, room, gg.Task((1, 1, 0), (9, 1, 0)))
    return {
        "problem": [problem], "robot": [robot], "environment": [room], "task": [problem.task],
        "space": [problem.space], "start": [(1, 1, 0)], "goal": [(9, 1, 0)], "guidance": ["rrt", "lazy_prm"],
        "name": ["rrt", "Cup"], "seed": [0], "max_samples": [5], "path": [np.array([(1.0, 1, 0), (1, 2, 0)])],
        "bounds": [(0, 0, 10, 10)], "outline": [shapely.box(-1, -1, 1, 1)], "dimension": [2, 3],
        "tau": [np.array([1.0, 0.5])], "delta": [np.array([0.0, 0.1])], "p": [np.array([0.5, 0.5])],
        "q": [np.array([0.5, 0.5])], "rng": [np.random.default_rng(0)],
        "tree": [gg.SearchTree(problem.space, [1, 1, 0])],
        "solver": [None], "options": [None], "distribution": ["Cup"], "env": [None],
    }  # fmt: skip


def _only_a_promise(thing: type) -> bool:
    """Whether Python itself makes no object of a class: a protocol, an enumeration, or an abstract one."""
    return inspect.isabstract(thing) or issubclass(thing, Enum) or getattr(thing, "_is_protocol", False)


def _callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Everything public that can be called, and what its classes offer beside their constructors."""
    for name in gg.__all__:
        thing = getattr(gg, name)
        if (
            name in _LEFT_OUT
            or not callable(thing)
            or (isinstance(thing, type) and (issubclass(thing, Exception) or _only_a_promise(thing)))
        ):
            continue
        yield name, thing
        if isinstance(thing, type):
            for member, value in vars(thing).items():
                if isinstance(value, classmethod | staticmethod) and not member.startswith("_"):
                    yield f"{name}.{member}", getattr(thing, member)


def _methods() -> Iterator[tuple[str, Callable[..., Any]]]:
    """What sound objects can be asked."""
    good = _good()
    problem = good["problem"][0]
    search = gg.Search(problem, np.random.default_rng(0), np.random.default_rng(1))
    arm, spatial = (gg.make_distribution(name).problem(0) for name in ("PlanarArm4", "SpatialArm"))
    for thing in (problem, problem.space, problem.environment, problem.robot, problem.task, search,
                  search.tree, search.planner, gg.make_distribution("Cup"), gg.Measure(search), arm.robot,
                  arm.space, spatial.robot, spatial.space, spatial.environment,
                  gg.make_distribution("RandomMaze"),
                  gg.Oracle(problem.space, problem.task.goal)):  # fmt: skip
        for member in dir(type(thing)):
            value = getattr(type(thing), member)
            if not member.startswith("_") and inspect.isfunction(value):
                yield f"{type(thing).__name__}().{member}", getattr(thing, member)


def _arguments(
    signature: inspect.Signature, rng: np.random.Generator, good: dict[str, list[Any]]
) -> dict[str, Any]:
    chosen: dict[str, Any] = {}
    for name, parameter in signature.parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        required = parameter.default is parameter.empty
        if not required and rng.random() < 0.6:
            continue
        fitting = good.get(name, [])
        if fitting and rng.random() < 0.6:
            chosen[name] = fitting[rng.integers(len(fitting))]
        else:
            chosen[name] = _NASTY[rng.integers(len(_NASTY))]
    return chosen


def _fits(signature: inspect.Signature, arguments: dict[str, Any]) -> bool:
    try:
        signature.bind(**arguments)
    except TypeError:  # what Python itself refuses: positional-only parameters, by name
        return False
    return True


def _shown(value: Any) -> str:
    try:
        return repr(value)[:40]
    except ValueError:
        return "10**5000"


def fuzz(seed: int, share: float) -> list[Tally]:
    """Call everything public."""
    tally = Tally("calls by signature", "bad arguments raise errors of this package and no others")
    rng = np.random.default_rng(seed)
    with tally.timed(), tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        good = _good()
        for name, call in [*_callables(), *_methods()]:
            try:
                signature = inspect.signature(call)
            except (TypeError, ValueError):
                continue
            for _ in range(max(2, round(40 * share)) if signature.parameters else 0):
                arguments = _arguments(signature, rng, good)
                if not _fits(signature, arguments):
                    continue
                said = f"{name}({', '.join(f'{k}={_shown(v)}' for k, v in arguments.items())})"
                trouble = _trouble(call, arguments)
                tally.check(trouble is None, f"{said}: {trouble}")
    return [tally]


def _trouble(call: Callable[..., Any], arguments: dict[str, Any]) -> str | None:
    try:
        with limited(), contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            call(**arguments)
    except gg.GuidedGymError:
        return None
    except Overtime:
        return "took longer than 20 s"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None
