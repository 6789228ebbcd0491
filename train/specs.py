"""What to run: guidances with their options, settings of the search, and a fingerprint of both."""

from __future__ import annotations

import hashlib
import importlib
import itertools
import json
import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from guided_gym.doors import doors
from guided_gym.errors import GuidedGymError, InvalidInputError, NoPathError
from guided_gym.guidance.grammar import FAMILY, JOINED, Call, Option, is_name, parse, split, text_of
from guided_gym.options import (
    DEFAULT_CANDIDATES,
    DEFAULT_ORACLE,
    OracleOptions,
    TargetParameters,
    checked_samples,
)
from guided_gym.problems import Task
from guided_gym.train.results import RESULTS_VERSION

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.options import SearchOptions
    from guided_gym.search.watch import WatchedPlanner

LEARNED = f"{FAMILY}:"  # before the name or folder of a learned agent
DATABASE_GUIDANCE = "path_database"  # the guidance that ``--database`` is for


@doors
@dataclass(frozen=True)
class GuidanceSpec:
    """A guiding space by name, with options; it can be sent to a process and written into a file.

    Attributes:
        name: Anything that `guided_gym.guidance.registry.make_guidance` knows by name, expressions too.
        options: Keyword arguments of `guided_gym.guidance.registry.make_guidance`, sorted by name.
        label: What tables call it; the name and its options unless given.
    """

    name: str
    options: tuple[tuple[str, Any], ...] = ()
    label: str = ""

    def __post_init__(self) -> None:
        call = self.call
        name, options = self.name, tuple(sorted(self.options))
        if _textual(call):
            values = [(option.name, _plain(option.value)) for option in call.options]
            whole = bool(call.arguments) or any(_nested(value) for _, value in values)
            name, options = (str(call), ()) if whole else (str(Call(call.name)), tuple(values))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "options", options)
        if not self.label:
            object.__setattr__(self, "label", _label(call))

    @classmethod
    def of(cls, name: str, *, label: str = "", **options: Any) -> GuidanceSpec:
        """A guidance with keyword options."""
        return cls(name, tuple(options.items()), label)

    @classmethod
    def parse(cls, text: str) -> GuidanceSpec:
        """A guidance from an expression, see `guided_gym.guidance.grammar`; ``name@option=value`` is one.

        Raises:
            InvalidInputError: The text has another form.
        """
        return cls(text)

    @property
    def call(self) -> Call:
        """The tree of name and options.

        Raises:
            InvalidInputError: The name is not an expression.
        """
        from guided_gym.guidance.registry import read_guidance

        call = parse(self.name)
        own = (Option(name, str(v) if isinstance(v, Path) else v) for name, v in self.options)
        return read_guidance(replace(call, options=(*call.options, *own)))

    def with_default(self, guidance: str, option: str, value: Any) -> GuidanceSpec:
        """This guidance with an option of it, or of guidances in it, set where it is not; the label stays.

        Args:
            guidance: The name of those that have the option.
            option: The option.
            value: Its value.
        """
        filled = _filled(self.call, guidance, Option(option, value))
        if _textual(filled):
            return GuidanceSpec(str(filled), (), self.label)
        own = () if self.name != guidance or option in dict(self.options) else ((option, value),)
        return replace(self, options=(*self.options, *own))

    def uses(self, guidance: str) -> bool:
        """Whether a guidance is this one or part of it."""
        return any(call.name == guidance for call in _calls(self.call))

    def make(self) -> GuidingSpace | WatchedPlanner:
        """The guiding space, or the planner, made anew.

        Raises:
            UnknownNameError: No guidance or option of that name.
        """
        from guided_gym.guidance.registry import make_searcher

        return make_searcher(self.name, **dict(self.options))


def _textual(value: Any) -> bool:
    """Whether a value can be written down."""
    if isinstance(value, Call):
        return _textual(value.arguments) and all(_textual(option.value) for option in value.options)
    if isinstance(value, tuple):
        return all(map(_textual, value))
    return (
        value is None or isinstance(value, str | bool | int) or (isinstance(value, float) and value == value)
    )


def _plain(value: Any) -> Any:
    """The value of an option, a bare word as the text that it is."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return value.name if isinstance(value, Call) and str(value) == value.name else value


def _nested(value: Any) -> bool:
    return any(map(_nested, value)) if isinstance(value, tuple) else isinstance(value, Call)


def _calls(value: Any) -> Iterator[Call]:
    """The calls within a value, itself included."""
    if isinstance(value, tuple):
        for item in value:
            yield from _calls(item)
    elif isinstance(value, Call):
        yield value
        yield from _calls(value.arguments)
        yield from _calls(tuple(option.value for option in value.options))


def _filled(value: Any, guidance: str, option: Option) -> Any:
    """A value with an option added to each call of a guidance that lacks it."""
    if isinstance(value, tuple):
        return tuple(_filled(item, guidance, option) for item in value)
    if not isinstance(value, Call):
        return value
    options = tuple(Option(own.name, _filled(own.value, guidance, option)) for own in value.options)
    if value.name == guidance and all(own.name != option.name for own in options):
        options = (*options, option)
    return Call(value.name, _filled(value.arguments, guidance, option), options)


def _label(call: Call) -> str:
    """What tables call a guidance: the short forms ``a+b`` and ``a@x=1`` where they can say it."""
    guides = call.arguments
    if (
        call.name == JOINED
        and len(guides) > 1
        and not call.options
        and all(isinstance(g, Call) for g in guides)
    ):
        return "+".join(map(_label, guides))
    values = [(option.name, _plain(option.value)) for option in call.options]
    if call.arguments or any(_nested(value) for _, value in values):
        return str(call)
    return "@".join([str(Call(call.name)), *(f"{name}={_short(value)}" for name, value in values)])


def _short(value: Any) -> str:
    """A value as a label has it: of a path its last part."""
    if not isinstance(value, str | Path):
        return text_of(value)
    name = Path(value).name
    return name if is_name(name) else text_of(name)


def made(spec: GuidanceSpec) -> GuidingSpace | WatchedPlanner:
    """A guiding space that this process keeps: some are costly to make, and each search resets them anyway.

    It is made anew where what its names stand for has changed: a class of yours, an agent, a database.
    """
    return _made(spec, repr(spec), _stamp(spec))  # equal are 1, 1.0 and True, which are no same options


@lru_cache(maxsize=16)
def _made(spec: GuidanceSpec, spelling: str, stamp: tuple[Any, ...]) -> GuidingSpace | WatchedPlanner:
    return spec.make()


def _stamp(spec: GuidanceSpec) -> tuple[Any, ...]:
    """What the names and files of a guidance stand for at the moment."""
    from guided_gym.guidance.learned.folders import agent_folder
    from guided_gym.guidance.registry import parts

    try:
        stamp: list[Any] = []
        for call, table in parts(spec.call):
            if not call.name.startswith(LEARNED):
                stamp.append(table.maker(call.name))
            values = [_plain(option.value) for option in call.options]
            stamp += [_changed(Path(value)) for value in values if isinstance(value, str)]
        for agent in _agents_of(spec.call):
            stamp += map(_changed, sorted(agent_folder(agent).iterdir()))
        return tuple(stamp)
    except GuidedGymError:  # making it says what is wrong, and where
        return ()


def _changed(file: Path) -> tuple[int, int]:
    """When a file was changed, and its size; zeros if there is none."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return 0, 0
    return found.st_mtime_ns, found.st_size


@doors
@dataclass(frozen=True)
class EvaluationSettings:
    """Everything besides environment, guidance and seed that the figures of a run depend on.

    Attributes:
        max_samples: Samples after which a search gives up.
        expansion: What proposes x_new: None for the guidance itself, ``"uniform"``, or a guidance's name.
        step: Radius of the local planner's ball; None for its default.
        candidates: Members of N_C(v) that a guided expansion looks at.
        goal_tolerance: Distance to the goal that counts as having reached it; None for what the problem says.
        rewire: Whether new nodes rewire the tree.
        target: Parameters of the target distribution Q.
        distributions: Whether to measure D_KL and D_JS of each guidance's whole distribution P, too.
        goal_edge: Whether a valid edge to the goal ends a search; None likewise.
        protocol: What is compared: ``"whole"``, ``"selection"`` or ``"expansion"``, see
            `guided_gym.train.protocols`.
        oracle: Resolution and budget of the oracle by which SE is measured.
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
    protocol: str = "whole"
    oracle: OracleOptions = DEFAULT_ORACLE

    def __post_init__(self) -> None:
        from guided_gym.train.protocols import checked_protocol

        checked_protocol(self.protocol, self.expansion, self.rewire)
        checked_samples(self.max_samples)
        self.search_options()  # checks the rest
        Task([0.0], [1.0]).ending(self.goal_tolerance, self.goal_edge)

    def search_options(self) -> SearchOptions:
        """The part of it that `guided_gym.search.search.Search` takes."""
        from guided_gym.options import SearchOptions

        return SearchOptions(self.step, self.candidates, self.rewire, self.target, self.oracle)


def settings_content(environment: str, spec: GuidanceSpec, settings: EvaluationSettings) -> dict[str, Any]:
    """What a settings fingerprint is the hash of.

    The package's code is part of it, so that no table mixes figures of two versions, and so is code of yours
    behind the names. A problem counts by its content, a file by its content, never by its path.
    """
    from guided_gym.catalogue.table import make_distribution

    distribution, calls = make_distribution(environment), [spec.call]
    if settings.expansion not in (None, "uniform"):
        calls.append(GuidanceSpec(str(settings.expansion)).call)
    return {
        "results_version": RESULTS_VERSION,
        "code": code_fingerprint(),
        "problem": _problem_content(environment),
        "guidance": {
            "expression": _content(spec.call),
            **_agents_content(calls),
            **_library_content(spec.call),
        },
        "settings": asdict(settings),
        "yours": _yours(calls, distribution),
    }


def _problem_content(environment: str) -> str:
    """The content of an environment's first problem; what is wrong with it, where it cannot be posed."""
    from guided_gym.catalogue.table import make_distribution

    distribution = make_distribution(environment)
    try:
        return distribution.problem(0).fingerprint
    except (InvalidInputError, NoPathError) as error:
        return str(error)


def _yours(calls: Sequence[Call], *others: Any) -> dict[str, str]:
    """The code of yours behind the names in expressions, behind objects in them, and behind other things."""
    from guided_gym.guidance.registry import is_planner, parts
    from guided_gym.train.identity import code_identity

    found = list(others)
    for call, table in itertools.chain.from_iterable(map(parts, calls)):
        if not (call.name.startswith(LEARNED) or is_planner(call) or table.is_built_in(call.name)):
            found.append(table.maker(call.name))
        found += call.arguments
        found += [option.value for option in call.options]
    return code_identity(found)


def _agents_of(expression: Call) -> Iterator[str]:
    """The learned agents in an expression: ``learned:NAME``, and the option ``agent`` of its parts."""
    from guided_gym.guidance.registry import parts
    from guided_gym.guidance.tables import parameters

    for call, table in parts(expression):
        if call.name.startswith(LEARNED):
            yield call.name.removeprefix(LEARNED)
        elif (known := parameters(table.maker(call.name))).keys() >= {"agent"}:
            named = [option.value for option in call.options if option.name == "agent"]
            yield str([*named, *call.arguments[:1], known["agent"].default][0])


def _agents_content(expressions: Sequence[Call]) -> dict[str, Any]:
    """The learned agents that take part, by their weights and the code that runs them."""
    agents = [agent for call in expressions for agent in _agents_of(call)]
    if not agents:
        return {}
    from guided_gym.guidance.learned.agent import fingerprint as agent_fingerprint

    return {"agents": [agent_fingerprint(agent) for agent in agents]}


def _library_content(call: Call) -> dict[str, Any]:
    """The version of the library whose planner a call names."""
    import importlib.metadata

    from guided_gym.guidance.registry import is_planner

    if not is_planner(call):
        return {}
    library = call.name.partition(":")[0]
    return {library: importlib.metadata.version(library)}


def fingerprint(content: Mapping[str, Any]) -> str:
    """Hash of a JSON-able content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _content(value: Any) -> Any:
    """What counts of a value of an expression: of a file or an object what it holds."""
    if isinstance(value, tuple):
        return [_content(item) for item in value]
    if not isinstance(value, Call):
        if value is None or isinstance(value, str | int | float):
            return value
        from guided_gym.train.identity import value_identity

        return value_identity(value)
    options = {option.name: option.value for option in value.options}
    content = {name: _content(inner) for name, inner in options.items()}
    file = content.get("database")
    if isinstance(file, str) and Path(file).is_file():
        content["database"] = _database_content(file, os.stat(file).st_mtime_ns, options.get("paths"))
    name = LEARNED if value.name.startswith(LEARNED) else value.name  # agents count by their weights
    if value.bare:
        return name
    return {"name": name, "arguments": _content(value.arguments), "options": content}


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


def file_label(environment: str) -> str:
    """An environment's name as part of a file's name; of a problem file without folder and extension."""
    from guided_gym.catalogue.file_problems import is_file_name

    return Path(environment).stem if is_file_name(environment) else environment


def words(option: str, text: str) -> list[str]:
    """The items of a list with commas, as options have it; none of an empty text.

    Commas within brackets or quotes, as expressions have them, separate nothing.

    Raises:
        InvalidInputError: An item is empty.
    """
    return split(option, text)


def learned_word(folder: Path) -> str:
    """The agent in a folder as a word of a command line."""
    text = f"{LEARNED}{folder}"
    plain = split("guidance", text) == [text] and parse(text) == Call(text)
    return shlex.quote(text if plain else str(Call(text)))


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
