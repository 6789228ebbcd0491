"""What the suites over all ids share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from guided_gym.options import OracleOptions

Options = Callable[[str], dict[str, Any]]


@pytest.fixture(scope="session")
def options_of() -> Options:
    """Options for an id: a small oracle for robots with joints, whose own takes seconds."""
    jointed = "Arm", "Snake"
    return lambda name: (
        {"oracle": OracleOptions(resolution=(1000,))} if any(word in name for word in jointed) else {}
    )
