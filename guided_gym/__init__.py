"""guided-gym: guided motion planning as a learning problem.

A search tree is observed, a node is chosen, and the choice is rewarded by its sampling efficiency against
an oracle's target distribution. This package is the paper's framework: problems, search tree, guiding spaces,
oracle and metric. The Gymnasium side is in `guided_gym.envs` (its ids are registered on import), policies are
in `guided_gym.agents`, programs in `guided_gym.train`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from guided_gym.registration import register_environments

if TYPE_CHECKING:
    from guided_gym.efficiency import TargetParameters, jensen_shannon, sampling_efficiency
    from guided_gym.environment import Environment
    from guided_gym.errors import (
        GuidedGymError,
        InvalidInputError,
        NoPathError,
        StorageError,
        UnknownNameError,
    )
    from guided_gym.guidance import GuidingSpace, guidance_names, make_guidance, register_guidance
    from guided_gym.local_planner import LocalPlanner
    from guided_gym.oracle import Oracle
    from guided_gym.problems import FixedProblem, Problem, ProblemDistribution, SampledProblems, Task
    from guided_gym.robots import Robot
    from guided_gym.search import Expansion, Record, Search, SearchOptions, SearchResult, guided_search
    from guided_gym.space import ConfigurationSpace
    from guided_gym.tree import SearchTree

# Imported when first used: `import guided_gym` stays quick, and registers the environments all the same.
_HOMES = {
    "efficiency": ("TargetParameters", "jensen_shannon", "sampling_efficiency"),
    "environment": ("Environment",),
    "errors": ("GuidedGymError", "InvalidInputError", "NoPathError", "StorageError", "UnknownNameError"),
    "guidance": ("GuidingSpace", "guidance_names", "make_guidance", "register_guidance"),
    "local_planner": ("LocalPlanner",),
    "oracle": ("Oracle",),
    "problems": ("FixedProblem", "Problem", "ProblemDistribution", "SampledProblems", "Task"),
    "robots": ("Robot",),
    "search": ("Expansion", "Record", "Search", "SearchOptions", "SearchResult", "guided_search"),
    "space": ("ConfigurationSpace",),
    "tree": ("SearchTree",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "ConfigurationSpace",
    "Environment",
    "Expansion",
    "FixedProblem",
    "GuidedGymError",
    "GuidingSpace",
    "InvalidInputError",
    "LocalPlanner",
    "NoPathError",
    "Oracle",
    "Problem",
    "ProblemDistribution",
    "Record",
    "Robot",
    "SampledProblems",
    "Search",
    "SearchOptions",
    "SearchResult",
    "SearchTree",
    "StorageError",
    "TargetParameters",
    "Task",
    "UnknownNameError",
    "__version__",
    "guidance_names",
    "guided_search",
    "jensen_shannon",
    "make_guidance",
    "register_guidance",
    "sampling_efficiency",
]

__version__: str


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("guided-gym")
    elif name in _HOME:
        value = getattr(importlib.import_module(f"guided_gym.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'guided_gym' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))


register_environments()
