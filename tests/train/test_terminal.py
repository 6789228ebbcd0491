"""How long jobs say how far they are: a bar on a terminal, lines elsewhere, nothing of short ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from guided_gym.errors import InvalidInputError
from guided_gym.train import terminal
from guided_gym.train.terminal import LINE_SECONDS, Terminated, drawing_status, progress_bar


class Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(terminal, "monotonic", clock)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    return clock


def work(clock: Clock, seconds: float, steps: int = 10) -> None:
    with progress_bar("Working", Path("here")) as progress:
        for i in range(steps):
            clock.now += seconds / steps
            progress(i + 1, steps)


def test_progress__of_a_short_job_is_silent(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    work(clock, LINE_SECONDS - 1)
    assert capsys.readouterr() == ("", "")


def test_progress__without_a_terminal_is_a_line_now_and_then_and_at_the_end(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    work(clock, 2.5 * LINE_SECONDS)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "guided-gym: Working: 4 of 10 (10 s)",
        "guided-gym: Working: 8 of 10 (20 s)",
        "guided-gym: Working: 10 of 10 (25 s)",
    ]


def test_progress__is_not_said_twice(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    work(clock, LINE_SECONDS, steps=1)
    assert capsys.readouterr().err == "guided-gym: Working: 1 of 1 (10 s)\n"


def test_progress__says_nothing_more_after_an_error(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidInputError), progress_bar("Working", Path("here")) as progress:
        clock.now += LINE_SECONDS
        progress(1, 3, "Thinking")
        raise InvalidInputError("no")
    assert capsys.readouterr().err == "guided-gym: Thinking: 1 of 3 (10 s)\n"


def test_progress__interrupted_says_what_is_kept(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit), progress_bar("Working", Path("here")) as progress:
        progress(1, 3)
        raise KeyboardInterrupt
    assert "1 of 3 are kept in here" in capsys.readouterr().err


def test_progress__on_a_terminal_is_a_bar(
    clock: Clock, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    work(clock, 10 * LINE_SECONDS)
    err = capsys.readouterr().err
    assert "10/10" in err
    assert "guided-gym: Working" not in err


def test_drawing__without_a_terminal_is_a_line_now_and_then(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    with drawing_status(True) as drawn:
        for name in ("one", "two", "three"):
            clock.now += 0.6 * LINE_SECONDS
            drawn(name)
    assert capsys.readouterr().err == "guided-gym: Drawing; two is done (12 s)\n"


@pytest.mark.parametrize(("kind", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
def test_an_interruption_in_compiled_code_is_one(
    kind: type[KeyboardInterrupt], code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """There, Python makes it the cause of a SystemError."""
    with pytest.raises(SystemExit) as ended, progress_bar("work", tmp_path) as progress:
        progress(3, 7)
        try:
            raise kind
        except KeyboardInterrupt as error:
            raise SystemError("a kernel returned a result with an exception set") from error
    assert ended.value.code == code
    assert "3 of 7 are kept in" in capsys.readouterr().err


def test_another_system_error_stays_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(SystemError, match="broken"), progress_bar("work", tmp_path):
        raise SystemError("broken")
