"""Learning curves from the cards of runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned import weights
from guided_gym.train.cli import app
from guided_gym.train.curves import learning_curves, read_runs, references


def run_folder(folder: Path, **training: object) -> Path:
    """A finished run of PPO as far as its card goes."""
    history = [
        {"steps": steps, "seconds": 1.0, "solved": 1.0, "samples": 10.0, "total_efficiency": se}
        for steps, se in ((0, 80.0), (1000, 20.0))
    ]
    options = {"method": "ppo", "environments": ["Cup"], "validation": 2, "max_samples": 60, **training}
    card = {
        "name": folder.name,
        "package_version": "0",
        "field": {},
        "scorer": {},
        "training": options,
        "metrics": {"history": history, "validation": history[-1]},
    }
    weights.save_agent(folder / "agent", card, {})
    return folder


def test_each_run_is_a_line_and_each_reference_a_level(tmp_path: Path) -> None:
    cards = read_runs([run_folder(tmp_path / "a"), run_folder(tmp_path / "b")])
    levels = references(cards[0], ["goal_distance", "wavefront"])
    assert levels["wavefront"]["solved"] == 1.0
    total, per_sample = learning_curves(cards, levels).axes
    assert [list(line.get_ydata()) for line in total.lines[:2]] == [[80.0, 20.0]] * 2
    assert list(per_sample.lines[0].get_ydata()) == [8.0, 2.0]
    assert total.lines[3].get_ydata()[0] == levels["wavefront"]["total_efficiency"]


def test_runs_that_do_not_compare_are_refused(tmp_path: Path) -> None:
    first = run_folder(tmp_path / "a")
    with pytest.raises(InvalidInputError, match="at least one"):
        read_runs([])
    with pytest.raises(InvalidInputError, match="cannot be compared"):
        read_runs([first, run_folder(tmp_path / "b", validation=3)])
    with pytest.raises(InvalidInputError, match="train ppo or train hybrid"):
        read_runs([run_folder(tmp_path / "c", method="imitation")])


def test_the_command_writes_the_figure(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "a")
    figure = tmp_path / "curves.svg"
    done = CliRunner().invoke(app, ["train", "curves", str(run), "--out", str(figure)])
    assert done.exit_code == 0, done.output
    assert figure.stat().st_size > 1000
    assert str(figure) in done.output.replace("\n", "")
