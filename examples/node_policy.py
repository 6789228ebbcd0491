"""A policy that reads nodes, for stable-baselines3: PPO from scratch, or a clone of recorded episodes.

    python examples/node_policy.py scratch --seeds 0 1 2 --json scratch.json
    python examples/node_policy.py scratch --seeds 0 1 2 --ray       # each seed a task of a Ray cluster
    python examples/node_policy.py clone --episodes 40 --teacher wavefront

SimplePassage with all options as they are by default. Every so often, 40 searches are run that nobody learned
from; beside them stand those of rrt's choices, in the same environment.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import guided_gym
import guided_gym.train.policies  # registers the ids, and the name NodePolicy

# With the module that registers it, for a Ray task has imported nothing.
ID = "guided_gym.train.policies:guided_gym/SimplePassage-v0"
FIRST_TEST = 10**6
# The reward of a choice is all that depends on it by definition of SE, so nothing is gained by looking ahead.
SETTINGS = {"n_steps": 64, "batch_size": 128, "n_epochs": 4, "gamma": 0.0, "gae_lambda": 1.0}
RATE = 3e-3
NETWORK = {"picture": 0}  # one map: there is nothing to be learned from its picture


def new_model(seed: int, environments: int = 16) -> MaskablePPO:
    """A policy that has learned nothing, and where it may learn."""
    torch.set_num_threads(1)
    envs = make_vec_env(ID, n_envs=environments, seed=1000 * seed)
    falling = lambda left: RATE * left  # noqa: E731
    return MaskablePPO(
        "NodePolicy", envs, seed=seed, learning_rate=falling, policy_kwargs=NETWORK, device="cpu", **SETTINGS
    )


def tested(model: MaskablePPO, tests: int) -> dict[str, float]:
    """Searches that nobody learned from, side by side; the most likely node is expanded."""
    envs = gymnasium.make_vec(ID, num_envs=tests)
    observation, _ = envs.reset(seed=FIRST_TEST)
    going, solved, samples = np.ones(tests, bool), np.zeros(tests, bool), np.zeros(tests)
    while going.any():
        masks = observation["action_mask"]
        actions, _ = model.predict(observation, action_masks=masks, deterministic=True)
        observation, _, terminated, truncated, info = envs.step(actions)
        ended = going & (terminated | truncated)
        solved[ended], samples[ended] = terminated[ended], info["samples"][ended]
        going &= ~ended
    envs.close()
    return {"solved": float(solved.mean()), "samples": float(samples.mean())}


def tested_guide(name: str, tests: int) -> dict[str, float]:
    """The same searches, nodes chosen by a guiding space."""
    env = gymnasium.make(ID)
    agent = guided_gym.make_agent(name)
    episodes = [guided_gym.rollout(env, agent, seed=FIRST_TEST + i) for i in range(tests)]
    return {
        "solved": float(np.mean([episode.solved for episode in episodes])),
        "samples": float(np.mean([episode.samples for episode in episodes])),
    }


class Curve(BaseCallback):
    """Tests the policy between updates."""

    def __init__(self, every: int, tests: int) -> None:
        super().__init__()
        self.every, self.tests, self.points = every, tests, []

    def point(self, model: MaskablePPO) -> None:
        """One more point of the curve."""
        self.points.append(
            {"steps": model.num_timesteps, "cpu": time.process_time(), **tested(model, self.tests)}
        )

    def _on_rollout_start(self) -> None:
        if not self.points or self.num_timesteps >= self.points[-1]["steps"] + self.every:
            self.point(self.model)

    def _on_step(self) -> bool:
        return True


def learned(seed: int, steps: int, every: int, tests: int) -> dict[str, Any]:
    """PPO from scratch: its curve. A function of its own, so that it can be a task anywhere."""
    model, curve = new_model(seed), Curve(every, tests)
    model.learn(steps, callback=curve)
    curve.point(model)
    began = curve.points[0]["cpu"]
    return {"seed": seed, "curve": [{**p, "cpu": round(p["cpu"] - began, 1)} for p in curve.points]}


def recorded(teacher: str, episodes: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What a guiding space saw and chose, step by step."""
    env, agent = gymnasium.make(ID), guided_gym.make_agent(teacher)
    observations, actions = [], []
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        agent.reset(env)
        ended = False
        while not ended:
            actions.append(agent.act(observation, info))
            observations.append(observation)
            observation, _, terminated, truncated, info = env.step(actions[-1])
            ended = terminated or truncated
    stacked = {key: np.stack([one[key] for one in observations]) for key in observations[0]}
    return stacked, np.array(actions)


def cloned(teacher: str, episodes: int, epochs: int, seed: int, tests: int) -> dict[str, Any]:
    """The policy, made likely to choose what was recorded."""
    observations, actions = recorded(teacher, episodes)
    model = new_model(seed, environments=1)
    policy, rng = model.policy, np.random.default_rng(seed)
    policy.set_training_mode(True)
    batches = max(1, len(actions) // 128)
    for epoch in range(epochs):
        for group in policy.optimizer.param_groups:
            group["lr"] = RATE * (1 - epoch / epochs)
        for batch in np.array_split(rng.permutation(len(actions)), batches):
            part = {key: torch.as_tensor(value[batch]) for key, value in observations.items()}
            _, likelihood, _ = policy.evaluate_actions(part, torch.as_tensor(actions[batch]))
            policy.optimizer.zero_grad()
            (-likelihood.mean()).backward()
            policy.optimizer.step()
    return {"steps": len(actions), **tested(model, tests)}


def population(seeds: list[int], on_ray: bool, *settings: int) -> list[dict[str, Any]]:
    """One run for each seed, one after the other, or as tasks of a cluster."""
    if not on_ray:
        return [learned(seed, *settings) for seed in seeds]
    import ray

    ray.init(include_dashboard=False, log_to_driver=False)  # an address: the cluster at it
    task = ray.remote(num_cpus=1)(learned)
    return ray.get([task.remote(seed, *settings) for seed in seeds])


def drawn(runs: list[dict[str, Any]], rrt: dict[str, float], file: Path) -> None:
    """The curves of the runs beside rrt, as a picture."""
    figure = Figure(figsize=(7.5, 2.8), layout="constrained")
    parts = (("solved", "solved (%)", 100.0), ("samples", "samples a search", 1.0))
    for axes, (key, label, unit) in zip(figure.subplots(1, 2), parts, strict=True):
        for run, dash in zip(runs, ("-", "--", ":", "-.") * len(runs), strict=False):
            steps = [p["steps"] / 1000 for p in run["curve"]]
            values = [unit * p[key] for p in run["curve"]]
            axes.plot(steps, values, f"k{dash}", marker="o", markersize=2.2, label=f"seed {run['seed']}")
        axes.axhline(unit * rrt[key], color="gray", label="RRT")
        axes.set(xlabel="samples learned from (thousands)", ylabel=label, ylim=(0, None))
    axes.legend(loc="lower left", fontsize=7, frameon=False)
    figure.savefig(file, dpi=200, metadata={"Software": None})


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("how", choices=("scratch", "clone"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--steps", type=int, default=32_768)
    parser.add_argument("--every", type=int, default=4096, help="steps between tests")
    parser.add_argument("--tests", type=int, default=40, help="searches of a test")
    parser.add_argument("--ray", action="store_true", help="each seed as a Ray task")
    parser.add_argument("--teacher", default="wavefront")
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--epochs", type=int, default=40)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--figure", type=Path, help="draw the curves of `scratch` into this PNG file")
    options = parser.parse_args()
    rrt = tested_guide("rrt", options.tests)
    print(f"rrt: solves {rrt['solved']:.0%} with {rrt['samples']:.0f} samples")
    if options.how == "scratch":
        runs = population(options.seeds, options.ray, options.steps, options.every, options.tests)
        for run in runs:
            for p in run["curve"]:
                print(
                    f"seed {run['seed']}, {p['steps']} steps, {p['cpu']:.0f} s: solves {p['solved']:.0%} "
                    f"with {p['samples']:.0f} samples"
                )
        if options.figure:
            drawn(runs, rrt, options.figure)
    else:
        runs = []
        for seed in options.seeds:
            run = cloned(options.teacher, options.episodes, options.epochs, seed, options.tests)
            runs.append({"seed": seed, **run})
            print(
                f"clone of {options.teacher}, seed {seed}, {run['steps']} choices: "
                f"solves {run['solved']:.0%} with {run['samples']:.0f} samples"
            )
    if options.json:
        options.json.write_text(json.dumps({"rrt": rrt, "runs": runs}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
