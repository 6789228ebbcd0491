"""A cache and a memory of oracles that are each test's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from guided_gym.measure import oracle as oracle_module
from guided_gym.measure import roadmap, solution


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that an earlier test solved is found again."""
    monkeypatch.setenv("GUIDED_GYM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(oracle_module, "_remembered", type(oracle_module._remembered)())
    monkeypatch.setattr(roadmap, "_worlds", type(roadmap._worlds)())
    solution._warned.set()  # where a warning is meant, the test clears it
