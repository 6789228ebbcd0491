"""The Gymnasium side: the environment, its observations, rewards and pictures, and the catalogue."""

from __future__ import annotations

from guided_gym.catalogue.table import distribution_names, make_distribution, register_distribution
from guided_gym.envs.guide_selection_env import GuideSelectionEnv
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.envs.observations import (
    NodeColumn,
    Observer,
    TreeObservation,
    node_table,
    rollout_bytes,
    valid_nodes,
)
from guided_gym.envs.pool import ProblemPool
from guided_gym.envs.rewards import Choice, EfficiencyReward, JensenShannonReward, Reward
from guided_gym.envs.wrappers import GraphObservation

__all__ = [
    "Choice",
    "EfficiencyReward",
    "GraphObservation",
    "GuideSelectionEnv",
    "GuidedSearchEnv",
    "JensenShannonReward",
    "NodeColumn",
    "Observer",
    "ProblemPool",
    "Reward",
    "TreeObservation",
    "distribution_names",
    "make_distribution",
    "node_table",
    "register_distribution",
    "rollout_bytes",
    "valid_nodes",
]
