"""Guiding spaces by name: one row each; a new one joins here, or by `register_guidance`."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Sequence
from typing import Any, Final, TypeVar

from guided_gym.checks import shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Uninformed, Voronoi
from guided_gym.guidance.grammar import FAMILY, JOINED, Call, parse
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.modifications import ENVIRONMENTS, ROBOTS
from guided_gym.guidance.recipes import RECIPES, SOLVERS, recipe
from guided_gym.guidance.rules import RULES
from guided_gym.guidance.tables import SEVERAL, Maker, Table, expanded, register_kind, walk
from guided_gym.search.watch import WatchedPlanner

M = TypeVar("M", bound=Maker)

PAPERS_HYBRID = ("lazy_prm", "medial_axis")

# Families of guiding spaces, ``"family:member"``: the module whose `guidance_class` knows the members. It is
# imported by name, on demand, since the core imports nothing of the rooms above it.
_PLANNERS: Final = {"ompl": "guided_gym.planners.ompl"}  # of planners that select and expand by themselves
_FAMILIES: Final = {FAMILY: "guided_gym.guidance.learned.agent", **_PLANNERS}


class _Guidances(Table):
    """The table of guiding spaces, with what is named by a family or by a module."""

    def maker(self, name: str, where: str = "") -> Maker:
        """What is behind a name, ``"package.module:Class"``, ``"learned:NAME"`` or ``"ompl:NAME"``.

        Raises:
            UnknownNameError: No such name; the nearest one is suggested.
            StorageError: A learned agent whose files cannot be used.
            InvalidInputError: The module or class cannot be imported or is no guiding space.
        """
        family, colon, member = name.partition(":")
        if not colon:
            return super().maker(name, where)
        if family in _FAMILIES:
            maker: Maker = importlib.import_module(_FAMILIES[family]).guidance_class(member, make_guides)
            return maker
        try:
            maker = getattr(importlib.import_module(family), member)
        except (ImportError, AttributeError, ValueError, TypeError) as error:
            raise InvalidInputError(f"guidance {name!r}: {error}") from error
        if not (isinstance(maker, type) and issubclass(maker, GuidingSpace)):
            raise InvalidInputError(f"guidance {name!r}: expected a GuidingSpace, got {shown(maker)}")
        return maker

    def build(self, call: Call, text: str, /, **options: Any) -> GuidingSpace:
        """The guiding space that a call in a text stands for."""
        if call.name == JOINED and not call.arguments and SEVERAL not in {o.name for o in call.options}:
            options.setdefault(SEVERAL, PAPERS_HYBRID)
        if is_planner(call):
            raise InvalidInputError(
                f"guidance {call.name!r}: expected a guiding space here, got a planner that selects and "
                "expands by itself; `evaluate` and `guided_search` take one"
            )
        made = super().build(call, text, **options)
        if not isinstance(made, GuidingSpace):
            raise InvalidInputError(
                f"guidance {call.name!r}: expected it to make a GuidingSpace, got {shown(made)}"
            )
        if call.name in self and made.name != call.name:  # a recipe: its parts do not know its name
            setattr(made, "name", call.name)  # noqa: B010  a class variable for all others
        made.expression = str(call)
        return made

    def plan(self, call: Call, text: str, /, **options: Any) -> WatchedPlanner:
        """The planner that a call in a text stands for."""
        made: WatchedPlanner = super().build(call, text, **options)
        made.expression = str(call)
        return made


# One row per guiding space: a new one joins here, as a recipe, or by `register_guidance`.
GUIDANCES: Final = _Guidances(
    "guidance",
    {
        Uninformed.name: Uninformed,
        Voronoi.name: Voronoi,
        **RECIPES,
        Hybrid.name: Hybrid,
        **SOLVERS,
    },
)
for _option in (SEVERAL, "guide", "guidance", "fallback"):
    register_kind(_option, GUIDANCES)
ROBOT_TABLE: Final = Table("robot modification", ROBOTS)
ENVIRONMENT_TABLE: Final = Table("environment modification", ENVIRONMENTS)
RULE_TABLE: Final = Table("rule", RULES)
register_kind("robot", ROBOT_TABLE)
register_kind("environment", ENVIRONMENT_TABLE)
register_kind("rule", RULE_TABLE)


@door
def register_guidance(maker: M, name: str | None = None, *, replace: bool = False) -> M:
    """Register a guiding space under a name, for all of the package; also a decorator of a class or function.

    Args:
        maker: A subclass of `GuidingSpace`, or a *recipe*: a function with keyword options that returns a
            guiding space. Registering the same one again, from a module loaded anew, is fine.
        name: Its name; that of the class (``cls.name``) or function if None.
        replace: Whether it may replace another one of that name.

    Raises:
        InvalidInputError: It is neither of these, or the name is missing, taken, or means something in an
            expression.
    """
    if isinstance(maker, type) and issubclass(maker, GuidingSpace):
        return GUIDANCES.register(maker, name, replace=replace)
    if isinstance(maker, type) or not callable(maker):
        raise InvalidInputError(
            "register_guidance: expected a subclass of GuidingSpace, or a function that makes one, "
            f"got {shown(maker)}"
        )
    return GUIDANCES.register(maker, name, replace=replace)


@door
def register_solver(maker: M, name: str, *, replace: bool = False) -> M:
    """Register a solver: ``name(robot=..., environment=...)`` is a guiding space from then on.

    Args:
        maker: A class with the methods of `CostToGo`, or a function that makes one. Its keyword options are
            options of the guiding space, too.
        name: Its name.
        replace: Whether it may replace another one of that name.

    Raises:
        InvalidInputError: It lacks a method, or the name is taken or means something in an expression.
    """
    _check_parts("register_solver", maker, ("begin", "__call__", "follow", "raise_near", "inspect"))
    summary = (inspect.getdoc(maker) or name).partition("\n")[0]
    GUIDANCES.register(recipe(maker, summary), name, replace=replace)
    return maker


@door
def register_robot(maker: M, name: str, *, replace: bool = False) -> M:
    """Register a robot modification: a word for ``robot=...``.

    Args:
        maker: A class with the methods of `RobotModification`, or a function that makes one.
        name: Its name.
        replace: Whether it may replace another one of that name.

    Raises:
        InvalidInputError: It lacks a method, or the name is taken or means something in an expression.
    """
    _check_parts("register_robot", maker, ("space", "project"))
    return ROBOT_TABLE.register(maker, name, replace=replace)


@door
def register_environment(maker: M, name: str, *, replace: bool = False) -> M:
    """Register an environment modification: a word for ``environment=...``.

    Args:
        maker: A class with the methods of `EnvironmentModification`, or a function that makes one.
        name: Its name.
        replace: Whether it may replace another one of that name.

    Raises:
        InvalidInputError: It lacks a method, or the name is taken or means something in an expression.
    """
    _check_parts("register_environment", maker, ("environment", "revised"))
    return ENVIRONMENT_TABLE.register(maker, name, replace=replace)


@door
def register_rule(maker: M, name: str, *, replace: bool = False) -> M:
    """Register a rule of hybrids: a word for ``rule=...``.

    Args:
        maker: A class with the methods of `Rule`, or a function that makes one. Its keyword options can be
            given in an expression: ``rule=name(option=value)``.
        name: Its name.
        replace: Whether it may replace another one of that name.

    Raises:
        InvalidInputError: It lacks a method, or the name is taken or means something in an expression.
    """
    _check_parts("register_rule", maker, ("begin", "weights", "learn"))
    return RULE_TABLE.register(maker, name, replace=replace)


def _check_parts(what: str, maker: object, parts: tuple[str, ...]) -> None:
    lacks = []
    if isinstance(maker, type):  # not by hasattr: every class can be called, what it makes cannot
        lacks = [part for part in parts if not any(part in vars(base) for base in maker.__mro__)]
    if not callable(maker) or lacks:
        raise InvalidInputError(
            f"{what}: expected a class with {', '.join(parts)}, or a function that makes one, "
            f"got {shown(maker)}" + (f", which lacks {', '.join(lacks)}" if lacks else "")
        )


@door
def guidance_names() -> list[str]:
    """Names of the guiding spaces, in order of appearance."""
    return list(GUIDANCES)


def guidance_maker(name: str) -> Maker:
    """The class or recipe behind a name, behind ``"package.module:Class"``, or behind ``"learned:NAME"``.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
        StorageError: A learned agent whose files cannot be used.
        InvalidInputError: The module or class cannot be imported or is no guiding space.
    """
    return GUIDANCES.maker(name)


def read_guidance(guidance: Call | str) -> Call:
    """The tree of an expression, texts in it that are expressions read too.

    Raises:
        InvalidInputError: It is no expression.
    """
    call: Call = expanded(parse(guidance) if isinstance(guidance, str) else guidance)
    return call


def parts(call: Call) -> Iterator[tuple[Call, Table]]:
    """The calls of a read expression, from the outside in, each with the table that its name is in.

    Raises:
        UnknownNameError: A table has no such name.
    """
    return walk(call, GUIDANCES)


@door
def make_guidance(guidance: GuidingSpace | Call | str, /, **options: Any) -> GuidingSpace:
    """A guiding space from its name.

    Args:
        guidance: A name (`guidance_names`), ``"learned:NAME"`` for a learned agent (shipped, or a folder),
            ``"package.module:Class"``, an expression of these (see `guided_gym.guidance.grammar`) such as
            ``"hybrid(lazy_prm(vertices=100), rrt)"``, ``"rrt@goal_bias=0.1"`` or ``"lazy_prm+rrt"``, or a
            guiding space, which is returned as it is.
        **options: Passed to the outermost class.

    Raises:
        UnknownNameError: No such guiding space or option, at any depth; the nearest one is suggested.
        InvalidInputError: The expression or an option's value cannot be used.
    """
    if isinstance(guidance, GuidingSpace):
        if options:
            raise InvalidInputError(f"options {sorted(options)} need a name, got the instance {guidance!r}")
        return guidance
    if not isinstance(guidance, str | Call):
        raise InvalidInputError(f"guidance: expected a name or a guiding space, got {shown(guidance)}")
    made: GuidingSpace = GUIDANCES.make(guidance, **options)
    return made


def is_planner(call: Call) -> bool:
    """Whether a call names a planner that selects and expands by itself, such as ``ompl:RRT``."""
    family, colon, _ = call.name.partition(":")
    return bool(colon) and family in _PLANNERS


def make_searcher(
    searcher: GuidingSpace | WatchedPlanner | Call | str, /, **options: Any
) -> GuidingSpace | WatchedPlanner:
    """A guiding space as `make_guidance` makes it, or a planner such as ``"ompl:RRT"``.

    Raises:
        UnknownNameError: No such guiding space, planner or option; the nearest one is suggested.
        InvalidInputError: The expression or an option's value cannot be used, or the planner's library is
            missing.
    """
    if isinstance(searcher, WatchedPlanner):
        if options:
            raise InvalidInputError(f"options {sorted(options)} need a name, got the instance {searcher!r}")
        return searcher
    if isinstance(searcher, str | Call):
        text = str(searcher)
        call = parse(text)
        if is_planner(call):
            return GUIDANCES.plan(call, text, **options)
    return make_guidance(searcher, **options)


@door
def make_guides(guides: object) -> list[GuidingSpace]:
    """Guiding spaces for a hybrid, from a sequence of names or guiding spaces.

    Raises:
        UnknownNameError: No guiding space has one of the names.
        InvalidInputError: No sequence, or an empty one.
    """
    if isinstance(guides, str) or not isinstance(guides, Sequence) or not guides:
        raise InvalidInputError(f"guides: expected a sequence of guiding spaces, got {shown(guides)}")
    return [make_guidance(guide) for guide in guides]


def make_expander(expansion: GuidingSpace | str) -> GuidingSpace | None:
    """Who proposes x_new: None for ``"uniform"``, the local planner's ball, else as in `make_guidance`.

    Raises:
        UnknownNameError: No such guiding space; the nearest name, or ``"uniform"``, is suggested.
    """
    if expansion == "uniform":
        return None
    if isinstance(expansion, str):
        check_name("expansion", expansion, ["uniform", *GUIDANCES])
    return make_guidance(expansion)


def check_name(kind: str, text: str, known: list[str]) -> None:
    """Refuse an expression that is an unknown name and nothing else, and suggest others.

    Raises:
        UnknownNameError: It is one; the nearest of ``known`` is suggested.
        InvalidInputError: It is no expression.
    """
    call = parse(text, kind)
    if call.bare and ":" not in call.name and call.name not in GUIDANCES:
        raise UnknownNameError(kind, call.name, known)
