"""Plain PPO of stable-baselines3 learns which guiding space guides: python examples/sb3_ppo.py [STEPS]."""

import sys

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
searches = int(sys.argv[2]) if len(sys.argv) > 2 else 32

env = gymnasium.make("guided_gym:guided_gym/RandomGuideSelection-v0", split="train")
env = gymnasium.wrappers.TransformReward(env, lambda reward: 0.1 * reward)
model = PPO("MlpPolicy", env, n_steps=min(2048, steps), batch_size=min(256, steps), gamma=0.995, seed=0)
model.learn(steps, progress_bar=False)

held_out = gymnasium.make("guided_gym/RandomGuideSelection-v0", split="test")
mean, _ = evaluate_policy(model, held_out, searches, warn=False)
print(f"total SE on {searches} test problems: {-mean:.1f}")
