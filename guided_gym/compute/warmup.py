"""Kernels that compile for the first time on a machine: a notice for who waits, and clocks that leave it out.

What a search takes is not what the first one in a process took: by `wall_seconds` and `processor_seconds`,
kernels are compiled, or loaded, in no time.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Final

from numba.core import event

PATIENCE: Final = 1.0  # seconds of compilation before something is said
MESSAGE: Final = (
    "guided-gym: compiling kernels for first use (half a minute or so of processor time; kept where that is "
    "possible, `guided-gym warmup` does it beforehand) ..."
)


class KernelClock:
    """Adds up what kernels take to be compiled or loaded; what begins within another is counted once.

    Attributes:
        seconds: Wall time.
        processor: Processor time.
        depth: How many are at it, each within the one before.
    """

    def __init__(self) -> None:
        self.seconds = self.processor = 0.0
        self.depth = 0
        self._began = 0.0, 0.0

    def begin(self) -> None:
        """From here on."""
        self.depth += 1
        if self.depth == 1:
            self._began = time.perf_counter(), time.process_time()

    def end(self) -> None:
        """Up to here."""
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.perf_counter() - self._began[0]
            self.processor += time.process_time() - self._began[1]

    def __enter__(self) -> None:
        self.begin()

    def __exit__(self, *error: object) -> None:
        self.end()


class CompilationNotice(event.Listener):
    """Prints `MESSAGE` on stderr, once per process, when our kernels have compiled for `PATIENCE` seconds.

    numba starts this event only for a function that is not in its cache, so a warm cache stays silent.

    Attributes:
        given: Whether it was printed.
        clock: Counts the time that kernels have taken, those that were loaded included.
    """

    def __init__(self) -> None:
        self.given = False
        self.clock = KernelClock()
        self._compiling = KernelClock()
        self._timer: threading.Timer | None = None

    def on_start(self, event: Any) -> None:
        """A function starts to compile; those that it calls compile within it."""
        if not _ours(event):
            return
        self.clock.begin()
        self._compiling.begin()
        if self._compiling.depth == 1 and not self.given:
            self._timer = threading.Timer(max(0.0, PATIENCE - self._compiling.seconds), self._give)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:
        """A function has compiled."""
        if self._compiling.depth == 0 or not _ours(event):
            return
        self._compiling.end()
        self.clock.end()
        if self._compiling.depth == 0 and self._timer is not None:
            self._timer.cancel()

    def _give(self) -> None:
        if not self.given:
            self.given = True
            print(MESSAGE, file=sys.stderr, flush=True)


def _ours(event: Any) -> bool:
    dispatcher = (event.data or {}).get("dispatcher")
    function = getattr(dispatcher, "py_func", None)
    return str(getattr(function, "__module__", "")).startswith("guided_gym.")


_notice: Final = CompilationNotice()
kernel_clock: Final = _notice.clock
_listens = False


def announce_compilation() -> None:
    """Have a notice printed when our kernels take long to compile; a second call changes nothing."""
    global _listens
    if not _listens:
        _listens = True
        event.register("numba:compile", _notice)  # type: ignore[no-untyped-call]


def wall_seconds() -> float:
    """Seconds since some moment, without those that kernels have taken."""
    return time.perf_counter() - kernel_clock.seconds


def processor_seconds() -> float:
    """Processor seconds of this process, without those that kernels have taken."""
    return time.process_time() - kernel_clock.processor
