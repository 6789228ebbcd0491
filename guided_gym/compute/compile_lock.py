"""One process compiles a kernel while the others wait, and then load what it has kept."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Final, ParamSpec, TypeVar

from numba.core import caching, config, event

from guided_gym.compute.shipped_kernels import KERNELS, shipped_kernels, sources_stamp
from guided_gym.compute.warmup import kernel_clock

try:
    import fcntl as _fcntl
except ImportError:  # not on Windows: there, each process compiles for itself
    _fcntl = None  # type: ignore[assignment]

locks: ModuleType | None = _fcntl
NAME: Final = "guided-gym-compiling.lock"
PATIENCE: Final = 1.0  # seconds of waiting before something is said
MARK: Final = "guided_gym_vectorised"  # attribute of functions whose loops are to be vectorised
MESSAGE: Final = "guided-gym: waiting for another process that compiles kernels ..."


P = ParamSpec("P")
R = TypeVar("R")


def vectorised(kernel: Callable[P, R]) -> Callable[P, R]:
    """Mark a function, below its ``@njit``, as one whose loops are to be vectorised.

    For short loops over arrays without branches, in functions of their own: others hardly gain.
    """
    setattr(kernel, MARK, True)
    return kernel


class CompileLock(event.Listener):
    """A file lock around each compilation of a kernel that is not in numba's cache.

    It is taken when the cache has nothing, and the cache is asked again once it is held; it is let go when
    the kernel has been kept, or could not be compiled. What a kernel calls compiles within it. The lock is
    the operating system's, so it goes with the process that holds it.

    Meanwhile LLVM does not look for loops to vectorise, but in kernels that are marked as `vectorised`: it
    finds few in kernels that branch at every turn, and looking takes a third of the time. Nor is garbage
    looked for: a compiler makes many objects that live, and going through them takes a tenth.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._file: int | None = None
        self._vectorize: list[int] = []  # numba's own setting, and that for each kernel being compiled
        self._collected = False  # whether garbage was looked for before
        self._said = False

    def miss(self, folder: str, vectorise: bool = False) -> None:
        """The cache in this folder has nothing: wait for the lock, unless it is held already.

        Args:
            folder: Where the lock lies.
            vectorise: Whether to look for loops to vectorise in what is compiled.
        """
        self._depth += 1
        if self._depth == 1:
            self._vectorize = [config.LOOP_VECTORIZE]  # type: ignore[attr-defined]
        self._vectorize.append(self._vectorize[0] if vectorise else 0)
        config.LOOP_VECTORIZE = self._vectorize[-1]  # type: ignore[attr-defined]
        if self._depth == 1:
            self._file = self._acquired(Path(folder) / NAME)
            self._collected = gc.isenabled()
            gc.disable()

    def done(self) -> None:
        """A kernel was kept, was loaded after all, or could not be compiled."""
        self._depth -= 1
        if self._vectorize:
            self._vectorize.pop()
        if self._vectorize:
            config.LOOP_VECTORIZE = self._vectorize[-1]  # type: ignore[attr-defined]
        if self._depth > 0:
            return
        self._depth, self._vectorize = 0, []
        if self._collected:
            gc.enable()
            self._collected = False
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def on_start(self, event: Any) -> None:
        """Nothing: the cache was asked before."""

    def on_end(self, event: Any) -> None:
        """Let go where compilation failed: then nothing is kept."""
        dispatcher = (event.data or {}).get("dispatcher")
        # Not `is_failed`: in numba 0.68 it is True where there was no exception.
        if getattr(event, "_exc_details", None) is not None and _ours(getattr(dispatcher, "py_func", None)):
            self.done()

    def _acquired(self, path: Path) -> int | None:
        """The open file, locked; None where there can be no lock."""
        if locks is None:
            return None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
        except OSError:
            return None
        try:
            self._wait(file)
        except OSError:  # a file system without locks
            os.close(file)
            return None
        return file

    def _wait(self, file: int) -> None:
        assert locks is not None
        began = time.monotonic()
        while True:
            try:
                locks.flock(file, locks.LOCK_EX | locks.LOCK_NB)
                return
            except BlockingIOError:
                time.sleep(0.02)
            if time.monotonic() - began > PATIENCE and not self._said:
                self._said = True
                print(MESSAGE, file=sys.stderr, flush=True)


def _ours(function: object) -> bool:
    return str(getattr(function, "__module__", "")).startswith("guided_gym.")


_WRAPPED: Final = ("load_overload", "save_overload", "_index_key")
_lock: CompileLock | None = None


def share_compilation() -> None:
    """Have processes that compile our kernels wait for each other; a second call changes nothing.

    numba has no hook between a miss of its cache and compilation, so its cache's methods are wrapped, for our
    functions only; what it keeps is also told apart by the sources of all kernels, not by those of one file.
    What its cache has not got may have come with the wheel (`guided_gym.compute.shipped_kernels`).
    Where this version of numba has other methods, nothing is done.
    """
    global _lock
    if _lock is not None or not all(hasattr(caching.Cache, n) for n in _WRAPPED):
        return
    lock = _lock = CompileLock()
    load, save = caching.Cache.load_overload, caching.Cache.save_overload

    def shipped(self: Any, signature: Any, target: Any) -> Any:
        name, key = self._impl.filename_base, self._index_key(signature, target.codegen())
        kept = shipped_kernels().load(name, key)
        return None if kept is None else self._impl.rebuild(target, kept)

    def load_overload(self: Any, signature: Any, target: Any) -> Any:
        if not _ours(getattr(self, "_py_func", None)):
            return load(self, signature, target)  # type: ignore[no-untyped-call]
        with kernel_clock:
            found = load(self, signature, target)  # type: ignore[no-untyped-call]
            if found is None:
                found = shipped(self, signature, target)
            if found is None:
                lock.miss(str(self.cache_path), getattr(self._py_func, MARK, False))
                found = load(self, signature, target)  # type: ignore[no-untyped-call]
                if found is not None:
                    lock.done()
            return found

    def save_overload(self: Any, signature: Any, data: Any) -> None:
        try:
            with kernel_clock:
                save(self, signature, data)  # type: ignore[no-untyped-call]
        finally:
            if _ours(getattr(self, "_py_func", None)):
                lock.done()

    key, stamp = caching.Cache._index_key, sources_stamp(KERNELS)

    def index_key(self: Any, signature: Any, codegen: Any) -> Any:
        own = key(self, signature, codegen)  # type: ignore[no-untyped-call]
        return (*own, stamp) if _ours(getattr(self, "_py_func", None)) else own

    caching.Cache._index_key = index_key  # type: ignore[method-assign]
    caching.Cache.load_overload = load_overload  # type: ignore[method-assign]
    caching.Cache.save_overload = save_overload  # type: ignore[method-assign]
    event.register("numba:compile", lock)  # type: ignore[no-untyped-call]
