"""Guidances as evaluations know them: one spelling each, a label that reads well, and what counts of them."""

from __future__ import annotations

import pickle
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.cells import Uninformed
from guided_gym.guidance.grammar import Call, parse
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned.folders import agent_folder
from guided_gym.train import cli
from guided_gym.train.evaluation import as_specs
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec, learned_word, settings_content, words


@pytest.mark.parametrize(
    ("text", "name", "options", "label"),
    [
        ("rrt", "rrt", {}, "rrt"),
        (" rrt@goal_bias=0.5@cell_samples=16", "rrt", {"cell_samples": 16, "goal_bias": 0.5},
         "rrt@cell_samples=16@goal_bias=0.5"),
        ("rrt(goal_bias=0.5)", "rrt", {"goal_bias": 0.5}, "rrt@goal_bias=0.5"),
        ("path_database@database=runs/x.sqlite", "path_database", {"database": "runs/x.sqlite"},
         "path_database@database=x.sqlite"),
        ("rrt + lazy_prm", "hybrid(rrt, lazy_prm)", {}, "rrt+lazy_prm"),
        ("hybrid(rrt@goal_bias=0.1,lazy_prm)", "hybrid(rrt(goal_bias=0.1), lazy_prm)", {},
         "rrt@goal_bias=0.1+lazy_prm"),
        ("hybrid(rrt, 'prm+rrt')", "hybrid(rrt, hybrid(prm, rrt))", {}, "rrt+prm+rrt"),
        ("hybrid(rrt)", "hybrid(rrt)", {}, "hybrid(rrt)"),
        ("f(x=[1, b], y=true, z='a b')", "f", {"x": (1, "b"), "y": True, "z": "a b"},
         "f@x=[1, \"b\"]@y=true@z=\"a b\""),
        ("f(x=g(1))", "f(x=g(1))", {}, "f(x=g(1))"),
        ('learned:"a, b"@patience=1', 'learned:"a, b"', {"patience": 1}, 'learned:"a, b"@patience=1'),
        ("m.n:Class", "m.n:Class", {}, "m.n:Class"),
    ],
)  # fmt: skip
def test_spec__is_read(text: str, name: str, options: dict[str, object], label: str) -> None:
    spec = GuidanceSpec.parse(text)
    assert (spec.name, dict(spec.options), spec.label) == (name, options, label)
    assert GuidanceSpec(spec.name, spec.options) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec
    assert GuidanceSpec.parse(str(spec.call)) == spec


def test_spec__has_one_spelling() -> None:
    spellings = [
        GuidanceSpec.parse("rrt+path_database@paths=3"),
        GuidanceSpec("hybrid(rrt,path_database(paths=3),)"),
        GuidanceSpec.of("hybrid", guides=["rrt", "path_database@paths=3"]),
        GuidanceSpec.parse("hybrid(guides=[rrt, path_database(paths=3)])"),
    ]
    assert len(set(spellings)) == 1
    contents = [settings_content("Cup", spec, EvaluationSettings()) for spec in spellings]
    assert all(content == contents[0] for content in contents)


def test_spec__makes_what_it_says() -> None:
    made = GuidanceSpec.parse("hybrid(rrt@goal_bias=0.2, goal_distance)").make()
    assert isinstance(made, Hybrid)
    assert [guide.name for guide in made.guides] == ["rrt", "goal_distance"]
    assert vars(made.guides[0])["goal_bias"] == 0.2
    with pytest.raises(UnknownNameError, match=r"'goal_bais' at character 12 of .*did you mean 'goal_bias'"):
        GuidanceSpec.parse("hybrid(rrt(goal_bais=0.2), prm)").make()


def test_spec__may_hold_what_no_text_can_say() -> None:
    guide = Uninformed()
    made = GuidanceSpec.of("hybrid", guides=[guide, "rrt"]).make()
    assert isinstance(made, Hybrid)
    assert made.guides[0] is guide


def test_database__reaches_each_guidance_that_needs_one(tmp_path: Path) -> None:
    file = tmp_path / "a+b, c.sqlite"
    file.touch()
    texts = ["path_database", "hybrid(rrt, path_database(paths=3))", "path_database@database=own", "rrt"]
    specs = as_specs(texts, file)
    for spec, path in zip(specs, [str(file), str(file), "own", None], strict=True):
        calls = [spec.call, *(a for a in spec.call.arguments if isinstance(a, Call))]
        (found,) = {
            option.value for call in calls for option in call.options if option.name == "database"
        } or {None}
        assert (found.name if isinstance(found, Call) else found) == path
    assert [spec.label for spec in specs] == [GuidanceSpec.parse(text).label for text in texts]
    with pytest.raises(InvalidInputError, match="expected path_database among the guidances"):
        as_specs(["rrt+lazy_prm"], file)


@pytest.mark.parametrize("folder", ["hybrid-A+B", "a@test+b@test", "a b", "a,b", "it's", "a(1)"])
def test_learned_word__names_the_folder_to_a_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    agent = Path("runs") / folder / "agent"
    agent.mkdir(parents=True)
    (typed,) = shlex.split(learned_word(agent))
    (item,) = words("guidance", typed)
    assert parse(item) == Call(f"learned:{agent}")
    if "+" in folder:
        assert learned_word(agent) == f"learned:runs/{folder}/agent"  # as people write it


def test_trained_on_two_environments__is_found_by_the_command_that_training_suggests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = Path("runs") / "hybrid-RandomTrapCup+RandomMaze" / "agent"
    shutil.copytree(agent_folder("trap-cup-hybrid"), folder)
    (tmp_path / "runs" / "hybrid-RandomTrapCup").mkdir()  # a shorter path that exists, too
    command = f"evaluate --guidance {learned_word(folder)} --env Cup --seeds 1 --workers 1 --max-samples 40"
    result = CliRunner().invoke(cli.app, [*shlex.split(command), "--no-figures", "--out", "out"])
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "out" / "table.csv").exists()
    made = GuidanceSpec.parse(f"learned:{folder}@temperature=1.0+rrt").make()
    assert [guide.name for guide in made.guides] == [f"learned:{folder}", "rrt"]  # type: ignore[attr-defined]
