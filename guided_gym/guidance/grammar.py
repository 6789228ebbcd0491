"""The grammar of guidances: calls within calls, from text to a small tree and back.

    expression: call ("+" call)*                          a+b is hybrid(a, b)
    call:       name ["(" [argument ("," argument)*] ")"] ("@" option "=" value)*
    argument:   [option "="] value                        a@x=1@y=2 is a(x=1, y=2)
    value:      number | true | false | none | "text" | 'text' | "[" [value ("," value)*] "]" | expression

A name is a word, ``package.module:Class`` or ``learned:PATH``. A quote inside quotes is written twice. A path
without quotes may hold ``+``, ``@``, ``=`` and blanks where a file or folder of that name exists.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from typing import Any, Final, TypeGuard

from guided_gym.errors import InvalidInputError

FAMILY: Final = "learned"  # of names with a path behind the colon
JOINED: Final = "hybrid"  # what ``a+b`` is a call of
LONGEST: Final = 10_000  # characters of an expression
DEEPEST: Final = 32  # brackets within brackets

_WORD: Final = re.compile(r"""[^\s,()\[\]=@+"']+""")
_NUMBER: Final = re.compile(
    r"""-?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?=[\s,()\[\]=@+"']|$)""", re.ASCII
)
_INTEGER: Final = re.compile(r"-?\d+", re.ASCII)
_QUOTED: Final = re.compile(r'"((?:[^"]|"")*)"' + r"|'((?:[^']|'')*)'")
_WRITTEN: Final[dict[bool | None, str]] = {True: "true", False: "false", None: "none"}
_CONSTANTS: Final = {text: value for value, text in _WRITTEN.items()} | {
    str(value): value for value in _WRITTEN
}
_SHOWN: Final = 60  # characters of an expression in a message


@dataclass(frozen=True)
class Option:
    """A keyword option of a call.

    Attributes:
        name: Its name.
        value: A number, a truth value, None, text, a tuple of values, or a `Call`: a bare word is one, too.
        at: Where in the text its name begins; does not count for equality.
    """

    name: str
    value: Any
    at: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Call:
    """A name with what is passed to it; its text (`str`) is the canonical one.

    Attributes:
        name: The name; of ``learned:"a b"`` it is ``learned:a b``.
        arguments: Values without a name, as in `Option`.
        options: Values with one, by name.
        span: Its first character in the text and the one after its last; does not count for equality.
    """

    name: str
    arguments: tuple[Any, ...] = ()
    options: tuple[Option, ...] = ()
    span: tuple[int, int] = field(default=(0, 0), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "options", tuple(sorted(self.options, key=lambda option: option.name)))

    @property
    def bare(self) -> bool:
        """Whether the call is a name and nothing else."""
        return not (self.arguments or self.options)

    def __str__(self) -> str:
        parts = [text_of(value) for value in self.arguments]
        parts += [f"{option.name}={text_of(option.value)}" for option in self.options]
        family, colon, member = self.name.partition(":")
        plain = _WORD.fullmatch(self.name) and not (family == FAMILY and colon and parts)
        name = self.name if plain else f"{family}:{_in_quotes(member)}"
        return f"{name}({', '.join(parts)})" if parts else name


def text_of(value: Any) -> str:
    """The canonical text of a value."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(text_of, value))}]"
    if isinstance(value, str):
        return _in_quotes(value)
    if value is None or isinstance(value, bool):
        return _WRITTEN[value]
    return str(value)


def _in_quotes(text: str) -> str:
    return '"{}"'.format(text.replace('"', '""'))


def parse(text: str, what: str = "guidance") -> Call:
    """The tree of an expression.

    Args:
        text: The expression.
        what: What messages call it.

    Raises:
        InvalidInputError: The text follows no rule of the grammar; the message says where.
    """
    if len(text) > LONGEST:
        raise InvalidInputError(
            f"{what}: expected at most {LONGEST} characters, got {len(text)} in {shown(text)}"
        )
    path = text.strip().removeprefix(f"{FAMILY}:")
    if path != text.strip() and _exists(path):  # whatever its characters
        return Call(f"{FAMILY}:{path}", span=(0, len(text)))
    parser = _Parser(text, what)
    call = parser.expression(0)
    parser.end()
    return call


def is_name(name: object) -> TypeGuard[str]:
    """Whether something can be a row's name: a word that an expression reads as a name, nothing else."""
    if not isinstance(name, str) or ":" in name or not _WORD.fullmatch(name):
        return False
    return name not in _CONSTANTS and not _NUMBER.fullmatch(name)


def split(what: str, text: str) -> list[str]:
    """The items of a list with commas; those within brackets or quotes separate nothing.

    Raises:
        InvalidInputError: An item is empty.
    """
    items, depth, begun, at = [], 0, 0, 0
    while at < len(text):
        quoted = _QUOTED.match(text, at)
        depth += (text[at] in "([") - (text[at] in ")]")
        if text[at] == "," and depth <= 0:
            items.append(text[begun:at].strip())
            begun = at + 1
        at = quoted.end() if quoted else at + 1
    items.append(text[begun:].strip())
    if not text.strip():
        return []
    if not all(items):
        raise InvalidInputError(
            f"{what}: expected names separated by commas, got an empty one in {shown(text)}"
        )
    return items


def shown(text: str, at: int = 0) -> str:
    """A text as a message shows it: in one line; of a long text, the part around a character."""
    first = max(0, min(at - _SHOWN // 2, len(text) - _SHOWN))
    part = text[first : first + _SHOWN]
    return repr(("…" if first else "") + part + ("…" if first + _SHOWN < len(text) else ""))


def place(text: str, at: int) -> str:
    """How a message says where in an expression something is."""
    return f"at character {at + 1} of {shown(text, at)}"


def _exists(path: str) -> bool:
    try:
        return bool(path) and os.path.exists(path)
    except (OSError, ValueError):  # longer than any path, or a null character
        return False


class _Parser:
    """Reads one text from left to right, a method per rule of the grammar."""

    def __init__(self, text: str, what: str) -> None:
        self.text, self.what, self.at = text, what, 0

    def fail(self, expected: str, at: int | None = None) -> InvalidInputError:
        at = self.at if at is None else at
        got = shown(self.text[at : at + 12]) if at < len(self.text) else "its end"
        return InvalidInputError(f"{self.what}: expected {expected}, got {got} {place(self.text, at)}")

    def peek(self) -> str:
        """The next character that is no blank; nothing at the end."""
        while self.text[self.at : self.at + 1].isspace():
            self.at += 1
        return self.text[self.at : self.at + 1]

    def take(self, character: str) -> bool:
        found = self.peek() == character
        self.at += found
        return found

    def end(self) -> None:
        if self.peek():
            raise self.fail("'+', '@' or the end (a path with such characters needs quotes)")

    def expression(self, depth: int) -> Call:
        first = self.call(depth)
        calls = [first]
        while self.take("+"):
            if self.peek() in ("", "+", ",", ")", "]"):
                raise self.fail("names joined by '+'")
            calls.append(self.call(depth))
        return first if len(calls) == 1 else Call(JOINED, tuple(calls), (), (first.span[0], self.at))

    def call(self, depth: int, suffixes: bool = True) -> Call:
        """A name, its arguments and, unless it is a value of one itself, what follows ``@``."""
        self.peek()
        begun = self.at
        name = self.name()
        arguments: list[Any] = []
        options: list[Option] = []
        if self.take("("):
            self.arguments(arguments, options, self.deeper(depth))
        while suffixes and self.take("@"):
            option = self.option()
            if option is None:
                raise self.fail("name@option=value")
            self.add(options, Option(option[0], self.value(depth, joined=False, path=True), option[1]))
        return Call(name, tuple(arguments), tuple(options), (begun, self.at))

    def deeper(self, depth: int) -> int:
        if depth >= DEEPEST:
            raise self.fail(f"at most {DEEPEST} brackets within each other", self.at - 1)
        return depth + 1

    def arguments(self, arguments: list[Any], options: list[Option], depth: int) -> None:
        """What is between brackets, including the closing one."""
        while not self.take(")"):
            option = self.option()
            value = self.value(depth, path=option is not None)
            if option is not None:
                self.add(options, Option(option[0], value, option[1]))
            elif options:
                raise self.fail("values without a name before those with one", options[-1].at)
            else:
                arguments.append(value)
            if not self.take(",") and self.peek() != ")":
                raise self.fail("',' or ')'")

    def add(self, options: list[Option], option: Option) -> None:
        if any(option.name == other.name for other in options):
            raise self.fail(f"the option {option.name!r} once", option.at)
        options.append(option)

    def option(self) -> tuple[str, int] | None:
        """The name of an option and where it begins, with the ``=`` behind it; None if there is none."""
        self.peek()
        begun = self.at
        word = _WORD.match(self.text, self.at)
        if word is not None:
            self.at = word.end()
            if self.take("="):
                if not word.group().isidentifier():
                    raise self.fail("the name of an option", begun)
                return word.group(), begun
        self.at = begun
        return None

    def name(self) -> str:
        """A word; after ``learned:`` and the like, with the name or the quoted text that follows."""
        begun = self.at
        word = _WORD.match(self.text, self.at)
        if word is None:
            raise self.fail("a name")
        self.at = word.end()
        name = word.group()
        if name.endswith(":") and self.text[self.at : self.at + 1] in ('"', "'"):
            return name + self.quoted()
        if name.startswith(f"{FAMILY}:"):
            return f"{FAMILY}:{self.path(begun + len(FAMILY) + 1)}"
        if ":" not in name and not is_name(name):
            raise self.fail("a name", begun)
        return name

    def path(self, begun: int) -> str:
        """The word that was just read from there, or the longest path that begins there and exists."""
        stop = re.compile(r"""[,()\[\]"']|$""").search(self.text, self.at)
        last = stop.start() if stop else len(self.text)
        ends = [at for at in range(self.at + 1, last) if self.text[at] in "+@= "] + [last]
        for end in reversed(ends[-64:]):
            whole = self.text[begun:end].rstrip()
            if begun + len(whole) > self.at and _exists(whole):
                self.at = begun + len(whole)
                break
        return self.text[begun : self.at]

    def quoted(self) -> str:
        found = _QUOTED.match(self.text, self.at)
        if found is None:
            raise self.fail("a closing quote; one inside a text is written twice")
        self.at = found.end()
        quote = found.group()[0]
        return found.group()[1:-1].replace(2 * quote, quote)

    def value(self, depth: int, joined: bool = True, path: bool = False) -> Any:
        """A value; ``joined``: a sum may be one; ``path``: a word may be a path."""
        first = self.peek()
        if first in ('"', "'") and first:
            return self.quoted()
        if self.take("["):
            return self.items(self.deeper(depth))
        number = _NUMBER.match(self.text, self.at)
        if number is not None:
            self.at = number.end()
            return self.number(number.group(), number.start())
        word = _WORD.match(self.text, self.at)
        if word is not None and word.group() in _CONSTANTS:
            self.at = word.end()
            return _CONSTANTS[word.group()]
        if word is None:
            raise self.fail("a value")
        if path:
            begun, self.at = self.at, word.end()
            whole = self.path(begun)
            if whole != word.group():
                return whole
            self.at = begun
        return self.expression(depth) if joined else self.call(depth, suffixes=False)

    def items(self, depth: int) -> tuple[Any, ...]:
        """What is between square brackets, including the closing one."""
        items: list[Any] = []
        while not self.take("]"):
            items.append(self.value(depth))
            if not self.take(",") and self.peek() != "]":
                raise self.fail("',' or ']'")
        return tuple(items)

    def number(self, text: str, at: int) -> int | float:
        try:
            return int(text) if _INTEGER.fullmatch(text) else float(text)
        except ValueError as error:  # Python reads integers of 4,300 digits at most
            raise self.fail("a number of fewer digits", at) from error
