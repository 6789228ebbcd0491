"""Tables of names: what each stands for, and how an expression (see `grammar`) becomes what it says.

A row is a *maker*: a class, or a function with keyword options. The options are read from its signature and
the one-line summary from its docstring. An option whose values are names of another table, such as
``robot=disc``, is resolved there; `register_kind` says which.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar

from guided_gym.checks import same_place, shown
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.grammar import JOINED, Call, Option, is_name, parse, place

Maker = Callable[..., Any]
M = TypeVar("M", bound=Maker)

SEVERAL: Final = "guides"  # the option that takes a list of guidances; values without a name go there


class Table:
    """Names of one kind of thing, each with its maker.

    Args:
        kind: What messages call such a thing.
        rows: Name to maker.
    """

    def __init__(self, kind: str, rows: Mapping[str, Maker] | None = None) -> None:
        self.kind = kind
        self.rows = dict(rows or {})
        self._first = dict(self.rows)

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def is_built_in(self, name: str) -> bool:
        """Whether a row is one that the table began with."""
        return name in self._first and self.rows.get(name) is self._first[name]

    def register(self, maker: M, name: str | None = None, *, replace: bool = False) -> M:
        """Make something known by a name; also a decorator.

        Args:
            maker: A class or a function. The same one again, from a module loaded anew, is fine.
            name: Its name; the attribute ``name`` or ``__name__`` of the maker if None.
            replace: Whether it may take the place of another.

        Raises:
            InvalidInputError: The name is none, is taken, or means something in an expression.
        """
        if name is None:
            name = getattr(maker, "name" if isinstance(maker, type) else "__name__", None)
            name = None if name == "<lambda>" else name
        if not is_name(name):
            raise InvalidInputError(
                f"name of {self.kind} {maker!r}: expected a word that means nothing else in an expression "
                f"(no blanks and none of ',()[]=@+:' and quotes), got {shown(name)}"
            )
        taken = self.rows.get(name)
        if not replace and taken is not None and not same_place(taken, maker):
            origin = f"{taken.__module__}.{getattr(taken, '__qualname__', taken)}"
            raise InvalidInputError(
                f"{self.kind} {name!r}: expected a name that is free, got that of {origin}; "
                "replace=True replaces it"
            )
        self.rows[name] = maker
        return maker

    def maker(self, name: str, where: str = "") -> Maker:
        """What is behind a name.

        Raises:
            UnknownNameError: No such name; the nearest one is suggested.
        """
        if name not in self.rows:
            raise UnknownNameError(self.kind, name, self.rows, where)
        return self.rows[name]

    def summary(self, name: str) -> str:
        """The first line of its docstring."""
        return (inspect.getdoc(self.maker(name)) or "").partition("\n")[0]

    def make(self, value: str | Call, /, **options: Any) -> Any:
        """What a name or an expression stands for.

        Args:
            value: The name or expression.
            **options: More options for the outermost call.

        Raises:
            UnknownNameError: No such name or option, at any depth; the nearest one is suggested.
            InvalidInputError: The expression or a value cannot be used.
        """
        text = str(value)
        return self.build(parse(text, self.kind), text, **options)

    def build(self, call: Call, text: str, /, **options: Any) -> Any:
        """What a call in a text stands for; see `make`."""
        where = "" if call.bare and text.strip() == call.name else place(text, call.span[0])
        try:
            maker = self.maker(call.name, where)
        except UnknownNameError as error:  # of a family, which knows no places
            raise error.placed(where) from error.__cause__
        known = parameters(maker)
        title = f"{self.kind} {call.name!r}"
        given: dict[str, Any] = {}
        for option in call.options:
            _check_option(option.name, title, known, place(text, option.at))
            given[option.name] = _value(option.name, option.value, text, known)
        for name, value in options.items():
            _check_option(name, title, known, "")
            if name in given:
                raise InvalidInputError(f"{title}: expected the option {name!r} once, got it in {text!r} too")
            given[name] = _value(name, value, text, known)
        _place_arguments(call, text, title, known, given)
        missing = [
            name
            for name, p in known.items()
            if p.default is p.empty and name not in given and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
        ]
        if missing:
            raise InvalidInputError(
                f"{title}: expected the option {missing[0]!r}, which has no default {where}"
            )
        if inspect.isabstract(maker):
            undone = ", ".join(sorted(getattr(maker, "__abstractmethods__", ())))
            raise InvalidInputError(f"{title}: expected its class to define {undone}")
        try:
            return maker(*_unpacked(known, given), **given)
        except InvalidInputError as error:
            if call.span == (0, len(text)) or not where:
                raise
            raise InvalidInputError(f"{error} ({title} {where})") from error


_KINDS: Final[dict[str, Table]] = {}


def register_kind(option: str, table: Table) -> None:
    """Look up values of an option in a table wherever it occurs: names, calls and expressions."""
    _KINDS[option] = table


def kinds() -> Mapping[str, Table]:
    """Option to table, as `register_kind` was told."""
    return _KINDS


def expanded(value: Any, reads: bool = False) -> Any:
    """A value in which all texts that are expressions have been read; a hybrid's guides come as arguments.

    Args:
        value: A call, a tuple of values, or a plain value.
        reads: Whether a text is an expression.
    """
    if isinstance(value, list | tuple):
        return tuple(expanded(item, reads) for item in value)
    if isinstance(value, str) and reads:
        value = parse(value)
    if not isinstance(value, Call):
        return value
    arguments = expanded(value.arguments, value.name == JOINED)
    options = [Option(o.name, expanded(o.value, o.name in _KINDS), o.at) for o in value.options]
    for option in options:
        if (
            value.name == JOINED
            and option.name == SEVERAL
            and isinstance(option.value, tuple)
            and not arguments
        ):
            return replace(
                value, arguments=option.value, options=tuple(o for o in options if o is not option)
            )
    return replace(value, arguments=arguments, options=tuple(options))


def walk(value: Any, table: Table) -> Iterator[tuple[Call, Table]]:
    """The calls of an expanded expression, each with the table that its name is in, from the outside in."""
    if isinstance(value, tuple):
        for item in value:
            yield from walk(item, table)
    if not isinstance(value, Call):
        return
    yield value, table
    known: Iterable[str] = parameters(table.maker(value.name)) if value.arguments else ()
    several = (
        [(SEVERAL, value.arguments)] if SEVERAL in known else list(zip(known, value.arguments, strict=False))
    )
    for name, inner in [*several, *((option.name, option.value) for option in value.options)]:
        if name in _KINDS:
            yield from walk(inner, _KINDS[name])


def parameters(maker: Maker) -> dict[str, inspect.Parameter]:
    """The options of a maker, from its signature."""
    if isinstance(maker, type):
        begin: Maker = maker.__init__  # type: ignore[misc]  # the signature of a class skips a partial one
        if begin is object.__init__:  # takes anything, says its signature
            return {}
        return dict(list(inspect.signature(begin).parameters.items())[1:])
    return dict(inspect.signature(maker).parameters)


def _unpacked(known: Mapping[str, inspect.Parameter], given: dict[str, Any]) -> Sequence[Any]:
    """The values of ``*name`` and of what stands before it, taken out of those given."""
    starred = [name for name, p in known.items() if p.kind is p.VAR_POSITIONAL and name in given]
    if not starred:
        return ()
    values = given.pop(starred[0])
    before = list(known)[: list(known).index(starred[0])]
    first = [given.pop(name) if name in given else known[name].default for name in before]
    return [*first, *(values if isinstance(values, list | tuple) else [values])]


def _check_option(name: str, title: str, known: Mapping[str, inspect.Parameter], where: str) -> None:
    if name not in known and not any(p.kind is p.VAR_KEYWORD for p in known.values()):
        raise UnknownNameError(f"option of {title}:", name, known, where)


def _place_arguments(
    call: Call, text: str, title: str, known: Mapping[str, inspect.Parameter], given: dict[str, Any]
) -> None:
    """Give values without a name to the options in their order, or all of them to `SEVERAL`."""
    if not call.arguments:
        return
    where = place(text, call.span[0])
    if SEVERAL in known:
        if SEVERAL in given:
            raise InvalidInputError(f"{title}: expected {SEVERAL} once, got them twice {where}")
        given[SEVERAL] = _value(SEVERAL, call.arguments, text, known)
        return
    starred = [name for name, p in known.items() if p.kind is p.VAR_POSITIONAL]
    if len(call.arguments) > len(known) and not starred:
        got = f"got {len(call.arguments)} {where}"
        raise InvalidInputError(f"{title}: expected at most {len(known)} options without a name, {got}")
    values: list[Any] = list(call.arguments)
    for name in known:
        if not values:
            break
        if name in given:
            raise InvalidInputError(f"{title}: expected the option {name!r} once, got it twice {where}")
        value = tuple(values) if name in starred else values[0]
        given[name] = _value(name, value, text, known)
        values = [] if name in starred else values[1:]


def _value(option: str, value: Any, text: str, known: Mapping[str, inspect.Parameter]) -> Any:
    """The value of an option: what a name or call stands for where there is a table, else the plain value."""
    table = _KINDS.get(option)
    if table is not None and option == SEVERAL:
        value = [value] if isinstance(value, Call) else value
        several = isinstance(value, Sequence) and not isinstance(value, str)
        return [_member(table, item, text) for item in value] if several else value
    if table is not None:
        default = known[option].default if option in known else None
        if isinstance(value, int | float | list | tuple) or (value is None and default is not None):
            raise InvalidInputError(f"{option}: expected a {table.kind} or its name, got {shown(value)}")
        return _member(table, value, text)
    if isinstance(value, Call):
        if not value.bare:
            raise InvalidInputError(
                f"option {option!r}: expected a value, got a call {place(text, value.span[0])}; options that "
                f"take calls: {', '.join(sorted(_KINDS))}"
            )
        return value.name
    return tuple(_value(option, item, text, known) for item in value) if isinstance(value, tuple) else value


def _member(table: Table, value: Any, text: str) -> Any:
    if isinstance(value, Call):
        return table.build(value, text)
    return table.make(value) if isinstance(value, str) else value
