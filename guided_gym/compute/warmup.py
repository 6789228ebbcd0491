"""A word to whoever waits while the kernels compile for the first time on a machine."""

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


class CompilationNotice(event.Listener):
    """Prints `MESSAGE` on stderr, once per process, when our kernels have compiled for `PATIENCE` seconds.

    numba starts this event only for a function that is not in its cache, so a warm cache stays silent.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._spent = 0.0
        self._began = 0.0
        self._timer: threading.Timer | None = None
        self.given = False

    def on_start(self, event: Any) -> None:
        """A function starts to compile; those that it calls compile within it."""
        if self.given or not _ours(event):
            return
        self._depth += 1
        if self._depth == 1:
            self._began = time.monotonic()
            self._timer = threading.Timer(max(0.0, PATIENCE - self._spent), self._give)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:
        """A function has compiled."""
        if self._depth == 0 or not _ours(event):
            return
        self._depth -= 1
        if self._depth == 0 and self._timer is not None:
            self._timer.cancel()
            self._spent += time.monotonic() - self._began

    def _give(self) -> None:
        if not self.given:
            self.given = True
            print(MESSAGE, file=sys.stderr, flush=True)


def _ours(event: Any) -> bool:
    dispatcher = (event.data or {}).get("dispatcher")
    function = getattr(dispatcher, "py_func", None)
    return str(getattr(function, "__module__", "")).startswith("guided_gym.")


_notice: CompilationNotice | None = None


def announce_compilation() -> None:
    """Have a notice printed when our kernels take long to compile; a second call changes nothing."""
    global _notice
    if _notice is None:
        _notice = CompilationNotice()
        event.register("numba:compile", _notice)  # type: ignore[no-untyped-call]
