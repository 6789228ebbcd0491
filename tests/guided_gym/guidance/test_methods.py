"""The paper's methods run as docs/methods.md writes them, and a new part takes no more than its page says."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from guided_gym import guided_search, make_distribution, make_guidance
from guided_gym.errors import InvalidInputError
from guided_gym.guidance import registry
from guided_gym.storage.path_file import DatabaseHeader, PathDatabase

DOCS = Path(__file__).parents[3] / "docs"
PAGE = DOCS / "methods.md"


def program() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_methods", DOCS / "make_methods.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


METHODS = program().METHODS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a few stored paths of RandomTrapCup as ``paths.db``."""
    made = tmp_path_factory.mktemp("methods")
    distribution = make_distribution("RandomTrapCup")
    problems = [distribution.problem(seed) for seed in range(4)]
    header = DatabaseHeader.for_space("RandomTrapCup", problems[0].space)
    with PathDatabase.create_or_open(made / "paths.db", header) as store:
        found = [guided_search(p, "exact", seed=0, measure=False).path for p in problems]
        store.append_many((seed, path) for seed, path in enumerate(found) if path is not None)
    return made


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_expression__builds_and_guides(
    method: tuple[str, str, str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "dtw" in method[2]:
        pytest.importorskip("dtaidistance")
    monkeypatch.chdir(folder)
    for name in ("TrapCup", "RandomTrapCup@test"):
        guidance = make_guidance(method[2])
        result = guided_search(make_distribution(name).problem(0), guidance, max_samples=25, measure=False)
        assert result.solved or result.samples == 25
        values = guidance.values(result.tree)
        assert (values >= 0).all()


def test_page__has_a_row_and_a_picture_for_each_method() -> None:
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("<!-- table") : text.index("<!-- end of table -->")]
    shown = re.findall(r"^\| ([^|]+) \| `([^`]+)` \|", table, flags=re.MULTILINE)
    assert shown == [(method.title, method.expression) for method in METHODS]
    for method in METHODS:
        assert (DOCS / "images" / f"method-{method.name}.png").stat().st_size > 1000


def test_parts__of_ones_own_take_twenty_lines() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "extend.md").read_text(encoding="utf-8"), re.DOTALL)
    found = {}
    for block in blocks:
        for kind in re.findall(r"^@?register_(\w+)", block, re.MULTILINE):
            found.setdefault(kind, block)
    for kind in ("solver", "robot", "environment", "guidance"):
        block = found[kind]
        lines = block[block.index("class ") :].splitlines()
        body = [line for line in lines if line.strip() and (line[0] in " c")]
        assert len(body) <= 20, f"{kind}: {len(body)} lines"


def test_register__refuses_what_lacks_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    class Half:
        def begin(self, query, rng, step):
            pass

    with pytest.raises(InvalidInputError, match="lacks __call__, follow, raise_near, inspect"):
        registry.register_solver(Half, "half")
    with pytest.raises(InvalidInputError, match="lacks space, project"):
        registry.register_robot(Half, "half")
    with pytest.raises(InvalidInputError, match="lacks environment, revised"):
        registry.register_environment(Half, "half")
    for nothing in (None, 3, "roadmap"):
        with pytest.raises(InvalidInputError, match="register_solver: expected a class with"):
            registry.register_solver(nothing, "half")  # type: ignore[type-var]


def test_register__keeps_what_has_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    from guided_gym.guidance.modifications import Boxes, Disc, Point
    from guided_gym.guidance.solvers.exact import Exact
    from guided_gym.guidance.solvers.plain import Straight

    for table in (registry.GUIDANCES, registry.ROBOT_TABLE, registry.ENVIRONMENT_TABLE):
        monkeypatch.setattr(table, "rows", dict(table.rows))
    with pytest.raises(InvalidInputError, match=r"'roadmap'.*replace=True"):
        registry.register_solver(Straight, "roadmap")
    with pytest.raises(InvalidInputError, match=r"'disc'.*replace=True"):
        registry.register_robot(Point, "disc")
    with pytest.raises(InvalidInputError, match=r"'hulls'.*replace=True"):
        registry.register_environment(Boxes, "hulls")
    registry.register_robot(Disc, "disc")  # the same one again
    registry.register_solver(Exact, "exact")
    registry.register_solver(Straight, "roadmap", replace=True)
    assert type(make_guidance("roadmap(robot=point)").solver) is Straight  # type: ignore[attr-defined]
    registry.register_robot(Point, "dot")
    registry.register_environment(Boxes, "crates")
    made = make_guidance("straight(robot=dot, environment=crates)")
    assert made.name == "straight"
