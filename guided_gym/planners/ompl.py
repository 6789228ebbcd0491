"""OMPL's planners by name, as ``"ompl:RRTConnect"``: those that its Python wheel binds (docs/ompl.md).

OMPL is imported when a planner is asked for, never before: it is an extra.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import flag, integer, number, shown
from guided_gym.compute.warmup import processor_seconds
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.options import SearchOptions
from guided_gym.planners.query import Query
from guided_gym.planners.spaces import StateSpace
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search, Watcher
from guided_gym.search.watch import State, Watch, WatchedPlanner

FAMILY: Final = "ompl"
MAJOR: Final = 2  # the version of OMPL whose planners we know
SECONDS: Final = 60.0  # that a planner may take by default
ANGLES: Final = ("round", "cut")

SUMMARIES: Final = {
    "RRT": "One tree; the node nearest to a sample, one step towards it.",
    "RRTConnect": "Two trees that grow towards each other; the goal's tries have no SE.",
    "RRTstar": "RRT that rewires its tree to shorten the ways.",
    "InformedRRTstar": "RRTstar that samples where a shorter path may be, once it has one.",
    "SORRTstar": "InformedRRTstar with its samples in order of promise.",
    "KPIECE1": "One tree; the least explored cells of a projection first.",
    "BKPIECE1": "KPIECE1 with two trees.",
    "LBKPIECE1": "BKPIECE1 that checks its motions late.",
    "BITstar": "Batches of samples; edges in order of the path that they promise.",
    "AORRTC": "RRTConnect again and again, each time for a shorter path.",
    "FMT": "One batch of samples; the tree grows in order of its cost from the start.",
    "BFMT": "FMT with two trees.",
    "PRM": "A roadmap of samples and motions between neighbours.",
    "PRMstar": "PRM with as many neighbours as a shortest path needs.",
}
# Planners of OMPL 2.0 that a wheel may lack.
OTHERS: Final = (
    "ABITstar", "AITstar", "AnytimePathShortening", "BiEST", "BiTRRT", "BLITstar", "CForest", "EITstar",
    "EST", "LazyLBTRRT", "LazyPRM", "LazyPRMstar", "LazyRRT", "LBTRRT", "Lightning", "pRRT", "ProjEST",
    "pSBL", "RLRT", "RRTsharp", "RRTXstatic", "SBL", "SPARS", "SPARStwo", "SST", "STRIDE", "Thunder", "TRRT",
)  # fmt: skip
_NOT_OPTIONS: Final = ("Name", "ProblemDefinition", "ProjectionEvaluator", "DefaultConnectionStrategy")
_TYPES: Final = {"float": float, "int": int, "bool": bool}
_COMMON: Final = ("resolution", "seconds", "angles", "first")


@cache
def bindings() -> Any:
    """The package `ompl`, looked for once.

    Raises:
        InvalidInputError: It is missing, cannot be loaded, or is of another major version.
    """
    try:
        version = importlib.metadata.version("ompl")
        package = importlib.import_module("ompl")
        for part in ("base", "geometric", "util"):
            importlib.import_module(f"ompl.{part}")
    except (ImportError, OSError) as error:
        raise InvalidInputError(
            f"OMPL's planners need the package ompl: pip install 'guided-gym[ompl]' ({error})"
        ) from error
    if version.partition(".")[0] != str(MAJOR):
        raise InvalidInputError(f"ompl: expected version {MAJOR}.x, got {version}")
    return package


def planner_names() -> list[str]:
    """The planners that the installed wheel binds, in its order.

    Raises:
        InvalidInputError: As `bindings`.
    """
    ompl = bindings()
    planner = ompl.base.Planner
    members = vars(ompl.geometric).items()
    return sorted(name for name, kind in members if isinstance(kind, type) and issubclass(kind, planner))


def missing_planners() -> list[str]:
    """Planners of OMPL that the installed wheel does not bind.

    Raises:
        InvalidInputError: As `bindings`.
    """
    return sorted(set((*SUMMARIES, *OTHERS)) - set(planner_names()))


def guidance_class(member: str, make_guides: object = None) -> Callable[..., OmplPlanner]:
    """The maker of a planner by name; its options are OMPL's parameters, ``setGoalBias`` as ``goal_bias``.

    Args:
        member: The planner's name in OMPL.
        make_guides: Not needed here: no planner is made of guiding spaces.

    Raises:
        UnknownNameError: No such planner; the nearest one is suggested.
        InvalidInputError: As `bindings`, or OMPL has the planner and its Python wheel has not.
    """
    return _maker(member)


@cache
def _maker(member: str) -> Callable[..., OmplPlanner]:
    names = planner_names()
    if member not in names:
        if member in missing_planners():
            version = importlib.metadata.version("ompl")
            raise InvalidInputError(
                f"guidance 'ompl:{member}': OMPL's Python wheel {version} does not bind this planner; "
                f"expected one of {', '.join(names)}"
            )
        raise UnknownNameError("OMPL planner", member, names)
    own = setters(member)

    def make(**options: Any) -> OmplPlanner:
        common = {name: options.pop(name) for name in _COMMON if name in options}
        return OmplPlanner(member, options, **common)

    known = inspect.signature(OmplPlanner.__init__).parameters
    shared = [known[name] for name in _COMMON]
    keyword = inspect.Parameter.KEYWORD_ONLY
    setattr(  # noqa: B010  mypy knows no such attribute
        make,
        "__signature__",
        inspect.Signature([*shared, *(inspect.Parameter(name, keyword, default=None) for name in own)]),
    )
    make.__doc__ = f"OMPL, watched. {SUMMARIES.get(member, member)}"
    return make


@cache
def setters(planner: str) -> dict[str, tuple[str, type]]:
    """The parameters of a planner: name to OMPL's setter and the type that it takes, as its binding says.

    Raises:
        UnknownNameError: No such planner.
    """
    kind = getattr(bindings().geometric, planner, None)
    if kind is None:
        raise UnknownNameError("OMPL planner", planner, planner_names())
    found: dict[str, tuple[str, type]] = {}
    for method in dir(kind):
        words = re.fullmatch(r"set([A-Z]\w*)", method)
        takes = re.search(r"\(self, \w+: (\w+)", getattr(kind, method).__doc__ or "")
        if words and words[1] not in _NOT_OPTIONS and takes and takes[1] in _TYPES:
            name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", words[1]).lower()
            found[name] = method, _TYPES[takes[1]]
    return found


def _checked(name: str, value: Any, kind: type) -> Any:
    """A parameter's value, checked: OMPL takes whatever has the right type."""
    if kind is bool:
        return flag(name, value)
    if kind is int:
        return integer(name, value, least=1)
    share = name.endswith(("_bias", "_fraction"))
    value = number(name, value, least=0)
    if share and value > 1:
        raise InvalidInputError(f"{name}: expected a share, 0 to 1, got {shown(value)}")
    return value


@dataclass(frozen=True)
class Alone:
    """What a planner found unwatched, with OMPL's own check of motions.

    Attributes:
        path: (k, d) the path that it calls exact, None if there is none.
        free: Whether the whole path is certified free.
        processor: Processor time, its preparation included.
        looks: States that OMPL looked at.
        tree: The edges of its `PlannerData`, as pairs of states.
    """

    path: NDArray[np.float64] | None
    free: bool
    processor: float
    looks: int
    tree: list[tuple[State, State]]


class _Answers:
    """Answers what OMPL asks, and takes no notes."""

    over = False

    def __init__(self, states: StateSpace, resolution: float) -> None:
        self._configuration = states.configuration
        self._check = states.sampled_check(resolution) if resolution else states.space.motion_free

    def look(self, state: State) -> None:
        """Do nothing about it."""

    def motion(self, first: State, second: State) -> bool:
        """Whether a motion is free."""
        return self._check(self._configuration(first), self._configuration(second))


@doors
class OmplPlanner(WatchedPlanner):
    """A planner of OMPL, watched as it plans.

    Motions are checked by our certified check, or by OMPL's own way at a resolution. The search ends by the
    rule of the task, as for guiding spaces: where it has ``goal_edge``, as soon as a node sees the goal.

    Args:
        planner: OMPL's name of the planner.
        parameters: Its own parameters; None for OMPL's default. ``range`` is the step of the search by
            default, as for guiding spaces, and 0 for OMPL's own choice (20 % of the extent).
        resolution: 0 for certified motions; else how finely motions are sampled, relative to the extent, as
            OMPL does (it takes 0.01 by default).
        seconds: Wall time after which the planner has to give up; what it takes to measure counts.
        angles: ``"round"``: circles, in OMPL's metric; ``"cut"``: plain numbers, in our metric.
        first: Whether the search ends with the first path; else it goes on to its limit.

    Attributes:
        history: (tries to grow, seconds, length) of each path of the last search that was shorter than those
            before; the time to measure counts.

    Raises:
        UnknownNameError: No such parameter.
        InvalidInputError: A value that cannot be used, or OMPL is missing.
    """

    def __init__(
        self,
        planner: str,
        parameters: dict[str, Any] | None = None,
        *,
        resolution: float = 0.0,
        seconds: float = SECONDS,
        angles: str = "round",
        first: bool = True,
    ) -> None:
        self.planner = planner
        known = setters(planner)
        self._parameters: list[tuple[str, Any]] = []
        for name, value in (parameters or {}).items():
            if name not in known:
                raise UnknownNameError(f"option of guidance 'ompl:{planner}':", name, known)
            if value is None:
                continue
            setter, kind = known[name]
            self._parameters.append((setter, _checked(name, value, kind)))
        self._ranged = "range" in known and not any(setter == "setRange" for setter, _ in self._parameters)
        self.resolution = number("resolution", resolution, least=0, below=1)
        self.seconds = number("seconds", seconds, above=0, what="time")
        if angles not in ANGLES:
            raise InvalidInputError(f"angles: expected {' or '.join(map(repr, ANGLES))}, got {shown(angles)}")
        self.angles, self.first = angles, flag("first", first)
        self.certified = self.resolution == 0
        self._query: Query | None = None
        self.history: list[tuple[int, float, float]] = []

    name = FAMILY

    def __repr__(self) -> str:
        return self.expression or f"ompl:{self.planner}"

    def prepare(self, search: Search) -> None:
        """Build OMPL's space, problem and planner, unless the search is over already.

        Raises:
            InvalidInputError: OMPL refuses the space: some planners sample in some kinds of spaces only.
        """
        self.history = []
        self._query = None
        if not (search.solved and self.first):
            self._query = self._ready(search, 0.0)

    def _ready(self, search: Search, resolution: float) -> Query:
        own = [("setRange", search.planner.step)] if self._ranged else []
        return Query(
            bindings(),
            search.problem,
            self.planner,
            [*own, *self._parameters],
            cut=self.angles == "cut",
            seed=int(search.guidance_rng.integers(1, 2**31 - 1)),
            resolution=resolution,
            first=self.first,
        )

    def run(
        self,
        search: Search,
        limit: int,
        *,
        watcher: Watcher | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Plan, watched, after `prepare`."""
        query, self._query = self._query, None
        if query is None:
            return
        search.tree.certified = self.certified
        states, certified = query.states, search.space.motion_free
        watch = Watch(
            search,
            limit,
            query.ends,
            states.configuration,
            states.sampled_check(self.resolution) if self.resolution else certified,
            states.length,
            first=self.first,
            watcher=watcher,
            progress=progress,
        )
        query.solve(self.seconds, watch)
        self.history = watch.history

    def alone(
        self,
        problem: Problem,
        *,
        seed: int | None = None,
        step: float | None = None,
        by_states: bool = True,
    ) -> Alone:
        """Plan unwatched, as OMPL's users do: its own rule for the end and, at a resolution, its own check.

        Args:
            problem: The problem.
            seed: As in `guided_search`: with the same seed, OMPL draws the same numbers.
            step: The range; the `scale` of the space by default.
            by_states: Whether OMPL asks for each state of a motion; else we look at all of them in one call,
                the same ones. Certified motions are always one call.

        Raises:
            InvalidInputError: OMPL refuses the space.
        """
        _, expansion_rng, rng = streams(seed)
        search = Search(problem, expansion_rng, rng, SearchOptions(step))
        began = processor_seconds()
        query = self._ready(search, self.resolution if by_states else 0.0)
        watch = None if by_states and self.resolution else _Answers(query.states, self.resolution)
        path = query.solve(self.seconds, watch)
        processor = processor_seconds() - began
        free = path is not None and bool(problem.space.motions_free(path[:-1], path[1:]).all())
        return Alone(path, free, processor, query.questions.looks, query.edges())
