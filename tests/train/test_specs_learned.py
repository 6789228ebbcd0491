"""Results of learned agents count by what the agents are, not by what they are called."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path

import pytest

from guided_gym.guidance.learned import field, scorer, weights
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec, settings_content


@pytest.fixture
def agent(tmp_path: Path) -> Path:
    sizes, scorer_sizes = field.FieldArchitecture(cells=16, headings=4), scorer.ScorerArchitecture()
    tensors = {f"field.{name}": t for name, t in field.plain_tensors(sizes).items()}
    tensors.update({f"scorer.{name}": t for name, t in scorer.plain_tensors(scorer_sizes).items()})
    card = {"name": "a", "package_version": "0", "field": asdict(sizes), "scorer": asdict(scorer_sizes)}
    weights.save_agent(tmp_path / "agent", {**card, "training": {}, "metrics": {}}, tensors)
    return tmp_path / "agent"


def agents(name: str, expansion: str | None = None, **options: object) -> object:
    content = settings_content(
        "Cup", GuidanceSpec.of(name, **options), EvaluationSettings(expansion=expansion)
    )
    return content["guidance"].get("agents")


def test_agents_count_by_their_weights(agent: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(agent, copy)
    before = agents(f"learned:{agent}")
    assert before == agents(f"learned:{copy}")
    card, tensors = weights.load_agent(copy)
    tensors["scorer.linear.weight"] += 1
    weights.save_agent(copy, card, tensors)
    assert before != agents(f"learned:{copy}")


def test_agents_count_wherever_they_take_part(agent: Path) -> None:
    alone = agents(f"learned:{agent}")
    assert agents(f"learned:{agent}+rrt") == alone
    assert agents("rrt", expansion=f"learned:{agent}") == alone
    assert agents("hybrid", guides=["rrt", f"learned:{agent}"]) == alone
    assert agents("rrt") is None
