"""Doors: functions whose arguments are held to their annotations, so that bad ones raise errors of ours.

A function has its own checks, of values and with the words that suit it. What it does not foresee is an
argument of another *kind*: a polygon for a problem, text for an array. `door` answers for those:

- What has to be an object of a class of ours is looked at before the call: an isinstance, some 0.1 us.
- Numbers, text, arrays and all else are looked at only if the call raised an error of Python's or numpy's.
  If one does not fit, the error becomes an `InvalidInputError` that names it. If all fit, but a sequence
  stands for an array, or a huge integer for a float, the call is made again with one. Else the error goes
  on: it may be one of the caller's own functions, or ours.

So a call that works costs next to nothing more.
"""

from __future__ import annotations

import builtins
import collections.abc
import functools
import importlib
import inspect
import os
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, ParamSpec, TypeVar, Union

import numpy as np
import numpy.typing as npt

from guided_gym.checks import shown
from guided_gym.errors import GuidedGymError, InvalidInputError

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)

_MISFIT: Final = object()
_MOST_BITS: Final = 1024  # of an integer: beyond all floats none is meant
_OWN: Final = "_door_"  # begins the names that a door's body has beside the parameters

Reader = Callable[[Any], Any]  # the value to hand on, or _MISFIT


class _Kind(NamedTuple):
    """What an annotation asks for.

    Attributes:
        read: Gives the value to hand on, or _MISFIT.
        words: What messages call it.
        classes: Those that it is an instance of one of, where that says all; else none.
    """

    read: Reader
    words: str
    classes: tuple[type, ...] = ()


def door(call: Callable[P, R]) -> Callable[P, R]:
    """Hold the arguments of a function or method to their annotations, see the top of this module."""

    def open_up() -> Callable[P, R]:
        """Give the door a body of the function's own parameters: packing them would cost more than it does.

        At the first call: only then all names of the annotations are known.
        """
        kinds = {name: kind for name, kind in _kinds(call, False).items() if kind.classes}
        namespace.update({f"{_OWN}classes_{name}": kind.classes for name, kind in kinds.items()})
        made: dict[str, Any] = {}
        exec(_body(code, kinds), namespace, made)
        opened.__defaults__ = call.__defaults__  # type: ignore[attr-defined]
        opened.__kwdefaults__ = call.__kwdefaults__  # type: ignore[attr-defined]
        opened.__code__ = made["opened"].__code__.replace(co_name=code.co_name, co_qualname=code.co_qualname)
        return door_of

    def refuse(name: str, value: object) -> None:
        if value is not _defaults(call).get(name, _MISFIT):
            raise _refused(name, _kinds(call, False)[name], value)

    def read(args: list[Any], kwargs: dict[str, Any], error: Exception) -> Any:
        return _read(call, code.co_varnames[: code.co_argcount], args, kwargs, error)

    code: types.CodeType = call.__code__  # type: ignore[attr-defined]
    own = {"call": call, "refuse": refuse, "read": read, "ours": GuidedGymError, "open_up": open_up}
    namespace: dict[str, Any] = {_OWN + name: value for name, value in own.items()}
    opened = types.FunctionType(_closed.__code__, namespace, code.co_name)
    door_of = functools.wraps(call)(opened)
    return door_of


def _body(code: types.CodeType, checked: Iterable[str]) -> str:
    """What a door does at each call, in Python: look at some arguments, and hand all on."""
    count, only, keywords = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount
    names = list(code.co_varnames)
    plain, named, rest = names[:count], names[count : count + keywords], names[count + keywords :]
    star = f"*{rest.pop(0)}" if code.co_flags & inspect.CO_VARARGS else ""
    stars = f"**{rest.pop(0)}" if code.co_flags & inspect.CO_VARKEYWORDS else ""
    before = [*plain[:only], "/", *plain[only:]] if only else plain
    taken = [*before, star or ("*" if named else ""), *named, stars]
    given = [*plain, star, *(f"{name}={name}" for name in named), stars]
    args, kwargs = (
        ", ".join(filter(None, [*plain, star])),
        ", ".join(filter(None, [*(f"{name!r}: {name}" for name in named), stars])),
    )
    lines = [f"def opened({', '.join(filter(None, taken))}):"]
    for name in (name for name in checked if name in (*plain, *named)):
        lines.append(f"    if not isinstance({name}, {_OWN}classes_{name}):")
        lines.append(f"        {_OWN}refuse({name!r}, {name})")
    lines += [
        "    try:",
        f"        return {_OWN}call({', '.join(filter(None, given))})",
        f"    except {_OWN}ours:",
        "        raise",
        f"    except Exception as {_OWN}error:",
        f"        {_OWN}again = {_OWN}read([{args}], {{{kwargs}}}, {_OWN}error)",
        f"        if {_OWN}again is None:",
        "            raise",
        f"    return {_OWN}call(*{_OWN}again[0], **{_OWN}again[1])",
    ]
    return "\n".join(lines)


def _closed(*args: Any, **kwargs: Any) -> Any:
    """The body of a door that nobody has come through yet."""
    return _door_open_up()(*args, **kwargs)  # type: ignore[name-defined]  # noqa: F821


def doors(cls: C) -> C:
    """`door` for a class: its constructor, and its public methods unless they are marked already.

    Methods that take nothing have nothing to check.
    """
    for name, member in list(vars(cls).items()):
        if isinstance(member, classmethod | staticmethod) and not name.startswith("_"):
            if not hasattr(member.__func__, "__wrapped__"):
                setattr(cls, name, type(member)(door(member.__func__)))
        elif (
            inspect.isfunction(member)
            and not hasattr(member, "__wrapped__")
            and (name in ("__init__", "__new__") or not name.startswith("_"))
            and inspect.get_annotations(member).keys() - {"return"}
        ):
            setattr(cls, name, door(member))
    return cls


def _defaults(call: Callable[..., Any]) -> dict[str, Any]:
    """The defaults of parameters; those of a dataclass's fields may be of any kind."""
    code = call.__code__  # type: ignore[attr-defined]
    values = call.__defaults__ or ()  # type: ignore[attr-defined]
    names = code.co_varnames[code.co_argcount - len(values) : code.co_argcount]
    return {**dict(zip(names, values, strict=True)), **(call.__kwdefaults__ or {})}  # type: ignore[attr-defined]


def _refused(name: str, kind: _Kind, value: object) -> InvalidInputError:
    return InvalidInputError(f"{name}: expected {kind.words}, got {shown(value)}")


def _read(
    call: Callable[..., Any],
    names: Sequence[str],
    args: Sequence[Any],
    kwargs: Mapping[str, Any],
    error: Exception,
) -> tuple[list[Any], dict[str, Any]] | None:
    """The arguments with arrays in place of sequences; None where that changes nothing.

    Raises:
        InvalidInputError: One does not fit.
    """
    kinds, defaults = _kinds(call, True), _defaults(call)
    changed = False

    def fitting(name: str, value: Any) -> Any:
        nonlocal changed
        if name not in kinds or value is defaults.get(name, _MISFIT):
            return value
        read = kinds[name].read(value)
        if read is _MISFIT:
            raise _refused(name, kinds[name], value) from error
        changed = changed or read is not value
        return read

    rest = len(args) - len(names)  # of *args
    read_args = [fitting(n, v) for n, v in zip(names, args, strict=False)]
    read_args += args[len(args) - rest :] if rest > 0 else []
    read_kwargs = {n: fitting(n, v) for n, v in kwargs.items()}
    return (read_args, read_kwargs) if changed else None


def _kinds(call: Callable[..., Any], thorough: bool) -> dict[str, _Kind]:
    """What each parameter asks for, by its annotation; names that nothing has imported, if ``thorough``."""
    found: dict[str, _Kind] = {}
    for name, annotation in inspect.get_annotations(call).items():
        if name == "return":
            continue
        try:
            hint = _resolved(annotation, call, thorough)
        except Exception:
            continue
        kind = _kind(hint)
        if kind is not None:
            found[name] = kind
    return found


class _Names(dict[str, Any]):
    """The names that annotations use: those of the module, and public ones that it imports for types only."""

    def __init__(self, module: dict[str, Any], thorough: bool) -> None:
        super().__init__()
        self._module, self._thorough = module, thorough

    def __missing__(self, name: str) -> Any:
        if name in self._module:
            return self._module[name]
        if hasattr(builtins, name):
            return getattr(builtins, name)
        package = sys.modules.get(__package__ or "guided_gym")
        home = getattr(package, "_HOME", {}).get(name)
        if home is None or not (self._thorough or f"{__package__}.{home}" in sys.modules):
            raise NameError(name)
        return getattr(importlib.import_module(f"{__package__}.{home}"), name)


def _resolved(annotation: Any, call: Callable[..., Any], thorough: bool) -> Any:
    if not isinstance(annotation, str):
        return annotation
    module = getattr(inspect.unwrap(call), "__globals__", {})
    return eval(annotation, {}, _Names(module, thorough))


def _kind(hint: Any) -> _Kind | None:
    """What an annotation asks for; None for anything."""
    if hint is None or hint is type(None):
        return _Kind(lambda value: None if value is None else _MISFIT, "None", (type(None),))
    if isinstance(hint, TypeVar):
        return _kind(hint.__bound__) if hint.__bound__ is not None else None
    if isinstance(hint, type) and hint in _PLAIN:
        return _PLAIN[hint]
    if hint is npt.ArrayLike or hint == npt.ArrayLike:
        return _Kind(_array_like, "an array of numbers")
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is not None:
        return _generic(origin, arguments)
    if not isinstance(hint, type) or hint in (object, Any):  # Any is a class since Python 3.11
        return None
    if getattr(hint, "_is_protocol", False):
        return _protocol(hint)
    # Others than ours are left to the function first: it may take more than it says.
    ours = hint.__module__.partition(".")[0] == (__package__ or "").partition(".")[0]
    return _Kind(_of(hint), _an(hint.__name__), (hint,) if ours else ())


def _generic(origin: Any, arguments: tuple[Any, ...]) -> _Kind | None:
    if origin in (Union, types.UnionType):
        return _union(arguments)
    if origin is Literal:
        words = " or ".join(map(repr, arguments))
        return _Kind(lambda value: value if _is_one_of(value, arguments) else _MISFIT, words)
    if origin is collections.abc.Callable:
        return _Kind(lambda value: value if callable(value) else _MISFIT, "a function")
    if origin is np.ndarray:
        return _Kind(_array, "an array of numbers")
    if origin is type:
        return _Kind(_of(type), "a class", (type,))
    if not isinstance(origin, type):
        return None
    if issubclass(origin, Mapping):
        return _mapping(arguments)
    if origin is tuple and not (len(arguments) == 2 and arguments[1] is Ellipsis):
        return _tuple(arguments)
    if issubclass(origin, collections.abc.Iterable):
        return _sequence(origin, arguments[0] if arguments else Any)
    return _kind(origin)


def _union(arguments: tuple[Any, ...]) -> _Kind | None:
    if {str, Path} <= set(arguments):  # no system has paths with a NUL
        others = [argument for argument in arguments if argument not in (str, Path)]
        return _either([_PATH, *map(_kind, others)])
    return _either([_kind(argument) for argument in arguments])


def _either(kinds: list[_Kind | None]) -> _Kind | None:
    known = [kind for kind in kinds if kind is not None]
    if len(known) < len(kinds):
        return None

    def read(value: Any) -> Any:
        others = [found for kind in known if (found := kind.read(value)) is not _MISFIT]
        as_is = [found for found in others if found is value]
        return (as_is or others or [_MISFIT])[0]

    words = [kind.words for kind in known if kind.words != "None" or len(known) == 1]
    said = ", ".join(words[:-1]) + f" or {words[-1]}" if len(words) > 1 else words[0]
    every = all(kind.classes for kind in known)
    return _Kind(read, said, tuple(one for kind in known for one in kind.classes) if every else ())


def _protocol(hint: Any) -> _Kind:
    """Anything with certain methods; a class that has them is no such thing itself."""
    wanted = {
        name
        for base in hint.__mro__
        if getattr(base, "_is_protocol", False)
        for name, member in vars(base).items()  # methods: attributes may not be there yet
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property))
    }

    def read(value: Any) -> Any:
        fits = not isinstance(value, type) and all(hasattr(value, name) for name in wanted)
        return value if fits else _MISFIT

    return _Kind(read, f"something with {', '.join(sorted(wanted))}")


def _mapping(arguments: tuple[Any, ...]) -> _Kind:
    of = _kind(arguments[1]) if len(arguments) > 1 else None

    def read(value: Any) -> Any:
        if not isinstance(value, Mapping):
            return _MISFIT
        fits = of is None or all(of.read(one) is not _MISFIT for one in value.values())
        return value if fits else _MISFIT

    return _Kind(read, "a mapping" if of is None else f"a mapping to {of.words}")


def _sequence(origin: type, argument: Any) -> _Kind:
    of = _kind(argument)

    def read(value: Any) -> Any:
        if isinstance(value, str | bytes | bytearray | Mapping) or not isinstance(
            value, collections.abc.Iterable
        ):
            return _MISFIT
        if issubclass(origin, Sequence) and (not hasattr(value, "__len__") or isinstance(value, Set)):
            return _MISFIT
        if isinstance(value, np.ndarray) and not value.ndim:
            return _MISFIT
        if of is None or isinstance(value, collections.abc.Iterator):
            return value
        return value if all(of.read(one) is not _MISFIT for one in value) else _MISFIT

    return _Kind(read, "a sequence" if of is None else f"a sequence, each {of.words}")


def _tuple(arguments: tuple[Any, ...]) -> _Kind:
    kinds = [_kind(argument) for argument in arguments]

    def read(value: Any) -> Any:
        if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str | bytes):
            return _MISFIT
        if isinstance(value, np.ndarray) and not value.ndim:
            return _MISFIT
        fits = len(value) == len(kinds) and all(
            kind is None or kind.read(one) is not _MISFIT for kind, one in zip(kinds, value, strict=True)
        )
        return value if fits else _MISFIT

    return _Kind(read, f"{len(kinds)} values")


def _is_one_of(value: Any, allowed: tuple[Any, ...]) -> bool:
    return any(type(value) is type(one) and value == one for one in allowed)


def _array(value: Any) -> Any:
    """An array of numbers as it is, a sequence of them as one; text and booleans are none."""
    if isinstance(value, np.ndarray):
        return value if value.dtype.kind in "iufb" and value.ndim else _MISFIT
    if not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray):
        return _MISFIT
    try:
        array = np.asarray(value)
        return array.astype(np.float64) if array.dtype.kind in "iuf" else _MISFIT
    except (TypeError, ValueError, OverflowError):
        return _MISFIT


def _array_like(value: Any) -> Any:
    """Whatever makes an array of numbers, as it is."""
    return value if _number(value) is not _MISFIT or _array(value) is not _MISFIT else _MISFIT


def _integer(value: Any) -> Any:
    fits = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return value if fits and int(value).bit_length() <= _MOST_BITS else _MISFIT


def _number(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return value
    return _integer(value)


def _real(value: Any) -> Any:
    """A number; integers that no array of numpy holds as such become floats."""
    read = _number(value)
    try:
        return float(read) if isinstance(read, int) and read.bit_length() > 63 else read
    except OverflowError:
        return _MISFIT


def _of(*classes: type) -> Reader:
    return lambda value: value if isinstance(value, classes) else _MISFIT


def _an(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOUaeiou' else 'a'} {noun}"


def _path(value: Any) -> Any:
    fits = isinstance(value, str | os.PathLike) and "\0" not in str(value)
    return value if fits else _MISFIT


_PATH: Final = _Kind(_path, "a path")
_PLAIN: Final[dict[Any, _Kind]] = {
    bool: _Kind(_of(bool, np.bool_), "True or False"),
    int: _Kind(_integer, "an integer"),
    float: _Kind(_real, "a number"),
    str: _Kind(_of(str), "text"),
    bytes: _Kind(_of(bytes), "bytes"),
    Path: _Kind(_of(os.PathLike), "a path"),
    list: _Kind(_of(list), "a list"),
    dict: _Kind(_of(dict), "a dictionary"),
    np.ndarray: _Kind(_array, "an array of numbers"),
    np.random.Generator: _Kind(_of(np.random.Generator), "a numpy.random.Generator", (np.random.Generator,)),
}
