"""Hashes of the user's code that a run depends on: results of code that was edited since are computed anew.

The package's own code counts as a whole, elsewhere. Of yours count the modules that define the classes and
functions behind a name (those of base classes too), and the modules of yours that they import. Each counts by
its source and by what is loaded of it, which differ where a file was edited and not loaded again. What is
defined in a script or a notebook has no module that could be imported: it counts by its bytecode, with the
defaults, closures and global names that it uses.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import inspect
import itertools
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, Final

import numpy as np

from guided_gym.guidance.base import GuidingSpace
from guided_gym.problems import Problem

_OURS: Final = "guided_gym"
_DEEPEST: Final = 12  # values within values that are looked at
# Where what was installed lies: it has versions, and does not change from one run to the next.
_PLACES: Final = frozenset(
    str(Path(sysconfig.get_paths()[kind]).resolve())
    for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)
_FOLDERS: Final = frozenset(("site-packages", "dist-packages"))


def code_identity(things: Iterable[Any]) -> dict[str, str]:
    """Hashes of the user's code behind classes, functions and instances.

    Returns:
        Name of a module, or of a class or function of a script, to its hash; empty if all is the package's.
    """
    seen = _Seen()
    for thing in things:
        seen.visit(thing)
    return dict(sorted(seen.found.items()))


def value_identity(value: Any) -> str:
    """A hash of a value's content: numbers, text, arrays, containers, and objects by what they hold."""
    return _hash(_Seen().value(value))


def problem_identity(problem: Problem) -> str:
    """A hash of a problem and of the regions by which its figures are split."""
    regions = sorted((name, region.wkb) for name, region in problem.regions.items())
    return _hash(problem.fingerprint, *itertools.chain.from_iterable(regions))


def _hash(*parts: str | bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()[:16]


class _Seen:
    """A walk over code, each part of it once.

    Attributes:
        found: What `code_identity` returns.
    """

    def __init__(self) -> None:
        self.found: dict[str, str] = {}
        self._visited: set[int] = set()
        self._kept: list[Any] = []  # so that no identity is given twice

    def visit(self, thing: Any, depth: int = 0) -> None:
        """Note the code behind a class, a function, or an instance and what it holds."""
        thing = getattr(thing, "py_func", thing)  # what numba compiled
        if id(thing) in self._visited or depth > _DEEPEST:
            return
        self._visited.add(id(thing))
        self._kept.append(thing)
        if isinstance(thing, functools.partial | functools.partialmethod):
            self.visit(thing.func, depth)
            self._note(_title(thing.func), self.value((thing.args, thing.keywords), depth + 1))
        elif isinstance(thing, MethodType):
            self.visit(thing.__func__, depth)
            self.visit(thing.__self__, depth)
        elif isinstance(thing, type):
            for base in thing.__mro__:
                self._class(base, depth)
        elif isinstance(thing, FunctionType):
            self._function(thing, depth)
        elif isinstance(thing, ModuleType):
            self._module(thing.__name__)
        elif not isinstance(thing, str | bytes | int | float | complex | None | np.ndarray):
            self.visit(type(thing), depth)
            if isinstance(thing, Problem):  # counts by its fingerprint
                return
            for inner in _held(thing):
                if callable(inner) or _yours(type(inner)) or _holds(inner):
                    self.visit(inner, depth + 1)

    def _class(self, cls: type, depth: int) -> None:
        if not _yours(cls):
            return
        if _importable(cls.__module__):
            self._module(cls.__module__)
            if "<locals>" in cls.__qualname__:  # of a function that may have made it of anything
                for member in vars(cls).values():
                    if isinstance(member, FunctionType) and (held := self._extras(member, depth)):
                        self._note(_title(member), *held)
            return
        members = {name: value for name, value in vars(cls).items() if name not in _NOT_CODE}
        self._note(
            _title(cls), *(f"{name}={self.value(members[name], depth + 1)}" for name in sorted(members))
        )

    def _function(self, function: FunctionType, depth: int) -> None:
        if not _yours(function):
            function = inspect.unwrap(function)  # a door of the package holds nothing of yours
        yours, title = _yours(function), _title(function)
        if not yours or _importable(function.__module__):
            if yours:
                self._module(function.__module__)
            # A function of the package that made another, such as a recipe, was given something by you.
            held = self._extras(function, depth) if yours or function.__closure__ else []
            if held:
                self._note(title, *held)
            return
        self._note(title, self._code(function.__code__), *self._extras(function, depth))
        for name in _names(function.__code__):
            if name in function.__globals__:
                value = function.__globals__[name]
                self._note(f"{title}: {name}", self.value(value, depth + 1))

    def _extras(self, function: FunctionType, depth: int) -> list[str]:
        """What a function has besides its code: defaults, and what its closure holds."""
        cells = []
        for cell in function.__closure__ or ():
            try:
                cells.append(cell.cell_contents)
            except ValueError:  # not filled yet
                cells.append(None)
        parts = (function.__defaults__, function.__kwdefaults__, tuple(cells) or None)
        return [self.value(part, depth + 1) for part in parts if part]

    def _note(self, title: str, *parts: str) -> None:
        self.found[title] = _hash(self.found.get(title, ""), *parts)

    def value(self, value: Any, depth: int = 0) -> str:
        """A text that two values share only if they are alike, whatever process they are in."""
        if value is None or isinstance(value, str | bytes | int | float | complex | range | Path):
            return repr(value)
        if depth > _DEEPEST:
            return type(value).__qualname__
        if isinstance(value, np.ndarray):
            if value.dtype != object:
                return f"array {value.dtype} {value.shape} {_hash(np.ascontiguousarray(value).tobytes())}"
            value = value.tolist()
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, Mapping):
            return str(sorted((self.value(k, depth + 1), self.value(v, depth + 1)) for k, v in value.items()))
        if isinstance(value, list | tuple):
            return f"{type(value).__name__} {[self.value(item, depth + 1) for item in value]}"
        if isinstance(value, set | frozenset):
            return str(sorted(self.value(item, depth + 1) for item in value))
        if isinstance(value, staticmethod | classmethod | property):
            inner = (value.fget, value.fset, value.fdel) if isinstance(value, property) else value.__func__
            return f"{type(value).__name__} {self.value(inner, depth + 1)}"
        self.visit(value, depth)
        if isinstance(value, type | FunctionType | ModuleType | MethodType):
            return _title(value)
        fingerprint = getattr(value, "fingerprint", None)
        if isinstance(fingerprint, str):
            return fingerprint
        if isinstance(value, GuidingSpace) or not _holds(value) or id(value) in self._inside:
            return _title(type(value))
        self._inside.add(id(value))
        try:
            return f"{_title(type(value))} {self.value(_state(value), depth + 1)}"
        finally:
            self._inside.discard(id(value))

    @functools.cached_property
    def _inside(self) -> set[int]:
        return set()

    def _code(self, code: CodeType) -> str:
        """Bytecode without the places that it came from."""
        constants = [self.value(constant) for constant in code.co_consts]
        head = (
            code.co_name,
            code.co_argcount,
            code.co_kwonlyargcount,
            code.co_posonlyargcount,
            code.co_flags,
        )
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        return _hash(code.co_code, repr(head), repr(names), *constants)

    def _module(self, name: str) -> None:
        """Take note of a module of yours, of the packages that it is in, and of those that it imports."""
        if name in self.found or not _yours_by_name(name):
            return
        module = sys.modules.get(name)
        source = _source(name)
        if module is None and source is None:
            return
        self.found[name] = ""
        loaded = sorted(self._loaded(module)) if module is not None else []
        self.found[name] = _hash(source or b"", *loaded)
        for imported in {*_imports(name, module, source), name.rpartition(".")[0]}:
            if imported and _of_yours(imported, name):
                self._module(imported)

    def _loaded(self, module: ModuleType) -> Iterator[str]:
        """The code of the functions and classes that a module defines."""
        for name, thing in list(vars(module).items()):
            thing = inspect.unwrap(getattr(thing, "py_func", thing)) if callable(thing) else thing
            if getattr(thing, "__module__", None) != module.__name__:
                continue
            members = vars(thing).items() if isinstance(thing, type) else [(name, thing)]
            for member, function in list(members):
                function = getattr(function, "__func__", getattr(function, "fget", function))
                if isinstance(function, FunctionType):
                    yield f"{name}.{member} {self._code(function.__code__)}"


_NOT_CODE: Final = ("__dict__", "__weakref__", "__doc__", "__module__", "__firstlineno__", "_abc_impl")


def _title(thing: Any) -> str:
    name = getattr(thing, "__qualname__", None) or getattr(thing, "__name__", type(thing).__qualname__)
    return f"{getattr(thing, '__module__', '')}:{name}"


def _yours(thing: Any) -> bool:
    return _yours_by_name(str(getattr(thing, "__module__", None) or ""))


def _yours_by_name(module: str) -> bool:
    top = module.partition(".")[0]
    return top == "__main__" or (
        top != _OURS and top not in sys.stdlib_module_names and top not in _LIBRARIES
    )


_LIBRARIES: Final = frozenset(
    (
        "numpy",
        "scipy",
        "shapely",
        "numba",
        "gymnasium",
        "networkx",
        "matplotlib",
        "torch",
        "stable_baselines3",
    )
)


def _importable(module: str) -> bool:
    """Whether a module has a file, by which it counts."""
    return module not in ("__main__", "__mp_main__") and _source(module) is not None


def _file(name: str) -> Path | None:
    """The file of a module, whether it is loaded or not."""
    module = sys.modules.get(name)
    if module is not None:
        file = getattr(module, "__file__", None)
        return Path(file) if file else None
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, AttributeError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin and spec.has_location else None


def _source(name: str) -> bytes | None:
    """What the file of a module says; None if there is none."""
    file = _file(name)
    try:
        return file.read_bytes() if file is not None else None
    except OSError:
        return None


def _of_yours(imported: str, by: str) -> bool:
    """Whether an imported module may change: one of the same package, or not among what is installed."""
    if not _yours_by_name(imported):
        return False
    if imported.partition(".")[0] == by.partition(".")[0]:
        return True
    file = _file(imported)
    if file is None:
        return False
    parents = file.resolve().parents
    return _PLACES.isdisjoint(map(str, parents)) and _FOLDERS.isdisjoint(parent.name for parent in parents)


def _imports(name: str, module: ModuleType | None, source: bytes | None) -> Iterator[str]:
    """Names of modules that a module imports, anywhere in it, and of those that its names come from."""
    for thing in list(vars(module).values()) if module is not None else ():
        if isinstance(thing, ModuleType):
            yield thing.__name__
        elif isinstance(thing, type | FunctionType):
            yield thing.__module__
    try:
        tree = ast.parse(source or b"")
    except (SyntaxError, ValueError):
        return
    package = name if getattr(module, "__path__", None) is not None else name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            try:
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:
                continue
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _names(code: CodeType) -> list[str]:
    """The global names and attributes that a piece of code mentions, nested ones too."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names.update(_names(constant))
    return sorted(names)


def _state(thing: Any) -> dict[str, Any]:
    if is_dataclass(thing) and not isinstance(thing, type):
        return {field.name: getattr(thing, field.name, None) for field in fields(thing)}
    return dict(getattr(thing, "__dict__", {}))


def _holds(thing: Any) -> bool:
    return bool(getattr(thing, "__dict__", None)) or is_dataclass(thing)


def _held(thing: Any) -> list[Any]:
    """What an instance holds, and what is in its lists."""
    held: list[Any] = []
    for value in _state(thing).values():
        held += list(value) if isinstance(value, list | tuple) else [value]
    return held
