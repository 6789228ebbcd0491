"""A learned agent that has learned nothing: known answers, no training."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from guided_gym.guidance.learned import field as fields
from guided_gym.guidance.learned import scorer as scorers
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.field import FieldArchitecture
from guided_gym.guidance.learned.scorer import ScorerArchitecture

ARCHITECTURE = FieldArchitecture(cells=24, headings=8)


@pytest.fixture
def agent_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "plain"
    tensors = {f"field.{name}": t for name, t in fields.plain_tensors(ARCHITECTURE).items()}
    scorer = ScorerArchitecture()
    tensors.update({f"scorer.{name}": t for name, t in scorers.plain_tensors(scorer).items()})
    card = {
        "name": "plain",
        "package_version": "0",
        "field": asdict(ARCHITECTURE),
        "scorer": asdict(scorer),
        "training": {},
        "metrics": {},
    }
    weights.save_agent(folder, card, tensors)
    return folder
