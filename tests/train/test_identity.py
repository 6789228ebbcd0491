"""Results never go stale: rows of code of yours that was edited are computed anew, and only those."""

from __future__ import annotations

import functools
import importlib
import json
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.guidance import registry
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.recipes import recipe
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.plain import Straight
from guided_gym.train.evaluation import evaluate
from guided_gym.train.identity import code_identity, value_identity
from guided_gym.train.results import ResultsFile
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec, settings_content

GUIDANCE = """
    import numpy as np
    from guided_gym import GuidingSpace, register_guidance
    from fees import fee

    class Base(GuidingSpace):
        name = "base"
        def project(self, tree, q):
            return q
        def heuristic(self, states):
            return self.space.distance(states, self.goal) * self.scale()
        def scale(self):
            return 1.0

    @register_guidance
    class Mine(Base):
        name = "mine"
        def heuristic(self, states):
            return fee(states, super().heuristic(states))

    @register_guidance
    def recipe(*, temperature=0.0):
        return Mine(temperature=temperature)
"""
FEES = """
    from tariffs import TARIFF
    def fee(states, h):
        return h + TARIFF * abs(states[:, 0])
"""
TARIFFS = "TARIFF = 0.0\n"
PROBLEMS = """
    from shapely.geometry import box
    from guided_gym import Environment, Problem, Robot, SampledProblems, Task, register_distribution

    def draw(rng):
        low = rng.uniform(2.0, 4.0)
        wall = box(4.5, low, 5.0, 8.0)
        return Problem(Robot.point(), Environment((0, 0, 10, 10), (wall,)), Task((1, 5), (9, 5)), "Walls")

    register_distribution("Walls", lambda: SampledProblems("Walls", draw))
"""
RUN = """
    import json, sys
    from guided_gym import EvaluationSettings, evaluate
    from guided_gym.train import evaluation

    computed = []
    def run_once(plan, seed, original=evaluation.run_once):
        if plan.settings.max_samples == 40:
            computed.append([plan.spec.label, seed])
        return original(plan, seed)
    evaluation.run_once = run_once

    guidances = sys.argv[1].split(",")
    results = evaluate("Walls", guidances, seeds=3, out="out", imports=["mine", "walls"],
                       settings=EvaluationSettings(max_samples=40))
    figures = [[run.guidance, run.seed, run.samples, run.total_efficiency] for run in results.runs]
    print(json.dumps({"computed": computed, "figures": figures}))
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with modules of a user's own."""
    files = {"mine": GUIDANCE, "fees": FEES, "tariffs": TARIFFS, "walls": PROBLEMS, "run": RUN}
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(text))
    return tmp_path


def run(project: Path, guidances: str = "rrt,mine,recipe") -> tuple[set[str], list[Any]]:
    """Evaluate in a new process; which guidances were computed (all three seeds), and the figures."""
    done = subprocess.run(
        [sys.executable, "run.py", guidances], cwd=project, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    names = {name for name, _ in found["computed"]}
    assert sorted(found["computed"]) == sorted([name, seed] for name in names for seed in range(3))
    return names, found["figures"]


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_code_of_ones_own__is_part_of_what_a_row_is_of(project: Path) -> None:
    names, first = run(project)
    assert names == {"rrt", "mine", "recipe"}
    assert run(project) == (set(), first)  # nothing was edited
    edit(project / "mine.py", "return 1.0", "return 2.0")  # a base class
    names, second = run(project)
    assert names == {"mine", "recipe"}
    edit(project / "tariffs.py", "0.0", "-0.5 + 0.6 * 3")  # a module that a module imports
    names, third = run(project)
    assert names == {"mine", "recipe"}
    assert [row for row in third if row[0] == "rrt"] == [row for row in first if row[0] == "rrt"]
    assert [row for row in third if row[0] == "mine"] != [row for row in second if row[0] == "mine"]


def test_distribution_of_ones_own__is_part_of_what_a_row_is_of(project: Path) -> None:
    _, first = run(project, "rrt")
    edit(project / "walls.py", "box(4.5, low, 5.0, 8.0)", "box(4.5, low, 5.0, 8.0 if low < 3.3 else 9.0)")
    names, second = run(project, "rrt")
    assert names == {"rrt"}
    assert first != second


def loaded(folder: Path, monkeypatch: pytest.MonkeyPatch, **modules: str) -> Any:
    """The first of some modules, imported from a folder of its own."""
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(textwrap.dedent(text))
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
    return importlib.import_module(next(iter(modules)))


def test_module__counts_with_what_it_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").write_text("")
    (tmp_path / "pack" / "near.py").write_text("from . import deep\n")
    (tmp_path / "pack" / "deep.py").write_text("x = 1\n")
    (tmp_path / "late.py").write_text("y = 1\n")
    module = loaded(
        tmp_path,
        monkeypatch,
        first_gg="""
            import os, numpy, guided_gym
            from pack.near import deep
            def f():
                import late
                return late.y
        """,
    )
    identity = code_identity([module.f])
    assert set(identity) == {"first_gg", "pack", "pack.near", "pack.deep", "late"}
    (tmp_path / "late.py").write_text("y = 2\n")
    changed = code_identity([module.f])
    assert {name for name in identity if identity[name] != changed[name]} == {"late"}
    assert code_identity([make_guidance, Voronoi, np.mean, len, 3, None, "a"]) == {}
    assert code_identity([make_distribution("RandomTrapCup"), make_distribution("RandomTrapCup@test")]) == {}


def test_module__counts_by_what_is_loaded_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that was edited, but not loaded again, is neither what it was nor what it will be."""
    old = "def f():\n    return 1\nclass A:\n    @staticmethod\n    def g():\n        return 1\n"
    for new in (old.replace("return 1\nclass", "return 2\nclass"), old.replace("return 1\n", "return 2\n")):
        before = code_identity([loaded(tmp_path, monkeypatch, second_gg=old).f])
        module = sys.modules["second_gg"]
        (tmp_path / "second_gg.py").write_text(new)
        edited = code_identity([module.f])
        after = code_identity([loaded(tmp_path, monkeypatch, second_gg=new).f])
        assert len({str(before), str(edited), str(after)}) == 3
        assert after == code_identity([loaded(tmp_path, monkeypatch, second_gg=new).f])


def test_recipe__counts_by_what_it_was_made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recipe is a function of the package's own, whatever solver it was made of."""
    monkeypatch.setattr(registry.GUIDANCES, "rows", dict(registry.GUIDANCES.rows))
    text = """
        from guided_gym.guidance.recipes import recipe
        from guided_gym.guidance.solvers.plain import Straight
        class Mine(Straight):
            factor = 1
        made = recipe(Mine, "My own.", temperature=0.5)
    """

    def yours(text: str) -> dict[str, str]:
        registry.register_guidance(loaded(tmp_path, monkeypatch, third_gg=text).made, "third", replace=True)
        spec = GuidanceSpec("hybrid(third, rrt)")
        found: dict[str, str] = settings_content("Cup", spec, EvaluationSettings())["yours"]
        return found

    before = yours(text)
    assert "third_gg" in before
    assert yours(text) == before
    assert yours(text.replace("factor = 1", "factor = 2")) != before
    # Nor has the module that calls `recipe` to be the one that its solver is in.
    assert len({str(code_identity([recipe(Straight, "", temperature=t)])) for t in (0.5, 0.6)}) == 2
    assert settings_content("Cup", GuidanceSpec("lazy_prm+rrt"), EvaluationSettings())["yours"] == {}


def script(text: str, **names: Any) -> dict[str, Any]:
    """The names of a script that ran as ``__main__``, which has no file to import."""
    space: dict[str, Any] = {"__name__": "__main__", **names}
    exec(compile(textwrap.dedent(text), "<script>", "exec"), space)
    return space


def of_script(text: str, name: str = "f", **names: Any) -> dict[str, str]:
    return code_identity([script(text, **names)[name]])


NOTEBOOK = """
    import numpy as np
    from guided_gym import GuidingSpace, register_guidance

    @register_guidance
    class Cell(GuidingSpace):
        name = "cell"
        def project(self, tree, q):
            return q
        def heuristic(self, states):
            return FACTOR * np.abs(states[:, 0])
"""


def test_notebook__that_runs_a_cell_again_gets_new_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry.GUIDANCES, "rows", dict(registry.GUIDANCES.rows))
    settings = EvaluationSettings(max_samples=40)

    def trees(factor: float) -> list[tuple[float, int]]:
        script(NOTEBOOK, FACTOR=factor)
        runs = evaluate("Cup", ["cell", "hybrid(cell, rrt)"], seeds=2, out=tmp_path, settings=settings).runs
        return [(run.total_efficiency, run.nodes) for run in runs]

    first, level = trees(1.0), trees(0.0)
    assert first != level
    assert trees(1.0) == first
    assert trees(0.0) == level
    with ResultsFile.in_folder(tmp_path) as file:
        rows = file._connection.execute("SELECT count(*) FROM runs").fetchone()
    assert rows == (2 * 4,)  # those of the first two calls


FUNCTION = """
    LIMIT = 3
    TABLE = [1.0, {"a": 2}]
    def helper(x):
        return x + 1
    class Part:
        scale = 2
        def g(self):
            return helper(self.scale)
    def f(a=1, *, b=2):
        total = [helper(a + LIMIT) for a in range(b)]
        return total, Part, TABLE
    unused = 1
"""


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("LIMIT = 3", "LIMIT = 4", False),
        ('"a": 2', '"a": 3', False),
        ("x + 1", "x + 2", False),
        ("x + 1", "x - 1", False),
        ("scale = 2", "scale = 3", False),
        ("helper(self.scale)", "self.scale", False),
        ("a=1", "a=2", False),
        ("b=2", "b=3", False),
        ("unused = 1", "unused = 2", True),
        ("    LIMIT = 3", "\n\n    # a comment\n    LIMIT = 3", True),
    ],
)
def test_script__counts_by_the_code_that_is_used(old: str, new: str, same: bool) -> None:
    assert old in FUNCTION
    assert (of_script(FUNCTION) == of_script(FUNCTION.replace(old, new))) is same
    assert of_script(FUNCTION)


def test_script__counts_by_its_closures() -> None:
    text = """
        def outer(x):
            def inner():
                return x
            return inner
        f = outer(X)
    """
    values: list[Any] = [1, 2, 1.0, "1", (1,), [1], {1, 2}, {"a": 1}, np.array([1]), np.array([1.0]), None]
    found = [str(of_script(text, X=value)) for value in values]
    assert len(set(found)) == len(found)
    assert found == [str(of_script(text, X=value)) for value in values]


def make_class(scale: float) -> type:
    class Scaled(Voronoi):
        def heuristic(self, states: Any) -> Any:
            return scale * np.ones(len(states))

    return Scaled


@pytest.mark.parametrize(
    ("make", "values"),
    [
        (make_class, (1.0, 2.0)),
        (lambda x: functools.partial(sorted, key=x), (1, 2)),
        (lambda x: functools.partial(test_script__counts_by_its_closures, x=x), (1, 2)),
    ],
)
def test_what_a_function_made__counts_by_what_it_was_made_of(make: Callable[[Any], Any], values: Any) -> None:
    one, other = values
    assert code_identity([make(one)]) == code_identity([make(one)])
    assert code_identity([make(one)]) != code_identity([make(other)])


class Held:
    """An object of no particular kind."""

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)


def test_values__count_by_what_they_hold() -> None:
    ring = Held(a=1)
    ring.ring = ring  # type: ignore[attr-defined]
    values = [
        Held(a=1),
        Held(a=2),
        Held(a=[Held(b=1)]),
        Held(a=[Held(b=2)]),
        ring,
        np.arange(3),
        np.arange(4),
        -0.0,
        0.0,
    ]
    assert len({value_identity(value) for value in values}) == len(values)
    assert value_identity(Held(a=np.arange(3))) == value_identity(Held(a=np.arange(3)))
    assert value_identity({"b", "a", "c"}) == value_identity({"c", "b", "a"})


def test_identity__is_the_same_in_every_process() -> None:
    code = textwrap.dedent(FUNCTION) + (
        "f2 = lambda x: x in {'a', 'b', 'c', 'd'}\n"
        "from guided_gym.train.identity import code_identity\n"
        "print(code_identity([f, f2]))\n"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(found) == 1
