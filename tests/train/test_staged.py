"""What trainings in stages share: which weights are kept, and what makes one better than another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from guided_gym.errors import InvalidInputError  # noqa: E402
from guided_gym.guidance.learned.scored import ScoredGuidance  # noqa: E402
from guided_gym.train import staged  # noqa: E402
from guided_gym.train.staged import StagedConfig, StagedRun  # noqa: E402


@dataclass(frozen=True)
class Config(StagedConfig):
    environments: tuple[str, ...] = ("RandomSimplePassage",)


class Counted(StagedRun):
    """A run whose only weight is how often it was changed."""

    method = "counted"

    def __init__(self, config: StagedConfig, out: Path) -> None:
        super().__init__(config, out, None, {})
        self.weight = 0.0
        self.restore()

    def tensors(self) -> staged.Tensors:
        return {"weight": np.array([self.weight], np.float32)}

    def load(self, tensors: staged.Tensors) -> None:
        self.weight = float(tensors["weight"][0])

    def searcher(self, temperature: float = 0.0) -> ScoredGuidance:
        raise AssertionError("nothing is searched here")


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, float]]:
    """What the validations to come will find, and who is asked to expand in them."""
    coming: list[dict[str, float]] = []

    def validated(*given: Any, **options: Any) -> dict[str, float]:
        return coming.pop(0)

    monkeypatch.setattr(staged, "validated", validated)
    return coming


def found(total: float, best: float = 0.0, solved: float = 1.0) -> dict[str, float]:
    return {"solved": solved, "samples": 9.0, "total_efficiency": total, "best_possible": best}


def after(run: Counted, *stages: tuple[str, str, bool]) -> float:
    """The weight that is kept after a change before each validation."""
    for kind, stage, always in stages:
        run.weight += 1.0
        run.consider(stage, None, kind, always)  # type: ignore[arg-type]
    return float(run.best["weight"][0])


def test_the_best_of_a_kind_is_kept_whatever_another_kind_reached(
    figures: list[dict[str, float]], tmp_path: Path
) -> None:
    figures += [found(5), found(9), found(100), found(80), found(90)]
    run = Counted(Config(), tmp_path / "run")
    stages = [("best", "a", False), ("best", "b", True), *[("scored", name, False) for name in "cde"]]
    assert after(run, *stages) == 4.0  # d: the best scorer, though a and b searched better without one
    assert run.state["best"]["stage"] == "b"  # what follows builds on it
    assert run.state["scored"]["stage"] == "d"
    assert [row["what"] for row in run.state["history"]][-1] == "validation after e"


def test_more_solved_comes_first(figures: list[dict[str, float]], tmp_path: Path) -> None:
    figures += [found(5, solved=0.5), found(50, solved=0.75)]
    assert after(Counted(Config(), tmp_path / "run"), ("best", "a", False), ("best", "b", False)) == 2.0


@pytest.mark.parametrize(("selection", "kept"), [(False, 1.0), (True, 2.0)])
def test_under_selection_less_excess_is_better(
    figures: list[dict[str, float]], tmp_path: Path, selection: bool, kept: float
) -> None:
    figures += [found(100, best=10), found(110, best=60)]
    run = Counted(Config(selection=selection), tmp_path / "run")
    assert after(run, ("best", "a", False), ("best", "b", False)) == kept


def test_a_run_goes_on_from_its_checkpoint(figures: list[dict[str, float]], tmp_path: Path) -> None:
    figures += [found(5), found(7)]
    run = Counted(Config(), tmp_path / "run")
    after(run, ("best", "a", False))
    run.weight = 8.0
    run.save()
    again = Counted(Config(), tmp_path / "run")
    assert (again.weight, again.best["weight"][0], again.state) == (8.0, 1.0, run.state)
    assert after(again, ("best", "b", False)) == 1.0


@pytest.mark.parametrize(
    "options",
    [{"environments": ()}, {"seed": -1}, {"searches": 0}, {"rounds": -1}, {"problems": 0}, {"validation": 0}],
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(options))):
        Config(**options)
