"""Small problems with known answers, and an oracle cache that ends with the tests."""

from __future__ import annotations

import functools
import importlib.util
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
import shapely

from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.problems import Problem, Task

BOUNDS = (0.0, 0.0, 10.0, 10.0)
ROBOTS = {
    "point": Robot.point(),
    "rectangle": Robot.rectangle(0.8, 0.3),
    "notched": Robot.polygon([(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (0.0, -0.1), (-0.4, 0.3)]),
}


@pytest.fixture(scope="session", autouse=True)
def oracle_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tests neither use nor fill the user's own cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GUIDED_GYM_CACHE", str(tmp_path_factory.mktemp("oracle")))
        yield


@pytest.fixture(scope="session")
def reference() -> Callable[[str], ModuleType]:
    """A slow and simple reference in `benchmarks/`, which is not installed, by name."""

    @functools.cache
    def load(name: str) -> ModuleType:
        file = Path(__file__).parents[2] / "benchmarks" / f"{name}.py"
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None and spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def walled() -> Callable[[str], Problem]:
    """A wall in the way, with room to pass above and below it, for any of `ROBOTS`."""

    def build(robot: str = "rectangle") -> Problem:
        environment = Environment(BOUNDS, (shapely.box(4.5, 2.5, 5.5, 7.5),))
        turn = () if robot == "point" else (0.0,)
        return Problem(ROBOTS[robot], environment, Task((1.5, 5.0, *turn), (8.5, 5.0, *turn)), "Walled")

    return build


@pytest.fixture(scope="session")
def closed() -> Problem:
    """Two rooms with no way from one to the other."""
    environment = Environment(BOUNDS, (shapely.box(4, 0, 6, 10),))
    return Problem(ROBOTS["rectangle"], environment, Task((1.5, 5.0, 0.0), (8.5, 5.0, 0.0)), "Closed")


@pytest.fixture(scope="session")
def room() -> Problem:
    """A 10 x 10 room without obstacles, for a point robot that starts at (1, 1)."""
    return Problem(Robot.point(), Environment(BOUNDS), Task((1.0, 1.0), (9.0, 9.0)), "Room")
