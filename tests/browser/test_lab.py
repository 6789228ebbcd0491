"""The lab in a real browser: from nothing to a problem of one's own, solved, replayed and saved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guided_gym import load_problem

pytest.importorskip("starlette", reason="the extra [lab] is not installed")

Pixels = Callable[[Any], np.ndarray[Any, Any]]
SECONDS = 120  # a first search may have to wait for kernels


@pytest.fixture(scope="module")
def lab(
    serve_lab: Callable[..., AbstractContextManager[Any]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, Path]]:
    """The address of a lab, and its folder."""
    folder = tmp_path_factory.mktemp("lab")
    with serve_lab(folder) as (port, _):
        yield f"http://127.0.0.1:{port}/", folder


@pytest.fixture
def page(lab: tuple[str, Path], open_page: Any) -> Any:
    return ready(open_page(lab[0]))


def ready(page: Any) -> Any:
    """The page, once it shows its first problem."""
    until(page, "window.lab && lab.document && lab.ready && lab.stage.scene", SECONDS)
    return page


def until(page: Any, condition: str, seconds: float = 30) -> None:
    # Not by wait_for_function, which evaluates in the page what its policy forbids.
    for _ in range(int(seconds * 20)):
        if page.evaluate(f"!!({condition})"):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"not within {seconds} s: {condition}")


def place(page: Any, x: float, y: float) -> tuple[float, float]:
    """Where in the window a point of the workspace is."""
    box = page.locator("#editor").bounding_box()
    sx, sy, ratio = page.evaluate(f"[...lab.stage.toScreen({x}, {y}), lab.stage.ratio]")
    return box["x"] + sx / ratio, box["y"] + sy / ratio


def drag(page: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.locator("#editor").scroll_into_view_if_needed()
    page.mouse.move(*place(page, *start))
    page.mouse.down()
    page.mouse.move(*place(page, *((a + b) / 2 for a, b in zip(start, end, strict=True))))
    page.mouse.move(*place(page, *end))
    page.mouse.up()


def empty_room(page: Any) -> None:
    page.get_by_label("Open a problem").select_option("new")
    until(page, "lab.document.obstacles.length === 0 && lab.stage.scene.obstacles.length === 0 && lab.ready")


def test_lab__from_nothing_to_a_problem_drawn_solved_replayed_and_saved(
    lab: tuple[str, Path], page: Any, pixels: Pixels
) -> None:
    empty_room(page)
    before = pixels(page.locator("#editor"))
    page.get_by_role("button", name="Box").click()
    drag(page, (4, 0), (5, 7))
    drawn = page.evaluate("lab.document.obstacles[0].polygon")
    np.testing.assert_allclose(drawn, [[4, 0], [5, 0], [5, 7], [4, 7]], atol=0.03)
    drag(page, (1, 5), (1.5, 2))
    np.testing.assert_allclose(page.evaluate("lab.document.start"), [1.5, 2, 0], atol=0.03)
    assert (pixels(page.locator("#editor")) != before).any()
    page.get_by_label("A guidance or an expression").fill("medial_axis")
    page.get_by_role("button", name="Leave out rrt").click()
    page.get_by_role("button", name="Leave out hybrid").click()
    page.get_by_label("A guidance or an expression").fill("medial_axis")
    page.get_by_role("button", name="Add").click()
    page.get_by_role("button", name="Search", exact=True).click()
    until(page, "lab.runs.length === 1 && !lab.runs[0].running", SECONDS)
    assert page.locator("#results tbody tr").inner_text().split()[:2] == ["medial_axis", "solved"]
    stage = page.locator("#player canvas.stage")
    page.get_by_role("button", name="To the start").click()
    first = pixels(stage)
    page.get_by_role("button", name="To the end").click()
    assert (pixels(stage) != first).any()
    samples = page.evaluate("lab.runs[0].facts.samples")
    assert page.evaluate("lab.player.sample") == samples
    assert "guide's graph" in page.locator("#player .legend").inner_text()
    assert f"solved after {samples} samples" in page.locator("#player figcaption").inner_text()
    page.get_by_label("Name").fill("mine.toml")
    page.get_by_role("button", name="Save").click()
    until(page, "document.getElementById('message').textContent.startsWith('Saved as mine.toml')")
    problem = load_problem(lab[1] / "mine.toml")
    assert problem.name == "mine"
    assert len(problem.environment.obstacles) == 1
    np.testing.assert_allclose(problem.task.start, [1.5, 2, 0], atol=0.03)


def test_lab__compares_cancels_and_says_what_failed(page: Any) -> None:
    for name in ("rrt", "hybrid"):
        page.get_by_role("button", name=f"Leave out {name}").click()
    for name in ("goal_distance", "lazyprm"):
        page.get_by_label("A guidance or an expression").fill(name)
        page.get_by_label("A guidance or an expression").press("Enter")
    page.get_by_label("samples, at most").fill("20000")
    page.get_by_role("button", name="Search", exact=True).click()
    until(page, "lab.runs[0].trace && lab.runs[0].trace.samples > 0", SECONDS)
    page.get_by_role("button", name="Cancel goal_distance").click()
    until(page, "lab.runs.every((run) => !run.running)", SECONDS)
    rows = page.locator("#results tbody tr")
    assert "cancelled after" in rows.nth(0).inner_text()
    assert "did you mean 'lazy_prm'?" in rows.nth(1).inner_text()
    assert page.locator("#player canvas.stage").count() == 1


def test_lab__a_file_that_is_no_problem_loses_nothing_and_names_are_text(
    lab: tuple[str, Path], page: Any
) -> None:
    held = page.evaluate("JSON.stringify(lab.document)")
    evil = "<img src=x onerror=alert(1)>.toml"
    page.locator("#upload").set_input_files({"name": evil, "mimeType": "text/plain", "buffer": b"no problem"})
    message = page.locator("#message")
    until(page, "document.getElementById('message').className.includes('bad')")
    assert "expected TOML" in message.inner_text()
    assert page.evaluate("JSON.stringify(lab.document)") == held
    text = (
        'format = "guided-gym problem 1"\nname = "<script>alert(1)</script>"\nbounds = [0.0, 0.0, 4.0, 4.0]\n'
        '[[obstacles]]\nname = "<img src=x onerror=alert(1)>"\nbox = [1.0, 1.0, 2.0, 2.0]\n'
    )
    page.locator("#upload").set_input_files({"name": evil, "mimeType": "x/y", "buffer": text.encode()})
    until(page, "lab.document.bounds[2] === 4 && lab.stage.scene.bounds[2] === 4")
    page.get_by_label("Name").fill("<b>.toml")
    page.get_by_role("button", name="Save").click()
    until(page, "document.getElementById('message').className.includes('bad')")
    assert "name: expected letters" in message.inner_text()
    assert page.locator("main img, main b:not(.pose b)").count() == 0
    assert not list(lab[1].glob("*b*.toml"))
    page.get_by_role("button", name="Undo").click()
    assert page.evaluate("JSON.stringify(lab.document)") == held


def test_lab__keys_do_what_a_pointer_does(page: Any) -> None:
    empty_room(page)
    page.locator("#editor").focus()
    page.keyboard.press("b")
    page.keyboard.press("Enter")
    assert page.evaluate("lab.document.obstacles.length") == 1
    before = page.evaluate("lab.document.obstacles[0].polygon[0]")
    page.keyboard.press("ArrowUp")
    after = page.evaluate("lab.document.obstacles[0].polygon[0]")
    np.testing.assert_allclose(after, [before[0], before[1] + 0.1], atol=1e-9)
    page.keyboard.press("Delete")
    assert page.evaluate("lab.document.obstacles.length") == 0
    page.keyboard.press("Control+z")
    assert page.evaluate("lab.document.obstacles.length") == 1
    page.keyboard.press("n")
    page.keyboard.press("]")
    assert page.evaluate("lab.document.start[2]") == pytest.approx(-np.pi / 36)
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+y")
    assert page.evaluate("lab.document.obstacles.length") == 1


def test_lab__a_polygon_is_drawn_turned_and_mended(page: Any) -> None:
    empty_room(page)
    page.get_by_role("button", name="Polygon").click()
    for corner in ((3, 3), (6, 3), (4.5, 6), (3, 3)):
        page.mouse.click(*place(page, *corner))
    np.testing.assert_allclose(
        page.evaluate("lab.document.obstacles[0].polygon"), [[3, 3], [6, 3], [4.5, 6]], atol=0.03
    )
    drag(page, (4.5, 6), (4.5, 8))  # a corner
    np.testing.assert_allclose(page.evaluate("lab.document.obstacles[0].polygon[2]"), [4.5, 8], atol=0.03)
    drag(page, (4.5, 4), (5.5, 4))  # the whole
    np.testing.assert_allclose(page.evaluate("lab.document.obstacles[0].polygon[0]"), [4, 3], atol=0.03)
    drag(page, (1, 5), (5.5, 4))  # the start, into it
    until(page, "document.getElementById('trouble').textContent.includes('in collision with obstacles[0]')")
    page.get_by_label("Kind of robot").select_option("point")
    until(page, "lab.document.start.length === 2")
    page.get_by_label("Kind of robot").select_option("segment")
    until(page, "lab.document.start.length === 3")


def test_lab__fits_a_phone_and_keeps_what_was_drawn(lab: tuple[str, Path], open_page: Any) -> None:
    page = ready(open_page(lab[0], width=390, height=844, theme="dark"))
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    empty_room(page)
    page.reload()
    ready(page)
    assert page.evaluate("lab.document.obstacles.length") == 0
    assert "what you drew last" in page.locator("#message").inner_text()


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 900)])
def test_lab__a_pose_at_an_edge_can_be_turned(
    lab: tuple[str, Path], open_page: Any, width: int, height: int
) -> None:
    page = ready(open_page(lab[0], width=width, height=height))
    empty_room(page)
    for zoom, degrees in ((1, 0), (1, 90), (1, 37), (6, 0), (6, 180)):
        for name, value in (("x", 9.5), ("y", 9.7), ("turn, °", degrees)):
            page.get_by_label(f"goal {name}", exact=True).fill(str(value))
            page.get_by_label(f"goal {name}", exact=True).press("Tab")
        page.locator("#editor").scroll_into_view_if_needed()
        page.evaluate("lab.stage.fit()")
        page.evaluate("([zoom, at]) => lab.stage.zoom(zoom, ...at)", [zoom, place(page, 9.5, 9.7)])
        handle = page.evaluate("lab.turnHandle('goal')")
        side = page.locator("#editor").bounding_box()
        on_screen = np.subtract(place(page, *handle["at"]), (side["x"], side["y"]))
        assert (on_screen >= 7).all()
        assert (on_screen <= (side["width"] - 7, side["height"] - 7)).all()
        centre, at = np.array(handle["centre"]), np.array(handle["at"])
        drag(page, tuple(at), tuple(centre + np.array([[0, 1], [-1, 0]]) @ (at - centre)))
        change = np.degrees(page.evaluate("lab.document.goal[2]")) - degrees
        assert (change + 180) % 360 - 180 == pytest.approx(-90, abs=3)
        np.testing.assert_allclose(page.evaluate("lab.document.goal.slice(0, 2)"), [9.5, 9.7], atol=0.03)
