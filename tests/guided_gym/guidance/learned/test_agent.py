"""Learned guidance as a guiding space like any other."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guided_gym.agents.scripted import make_agent, rollout
from guided_gym.catalogue.table import make_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.composed import Composed, Lesson
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned.agent import LearnedGuidance, fingerprint, load_named
from guided_gym.guidance.learned.folders import shipped_agents
from guided_gym.guidance.learned.scored import ScoredGuidance
from guided_gym.guidance.learned.scorer import ScorerColumn
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.planning import guided_search
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.train.evaluation import evaluate


def searched(guidance: str, name: str = "TrapCup", seed: int = 0, samples: int = 300):
    return guided_search(make_distribution(name).problem(seed), guidance, seed=seed, max_samples=samples)


@pytest.mark.parametrize("name", ["SimplePassage", "Cup", "Trap", "TrapCup"])
def test_solves_the_papers_problems(agent_folder: Path, name: str) -> None:
    assert searched(f"learned:{agent_folder}", name).solved


def test_the_same_seed_grows_the_same_tree(agent_folder: Path) -> None:
    first, second = (searched(f"learned:{agent_folder}") for _ in range(2))
    assert np.array_equal(first.tree.configurations, second.tree.configurations)


def test_works_in_a_hybrid_and_in_the_environment(agent_folder: Path) -> None:
    name = f"learned:{agent_folder}"
    assert searched(f"{name}+rrt", "Cup").solved
    env = GuidedSearchEnv("Cup", expansion=name, max_samples=200, max_nodes=256)
    result = rollout(env, make_agent(name), seed=3)
    expected = searched(name, "Cup", seed=3, samples=200)
    assert result.solved
    assert result.total_efficiency == pytest.approx(expected.total_efficiency)


def test_is_evaluated_like_any_other(agent_folder: Path) -> None:
    results = evaluate("Cup", [f"learned:{agent_folder}"], seeds=2)
    assert all(run.solved for run in results.runs)


def begun(
    agent_folder: Path, samples: int, taught: bool = True, **options: object
) -> tuple[Search, LearnedGuidance]:
    problem = make_distribution("Trap").problem(0)
    _, expansion, choice = streams(0)
    search = Search(problem, expansion, choice)
    guidance = LearnedGuidance(agent_folder, **options)  # type: ignore[arg-type]
    if not taught:
        guidance.lesson = Lesson(factor=1.0)
    search.attach(guidance)
    steps = np.random.default_rng(0)
    for _ in range(samples):
        node = int(steps.integers(len(search.tree)))
        search.expand(node, search.planner.uniform(search.tree.configurations[node]))
        guidance.select(search.tree)
    return search, guidance


def test_columns_grown_step_by_step_are_those_of_the_whole_tree(agent_folder: Path) -> None:
    search, guidance = begun(agent_folder, 800, taught=False)  # the fresh one hears of no failure
    grown = guidance.columns(search.tree)
    fresh = LearnedGuidance(agent_folder)
    fresh.reset(search)
    whole = fresh.columns(search.tree)
    assert search.tree.failure_count > 0
    assert np.allclose(grown, whole, atol=1e-5)
    assert np.isfinite(grown).all()
    assert (grown[:, ScorerColumn.GAP] >= 0).all()


def test_a_node_that_fails_loses_its_rank(agent_folder: Path) -> None:
    search, guidance = begun(agent_folder, 0)
    best = guidance.select(search.tree)
    before = guidance.logits(search.tree)[best]
    search.tree.add_failure(best, search.tree.configurations[best], search.tree.configurations[best])
    assert guidance.logits(search.tree)[best] < before - 0.3


def test_distribution__argmax_or_softmax(agent_folder: Path) -> None:
    search, guidance = begun(agent_folder, 40)
    p = guidance.distribution(search.tree)
    assert p[guidance.select(search.tree)] == p.sum() == 1.0
    search, guidance = begun(agent_folder, 40, temperature=1.0)
    p, logits = guidance.distribution(search.tree), guidance.logits(search.tree)
    assert np.allclose(np.log(p[p > 0]), (logits - np.log(np.exp(logits).sum()))[p > 0])
    assert 0 <= guidance.select(search.tree) < len(search.tree)


def test_without_its_scorer_it_is_the_wave_through_what_it_takes_for_free(agent_folder: Path) -> None:
    problem = make_distribution("Trap").problem(0)
    wave = Composed(Wave.of(load_named(str(agent_folder)).field), detour=0.5)
    alone = LearnedGuidance(agent_folder, scored=False)
    found = [
        guided_search(problem, guidance, seed=0, max_samples=150, expansion="uniform", measure=False)
        for guidance in (wave, alone, LearnedGuidance(agent_folder))
    ]
    trees = [result.tree.configurations for result in found]
    assert np.array_equal(trees[0], trees[1])
    assert not np.array_equal(trees[1], trees[2])


def test_works_for_a_tree_far_larger_than_its_buffers(agent_folder: Path) -> None:
    search, guidance = begun(agent_folder, 0)
    rng = np.random.default_rng(0)
    for q in search.space.sample(rng, 3000):
        search.tree.add(q, 0, 1.0)
    assert guidance.columns(search.tree).shape == (3001, len(ScorerColumn))
    assert 0 <= guidance.select(search.tree) <= 3000


def test_unknown_agents_and_options_are_refused(agent_folder: Path) -> None:
    with pytest.raises(UnknownNameError, match="learned agent"):
        make_guidance("learned:nobody")
    with pytest.raises(UnknownNameError, match="temperature"):
        make_guidance(f"learned:{agent_folder}", temprature=1.0)
    with pytest.raises(InvalidInputError, match="candidates"):
        make_guidance(f"learned:{agent_folder}", candidates=0)
    with pytest.raises(InvalidInputError, match="failure_penalty"):
        make_guidance(f"learned:{agent_folder}", failure_penalty=-1.0)


def test_agents_are_kept_until_their_files_change(agent_folder: Path) -> None:
    first = load_named(str(agent_folder))
    assert load_named(str(agent_folder)) is first
    before = fingerprint(str(agent_folder))
    assert fingerprint(str(agent_folder)) == before


@pytest.mark.parametrize("name", shipped_agents() or [None])
def test_shipped_agents_load(name: str | None) -> None:
    if name is None:
        pytest.skip("none is shipped yet")
    assert isinstance(make_guidance(f"learned:{name}"), ScoredGuidance | Hybrid)


def test_needs_no_torch(agent_folder: Path) -> None:
    code = f"""
import sys
from guided_gym import make_guidance
make_guidance("learned:{agent_folder}")
print([name for name in ("torch", "stable_baselines3") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
