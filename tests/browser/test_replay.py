"""The page of a replay in a real browser: its controls work, its pixels change, nothing foreign runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import box, get_coordinates

from guided_gym import (
    Environment,
    Linkage,
    Problem,
    SearchOptions,
    StorageError,
    Task,
    guided_search,
    make_distribution,
    read_trace,
)
from guided_gym.display.replay import replay_page, trace_content

Pixels = Callable[[Any], np.ndarray[Any, Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Traces of a hybrid, of RRT rewired, and of a wave, and the pages of them."""
    folder = tmp_path_factory.mktemp("traces")
    problem = make_distribution("TrapCup").problem(0)
    guided_search(problem, "hybrid", seed=3, trace=folder / "hybrid.jsonl")
    options = SearchOptions(rewire=True)
    guided_search(problem, "rrt", seed=3, max_samples=300, options=options, trace=folder / "rrt.jsonl")
    guided_search(problem, "wavefront", seed=3, trace=folder / "wavefront.jsonl")
    for name, traces in {"one": ["hybrid"], "two": ["rrt", "hybrid"], "wave": ["wavefront"]}.items():
        page = replay_page([folder / f"{trace}.jsonl" for trace in traces])
        (folder / f"{name}.html").write_text(page, encoding="utf-8")
    return folder


def value(page: Any, expression: str) -> Any:
    return page.evaluate(expression)


def wait_until(page: Any, expression: str) -> None:
    """Ask until it is so; `wait_for_function` evaluates texts in the page, which its policy forbids."""
    end = time.monotonic() + 60
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def test_replay__plays_steps_and_scrubs(folder: Path, open_page: Any, pixels: Pixels) -> None:
    page = open_page(folder / "one.html")
    stage = page.locator("canvas.stage")
    first = pixels(stage)
    page.get_by_role("button", name="One sample on").click()
    assert value(page, "player.sample") == 1
    assert (pixels(stage) != first).any()
    page.get_by_role("button", name="To the end").click()
    samples = len(read_trace(folder / "hybrid.jsonl"))
    assert value(page, "player.sample") == samples
    assert "reaches the goal" in page.locator(".readout").inner_text()
    assert page.get_by_role("slider", name="Sample").input_value() == str(samples)
    page.get_by_role("button", name="To the start").click()
    np.testing.assert_array_equal(pixels(stage), first)
    page.get_by_label("Speed").select_option("1000")
    page.get_by_role("button", name="Play").click()
    wait_until(page, "!player.playing && player.sample > 0")
    assert value(page, "player.sample") == samples
    page.get_by_role("slider", name="Sample").fill("7")
    assert value(page, "player.sample") == 7


def test_replay__keys_and_layers(folder: Path, open_page: Any, pixels: Pixels) -> None:
    page = open_page(folder / "one.html")
    page.keyboard.press("End")
    stage = page.locator("canvas.stage")
    for key, label in (("g", "guide's view"), ("t", "tree"), ("c", "collisions"), ("p", "path found")):
        before = pixels(stage)
        page.keyboard.press(key)
        assert not page.get_by_label(label, exact=True).is_checked()
        assert (pixels(stage) != before).any(), label
        page.get_by_label(label, exact=True).check()
        np.testing.assert_array_equal(pixels(stage), before)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowLeft")
    assert value(page, "player.length - player.sample") == 11
    page.locator("h1").click()  # a box that is focused keeps its own space key
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    assert value(page, "player.playing")
    page.keyboard.press(" ")
    assert not value(page, "player.playing")
    # Buttons keep their own space key.
    page.get_by_role("button", name="One sample on").focus()
    sample = value(page, "player.sample")
    page.keyboard.press(" ")
    assert value(page, "[player.sample, player.playing]") == [sample + 1, False]


def test_replay__whose_view_is_shown(folder: Path, open_page: Any, pixels: Pixels) -> None:
    page = open_page(folder / "one.html")
    page.keyboard.press("End")
    select, stage = page.get_by_label("Whose view"), page.locator("canvas.stage")
    assert select.locator("option").all_inner_texts() == ["who guides", "lazy_prm", "medial_axis"]
    select.select_option("0")
    roadmap = pixels(stage)
    select.select_option("1")
    assert (pixels(stage) != roadmap).any()


def test_replay__zooms_and_moves_and_comes_back(folder: Path, open_page: Any, pixels: Pixels) -> None:
    page = open_page(folder / "one.html")
    page.keyboard.press("End")
    stage = page.locator("canvas.stage")
    whole, box = pixels(stage), stage.bounding_box()
    x, y = round(box["x"] + box["width"] / 3), round(box["y"] + box["height"] / 3)
    world = "player.stages[0].toWorld({}, {})".format
    before = value(page, world(x, y))
    page.mouse.move(x, y)
    page.mouse.wheel(0, -400)
    wait_until(page, "player.stages[0].view.zoom > 1.5")
    assert value(page, world(x, y)) == pytest.approx(before, abs=1e-6)  # what is pointed at stays
    page.mouse.down()
    page.mouse.move(x + 50, y + 20)
    page.mouse.up()
    assert value(page, world(x + 50, y + 20)) == pytest.approx(before, abs=1e-6)
    page.mouse.move(0, 0)  # away from the nodes
    page.get_by_role("button", name="Show the whole workspace").click()
    np.testing.assert_array_equal(pixels(stage), whole)


def test_replay__pinch(folder: Path, open_page: Any) -> None:
    page = open_page(folder / "one.html", width=390, height=844)
    session = page.context.new_cdp_session(page)
    box = page.locator("canvas.stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def touch(kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": a, "y": b, "id": i} for i, (a, b) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    touch("touchStart", (x - 30, y), (x + 30, y))
    for spread in (40, 60, 90):
        touch("touchMove", (x - spread, y), (x + spread, y))
    touch("touchEnd")
    assert value(page, "player.stages[0].view.zoom") == pytest.approx(3.0, rel=0.05)


def test_replay__the_tree_is_that_of_the_trace(folder: Path, open_page: Any) -> None:
    """Parents and costs after some samples, rewiring included, forwards and backwards, as in Python."""
    page = open_page(folder / "two.html")
    trace = read_trace(folder / "rrt.jsonl")
    tree = trace.replay().tree
    assert tree.rewirings > 0
    told = """(() => { const t = player.traces[0], n = t.sizes[t.at];
        return [t.parent.slice(0, n), t.cost.slice(0, n)]; })()"""
    page.evaluate("player.seek(1e9)")
    parents, costs = value(page, told)
    assert parents == tree.parents.tolist()
    np.testing.assert_allclose(costs, tree.cost_to_come, rtol=1e-4)
    halfway = len(trace) // 2
    page.evaluate(f"player.seek({halfway})")
    trace.samples = trace.samples[:halfway]
    tree = trace.replay().tree
    parents, costs = value(page, told)
    assert parents == tree.parents.tolist()
    np.testing.assert_allclose(costs, tree.cost_to_come, rtol=1e-4)


def test_replay__q_is_that_of_python(folder: Path, open_page: Any) -> None:
    page = open_page(folder / "one.html")
    samples = read_trace(folder / "hybrid.jsonl").samples
    for number in (0, 10, len(samples) - 1):
        page.evaluate(f"player.seek({number})")
        q = value(page, f"player.traces[0].probability({samples[number].node})")
        assert -np.log(q) == pytest.approx(samples[number].efficiency, abs=2e-3)


def test_replay__two_side_by_side_are_in_step(folder: Path, open_page: Any) -> None:
    page = open_page(folder / "two.html")
    assert page.locator("canvas.stage").count() == 2
    page.evaluate("player.seek(200)")
    hybrid = len(read_trace(folder / "hybrid.jsonl"))
    assert value(page, "player.stages.map((stage) => stage.sample)") == [200, hybrid]
    page.keyboard.press("+")
    zooms = value(page, "player.stages.map((stage) => stage.view.zoom)")
    assert zooms[0] == zooms[1] > 1
    left, right = (page.locator("canvas.stage").nth(i).bounding_box() for i in (0, 1))
    assert right["x"] > left["x"] + left["width"]


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_replay__fits_the_window_in_light_and_dark(
    folder: Path, open_page: Any, pixels: Pixels, theme: str, width: int
) -> None:
    page = open_page(folder / "two.html", width=width, theme=theme)
    assert value(page, "document.documentElement.scrollWidth") == width
    paper = pixels(page)[2, 2, :3].mean()
    assert paper > 240 if theme == "light" else paper < 40
    page.get_by_role("button", name="Change to").click()
    assert abs(pixels(page)[2, 2, :3].mean() - paper) > 200
    small = [
        box
        for box in (one.bounding_box() for one in page.get_by_role("button").all())
        if min(box["width"], box["height"]) < 34
    ]
    assert small == []  # all can be hit with a finger


def test_replay__every_control_has_a_name(folder: Path, open_page: Any) -> None:
    page = open_page(folder / "one.html")
    nameless = """[...document.querySelectorAll("button, input, select, canvas")]
        .filter((one) => !(one.getAttribute("aria-label") || one.textContent.trim()
            || (one.labels && one.labels.length)))
        .map((one) => one.outerHTML)"""
    assert value(page, nameless) == []
    page.keyboard.press("End")
    label = page.locator("canvas.stage").get_attribute("aria-label")
    assert label.startswith("hybrid on TrapCup after") and "nodes" in label


def test_replay__points_at_a_node(folder: Path, open_page: Any) -> None:
    page = open_page(folder / "wave.html")
    page.keyboard.press("End")
    box = page.locator("canvas.stage").bounding_box()
    x, y = value(page, "player.stages[0].toScreen(player.traces[0].x[0], player.traces[0].y[0])")
    page.mouse.move(box["x"] + x, box["y"] + y)
    assert "way from the start 0" in " ".join(page.locator(".readout").inner_text().split())


def test_replay__loads_nothing(folder: Path, open_page: Any) -> None:
    open_page(folder / "one.html")
    assert [url for url in open_page.asked if not url.startswith("file:")] == []
    assert len(open_page.asked) == 1


SCRIPT = "</script><script>document.title = 'run'</script><img src=x onerror=\"document.title = 'run'\">"


def test_replay__names_with_script_are_shown_as_text(open_page: Any, tmp_path: Path) -> None:
    one = make_distribution("Cup").problem(0)
    problem = Problem(one.robot, one.environment, one.task, SCRIPT, {SCRIPT: one.environment.free_space})
    guided_search(problem, "goal_distance", seed=0, max_samples=5, trace=tmp_path / "trace.jsonl")
    lines = (tmp_path / "trace.jsonl").read_text(encoding="utf-8").splitlines()
    header = json.loads(lines[0])
    header |= {
        "guidance": SCRIPT,
        "title": SCRIPT + "\u2028",
        "guides": [SCRIPT],
        "version": SCRIPT,
        "seed": SCRIPT,
    }
    (tmp_path / "trace.jsonl").write_text("\n".join([json.dumps(header), *lines[1:]]), encoding="utf-8")
    (tmp_path / "page.html").write_text(replay_page([tmp_path / "trace.jsonl"]), encoding="utf-8")
    page = open_page(tmp_path / "page.html")
    page.evaluate("player.show('regions', true); player.seek(3)")
    assert page.title() == f"{SCRIPT} on {SCRIPT}"
    assert page.locator("figcaption strong").inner_text() == SCRIPT + "\u2028"
    assert page.locator("img").count() == 0


def test_replay__a_truncated_trace_says_so(folder: Path, open_page: Any, tmp_path: Path) -> None:
    text = (folder / "hybrid.jsonl").read_text(encoding="utf-8")
    (tmp_path / "cut.jsonl").write_text(text[: int(0.9 * len(text))], encoding="utf-8")
    (tmp_path / "page.html").write_text(replay_page([tmp_path / "cut.jsonl"]), encoding="utf-8")
    page = open_page(tmp_path / "page.html")
    assert "This trace ends early: line" in page.locator(".notice").inner_text()
    assert value(page, "player.length") == len(read_trace(tmp_path / "cut.jsonl")) > 0


def test_replay__of_more_samples_than_are_shown_says_so(folder: Path, open_page: Any, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(replay_page([folder / "rrt.jsonl"], samples=20), encoding="utf-8")
    page = open_page(tmp_path / "page.html")
    assert value(page, "player.length") == 20
    assert (
        page.locator(".notice").inner_text() == "The search has 300 samples, of which the first 20 are shown."
    )


def test_replay__of_another_version_is_refused_in_python_and_in_the_page(
    folder: Path, open_page: Any, tmp_path: Path
) -> None:
    text = (folder / "hybrid.jsonl").read_text(encoding="utf-8")
    (tmp_path / "new.jsonl").write_text(text.replace("trace 1", "trace 2", 1), encoding="utf-8")
    with pytest.raises(StorageError, match="another version of it: 'guided-gym trace 2'"):
        trace_content(tmp_path / "new.jsonl")
    page = replay_page([folder / "hybrid.jsonl"]).replace('trace 1",', 'trace 2",', 1)
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    shown = open_page(tmp_path / "page.html").get_by_role("alert").inner_text()
    assert "expected guided-gym trace 1, got guided-gym trace 2" in shown


def test_replay__is_small(folder: Path) -> None:
    """Some 370 samples, a roadmap of 1,000 vertices included; benchmarks/replay.py measures what is slow."""
    assert len((folder / "two.html").read_bytes()) < 400_000


def test_replay__draws_arms_where_they_are(open_page: Any, tmp_path: Path) -> None:
    """The page's kinematics against Python's: every body and the tool, at every node."""
    arm = Linkage.arm([1.0, 0.8, 0.6], 0.1, base=(5, 5))
    room = Environment((0, 0, 10, 10), (box(6.5, 5.6, 9, 6.2),))
    problem = Problem(arm, room, Task([-1.2, 0.3, 0.2], [1.3, 0.4, -0.3]), "arm")
    result = guided_search(
        problem, "rrt", seed=0, max_samples=60, measure=False, trace=tmp_path / "trace.jsonl"
    )
    (tmp_path / "page.html").write_text(replay_page([tmp_path / "trace.jsonl"]), encoding="utf-8")
    page = open_page(tmp_path / "page.html")
    q = result.tree.configurations
    tips = value(page, "player.traces[0].x.map((x, i) => [x, player.traces[0].y[i]])")
    # Pages round angles to 1e-4, and the arm is 2.4 long.
    np.testing.assert_allclose(tips, arm.position(q), atol=3 * 0.5e-4 * 2.4)
    placed = page.evaluate(
        "(q) => player.traces[0].kinematics.place(q).map((body) => [...body.points])", q[-1].tolist()
    )
    for points, shape in zip(placed, arm.place(q[-1]), strict=True):
        corners = get_coordinates(shape)[:-1].ravel()
        np.testing.assert_allclose(points, corners, atol=1e-9)


@pytest.mark.parametrize(("theme", "paper"), [("light", "rgb(255, 255, 255)"), ("dark", "rgb(20, 23, 28)")])
def test_notebook__a_result_plays_in_a_frame_of_its_own(
    open_page: Any, tmp_path: Path, theme: str, paper: str
) -> None:
    result = guided_search(make_distribution("Cup").problem(0), "medial_axis", seed=0)
    (tmp_path / "page.html").write_text(f"<meta charset=utf-8>{result._repr_html_()}", encoding="utf-8")
    page = open_page(tmp_path / "page.html", theme=theme)
    frame = page.frame_locator("iframe")
    body = frame.locator("body")  # as the drawing, which is as the system
    assert body.evaluate("(body) => getComputedStyle(body).backgroundColor") == paper
    frame.get_by_role("button", name="To the start").click()
    assert frame.get_by_role("slider", name="Sample").input_value() == "0"
    frame.get_by_role("button", name="One sample on").click()
    assert "chosen: node 0" in frame.locator(".readout").inner_text()
