"""What the commands print on: a console, and the progress of long jobs."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars

EXIT_INTERRUPTED: Final = 130
EXIT_TERMINATED: Final = 143
WIDE: Final = 140  # columns of a table in a file
LINE_SECONDS: Final = 10.0  # between two lines of progress where no bar can be drawn

Progress = Callable[[int, int, str], None]
"""What a long job calls with (done, total, what is going on)."""


class Terminated(KeyboardInterrupt):
    """SIGTERM: ends a command as Ctrl-C does, so that its workers end, too, and leave nothing behind."""


def end_on_sigterm() -> None:
    """Have SIGTERM raise `Terminated` from now on; by default the process would end without cleaning up."""

    def terminated(number: int, frame: object) -> None:
        raise Terminated

    signal.signal(signal.SIGTERM, terminated)


@contextlib.contextmanager
def interruptions() -> Iterator[None]:
    """Raise an interruption that came while compiled code ran, where it is the cause of a SystemError."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from None
        raise


def exit_code(error: KeyboardInterrupt) -> int:
    """The exit code of a command that was stopped."""
    return EXIT_TERMINATED if isinstance(error, Terminated) else EXIT_INTERRUPTED


def console(stderr: bool = False) -> Console:
    """Rich's console; one wide enough for our tables where there is no window."""
    from rich.console import Console

    screen = Console(stderr=stderr, highlight=False)
    return screen if screen.is_terminal else Console(stderr=stderr, highlight=False, width=WIDE)


@contextlib.contextmanager
def progress_bar(title: str, place: Path) -> Iterator[Callable[..., None]]:
    """Show progress on stderr: a bar on a terminal, else lines; after Ctrl-C, what is done and how to go on.

    Yields:
        What to call with (done, total), or with (done, total, what is being done).
    """
    state = {"done": 0, "total": 0}
    screen = console(stderr=True)
    shown = _bar(title, screen) if screen.is_terminal else _lines(title)

    try:
        with shown as show, interruptions():

            def update(done: int, total: int, what: str = title) -> None:
                state.update(done=done, total=total)
                show(done, total, what)

            yield update
    except KeyboardInterrupt as error:
        done = f"{state['done']} of {state['total']} are kept in {place}"
        print(f"guided-gym: interrupted; {done}. The same command goes on from there.", file=sys.stderr)
        sys.exit(exit_code(error))


@contextlib.contextmanager
def drawing_status(shown: bool) -> Iterator[Callable[[str], None]]:
    """Says on stderr which figure is done."""
    screen = console(stderr=True)
    if not shown:
        yield lambda name: None
    elif screen.is_terminal:
        with screen.status("Drawing") as status:
            yield lambda name: status.update(f"Drawing; {name} is done")
    else:
        lines = Lines()
        yield lambda name: lines.now_and_then(f"Drawing; {name} is done")


class Lines:
    """Lines on stderr for a log: one now and then, so that a short job prints none."""

    def __init__(self) -> None:
        self._begun = self._said = monotonic()
        self._last = ""

    def now_and_then(self, text: str) -> None:
        """Print it if nothing was printed for `LINE_SECONDS`."""
        if monotonic() - self._said >= LINE_SECONDS:
            self._print(text)

    def at_the_end(self, text: str) -> None:
        """Print it if anything else was printed before."""
        if self._last not in ("", text):
            self._print(text)

    def _print(self, text: str) -> None:
        self._said, self._last = monotonic(), text
        print(f"guided-gym: {text} ({self._said - self._begun:.0f} s)", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _bar(title: str, screen: Console) -> Iterator[Callable[[int, int, str], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bars = Progress(*columns, console=screen)
    task = bars.add_task(title, total=None)

    def show(done: int, total: int, what: str) -> None:
        bars.update(task, completed=done, total=total, description=what)
        bars.start()  # not before: what can't work says so without a bar

    try:
        yield show
    finally:
        _stop(bars)


def _stop(bars: Bars) -> None:
    if bars.live.is_started:
        bars.stop()


@contextlib.contextmanager
def _lines(title: str) -> Iterator[Callable[[int, int, str], None]]:
    lines = Lines()
    last = title

    def show(done: int, total: int, what: str) -> None:
        nonlocal last
        last = f"{what}: {done} of {total}"
        lines.now_and_then(last)

    yield show
    lines.at_the_end(last)  # not after an error, which is the last line then


def named(progress: Progress | None, what: str) -> Callable[[int, int], None] | None:
    """One that is called with (done, total) alone, for a part of a job that has this name."""
    return None if progress is None else partial(_call, progress, what)


def _call(progress: Progress, what: str, done: int, total: int) -> None:
    progress(done, total, what)
