"""What `import guided_gym` does, and what it leaves for later."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import pytest

import guided_gym
from guided_gym.registration import ENVIRONMENTS, register_environments


def run(program):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout


def test_every_public_name_is_there():
    for name in guided_gym.__all__:
        assert getattr(guided_gym, name) is not None
        assert name in dir(guided_gym)
    assert guided_gym.__version__[0].isdigit()
    with pytest.raises(AttributeError, match="no_such_name"):
        guided_gym.no_such_name  # noqa: B018


def test_importing_costs_nothing_heavy():
    heavy = ("torch", "pygame", "matplotlib", "numba", "networkx", "pandas", "stable_baselines3")
    program = f"import sys, guided_gym; print([name for name in {heavy} if name in sys.modules])"
    assert run(program).strip() == "[]"


def test_importing_registers_the_ids_and_twice_is_fine(recwarn):
    register_environments()
    assert not recwarn.list
    for name, distribution in ENVIRONMENTS.items():
        assert gymnasium.spec(name).kwargs == {"distribution": distribution}
