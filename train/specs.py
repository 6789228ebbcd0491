"""What to run: guidances with their options, settings of the search, and the fingerprint of both."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from guided_gym.checks import integer
from guided_gym.errors import InvalidInputError
from guided_gym.options import DEFAULT_CANDIDATES, TargetParameters
from guided_gym.problems import Task
from guided_gym.train.results import RESULTS_VERSION

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.options import SearchOptions

LEARNED = "learned:"  # before the name or folder of a learned agent
DATABASE_GUIDANCE = "path_database"  # the guidance that ``--database`` is for


@dataclass(frozen=True)
class GuidanceSpec:
    """A guiding space by name, with options; it can be sent to a process and written into a file.

    Attributes:
        name: Anything that `guided_gym.guidance.make_guidance` knows by name.
        options: Keyword arguments of `guided_gym.guidance.make_guidance`, sorted by name.
        label: What tables call it; the name and its options unless given.
    """

    name: str
    options: tuple[tuple[str, Any], ...] = ()
    label: str = ""

    def __post_init__(self) -> None:
        options = ((name, tuple(value) if isinstance(value, list) else value) for name, value in self.options)
        object.__setattr__(self, "options", tuple(sorted(options)))
        if not self.label:
            parts = [self.name, *(f"{name}={_short(value)}" for name, value in self.options)]
            object.__setattr__(self, "label", "@".join(parts))

    @classmethod
    def of(cls, name: str, *, label: str = "", **options: Any) -> GuidanceSpec:
        """A guidance with keyword options."""
        return cls(name, tuple(options.items()), label)

    @classmethod
    def parse(cls, text: str) -> GuidanceSpec:
        """A guidance from ``name`` or ``name@option=value@option=value``; values are JSON or plain words.

        Raises:
            InvalidInputError: The text has another form.
        """
        name, *parts = (part.strip() for part in text.split("@"))
        options = {}
        for part in parts:
            key, equals, value = part.partition("=")
            if not (key and equals):
                raise InvalidInputError(f"guidance: expected name@option=value, got {text!r}")
            options[key] = _literal(value)
        if not name:
            raise InvalidInputError(f"guidance: expected a name, got {text!r}")
        return cls(name, tuple(options.items()))

    def with_default(self, option: str, value: Any) -> GuidanceSpec:
        """This guidance with an option set, unless it is set already; the label stays."""
        if option in dict(self.options):
            return self
        return GuidanceSpec(self.name, (*self.options, (option, value)), self.label)

    def make(self) -> GuidingSpace:
        """The guiding space.

        Raises:
            UnknownNameError: No guidance or option of that name.
        """
        from guided_gym.guidance.registry import make_guidance

        return make_guidance(self.name, **dict(self.options))


def _literal(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def _short(value: Any) -> str:
    return Path(value).name if isinstance(value, str | Path) else str(value)


@lru_cache(maxsize=16)
def made(spec: GuidanceSpec) -> GuidingSpace:
    """A guiding space that this process keeps: some are dear to make, and each search resets it anyway."""
    return spec.make()


@dataclass(frozen=True)
class EvaluationSettings:
    """Everything that the figures of a run depend on besides environment, guidance and seed.

    Attributes:
        max_samples: Samples after which a search gives up.
        expansion: Who proposes x_new: None for the guidance itself, ``"uniform"``, or a guidance's name.
        step: Radius of the local planner's ball; None for its default.
        candidates: Members of N_C(v) that a guided expansion looks at.
        goal_tolerance: Distance to the goal that counts as having reached it; None for what the problem says.
        rewire: Whether new nodes rewire the tree.
        target: Parameters of the target distribution Q.
        distributions: Whether to measure D_KL and D_JS of each guidance's whole distribution P too.
        goal_edge: Whether a valid edge to the goal ends a search; None likewise.
    """

    max_samples: int = 1000
    expansion: str | None = None
    step: float | None = None
    candidates: int = DEFAULT_CANDIDATES
    goal_tolerance: float | None = None
    rewire: bool = False
    target: TargetParameters = field(default_factory=TargetParameters)
    distributions: bool = False
    goal_edge: bool | None = None

    def __post_init__(self) -> None:
        integer("max_samples", self.max_samples, least=1)
        self.search_options()  # checks the rest
        Task([0.0], [1.0]).ending(self.goal_tolerance, self.goal_edge)

    def search_options(self) -> SearchOptions:
        """The part of it that `guided_gym.search.search.Search` takes."""
        from guided_gym.options import SearchOptions

        return SearchOptions(self.step, self.candidates, self.rewire, self.target)


def settings_content(environment: str, spec: GuidanceSpec, settings: EvaluationSettings) -> dict[str, Any]:
    """What a settings fingerprint is the hash of.

    The package's code is part of it, so that no table mixes figures of two versions. A problem counts by its
    content, a file by its content, never by its path.
    """
    from guided_gym.catalogue.table import make_distribution

    options = {name: _content(spec, name, value) for name, value in spec.options}
    return {
        "results_version": RESULTS_VERSION,
        "code": code_fingerprint(),
        "problem": make_distribution(environment).problem(0).fingerprint,
        "guidance": {"name": spec.name, "options": options, **_agents_content(spec, settings)},
        "settings": asdict(settings),
    }


def _agents_content(spec: GuidanceSpec, settings: EvaluationSettings) -> dict[str, Any]:
    """The learned agents that take part, by their weights and the code that runs them."""
    names = [spec.name, settings.expansion or ""]
    for _, value in spec.options:
        names += [item for item in value if isinstance(item, str)] if isinstance(value, tuple) else []
    parts = [part for name in names for part in name.split("+")]
    agents = [part.removeprefix(LEARNED) for part in parts if part.startswith(LEARNED)]
    if not agents:
        return {}
    from guided_gym.guidance.learned.agent import fingerprint as agent_fingerprint

    return {"agents": [agent_fingerprint(agent) for agent in agents]}


def fingerprint(content: Mapping[str, Any]) -> str:
    """Hash of a JSON-able content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _content(spec: GuidanceSpec, name: str, value: Any) -> Any:
    if spec.name == DATABASE_GUIDANCE and isinstance(value, str | Path) and Path(value).is_file():
        limit = dict(spec.options).get("paths")
        return _database_content(str(value), os.stat(value).st_mtime_ns, limit)
    return value


@lru_cache(maxsize=64)
def _database_content(path: str, changed: int, limit: int | None) -> str:
    from guided_gym.storage.path_file import PathDatabase

    with PathDatabase.open(path, readonly=True) as database:
        library = database.load(limit)
    digest = hashlib.sha256(library.waypoints.tobytes() + library.offsets.tobytes())
    return digest.hexdigest()[:16]


@cache
def code_fingerprint() -> str:
    """Version of the package and hash of the source of its core, problems included."""
    import guided_gym

    folder = Path(guided_gym.__file__).parent
    files = sorted(folder.rglob("*.py")) if folder.is_dir() else []
    core = [file for file in files if file.relative_to(folder).parts[0] not in ("envs", "agents", "train")]
    digest = hashlib.sha256()
    for file in core:
        digest.update(file.read_bytes())
    return f"{package_version()} {digest.hexdigest()[:16]}"


@cache
def package_version() -> str:
    """Version of the installed package."""
    import importlib.metadata

    try:
        return importlib.metadata.version("guided-gym")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def words(option: str, text: str) -> list[str]:
    """The items of a list with commas, as options have it; none of an empty text.

    Raises:
        InvalidInputError: An item is empty.
    """
    items = [item.strip() for item in text.split(",")] if text.strip() else []
    if not all(items):
        raise InvalidInputError(f"{option}: expected names separated by commas, got an empty one in {text!r}")
    return items


def import_modules(names: Sequence[str]) -> None:
    """Import modules that register environments or guidances; the working folder counts.

    Raises:
        InvalidInputError: A module cannot be imported.
    """
    if names and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    for name in names:
        try:
            importlib.import_module(name)
        except Exception as error:
            raise InvalidInputError(f"cannot import {name!r}: {type(error).__name__}: {error}") from error
