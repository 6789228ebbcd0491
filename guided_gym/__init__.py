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
    from guided_gym.catalogue.distributions import (
        FixedProblem,
        ProblemDistribution,
        ProblemList,
        SampledProblems,
    )
    from guided_gym.catalogue.files import ProblemFile, load_environment, load_problem, save_problem
    from guided_gym.catalogue.maps import MapOptions, read_map, read_scenario
    from guided_gym.catalogue.next_mazes import load_next_mazes
    from guided_gym.catalogue.problem_set import ProblemSet, build_problem_set
    from guided_gym.catalogue.splits import problem_seed
    from guided_gym.catalogue.table import distribution_names, make_distribution, register_distribution
    from guided_gym.compute.on_ray import OnRay
    from guided_gym.compute.workers import Local
    from guided_gym.errors import (
        GuidedGymError,
        InvalidInputError,
        NoPathError,
        StorageError,
        UnknownNameError,
    )
    from guided_gym.geometry.environment import Environment
    from guided_gym.geometry.linkages import Body, Joint, Linkage
    from guided_gym.geometry.mechanism import Mechanism
    from guided_gym.geometry.robots import Robot
    from guided_gym.geometry.solids import Box, Capsule, Cylinder, SpatialEnvironment
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.geometry.spatial_arms import SpatialArm, SpatialBody, SpatialJoint
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.guidance.composed import Composed, Lesson
    from guided_gym.guidance.hybrid import Hybrid
    from guided_gym.guidance.registry import (
        guidance_names,
        make_guidance,
        make_guides,
        register_environment,
        register_guidance,
        register_robot,
        register_rule,
        register_solver,
    )
    from guided_gym.measure.oracle import Oracle
    from guided_gym.measure.target import (
        Measure,
        entropy,
        jensen_shannon,
        sampling_efficiency,
        suboptimality,
        target,
    )
    from guided_gym.options import OracleOptions, SearchOptions, TargetParameters
    from guided_gym.planners.ompl import OmplPlanner
    from guided_gym.planning import Record, SearchResult, guided_search
    from guided_gym.problems import Problem, Task
    from guided_gym.randomness import streams
    from guided_gym.search.local_planner import LocalPlanner
    from guided_gym.search.search import Expansion, Search
    from guided_gym.search.tree import SearchTree
    from guided_gym.storage.path_file import PathDatabase
    from guided_gym.storage.path_library import PathLibrary
    from guided_gym.trajectories import (
        Trajectory,
        headings,
        path_clearance,
        path_length,
        shortcut,
        smooth,
        spaced_path,
        time_path,
    )

# All that is public, and where it lives: a name that is not here may change without notice. Imported when
# first used: `import guided_gym` stays quick, and registers the environments all the same.
_HOMES: dict[str, tuple[str, ...]] = {
    "catalogue.files": ("ProblemFile", "load_environment", "load_problem", "save_problem"),
    "catalogue.maps": ("MapOptions", "read_map", "read_scenario"),
    "catalogue.distributions": ("FixedProblem", "ProblemDistribution", "ProblemList", "SampledProblems"),
    "catalogue.next_mazes": ("load_next_mazes",),
    "catalogue.problem_set": ("ProblemSet", "build_problem_set"),
    "catalogue.splits": ("problem_seed",),
    "catalogue.table": ("distribution_names", "make_distribution", "register_distribution"),
    "compute.on_ray": ("OnRay",),
    "compute.workers": ("Local",),
    "errors": ("GuidedGymError", "InvalidInputError", "NoPathError", "StorageError", "UnknownNameError"),
    "geometry.environment": ("Environment",),
    "geometry.linkages": ("Body", "Joint", "Linkage"),
    "geometry.mechanism": ("Mechanism",),
    "geometry.robots": ("Robot",),
    "geometry.solids": ("Box", "Capsule", "Cylinder", "SpatialEnvironment"),
    "geometry.spatial_arms": ("SpatialArm", "SpatialBody", "SpatialJoint"),
    "geometry.space": ("ConfigurationSpace",),
    "guidance.base": ("GuidingSpace",),
    "guidance.composed": ("Composed", "Lesson"),
    "guidance.hybrid": ("Hybrid",),
    "guidance.registry": (
        "guidance_names",
        "make_guidance",
        "make_guides",
        "register_environment",
        "register_guidance",
        "register_robot",
        "register_rule",
        "register_solver",
    ),
    "measure.oracle": ("Oracle",),
    "measure.target": (
        "Measure",
        "entropy",
        "jensen_shannon",
        "sampling_efficiency",
        "suboptimality",
        "target",
    ),
    "options": ("OracleOptions", "SearchOptions", "TargetParameters"),
    "planners.ompl": ("OmplPlanner",),
    "planning": ("Record", "SearchResult", "guided_search"),
    "problems": ("Problem", "Task"),
    "randomness": ("streams",),
    "search.local_planner": ("LocalPlanner",),
    "search.search": ("Expansion", "Search"),
    "search.tree": ("SearchTree",),
    "traces.reading": ("Trace", "read_trace"),
    "trajectories": (
        "Trajectory",
        "headings",
        "path_clearance",
        "path_length",
        "shortcut",
        "smooth",
        "spaced_path",
        "time_path",
    ),
    "storage.path_file": ("PathDatabase",),
    "storage.path_library": ("PathLibrary",),
    # The rooms above the core, by name only: the core does not import them.
    "envs.guide_selection_env": ("GuideSelectionEnv",),
    "envs.guided_search_env": ("GuidedSearchEnv",),
    "envs.observations": (
        "NodeColumn",
        "Observer",
        "TreeObservation",
        "node_table",
        "rollout_bytes",
        "valid_nodes",
    ),
    "envs.pool": ("ProblemPool",),
    "envs.rewards": ("Choice", "EfficiencyReward", "JensenShannonReward", "Reward"),
    "envs.wrappers": ("GraphObservation", "MaskedObservation", "RecordSearch"),
    "agents.scripted": (
        "Agent",
        "EpisodeResult",
        "GuidanceAgent",
        "RandomAgent",
        "agent_names",
        "make_agent",
        "rollout",
    ),
    "train": ("figures",),
    "train.claims": ("ClaimResult", "check_claims"),
    "train.evaluation": ("evaluate",),
    "train.paths": ("build_path_database",),
    "train.plans": ("Answer", "Planner"),
    "train.reproduction": ("reproduce",),
    "train.results": ("Results", "Run"),
    "train.single_step": ("single_step",),
    "train.specs": ("EvaluationSettings", "GuidanceSpec"),
    "train.table": ("summarise",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Agent",
    "Answer",
    "Body",
    "Box",
    "Capsule",
    "Choice",
    "ClaimResult",
    "Composed",
    "ConfigurationSpace",
    "Cylinder",
    "EfficiencyReward",
    "Environment",
    "EpisodeResult",
    "EvaluationSettings",
    "Expansion",
    "FixedProblem",
    "GraphObservation",
    "GuidanceAgent",
    "GuidanceSpec",
    "GuideSelectionEnv",
    "GuidedGymError",
    "GuidedSearchEnv",
    "GuidingSpace",
    "Hybrid",
    "InvalidInputError",
    "JensenShannonReward",
    "Joint",
    "Lesson",
    "Linkage",
    "Local",
    "LocalPlanner",
    "MapOptions",
    "MaskedObservation",
    "Measure",
    "Mechanism",
    "NoPathError",
    "NodeColumn",
    "Observer",
    "OmplPlanner",
    "OnRay",
    "Oracle",
    "OracleOptions",
    "PathDatabase",
    "PathLibrary",
    "Planner",
    "Problem",
    "ProblemDistribution",
    "ProblemFile",
    "ProblemList",
    "ProblemPool",
    "ProblemSet",
    "RandomAgent",
    "Record",
    "RecordSearch",
    "Results",
    "Reward",
    "Robot",
    "Run",
    "SampledProblems",
    "Search",
    "SearchOptions",
    "SearchResult",
    "SearchTree",
    "SpatialArm",
    "SpatialBody",
    "SpatialEnvironment",
    "SpatialJoint",
    "StorageError",
    "TargetParameters",
    "Task",
    "Trace",
    "Trajectory",
    "TreeObservation",
    "UnknownNameError",
    "__version__",
    "agent_names",
    "build_path_database",
    "build_problem_set",
    "check_claims",
    "distribution_names",
    "entropy",
    "evaluate",
    "figures",
    "guidance_names",
    "guided_search",
    "headings",
    "jensen_shannon",
    "load_environment",
    "load_next_mazes",
    "load_problem",
    "make_agent",
    "make_distribution",
    "make_guidance",
    "make_guides",
    "node_table",
    "path_clearance",
    "path_length",
    "problem_seed",
    "read_map",
    "read_scenario",
    "read_trace",
    "register_distribution",
    "register_environment",
    "register_guidance",
    "register_robot",
    "register_rule",
    "register_solver",
    "reproduce",
    "rollout",
    "rollout_bytes",
    "sampling_efficiency",
    "save_problem",
    "shortcut",
    "single_step",
    "smooth",
    "spaced_path",
    "streams",
    "suboptimality",
    "summarise",
    "target",
    "time_path",
    "valid_nodes",
]

__version__: str


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("guided-gym")
    elif name in _HOME:
        home = f"guided_gym.{_HOME[name]}"
        module = importlib.import_module(home)
        value = getattr(module, name) if hasattr(module, name) else importlib.import_module(f"{home}.{name}")
    else:
        raise AttributeError(f"module 'guided_gym' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))


register_environments()
