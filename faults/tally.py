"""What a part of the campaign counts: promises, how often each was tried, and where it failed."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import FrameType

LONGEST = 20.0  # seconds of processor time that one try may take


@dataclass
class Tally:
    """One promise.

    Attributes:
        kind: What was tried.
        promise: What has to hold.
        tried: How often it was tried.
        failures: Where it did not hold: enough to try it again.
        note: Why nothing was tried, if nothing was.
        seconds: How long it took.
    """

    kind: str
    promise: str
    tried: int = 0
    failures: list[str] = field(default_factory=list)
    note: str = ""
    seconds: float = 0.0

    def check(self, holds: bool, where: str) -> None:
        """One try."""
        self.tried += 1
        if not holds:
            self.failures.append(" ".join(where.split())[:300])

    @contextlib.contextmanager
    def timed(self) -> Iterator[Tally]:
        """Count the time that passes inside."""
        began = time.perf_counter()
        try:
            yield self
        finally:
            self.seconds += time.perf_counter() - began


class Overtime(BaseException):
    """A try took longer than `LONGEST`."""


@contextlib.contextmanager
def limited(seconds: float = LONGEST) -> Iterator[None]:
    """Raise `Overtime` in what takes so much processor time, or six times as long by the clock.

    Where the system has such alarms. A busy machine is no fault; a wait without end is one.
    """

    def ring(number: int, frame: FrameType | None) -> None:
        raise Overtime

    if not hasattr(signal, "SIGPROF"):
        yield
        return
    clocks = ((signal.SIGPROF, signal.ITIMER_PROF, 1), (signal.SIGALRM, signal.ITIMER_REAL, 6))
    before = [(number, clock, signal.signal(number, ring)) for number, clock, _ in clocks]
    running = [signal.setitimer(clock, times * seconds) for _, clock, times in clocks]
    try:
        yield
    finally:
        for (number, clock, handler), timer in zip(before, running, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, handler)
            signal.setitimer(clock, *timer)  # such as the one that limits a test
