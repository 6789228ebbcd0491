"""Guiding spaces as compositions: one line each, under the names that are common in the field.

Each row of `SOLVERS` makes a guiding space on any modified problem, as in ``roadmap(robot=disc)``. Each row
of `RECIPES` is one of them with defaults of its own, as in ``lazy_prm``. Both take the options of the solver,
those of `Composed`, and the parts of a `Lesson`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Final

from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.composed import Composed, Lesson
from guided_gym.guidance.modifications import Nothing, Point
from guided_gym.guidance.solvers.exact import Exact
from guided_gym.guidance.solvers.paths import StoredPaths
from guided_gym.guidance.solvers.plain import Straight
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.guidance.solvers.searched import Searched
from guided_gym.guidance.solvers.shortened import Shortened
from guided_gym.guidance.solvers.skeleton import Skeleton
from guided_gym.guidance.solvers.wave import Wave

_LESSON: Final = tuple(field.name for field in fields(Lesson))


def recipe(solver: Callable[..., Any], summary: str, /, **defaults: Any) -> Callable[..., GuidingSpace]:
    """A function that makes a guiding space from a solver.

    Args:
        solver: Makes the solver.
        summary: What the guiding space is, in one line.
        **defaults: Options that it has unless others are given: of the solver, of `Composed`, or of `Lesson`.
            A function without arguments, such as a class, is called each time.
    """
    of_solver = dict(inspect.signature(solver).parameters)
    of_composed = dict(list(inspect.signature(Composed).parameters.items())[1:])
    lesson = {name: inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None) for name in _LESSON}

    def make(**options: Any) -> GuidingSpace:
        made = {key: value() if isinstance(value, type) else value for key, value in defaults.items()}
        given = {**made, **options}
        taught = {name: given.pop(name) for name in _LESSON if given.get(name) is not None}
        for name in _LESSON:
            given.pop(name, None)
        parts = {name: given.pop(name) for name in of_solver if name in given}
        space = Composed(solver(**parts), **given)
        if taught:
            space.lesson = replace(space.lesson, **taught)
        return space

    keywords = {**of_solver, **of_composed, **lesson}
    parameters = [
        p.replace(kind=inspect.Parameter.KEYWORD_ONLY, default=defaults.get(name, p.default))
        for name, p in keywords.items()
    ]
    make.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    make.__doc__ = summary
    make.__module__, make.__qualname__ = solver.__module__, solver.__qualname__  # what `same_place` asks for
    return make


# name -> a guiding space that is what its solver sees, on the problem as it is unless it is modified.
SOLVERS: Final[dict[str, Callable[..., GuidingSpace]]] = {
    "straight": recipe(Straight, "The distance to the goal in (r', E'), obstacles ignored."),
    "exact": recipe(Exact, "The true cost-to-go in (r', E'), from the oracle."),
    "roadmap": recipe(Roadmap, "Shortest paths on a sampled roadmap in (r', E')."),
    "shortened": recipe(Shortened, "The best way on a sampled roadmap in (r', E'), its detours cut off."),
    "skeleton": recipe(Skeleton, "Shortest paths along the medial axis of the workspace E'."),
    "wave": recipe(Wave, "When a wave from the goal arrives, on a grid of poses of r' in E'."),
    "paths": recipe(StoredPaths, "The lengths of stored paths of similar problems."),
    "searched": recipe(
        Searched, "The costs of a search tree in (r', E'), itself guided by another guidance."
    ),
}

# name -> the guiding spaces that have a name in the paper or the field.
RECIPES: Final[dict[str, Callable[..., GuidingSpace]]] = {
    "goal_distance": recipe(Straight, "S = C with d_C replaced by the obstacle-free distance d_X."),
    "oracle": recipe(Exact, "S = C and h = d_C: the exact cost-to-go, failures not foreseen.", factor=1.0),
    "prm": recipe(
        Roadmap,
        "A probabilistic roadmap in C, validated before the search; failures teach it nothing.",
        vertices=2000,
        anchors=8,
        factor=1.0,
    ),
    "lazy_prm": recipe(
        Roadmap,
        "A roadmap that ignores all obstacles and loses what collisions refute: E' = {}.",
        environment=Nothing,
    ),
    "medial_axis": recipe(
        Skeleton,
        "The medial axis of the workspace, travelled by a point: r' is the reference point.",
        robot=Point,
        node=True,
        reach=0.0,
        factor=1.2,
        expansion_penalty=1.0,
    ),
    "path_database": recipe(
        StoredPaths,
        "Stored paths of similar tasks (Lightning refactored); RRT while no node sees one.",
        fallback=Voronoi,
        factor=float("inf"),
        check=2.5,
        reach=0.1,
    ),
    "wavefront": recipe(
        Wave,
        "S = C on a coarse grid of poses: when a wave from the goal arrives, slow where there is no room.",
        detour=0.5,
    ),
}
