"""Guiding spaces by name: one row each; a new one joins here, or by `register_guidance`."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Sequence
from typing import Any

from guided_gym.checks import same_place
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import GoalDistance, OracleGuidance, Uninformed, Voronoi
from guided_gym.guidance.environment_modification import PRM, LazyPRM
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.robot_modification import MedialAxis
from guided_gym.guidance.solvers.paths import PathDatabase
from guided_gym.guidance.wavefront import Wavefront

# One row per guiding space: a new one joins here, or by `register_guidance`.
_GUIDANCE: dict[str, type[GuidingSpace]] = {
    cls.name: cls
    for cls in (
        Uninformed,
        GoalDistance,
        OracleGuidance,
        Voronoi,
        PRM,
        LazyPRM,
        MedialAxis,
        PathDatabase,
        Wavefront,
        Hybrid,
    )
}


# Families of guiding spaces, ``"family:member"``: the module whose `guidance_class` knows the members. It is
# imported by name, on demand, since the core imports nothing of the rooms above it.
_FAMILIES = {"learned": "guided_gym.guidance.learned.agent"}


def register_guidance(cls: type[GuidingSpace], *, replace: bool = False) -> type[GuidingSpace]:
    """Class decorator: makes a guiding space known under its ``name``, everywhere a name is taken.

    Args:
        cls: The class. Registering the same one again, from a module loaded anew, is fine.
        replace: Whether it may take the place of another class of that name.

    Raises:
        InvalidInputError: No guiding space, or its name is missing, taken, or means something in a guidance
            string.
    """
    if not (isinstance(cls, type) and issubclass(cls, GuidingSpace)):
        raise InvalidInputError(f"register_guidance: expected a subclass of GuidingSpace, got {cls!r}")
    if not isinstance(cls.name, str) or not cls.name or set(cls.name) & set("+:,@ "):
        raise InvalidInputError(
            f"{cls.__name__}.name: expected a word without '+', ':', ',', '@' or blanks, got {cls.name!r}"
        )
    taken = _GUIDANCE.get(cls.name)
    if not replace and taken is not None and not same_place(taken, cls):
        raise InvalidInputError(
            f"guidance {cls.name!r}: expected a name that is free, got that of {taken.__module__}."
            f"{taken.__qualname__}; replace=True takes its place"
        )
    _GUIDANCE[cls.name] = cls
    return cls


def guidance_names() -> list[str]:
    """Names of the guiding spaces, in order of appearance."""
    return list(_GUIDANCE)


def guidance_class(name: str) -> type[GuidingSpace]:
    """The class behind a name, behind ``"package.module:Class"``, or behind ``"learned:NAME"``.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
        StorageError: A learned agent whose files cannot be used.
        InvalidInputError: The module or class cannot be imported or is no guiding space.
    """
    family, _, member = name.partition(":")
    if family in _FAMILIES and ":" in name:
        cls: type[GuidingSpace] = importlib.import_module(_FAMILIES[family]).guidance_class(
            member, make_guides
        )
        return cls
    if ":" in name:
        module, _, attribute = name.partition(":")
        try:
            cls = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError, ValueError, TypeError) as error:
            raise InvalidInputError(f"guidance {name!r}: {error}") from error
        if not (isinstance(cls, type) and issubclass(cls, GuidingSpace)):
            raise InvalidInputError(f"guidance {name!r}: expected a GuidingSpace, got {cls!r}")
        return cls
    if name not in _GUIDANCE:
        raise UnknownNameError("guidance", name, _GUIDANCE)
    return _GUIDANCE[name]


def make_guidance(guidance: GuidingSpace | str, **options: Any) -> GuidingSpace:
    """A guiding space from its name.

    Args:
        guidance: A name (`guidance_names`), ``"learned:NAME"`` for a learned agent (shipped, or a folder),
            ``"package.module:Class"``, several joined by ``+`` for a
            `Hybrid` of them, or a guiding space, which is returned as it is.
        **options: Passed to the class.

    Raises:
        UnknownNameError: No such guiding space or option; the nearest one is suggested.
        InvalidInputError: An option's value cannot be used.
    """
    if isinstance(guidance, GuidingSpace):
        if options:
            raise InvalidInputError(f"options {sorted(options)} need a name, got the instance {guidance!r}")
        return guidance
    if not isinstance(guidance, str):
        raise InvalidInputError(f"guidance: expected a name or a guiding space, got {guidance!r}")
    if "+" in guidance:
        if not all(part.strip() for part in guidance.split("+")):
            raise InvalidInputError(f"guidance: expected names joined by '+', got {guidance!r}")
        return make_guidance("hybrid", guides=guidance.split("+"), **options)
    cls = guidance_class(guidance)
    if cls is Hybrid:
        options["guides"] = make_guides(options.get("guides", PAPERS_HYBRID))
    known = list(inspect.signature(cls.__init__).parameters)[1:]
    for option in options:
        if option not in known:
            raise UnknownNameError(f"option of guidance {guidance!r}:", option, known)
    return cls(**options)


PAPERS_HYBRID = ("lazy_prm", "medial_axis")


def make_guides(guides: object) -> list[GuidingSpace]:
    """Guiding spaces of a sequence of names, or of guiding spaces, as hybrids take them.

    Raises:
        UnknownNameError: No guiding space has one of the names.
        InvalidInputError: No sequence, or an empty one.
    """
    if isinstance(guides, str) or not isinstance(guides, Sequence) or not guides:
        raise InvalidInputError(f"guides: expected a sequence of guiding spaces, got {guides!r}")
    return [make_guidance(guide) for guide in guides]


def make_expander(expansion: GuidingSpace | str) -> GuidingSpace | None:
    """Who proposes x_new: None for ``"uniform"``, the local planner's ball, else as in `make_guidance`.

    Raises:
        UnknownNameError: No such guiding space; the nearest name, or ``"uniform"``, is suggested.
    """
    if expansion == "uniform":
        return None
    if isinstance(expansion, str) and not set(expansion) & set("+:") and expansion not in _GUIDANCE:
        raise UnknownNameError("expansion", expansion, ["uniform", *_GUIDANCE])
    return make_guidance(expansion)
