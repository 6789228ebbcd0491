"""What notebooks show: well-formed, with names as text, and the same tree."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium
import numpy as np
import pytest
from shapely.geometry import box

from guided_gym import (
    Environment,
    Linkage,
    Problem,
    Robot,
    SearchOptions,
    Task,
    evaluate,
    guided_search,
    make_distribution,
    make_guidance,
    read_trace,
)
from guided_gym.display.notebook import lines_again
from guided_gym.options import TargetParameters
from guided_gym.train.specs import EvaluationSettings

SCRIPT = "</title><script>alert('x')</script>"
VOID = {"meta", "rect", "path", "circle", "image", "br", "input"}


class _Balanced(HTMLParser):
    """Whether every element is closed in its order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.seen.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open and self.open.pop() == tag, tag


def checked(text: str) -> list[str]:
    """The tags of some HTML, which is balanced."""
    parser = _Balanced()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    return parser.seen


@pytest.fixture(scope="module")
def problem() -> Problem:
    return make_distribution("TrapCup").problem(0)


def test_problem__is_a_picture_and_a_table(problem: Problem) -> None:
    text = problem._repr_html_()
    assert {"svg", "table", "title"} <= set(checked(text))
    svg = ElementTree.fromstring(text[text.index("<svg") : text.rindex("</svg>") + 6])
    paths = svg.iter("{http://www.w3.org/2000/svg}path")
    assert sum(1 for _ in paths) == len(problem.environment.obstacles) + 2  # and start and goal
    assert "rectangle" in text and "TrapCup" in text


def test_problem__where_obstacles_overlap_is_no_hole() -> None:
    overlapping = (box(2, 2, 6, 6), box(4, 4, 8, 8))
    space = Problem(Robot.point(), Environment((0, 0, 10, 10), overlapping), Task([1, 1], [9, 9]), "two")
    subpaths = [data.count("M") for data in re.findall(r'<path d="([^"]*)"', space._repr_html_())]
    assert subpaths == [1, 1]


def test_problem__in_space_has_its_sides_and_is_seen_through() -> None:
    problem = make_distribution("SpatialArm").sample(np.random.default_rng(0))
    text = problem._repr_html_()
    room = np.array(problem.environment.room)
    assert " x ".join(f"{side:.6g}" for side in room[3:] - room[:3]) in text
    assert text.count('fill-opacity="0.22"') == len(problem.environment.obstacles)


def test_problem__of_arms_and_points() -> None:
    room = Environment((0, 0, 10, 10), (box(6, 6, 7, 7),))
    arm = Problem(Linkage.arm([1.0, 1.0], base=(5, 5)), room, Task([0.0, 0.0], [2.0, 0.5]), "arm")
    assert checked(arm._repr_html_()).count("path") == 1 + 2 * 2
    point = make_distribution("RandomPointMaze").problem(0)
    assert checked(point._repr_html_()).count("circle") == 2


def test_names_are_text(problem: Problem) -> None:
    named = Problem(problem.robot, problem.environment, problem.task, SCRIPT)
    result = guided_search(named, "medial_axis", seed=0, max_samples=5)
    for text in (named._repr_html_(), result._repr_html_()):
        assert "script" not in checked(text)


@pytest.mark.parametrize("rewire", [False, True])
def test_result__is_played_as_a_trace_would_be(problem: Problem, tmp_path: Path, rewire: bool) -> None:
    options = SearchOptions(rewire=rewire, target=TargetParameters(delta=0.2))
    result = guided_search(
        problem, "rrt", seed=1, max_samples=150, options=options, trace=tmp_path / "trace.jsonl"
    )
    lines, samples = lines_again(result), read_trace(tmp_path / "trace.jsonl").samples
    assert lines is not None and lines[0]["target"]["delta"] == 0.2
    rows = [row for row in lines if "n" in row]
    assert [row["n"] for row in rows] == [sample.node for sample in samples]
    assert [list(map(tuple, row.get("w", []))) for row in rows] == [list(s.parents) for s in samples]
    np.testing.assert_allclose([row["s"] for row in rows], [s.efficiency for s in samples], rtol=1e-3)
    text = result._repr_html_()
    assert checked(text) == ["iframe"] and 'sandbox="allow-scripts"' in text


def test_result__that_was_not_measured(problem: Problem) -> None:
    result = guided_search(problem, "goal_distance", seed=1, max_samples=20, measure=False)
    lines = lines_again(result)
    assert lines is not None and not any("s" in row for row in lines)


@pytest.mark.parametrize(
    "name", ["rrt", "uninformed", "goal_distance", "lazy_prm", "medial_axis", "wavefront", "hybrid", "oracle"]
)
def test_guiding_space__before_and_after(problem: Problem, name: str) -> None:
    guide = make_guidance(name)
    assert "not prepared" in guide._repr_html_()
    guided_search(problem, guide, seed=0, max_samples=30, measure=False)
    looks, state = guide.search.looks, guide.rng.bit_generator.state
    text = guide._repr_html_()
    tags = checked(text)
    assert tags.count("title") == (2 if name == "hybrid" else 1)
    assert ("image" in tags) == (name in ("goal_distance", "wavefront", "oracle"))
    assert guide.search.looks == looks and guide.rng.bit_generator.state == state  # looking changes nothing


def test_field__is_a_picture_of_h(problem: Problem) -> None:
    """The strongest pixel is at the goal, where h is least."""
    image = pytest.importorskip("PIL.Image")
    import base64
    import io

    guide = make_guidance("goal_distance")
    guided_search(problem, guide, seed=0, max_samples=1, measure=False)
    data = re.search(r'data:image/png;base64,([^"]+)', guide._repr_html_())
    assert data is not None
    alpha = np.asarray(image.open(io.BytesIO(base64.b64decode(data[1]))))[..., 3]
    row, column = np.unravel_index(np.argmax(alpha), alpha.shape)
    xmin, ymin, xmax, ymax = problem.environment.bounds
    at = (
        xmin + (column + 0.5) / alpha.shape[1] * (xmax - xmin),
        ymax - (row + 0.5) / alpha.shape[0] * (ymax - ymin),
    )
    np.testing.assert_allclose(at, problem.task.goal[:2], atol=(xmax - xmin) / 40)


def test_environments__before_and_after_a_reset() -> None:
    for name in ("TrapCup", "GuideSelection"):
        env = gymnasium.make(f"guided_gym/{name}-v0").unwrapped
        assert "no search yet" in env._repr_html_()
        env.reset(seed=0)
        env.step(0)
        assert {"svg", "table"} <= set(checked(env._repr_html_()))


def test_results__are_the_table(problem: Problem) -> None:
    settings = EvaluationSettings(max_samples=30)
    results = evaluate("Cup", ["goal_distance", "medial_axis"], seeds=2, settings=settings)
    text = results._repr_html_()
    assert checked(text).count("tr") == 3
    assert "medial_axis" in text and "script" not in checked(text)
