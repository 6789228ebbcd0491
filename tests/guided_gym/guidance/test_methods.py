"""The paper's methods run as docs/methods.md writes them, and a new part takes no more than its page says."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from guided_gym import Hybrid, guided_search, make_distribution, make_guidance
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance import registry
from guided_gym.guidance.rules import Taking
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
    for kind in ("solver", "robot", "environment", "guidance", "rule"):
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
    with pytest.raises(InvalidInputError, match="lacks weights, learn"):
        registry.register_rule(Half, "half")
    for nothing in (None, 3, "roadmap"):
        with pytest.raises(InvalidInputError, match="register_solver: expected a class with"):
            registry.register_solver(nothing, "half")  # type: ignore[type-var]


def test_register__keeps_what_has_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    from guided_gym.guidance.modifications import Boxes, Disc, Point
    from guided_gym.guidance.rules import RoundRobin
    from guided_gym.guidance.solvers.exact import Exact
    from guided_gym.guidance.solvers.plain import Straight

    for table in (registry.GUIDANCES, registry.ROBOT_TABLE, registry.ENVIRONMENT_TABLE, registry.RULE_TABLE):
        monkeypatch.setattr(table, "rows", dict(table.rows))
    with pytest.raises(InvalidInputError, match=r"'roadmap'.*replace=True"):
        registry.register_solver(Straight, "roadmap")
    with pytest.raises(InvalidInputError, match=r"'disc'.*replace=True"):
        registry.register_robot(Point, "disc")
    with pytest.raises(InvalidInputError, match=r"'hulls'.*replace=True"):
        registry.register_environment(Boxes, "hulls")
    with pytest.raises(InvalidInputError, match=r"'swap'.*replace=True"):
        registry.register_rule(RoundRobin, "swap")
    registry.register_robot(Disc, "disc")  # the same one again
    registry.register_solver(Exact, "exact")
    registry.register_solver(Straight, "roadmap", replace=True)
    assert type(make_guidance("roadmap(robot=point)").solver) is Straight  # type: ignore[attr-defined]
    registry.register_robot(Point, "dot")
    registry.register_environment(Boxes, "crates")
    made = make_guidance("straight(robot=dot, environment=crates)")
    assert made.name == "straight"


def test_register_rule__guides_by_name_as_by_object(monkeypatch: pytest.MonkeyPatch) -> None:
    class Patient(Taking):
        """Swaps after so many collisions in a row."""

        def __init__(self, failures: int = 3) -> None:
            self.most = failures

        def begin(self, guides, search):
            super().begin(guides, search)
            self.failures = 0

        def learn(self, guide, expansion):
            self.failures = self.failures + 1 if expansion.failed else 0
            if self.failures == self.most:
                self.failures = 0
                self.pass_on()

    monkeypatch.setattr(registry.RULE_TABLE, "rows", dict(registry.RULE_TABLE.rows))
    with pytest.raises(UnknownNameError, match="patient"):
        make_guidance("hybrid(lazy_prm, rrt, rule=patient)")
    registry.register_rule(Patient, "patient")
    problem = make_distribution("TrapCup").problem(0)
    for failures in (1, 3):
        named = f"hybrid(lazy_prm, rrt, rule=patient(failures={failures}))"
        made = Hybrid(registry.make_guides(["lazy_prm", "rrt"]), rule=Patient(failures))
        trees = [guided_search(problem, guidance, seed=0, max_samples=150).tree for guidance in (named, made)]
        assert np.array_equal(trees[0].configurations, trees[1].configurations)
        assert trees[0].failure_count == trees[1].failure_count > failures
    with pytest.raises(UnknownNameError, match="failures"):
        make_guidance("hybrid(lazy_prm, rrt, rule=patient(failure=2))")
