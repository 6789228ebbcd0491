"""Programs: evaluate guidances, reproduce the paper's experiments, build path databases; the command line."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guided_gym.train.claims import ClaimResult, check_claims
    from guided_gym.train.evaluation import evaluate
    from guided_gym.train.paths import build_path_database
    from guided_gym.train.reproduction import reproduce
    from guided_gym.train.results import Results, Run
    from guided_gym.train.specs import EvaluationSettings, GuidanceSpec
    from guided_gym.train.table import summarise

# Imported when asked for: `guided-gym --help` needs none of it.
_HOMES = {
    "ClaimResult": "claims",
    "EvaluationSettings": "specs",
    "GuidanceSpec": "specs",
    "Results": "results",
    "Run": "results",
    "build_path_database": "paths",
    "check_claims": "claims",
    "evaluate": "evaluation",
    "reproduce": "reproduction",
    "summarise": "table",
}

__all__ = [
    "ClaimResult",
    "EvaluationSettings",
    "GuidanceSpec",
    "Results",
    "Run",
    "build_path_database",
    "check_claims",
    "evaluate",
    "reproduce",
    "summarise",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"guided_gym.train.{_HOMES[name]}"), name)
