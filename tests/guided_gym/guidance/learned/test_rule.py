"""Learned rules: what they see, whom they choose, and which files they refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest

from guided_gym import guided_search
from guided_gym.catalogue.table import make_distribution
from guided_gym.envs.guide_selection_env import GuideSelectionEnv
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import fingerprint
from guided_gym.guidance.learned.rule import LearnedRule, RuleModel, rule_shapes, save_rule
from guided_gym.guidance.learned.turns import COLUMN_NAMES, GuideColumn, SearchColumn, Turns, observed_size
from guided_gym.guidance.registry import make_guidance, make_guides
from guided_gym.guidance.rules import Swap
from guided_gym.search.search import Search

GUIDES = ["lazy_prm", "medial_axis"]
CARD = {
    "name": "rule", "package_version": "0", "guides": GUIDES, "hidden": [], "training": {}, "metrics": {},
}  # fmt: skip


def keeping_tensors():
    """Whoever guided last guides again; the first one at first."""
    tensors = {name: np.zeros(shape, np.float32) for name, shape in rule_shapes(GUIDES, []).items()}
    for guide in range(2):
        at = len(SearchColumn) + guide * len(GuideColumn)
        weight = tensors["layers.0.weight"]
        weight[guide, at + GuideColumn.CURRENT] = 1.0
        weight[1 - guide, at + GuideColumn.CURRENT] = -1.0
    tensors["layers.0.bias"][0] = 0.1
    return tensors


def folder_of(tmp_path, tensors, **changes):
    save_rule(tmp_path / "rule", {**CARD, **changes}, tensors)
    return tmp_path / "rule"


def random_tensors(hidden=(4,), seed=0):
    rng = np.random.default_rng(seed)
    shapes = rule_shapes(GUIDES, hidden)
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def test_logits_are_those_of_the_perceptron():
    tensors = random_tensors()
    model = RuleModel({**CARD, "hidden": [4], "columns": COLUMN_NAMES}, tensors)
    x = np.linspace(-1, 1, observed_size(2)).astype(np.float32)
    hidden = np.tanh(tensors["layers.0.weight"] @ x + tensors["layers.0.bias"])
    expected = tensors["layers.1.weight"] @ hidden + tensors["layers.1.bias"]
    assert model.logits(x) == pytest.approx(expected, rel=1e-5)


def test_a_rule_that_keeps_its_guide_keeps_it(tmp_path):
    rule = LearnedRule(folder_of(tmp_path, keeping_tensors()))
    problem = make_distribution("RandomTrapCup").problem(1)
    kept = guided_search(
        problem, Hybrid(make_guides(rule.guides), rule=rule), seed=1, max_samples=40, measure=False
    )
    alone = guided_search(problem, "lazy_prm", seed=1, max_samples=40, measure=False)
    assert np.array_equal(kept.tree.configurations, alone.tree.configurations)


def test_guides_may_be_expressions(tmp_path):
    guides = ["lazy_prm(vertices=100)", "rrt@goal_bias=0.1+prm"]
    made = make_guidance(f"learned:{folder_of(tmp_path, keeping_tensors(), guides=guides)}")
    assert [guide.name for guide in made.guides] == ["lazy_prm", "hybrid"]
    problem = make_distribution("RandomTrapCup").problem(1)
    assert guided_search(problem, made, seed=1, max_samples=10, measure=False).samples == 10


@pytest.mark.parametrize("temperature", [0.0, 1.0])
def test_the_same_seed_gives_the_same_tree(tmp_path, temperature):
    folder = folder_of(tmp_path, random_tensors(), hidden=[4])
    problem = make_distribution("RandomTrapCup").problem(2)
    trees = []
    for _ in range(2):
        hybrid = Hybrid(make_guides(GUIDES), rule=LearnedRule(folder, temperature=temperature))
        trees.append(guided_search(problem, hybrid, seed=2, max_samples=40, measure=False).tree)
    assert np.array_equal(trees[0].configurations, trees[1].configurations)


def test_it_decides_in_a_hybrid_as_it_does_in_the_environment(tmp_path):
    model = RuleModel.load(folder_of(tmp_path, random_tensors(), hidden=[4]))
    env = GuideSelectionEnv("RandomTrapCup", guides=GUIDES, max_samples=60)
    observation, _ = env.reset(seed=5)
    choices = set()
    for _ in range(60):
        choices.add(int(np.argmax(model.logits(observation))))
        observation, _, terminated, truncated, _ = env.step(int(np.argmax(model.logits(observation))))
        if terminated or truncated:
            break
    problem = make_distribution("RandomTrapCup").problem(5)
    result = guided_search(
        problem, Hybrid(make_guides(GUIDES), rule=LearnedRule(model)), seed=5, max_samples=60
    )
    assert np.array_equal(env.search.tree.configurations, result.tree.configurations)


def test_turns_noted_without_a_look_between_them_are_recorded_all_the_same():
    problem = make_distribution("TrapCup").problem(0)
    search = Search(problem, *(np.random.default_rng(i) for i in range(2)))
    hybrid = make_guidance("hybrid(lazy_prm, medial_axis, rule=round_robin)")
    search.attach(hybrid)
    looking, waiting = (Turns(hybrid.guides, search) for _ in range(2))
    for _ in range(20):
        guide = hybrid.current
        node = hybrid.select(search.tree)
        expansion = search.expand(node, hybrid.propose(search.tree, node))
        for turns in (looking, waiting):
            turns.note(guide, expansion)
        seen = looking.observe()
    whole = dict(zip(COLUMN_NAMES, [*seen[:5], *seen[5 : 5 + len(GuideColumn)]], strict=True))
    late = dict(zip(COLUMN_NAMES, waiting.observe()[: len(COLUMN_NAMES)], strict=True))
    assert 0 < whole["guide.failures"] < 1
    for name in ("last_failed", "failures", "waiting", "use"):
        assert late[f"guide.{name}"] == whole[f"guide.{name}"]
    for column in SearchColumn:
        assert late[f"search.{column.name.lower()}"] == whole[f"search.{column.name.lower()}"]


def test_other_guides_are_refused(tmp_path):
    rule = LearnedRule(folder_of(tmp_path, keeping_tensors()))
    problem = make_distribution("RandomTrapCup").problem(1)
    with pytest.raises(InvalidInputError, match="lazy_prm, medial_axis"):
        guided_search(problem, Hybrid(make_guides(["medial_axis", "lazy_prm"]), rule=rule), max_samples=3)
    guided_search(problem, Hybrid(make_guides(GUIDES), rule=Swap()), max_samples=3)


@pytest.mark.parametrize("change", [{"guides": [*GUIDES, "rrt"]}, {"hidden": [3]}, {"columns": ["x"]}])
def test_a_card_that_does_not_fit_is_refused(tmp_path, change):
    folder = folder_of(tmp_path, keeping_tensors())
    card = json.loads((folder / weights.CARD_FILE).read_text())
    (folder / weights.CARD_FILE).write_text(json.dumps({**card, **change}))
    with pytest.raises(StorageError):
        LearnedRule(folder)


def test_an_agent_is_no_rule(agent_folder):
    with pytest.raises(StorageError, match="guided-gym rule"):
        LearnedRule(agent_folder)


def test_its_name_stands_for_the_hybrid(tmp_path):
    folder = folder_of(tmp_path, random_tensors(), hidden=[4])
    problem = make_distribution("RandomTrapCup").problem(2)
    named = guided_search(problem, make_guidance(f"learned:{folder}"), seed=2, max_samples=30)
    made = guided_search(problem, Hybrid(make_guides(GUIDES), LearnedRule(folder)), seed=2, max_samples=30)
    assert np.array_equal(named.tree.configurations, made.tree.configurations)
    assert make_guidance(f"learned:{folder}", temperature=1.0).rule.temperature == 1.0
    assert fingerprint(str(folder)) == fingerprint(str(folder))
    other = folder_of(tmp_path / "other", random_tensors(seed=1), hidden=[4])
    assert fingerprint(str(folder)) != fingerprint(str(other))
