"""Every example runs, on a tiny budget."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="the examples are in the repository alone")


def run(name: str, *arguments: str) -> str:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_stable_baselines_in_twenty_lines():
    pytest.importorskip("stable_baselines3")
    assert "total SE on 2 test problems" in run("sb3_ppo.py", "64", "2")
    code = (EXAMPLES / "sb3_ppo.py").read_text().splitlines()
    assert len(code) <= 25


def test_masked_ppo_in_one_file():
    pytest.importorskip("torch")
    options = ["--total-steps", "128", "--environments", "2", "--rollout", "64", "--max-nodes", "24"]
    assert "128 samples, total SE of the last 20 searches" in run("cleanrl_masked_ppo.py", *options)


def test_a_network_of_your_own():
    pytest.importorskip("sb3_contrib")
    assert "total_timesteps" in run("custom_network.py", "64")


def test_learned_guidance_in_a_hybrid(tmp_path):
    from guided_gym.guidance.learned import field, scorer, weights

    fields, scorers = field.FieldArchitecture(cells=24, headings=8), scorer.ScorerArchitecture()
    tensors = {f"field.{name}": t for name, t in field.plain_tensors(fields).items()}
    tensors.update({f"scorer.{name}": t for name, t in scorer.plain_tensors(scorers).items()})
    sizes = {"field": asdict(fields), "scorer": asdict(scorers)}
    card = {"name": "plain", "package_version": "0", **sizes, "training": {}, "metrics": {}}
    weights.save_agent(tmp_path, card, tensors)
    lines = run("learned_in_hybrid.py", str(tmp_path), "2").splitlines()
    assert [line.split(":")[0] for line in lines] == ["learned", "medial_axis", "both"]


def test_a_guiding_space_as_a_planner_of_ompl():
    pytest.importorskip("ompl")
    lines = run("ompl_guided.py", "--env", "Cup", "--guidance", "rrt").splitlines()
    assert lines[0] == "Exact solution"
    assert "simplified by OMPL" in lines[1]


def test_the_best_policy_of_each_reward():
    lines = [
        line.rsplit(maxsplit=5)
        for line in run("best_policies.py", "--gaps", "0.25", "0.001").splitlines()[1:]
    ]
    rows = {(name.strip(), float(gap)): tuple(map(float, rest)) for name, gap, *rest in lines}
    # One of two nodes opens with probability 1/2 at first; 4 samples an edge.
    assert rows["sample", 0.25][:2] == (1.0, 24.0)
    for reward in ("efficiency", "regret"):  # to the gap, whatever it takes: 1,000 samples and 5 edges more
        assert rows[reward, 0.001][:2] == (1.0, 1020.0)
    assert rows["regret", 0.001][3] == 0.0
    short, samples, efficiency, _ = rows["sample", 0.001]  # round by the open way: 9 edges of 4 samples
    assert short < 0.01 and abs(samples - 36.0) < 0.2
    assert efficiency > rows["efficiency", 0.001][2]
    assert rows["regret + sample", 0.001] == rows["sample", 0.001]


def test_a_clone_of_recorded_episodes_by_the_policy_that_reads_nodes():
    pytest.importorskip("sb3_contrib")
    options = ["--episodes", "1", "--epochs", "1", "--teacher", "goal_distance", "--tests", "2"]
    lines = run("node_policy.py", "clone", *options).splitlines()
    assert [line.split(":")[0].split(",")[0] for line in lines] == ["rrt", "clone of goal_distance"]


LIBRARIES = {
    "rllib_ppo.py": ("ray.rllib", ["--iterations", "1", "--runners", "1"]),
    "torchrl_masked.py": ("torchrl", ["--steps", "20"]),
    "tianshou_dqn.py": ("tianshou", ["--steps", "40"]),
    "skrl_ppo.py": ("skrl", ["--steps", "40"]),
    "minari_dataset.py": ("minari", ["--episodes", "1"]),
    "torch_geometric_batch.py": ("torch_geometric", []),
}


@pytest.mark.parametrize("name", LIBRARIES)
def test_examples_of_libraries_that_are_installed(name, tmp_path, monkeypatch):
    package, options = LIBRARIES[name]
    pytest.importorskip(package, exc_type=ImportError)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert run(f"libraries/{name}", *options)


def test_hyperparameters_for_rl_zoo3_are_those_of_known_ids_and_policies():
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("sb3_contrib")
    from stable_baselines3 import PPO

    import guided_gym.train.policies  # noqa: F401
    from guided_gym.registration import ENVIRONMENTS, SELECTIONS

    settings = yaml.safe_load((EXAMPLES / "libraries" / "rl_zoo3.yml").read_text())
    for name, options in settings.items():
        assert name in {**ENVIRONMENTS, **SELECTIONS}
        assert options["policy"] in PPO.policy_aliases
        assert options["n_envs"] * options["n_steps"] % options["batch_size"] == 0
