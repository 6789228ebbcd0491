"""The lab's server: whom it answers, which files it touches, and how a search ends."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guided_gym import (
    GuidedGymError,
    InvalidInputError,
    SpatialEnvironment,
    distribution_names,
    guided_search,
    load_problem,
    make_distribution,
)
from guided_gym.catalogue.files import problem_content

pytest.importorskip("starlette", reason="the extra [lab] is not installed")
pytest.importorskip("uvicorn", reason="the extra [lab] is not installed")

from guided_gym.train.lab.documents import Folder, checked_guidance, document_of_text, example
from guided_gym.train.lab.server import Limits, bound_socket

Serve = Callable[..., AbstractContextManager[Any]]
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def served(serve_lab: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, Any, Path]]:
    folder = tmp_path_factory.mktemp("lab")
    with serve_lab(folder) as (port, lab):
        yield port, lab, folder


def ask(
    port: int, path: str, body: Any = None, headers: dict[str, str] | None = None
) -> tuple[int, Any, dict[str, str]]:
    """The status, what was answered (parsed), and the headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    data = None if body is None else json.dumps(body).encode()
    sent = {**({} if body is None else JSON), **(headers or {})}
    connection.request("GET" if body is None else "POST", path, data, sent)
    response = connection.getresponse()
    text = response.read().decode()
    connection.close()
    kind = response.headers.get("content-type", "")
    answer = json.loads(text) if "json" in kind and "ndjson" not in kind else text
    return response.status, answer, {name.lower(): value for name, value in response.headers.items()}


def document(name: str = "TrapCup") -> dict[str, Any]:
    return problem_content(make_distribution(name).problem(0))


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines() if line]


def job(**fields: Any) -> dict[str, Any]:
    return {"document": document(), "guidance": "medial_axis", "seed": 3, "samples": 1000, **fields}


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1.evil.example:PORT"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:PORT"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_guard__refuses_other_hosts_and_origins(
    served: tuple[int, Any, Path], headers: dict[str, str]
) -> None:
    port = served[0]
    headers = {name: value.replace("PORT", str(port)) for name, value in headers.items()}
    for path, body in (("/", None), ("/api/files", None), ("/api/open", {"example": "Cup"})):
        status, answer, _ = ask(port, path, body, headers)
        assert status == 403, path
        assert answer["error"].startswith("refused: expected ")


def test_guard__refuses_what_a_foreign_form_could_send(served: tuple[int, Any, Path]) -> None:
    port, _, folder = served
    sent = {"name": "form.toml", "document": document()}
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        assert ask(port, "/api/save", sent, {"Content-Type": kind})[0] == 403
    assert not (folder / "form.toml").exists()


def test_guard__lets_the_page_through(served: tuple[int, Any, Path]) -> None:
    port = served[0]
    for host in (f"127.0.0.1:{port}", f"localhost:{port}"):
        own = {"Host": host, "Origin": f"http://{host}", "Sec-Fetch-Site": "same-origin"}
        status, text, headers = ask(port, "/", None, own)
        assert status == 200
        assert "<script src=" in text
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["content-security-policy"].startswith("default-src 'none'")
    for name in ("view.js", "player.js", "lab.js", "theme.css", "lab.css"):
        assert ask(port, f"/static/{name}")[0] == 200
    for name in ("replay.js", "..%2fpages.py", "%2e%2e/pages.py", "nothing"):
        assert ask(port, f"/static/{name}")[0] == 404


BAD_NAMES = (
    "../outside.toml",
    "/etc/passwd",
    "sub/inside.toml",
    "sub\\inside.toml",
    ".hidden.toml",
    "outside",
    "outside.py",
    "a\n.toml",
    "C:x.toml",
    "",
    "x" * 200 + ".toml",
    None,
    7,
    "link.toml",
    "folder.toml",
)


def test_folder__nothing_outside_is_read_or_written(served: tuple[int, Any, Path]) -> None:
    port, _, folder = served
    outside = folder.parent / "outside.toml"
    make_distribution("Cup").problem(0).save(outside)
    before = outside.read_bytes()
    (folder / "link.toml").symlink_to(outside)
    (folder / "folder.toml").mkdir()
    (folder / "sub").mkdir()
    make_distribution("Cup").problem(0).save(folder / "sub" / "inside.toml")
    there = sorted(folder.rglob("*"))
    for name in BAD_NAMES:
        for path, more in (("open", {}), ("save", {"document": document(), "replace": True})):
            answer = ask(port, f"/api/{path}", {"name": name, **more})[1]
            assert "expected" in answer.get("error", ""), (path, name)
    assert ask(port, "/api/files")[1] == {"files": []}
    assert sorted(folder.rglob("*")) == there
    assert outside.read_bytes() == before


def test_save_and_open__keep_a_problem(served: tuple[int, Any, Path]) -> None:
    port, _, folder = served
    sent = document()
    assert "My room.toml" in ask(port, "/api/save", {"name": "My room.toml", "document": sent})[1]["files"]
    assert (
        load_problem(folder / "My room.toml").fingerprint
        == make_distribution("TrapCup").problem(0).fingerprint
    )
    other = {**sent, "obstacles": []}
    assert ask(port, "/api/save", {"name": "My room.toml", "document": other})[1] == {"exists": True}
    opened = ask(port, "/api/open", {"name": "My room.toml"})[1]["document"]
    assert len(opened["obstacles"]) == len(sent["obstacles"])
    assert opened["start"] == sent["start"]
    ask(port, "/api/save", {"name": "My room.toml", "document": other, "replace": True})
    assert load_problem(folder / "My room.toml").environment.obstacles == ()


def test_save__an_unfinished_problem_is_not_lost(served: tuple[int, Any, Path]) -> None:
    port, _, folder = served
    sent = {**document("Cup"), "start": [5.0, 11.0, 0.0]}
    assert "error" not in ask(port, "/api/save", {"name": "half.json", "document": sent})[1]
    with pytest.raises(GuidedGymError, match="start"):
        load_problem(folder / "half.json")
    opened = ask(port, "/api/open", {"name": "half.json"})[1]["document"]
    assert opened["start"] == sent["start"]
    assert "bounds" in ask(port, "/api/view", {"document": opened})[1]["trouble"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.toml", "no toml at all", "expected TOML"),
        ("a.json", '{"format": "other"}', "expected 'guided-gym problem 1'"),
        ("a.json", "[" * 100_000, "nested"),
        ("a.toml", 'format = "guided-gym problem 1"', "expected bounds, a map or a room"),
        ("a.json", '{"format": "guided-gym problem 1", "bounds": [0, 0, 1, NaN]}', "NaN"),
        ("a.yaml", "image: x", "expected a problem file"),
        ("a.toml", 'format = "guided-gym problem 1"\n[map]\nfile = "../../x.pgm"', "expected a file in"),
        ("a.toml", "\ud800", ""),
    ],
)
def test_open__what_is_no_problem_is_said(name: str, text: str, message: str) -> None:
    with pytest.raises(GuidedGymError) as error:
        document_of_text(name, text)
    assert message in str(error.value)
    assert "/tmp" not in str(error.value)


def test_open__a_map_gets_a_robot_and_a_task(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(
        'format = "guided-gym problem 1"\nbounds = [0.0, 0.0, 20.0, 10.0]\n'
        "[[obstacles]]\nbox = [9.0, 4.0, 11.0, 10.0]\n"
    )
    opened = Folder(tmp_path).read("map.toml")
    assert opened["obstacles"] == [{"polygon": [[11.0, 4.0], [11.0, 10.0], [9.0, 10.0], [9.0, 4.0]]}]
    assert opened["robot"]["kind"] == "rectangle"
    assert len(opened["start"]) == len(opened["goal"]) == 3


def test_open__an_arm_in_space_is_refused_and_not_offered(
    tmp_path: Path, served: tuple[int, Any, Path]
) -> None:
    make_distribution("SpatialArm").problem(0).save(tmp_path / "arm.toml")
    before = (tmp_path / "arm.toml").read_bytes()
    with pytest.raises(
        InvalidInputError, match=r"^arm.toml: expected a problem in the plane.*got an arm in space"
    ):
        Folder(tmp_path).read("arm.toml")
    assert (tmp_path / "arm.toml").read_bytes() == before
    with pytest.raises(InvalidInputError, match="SpatialArm: expected a problem in the plane"):
        example("SpatialArm", 0)
    offered = ask(served[0], "/api/start")[1]["examples"]
    in_space = {
        name
        for name in distribution_names()
        if isinstance(
            make_distribution(name).sample(np.random.default_rng(0)).environment, SpatialEnvironment
        )
    }
    assert in_space == set(distribution_names()) - set(offered)


def test_view__says_what_is_wrong_and_still_draws() -> None:
    from guided_gym.train.lab.documents import view_of

    good = view_of(document())
    assert good["trouble"] is None
    assert good["robot"]["dimension"] == 3
    assert good["metric"]["periods"][2] == pytest.approx(2 * np.pi)
    crossed = {**document(), "obstacles": [{"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}]}
    answer = view_of(crossed)
    assert "obstacles[0]" in answer["trouble"]
    assert answer["robot"] is not None
    assert view_of({"format": "x"})["trouble"]


def test_run__is_the_search_that_python_runs(served: tuple[int, Any, Path]) -> None:
    rows = lines(ask(served[0], "/api/run", job())[1])
    result = guided_search(make_distribution("TrapCup").problem(0), "medial_axis", seed=3)
    samples = [row for row in rows if "n" in row]
    assert [row["n"] for row in samples] == result.record.selected.tolist()
    assert rows[0]["scene"]["name"] == "TrapCup"
    assert "problem" not in rows[0]
    facts = rows[-1]["facts"]
    assert facts["samples"] == result.samples
    assert facts["total"] == result.total_efficiency
    assert facts["length"] == result.length


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"guidance": "lazyprm"}, "lazy_prm"),
        ({"guidance": "rrt("}, "expected"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"samples": 20_001}, "samples: expected a whole number of 1 to 20000"),
        ({"samples": True}, "samples: expected a whole number"),
        ({"document": []}, "document: expected a problem"),
        (
            {
                "document": {
                    **document("Cup"),
                    "obstacles": [{"polygon": [[4, -1], [5, -1], [5, 11], [4, 11]]}],
                }
            },
            "no path",
        ),
    ],
)
def test_run__what_cannot_be_is_said(
    served: tuple[int, Any, Path], fields: dict[str, Any], message: str
) -> None:
    _, answer, _ = ask(served[0], "/api/run", job(**fields))
    error = answer["error"] if isinstance(answer, dict) else lines(answer)[-1]["error"]
    assert message in error


@pytest.mark.parametrize(
    "text",
    [
        "os:system",
        "guided_gym.guidance.cells:Voronoi",
        "hybrid(rrt, this:Zen)",
        "learned:/etc",
        "learned:..",
        "learned:agent",
        'learned:"a b"',
        "path_database(/etc/passwd)",
        "path_database(paths.sqlite)",
        "path_database(paths)",
        "path_database('a')",
        "paths(database=x)",
        "roadmap(robot=principal(paths))",
        "roadmap(robot=principal(a.db))",
        "rrt+path_database(a)",
        "x" * 600,
        "",
        None,
        ["rrt"],
    ],
)
def test_guidance__reads_no_files_and_imports_no_code(text: object) -> None:
    with pytest.raises(GuidedGymError, match=r"expected|reads no files"):
        checked_guidance(text)


def test_guidance__expressions_are_taken() -> None:
    for text in (
        "rrt@goal_bias=0.05",
        "roadmap(robot=disc(outer=true), vertices=500)",
        "learned:se2",
        "lazy_prm+rrt",
    ):
        assert checked_guidance(text) == text


def wait_until(true: Callable[[], bool], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.05)
    return true()


def test_run__whoever_leaves_ends_the_search(served: tuple[int, Any, Path]) -> None:
    port, lab, _ = served
    assert wait_until(lambda: len(lab.workers._running) == 1)  # the one that waits
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    sent = job(guidance="uninformed", samples=20_000, document=document("SimplePassage"))
    connection.request("POST", "/api/run", json.dumps(sent).encode(), JSON)
    response = connection.getresponse()
    assert b'"format"' in response.readline()
    (process,) = (one for one in lab.workers._running if one is not lab.workers._spare)
    assert process.returncode is None
    response.close()
    connection.close()
    assert wait_until(lambda: process.returncode is not None)
    assert lab.workers._jobs == 0


def test_run__time_and_number_of_searches_are_bounded(serve_lab: Serve, tmp_path: Path) -> None:
    with serve_lab(tmp_path, Limits(seconds=0.05)) as (port, lab):
        rows = lines(ask(port, "/api/run", job(guidance="uninformed", samples=20_000))[1])
        assert rows[-1]["error"].startswith("stopped after 0.05 s")
        lab.workers._jobs = 4
        assert "4 searches run already" in lines(ask(port, "/api/run", job())[1])[-1]["error"]
        lab.workers._jobs = 0


def test_run__memory_is_bounded(serve_lab: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GUIDED_GYM_MAX_MEMORY", str(10**15))  # sizes are refused at the door otherwise
    with serve_lab(tmp_path, Limits(megabytes=1800)) as (port, _):
        sent = job(guidance="prm(vertices=100000000)")
        assert "more than 1800 MB" in lines(ask(port, "/api/run", sent)[1])[-1]["error"]


def test_requests__are_bounded(served: tuple[int, Any, Path]) -> None:
    corners = [[float(i), 0.0] for i in range(20_001)]
    sent = {"document": {**document(), "obstacles": [{"polygon": corners}]}}
    assert "at most 20,000 corners" in ask(served[0], "/api/view", sent)[1]["error"]
    assert "16 MiB" in ask(served[0], "/api/view", {"x": "y" * 2**24})[1]["error"]


def test_a_port_in_use_is_said() -> None:
    with bound_socket(0) as taken, pytest.raises(GuidedGymError, match=r"port \d+ of 127.0.0.1 .*--port 0"):
        taken.listen()
        bound_socket(taken.getsockname()[1])
    with pytest.raises(GuidedGymError, match="port 70000"):
        bound_socket(70_000)
