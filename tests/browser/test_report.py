"""The page of an evaluation in a real browser: its tables sort, and its searches play."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from guided_gym import EvaluationSettings
from guided_gym.train.evaluation import Plan, run_plans
from guided_gym.train.report import note_evaluation, write_report
from guided_gym.train.specs import GuidanceSpec


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluation")
    settings = EvaluationSettings(max_samples=50)
    plans = [Plan("Cup", GuidanceSpec(name), settings) for name in ("goal_distance", "medial_axis")]
    run_plans(plans, seeds=3, out=folder)
    note_evaluation(folder, plans, range(3), "guided-gym evaluate")
    return write_report(folder)


def test_report__tables_sort_both_ways(report: Path, open_page: Any) -> None:
    page = open_page(report)
    table = page.locator("table").first
    names = table.locator("tbody th")
    assert names.all_inner_texts() == ["medial_axis", "goal_distance"]
    table.get_by_role("button", name="guidance").click()
    assert names.all_inner_texts() == ["goal_distance", "medial_axis"]
    table.get_by_role("button", name="guidance").click()
    assert names.all_inner_texts() == ["medial_axis", "goal_distance"]
    heading = table.get_by_role("button", name="samples, mean")
    heading.click()
    assert names.all_inner_texts() == ["medial_axis", "goal_distance"]
    heading.focus()
    page.keyboard.press("Enter")
    assert names.all_inner_texts() == ["goal_distance", "medial_axis"]
    assert heading.locator("..").get_attribute("aria-sort") == "descending"


@pytest.mark.parametrize("width", [1024, 390])
def test_report__searches_play_one_or_two(report: Path, open_page: Any, width: int) -> None:
    page = open_page(report, width=width)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.locator("canvas.stage").count() == 1
    page.get_by_label("beside").select_option(index=4)
    assert page.locator("canvas.stage").count() == 2
    assert "goal_distance" in page.locator("figcaption").nth(1).inner_text()
    page.get_by_role("button", name="To the start").click()
    assert page.evaluate("players[0].sample") == 0
    page.get_by_role("button", name="Change to dark").click()
    assert page.evaluate("players[0].theme") == "dark"
