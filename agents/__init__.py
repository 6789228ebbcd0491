"""Policies for the environment: scripted ones here; learned ones join in modules of their own."""

from __future__ import annotations

from guided_gym.agents.scripted import (
    Agent,
    EpisodeResult,
    GuidanceAgent,
    RandomAgent,
    agent_names,
    make_agent,
    rollout,
)

__all__ = [
    "Agent",
    "EpisodeResult",
    "GuidanceAgent",
    "RandomAgent",
    "agent_names",
    "make_agent",
    "rollout",
]
