"""Tables of names: classes and recipes, options that are names of other tables, errors that say where."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest

from guided_gym import guided_search
from guided_gym.agents.scripted import make_agent
from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance import registry, tables
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.grammar import parse
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.registry import (
    guidance_names,
    make_expander,
    make_guidance,
    parts,
    read_guidance,
    register_guidance,
)
from guided_gym.guidance.tables import Table, register_kind
from guided_gym.problems import Problem

UNKNOWN, INVALID = UnknownNameError, InvalidInputError


@dataclass
class Shrunk:
    """Obstacles that are smaller."""

    by: float = 0.1
    rounds: int = 1


class Bodiless:
    """A class without options."""


def disc(radius: float = 1.0) -> tuple[str, float]:
    """A disc, inscribed.

    More about it.
    """
    return "disc", radius


class GoalDistance(GuidingSpace):
    """The distance to the goal, obstacles ignored."""

    name: ClassVar[str] = "goal_distance"

    def project(self, tree, q):  # type: ignore[no-untyped-def]
        return q

    def heuristic(self, states):  # type: ignore[no-untyped-def]
        return self.space.distance(states, self.goal)


class Modified(GoalDistance):
    """Knows what it was made with."""

    def __init__(
        self, *, robot: Any = None, environment: Any = None, note: Any = None, size: int = 1
    ) -> None:
        super().__init__()
        self.made_with = (robot, environment, note, size)


def several(first: int = 0, *names: str, last: int = 9) -> tuple[Any, ...]:
    """Takes any number of names."""
    return first, names, last


def modified(*, robot: Any = None, environment: Any = None, note: Any = None, size: int = 1) -> GuidingSpace:
    """A recipe: what it says first.

    And what it says then.
    """
    return Modified(robot=robot, environment=environment, note=note, size=size)


@pytest.fixture(autouse=True)
def own_tables(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Tables of this test's own, and the others as they were afterwards."""
    monkeypatch.setattr(registry.GUIDANCES, "rows", dict(registry.GUIDANCES.rows))
    monkeypatch.setattr(tables, "_KINDS", dict(tables._KINDS))
    register_kind(
        "robot",
        Table("robot", {"point": lambda: "point", "disc": disc, "bodiless": Bodiless, "several": several}),
    )
    register_kind("environment", Table("environment modification", {"shrunk": Shrunk}))
    register_guidance(modified)
    yield


def made_with(text: str, **options: Any) -> Any:
    guidance = make_guidance(text, **options)
    assert isinstance(guidance, Modified)
    return guidance.made_with


def test_recipe__is_a_row_like_a_class() -> None:
    assert guidance_names()[-1] == "modified"
    assert registry.GUIDANCES.summary("modified") == "A recipe: what it says first."
    assert registry.GUIDANCES.summary("rrt") == (Voronoi.__doc__ or "").partition("\n")[0]
    made = make_guidance("modified")
    assert made.name == "modified"  # as learned rules and figures ask for it
    assert Modified.name == "goal_distance"
    assert register_guidance(modified) is modified
    register_guidance(partial(modified, size=3), name="threefold")
    assert made_with("threefold")[3] == 3
    assert made_with("threefold(size=4)")[3] == 4


def test_options__that_are_names_are_looked_up() -> None:
    assert made_with("modified(robot=disc)")[0] == ("disc", 1.0)
    assert made_with("modified(robot=disc(2))")[0] == ("disc", 2)
    assert made_with("modified@robot=disc(radius=2)@size=5") == (("disc", 2), None, None, 5)
    assert made_with("modified(environment=shrunk(0.3, rounds=2))")[1] == Shrunk(0.3, 2)
    assert made_with("modified", robot="disc(3)", environment=Shrunk(9))[:2] == (("disc", 3), Shrunk(9))
    assert made_with("modified(robot='disc(4)')")[0] == ("disc", 4)
    assert made_with("modified(robot=several)")[0] == (0, (), 9)
    assert made_with("modified(robot=several(1, a, 'b c', last=2))")[0] == (1, ("a", "b c"), 2)
    assert made_with("modified(note=disc)")[2] == "disc"  # there is no table of notes
    assert made_with("modified(note=[a, 'b c', 1])")[2] == ("a", "b c", 1)


def test_guides__are_guidances_at_any_depth() -> None:
    made = make_guidance("hybrid(rrt@goal_bias=0.1 + modified(robot=point), hybrid(prm, 'rrt+prm'))")
    assert isinstance(made, Hybrid)
    first, second = made.guides
    assert isinstance(first, Hybrid) and isinstance(second, Hybrid)
    assert [guide.name for guide in first.guides] == ["rrt", "modified"]
    assert [guide.name for guide in second.guides] == ["prm", "hybrid"]
    for same in (make_guidance("hybrid", guides=["rrt", "prm"]), make_guidance("hybrid(guides=[rrt, prm])")):
        assert [guide.name for guide in same.guides] == ["rrt", "prm"]  # type: ignore[attr-defined]
    assert [guide.name for guide in make_guidance("hybrid(rrt)").guides] == ["rrt"]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("rrrt", UNKNOWN, r"^unknown guidance 'rrrt'; did you mean 'rrt'\?"),
        ("prm + rrrt", UNKNOWN, r"'rrrt' at character 7 of 'prm \+ rrrt'; did you mean 'rrt'"),
        ("hybrid(prm, hybrid(rrrt))", UNKNOWN, r"guidance 'rrrt' at character 20 of .*mean 'rrt'"),
        ("RRT", UNKNOWN, r"^unknown guidance 'RRT'; did you mean 'rrt'\?"),
        ("a" * 9000, UNKNOWN, r"^unknown guidance 'a{199}…"),
        ("rrt(goal_bais=1)", UNKNOWN, r"'goal_bais' at character 5 of .*did you mean 'goal_bias'"),
        ("prm+rrt@goal_bais=1", UNKNOWN, r"'goal_bais' at character 9 of .*did you mean 'goal_bias'"),
        ("modified(robot=disk)", UNKNOWN, r"robot 'disk' at character 16 of .*did you mean 'disc'"),
        ("prm+modified@robot=disc(radus=1)", UNKNOWN,
         r"option of robot 'disc': 'radus' at character 25 of .*did you mean 'radius'"),
        ("modified(environment=shrink)", UNKNOWN, r"'shrink' at character 22.*did you mean 'shrunk'"),
        ("hybrid(learned:piont)", UNKNOWN, r"'piont'; did you mean 'point'.* at character 8 of"),
        ("modified(robot=disc(1, 2))", INVALID,
         r"robot 'disc': expected at most 1 options without a name, got 2 at character 16"),
        ("modified(robot=disc(1, radius=2))", INVALID, r"the option 'radius' once, got it twice at"),
        ("rrt(cell_samples=f(3))", INVALID, r"'cell_samples': expected a value, got a call at .* 18"),
        ("hybrid(prm, rrt(goal_bias=7))", INVALID,
         r"goal_bias: expected .*got 7 \(guidance 'rrt' at character 13 of"),
        ("hybrid(prm, rrt(goal_bias=fast))", INVALID, r"goal_bias: expected .*got 'fast' \(guid.* 13"),
        ("hybrid(3)", INVALID, r"guides: expected .*got 3"),
        ("hybrid(rrt, guides=[prm])", INVALID, r"guides once, got them twice at character 1"),
        ("modified(robot=0.5)", INVALID, r"robot: expected a robot or its name, got 0.5"),
        ("modified(robot=[disc])", INVALID, r"robot: expected a robot or its name, got \("),
        ("modified(robot=bodiless(size=1))", UNKNOWN, r"option of robot 'bodiless': 'size' at character 25"),
        ("lazy_prm(factor=far)", INVALID, r"factor: expected .*got 'far'"),
        ("lazy_prm(node=3)", INVALID, r"node: expected True or False, got 3"),
        ("lazy_prm(lesson=all)", INVALID, r"lesson: expected a Lesson, got 'all'"),
        ("os:getcwd", INVALID, r"'os:getcwd': expected a GuidingSpace"),
    ],
)  # fmt: skip
def test_errors__say_what_and_where(text: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message) as caught:
        make_guidance(text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).count("at character") <= 1


def test_options__are_given_once() -> None:
    assert vars(make_guidance("rrt@goal_bias=0.1", cell_samples=7))["goal_bias"] == 0.1
    inner = make_guidance("searched", guidance="rrt(goal_bias=0.2)").solver.guidance  # type: ignore[attr-defined]
    assert vars(inner)["goal_bias"] == 0.2  # an option that is called as an argument of ours is
    assert make_agent("searched", guidance="rrt").guidance.name == "searched"  # type: ignore[attr-defined]
    with pytest.raises(InvalidInputError, match="the option 'goal_bias' once"):
        make_guidance("rrt@goal_bias=0.1", goal_bias=0.2)


def test_recipe__has_to_make_a_guiding_space() -> None:
    register_guidance(lambda: 3, name="three")
    with pytest.raises(
        InvalidInputError, match="guidance 'three': expected it to make a GuidingSpace, got 3"
    ):
        make_guidance("three")
    with pytest.raises(InvalidInputError, match="expected a name that is free"):
        register_guidance(lambda: 4, name="three")
    with pytest.raises(InvalidInputError, match="expected a word"):
        register_guidance(lambda: 3)
    register_guidance(lambda size: Modified(size=size), name="sized")
    with pytest.raises(InvalidInputError, match="guidance 'sized': expected the option 'size'"):
        make_guidance("sized")


def test_class__that_lacks_a_method_is_named() -> None:
    @register_guidance
    class Half(GuidingSpace):
        """Forgot its heuristic."""

        name: ClassVar[str] = "half"

        def project(self, tree, q):  # type: ignore[no-untyped-def]
            return q

    with pytest.raises(InvalidInputError, match="guidance 'half': expected its class to define heuristic"):
        make_guidance("half")


class Forgetful(GuidingSpace):
    """Forgets what it is told to."""

    name: ClassVar[str] = "forgetful"

    def __init__(self, *, states: bool = True) -> None:
        if not states:
            super().__init__()

    def project(self, tree, q):  # type: ignore[no-untyped-def]
        """Says nothing."""

    def heuristic(self, states):  # type: ignore[no-untyped-def]
        return np.zeros(len(states))


@pytest.mark.parametrize("expansion", [None, "uniform"])
def test_guiding_space__that_forgets_is_told_what(
    walled: Callable[[str], Problem], expansion: str | None
) -> None:
    said = {
        True: r"Forgetful.__init__: expected it to call super\(\).__init__\(\)",
        False: "Forgetful.project: expected the states of 1 conf.*got None",
    }
    for states, message in said.items():
        guidance = Forgetful(states=states)
        with pytest.raises(InvalidInputError, match=message):
            guided_search(walled("point"), guidance, seed=0, max_samples=5, expansion=expansion)


def test_expressions__are_taken_everywhere(walled: Callable[[str], Problem]) -> None:
    problem = walled("rectangle")
    found = [
        guided_search(problem, text, seed=0, max_samples=40, measure=False, expansion=expansion).tree
        for text, expansion in (
            ("lazy_prm@vertices=200", None),
            ("lazy_prm(vertices=200)", "lazy_prm( vertices = 200 )"),
            ("hybrid(lazy_prm(vertices=200))", None),
        )
    ]
    assert (found[0].configurations == found[2].configurations).all()
    assert isinstance(make_expander("rrt@goal_bias=0.1"), Voronoi)
    with pytest.raises(UnknownNameError, match="unknown expansion 'unifrom'; did you mean 'uniform'"):
        make_expander("unifrom")
    env = gym.make("guided_gym/Cup-v0", expansion="rrt(goal_bias=0.1)", max_nodes=32)
    agent = make_agent("rrt@goal_bias=0.1", env)
    observation, info = env.reset(seed=0)
    env.step(agent.act(observation, info))
    assert agent.guidance is env.unwrapped.expander  # type: ignore[attr-defined]  # one spelling is as good
    with pytest.raises(UnknownNameError, match="unknown agent 'rnadom'; did you mean 'random'"):
        make_agent("rnadom")
    selection = gym.make(
        "guided_gym/GuideSelection-v0", guides=["lazy_prm(vertices=50)", "rrt"], max_samples=5
    )
    assert selection.action_space.n == 2  # type: ignore[attr-defined]


def test_parts__are_all_calls_with_their_tables() -> None:
    text = "hybrid(modified(robot=disc(1)), 'rrt+prm', guides=3)"
    with pytest.raises(InvalidInputError, match="twice"):
        make_guidance(text)
    call = read_guidance("hybrid(modified(robot=disc(1)), 'rrt + prm')")
    found = [(part.name, table.kind) for part, table in parts(call)]
    names = ["hybrid", "modified", "disc", "hybrid", "rrt", "prm"]
    assert found == [(name, "robot" if name == "disc" else "guidance") for name in names]
    assert call == parse("hybrid(modified(robot=disc(1)), rrt+prm)")


@pytest.mark.parametrize(
    ("expression", "name"),
    [
        ("lazy_prm(vertices=1000000000)", "vertices, neighbours"),
        ("prm(neighbours=1000000000)", "vertices, neighbours"),
        ("lazy_prm(anchors=1000000000)", "anchors"),
        ("lazy_prm(vertices=1" + 40 * "0" + ")", "vertices, neighbours"),
        ("wavefront(cells=8" + 30 * "0" + ")", "cells, headings"),
        ("wavefront(headings=100000000)", "cells, headings"),
        ("wavefront(candidates=10000000000)", "candidates"),
        ("medial_axis(spacing=1e-300)", "spacing"),
    ],
)
def test_sizes_beyond_all_memory_are_refused_at_once(expression: str, name: str) -> None:
    problem = make_distribution("Cup").problem(0)
    with pytest.raises(InvalidInputError, match=rf"{name}: .* would take .* GB .* GUIDED_GYM_MAX_MEMORY"):
        guided_search(problem, expression, seed=0, max_samples=1, measure=False)


def test_names_longer_than_any_path_are_unknown() -> None:
    with pytest.raises(UnknownNameError, match="learned agent"):
        make_guidance("learned:" + 5000 * "a")
