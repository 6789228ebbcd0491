"""Direct search for the numbers by which agents select: it learns, resumes, and refuses what it can't use."""

from __future__ import annotations

import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cmaes")

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.composed import AVOID
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedGuidance, fingerprint, guidance_class
from guided_gym.guidance.learned.folders import SHIPPED
from guided_gym.guidance.registry import make_guidance
from guided_gym.train import selection
from guided_gym.train.checkpoints import AGENT_FOLDER
from guided_gym.train.selection import SelectionConfig, train_selection
from guided_gym.train.validation import Found, rank

TINY = SelectionConfig(
    environments=("RandomSimplePassage",),
    agent="se2",
    problems=2,
    validation=2,
    generations=2,
    population=4,
    searches=1,
    max_samples=40,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("selection") / "run"
    train_selection(TINY, out)
    return out


def card_of(folder: Path) -> dict[str, Any]:
    card: dict[str, Any] = json.loads((folder / weights.CARD_FILE).read_text())
    return card


def test_the_better_numbers_on_validation_problems_are_what_the_agent_selects_by(finished: Path) -> None:
    card = card_of(finished / AGENT_FOLDER)
    judged = [row for row in card["metrics"]["history"] if "solved" in row]
    stages = ["nothing", "generation 2", "the best of generation 1", "the best of generation 2"]
    assert [row["what"] for row in judged] == [f"validation after {stage}" for stage in stages]
    assert card["metrics"]["validation"]["stage"] in stages
    least = min(judged, key=rank)
    assert card["metrics"]["validation"]["total_efficiency"] == least["total_efficiency"]
    guidance = make_guidance(f"learned:{finished / AGENT_FOLDER}")
    assert isinstance(guidance, LearnedGuidance)
    assert not guidance.scored
    assert guidance.detour == card["selection"]["detour"]
    assert guidance.expansion_penalty == card["selection"]["expansion_penalty"]
    assert guidance.lesson == replace(AVOID, foreseen=card["selection"]["foreseen"])


def test_the_weights_are_those_of_the_agent_before(finished: Path) -> None:
    before = weights.load_agent(SHIPPED / "se2")[1]
    after = weights.load_agent(finished / AGENT_FOLDER)[1]
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_a_run_that_was_stopped_goes_on_where_it_was(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, judge = tmp_path / "run", selection._Run._judge

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(selection._Run, "_judge", stop)
    with pytest.raises(KeyboardInterrupt):
        train_selection(TINY, out)
    monkeypatch.setattr(selection._Run, "_judge", judge)
    monkeypatch.setattr(selection._Run, "_try", stop)  # what was tried is not tried again
    card = train_selection(TINY, out)
    assert card["selection"] == card_of(finished / AGENT_FOLDER)["selection"]


def test_a_charge_for_each_search_without_an_end(tmp_path: Path) -> None:
    run = selection._Run(replace(TINY, environments=("Trap", "Cup")), tmp_path / "run", None)
    found = [Found(0, True, 9, 5.0, 3.0), Found(1, False, 40, 7.0, 6.0), Found(2, True, 9, 8.0, 2.0)]
    np.testing.assert_allclose(run._losses(found), [1 + (2 + 6) / 2, 1 + 1 + 40])


def test_candidates_search_with_what_they_stand_for(tmp_path: Path) -> None:
    run = selection._Run(TINY, tmp_path / "run", None)
    assert run.numbers(np.zeros(3)) == run.begin == {"detour": 0.5, "expansion_penalty": 0.1, "foreseen": 1.0}
    sought = {"detour": 1.0, "expansion_penalty": 0.05, "foreseen": 0.25}
    assert run.numbers(np.log([2.0, 0.5, 0.25])) == sought
    found = run.searcher(sought)
    assert isinstance(found, LearnedGuidance)
    assert (found.detour, found.scored, found.lesson) == (1.0, False, replace(AVOID, foreseen=0.25))
    arm = selection._Run(replace(TINY, agent="planar-arm-4"), tmp_path / "arm", None)
    assert set(arm.begin) == {"detour", "expansion_penalty", "effort"}
    arm.searcher(arm.begin)


@pytest.mark.parametrize(
    "entry",
    [
        {"detour": -1.0},
        {"detour": True},
        {"scored": 1},
        {"elsewhere": 1.0},
        [1.0],
        {"detour": "1"},
        {"factor": 0.5},
        {"foreseen": -0.5},
    ],
)
def test_a_card_of_another_selection_is_refused(finished: Path, tmp_path: Path, entry: Any) -> None:
    card, tensors = weights.load_agent(finished / AGENT_FOLDER)
    weights.save_agent(tmp_path / "agent", {**card, "selection": entry}, tensors)
    with pytest.raises(StorageError, match="card: expected"):
        guidance_class(str(tmp_path / "agent"), lambda names: [])


def test_numbers_of_a_card_are_defaults_and_part_of_the_fingerprint(finished: Path, tmp_path: Path) -> None:
    card, tensors = weights.load_agent(finished / AGENT_FOLDER)
    folder = tmp_path / "agent"
    marks = set()
    for detour in (0.25, 0.75):
        weights.save_agent(folder, {**card, "selection": {"detour": detour}}, tensors)
        marks.add(fingerprint(str(folder)))
        kind = guidance_class(str(folder), lambda names: [])
        assert kind().detour == detour  # type: ignore[attr-defined]
        assert kind(detour=0.6).detour == 0.6  # type: ignore[attr-defined, call-arg]
        assert inspect.signature(kind).parameters["detour"].default == detour
    assert len(marks) == 2


@pytest.mark.parametrize(
    "options", [{"environments": ()}, {"population": 3}, {"searches": 0}, {"generations": -1}, {"seed": -1}]
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(options))):
        replace(TINY, **options)


def test_an_agent_without_nodes_to_select_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="agent: expected one that selects nodes"):
        train_selection(replace(TINY, agent="trap-cup-hybrid"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
