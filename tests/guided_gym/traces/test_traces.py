"""Traces: the search is the same with and without one, and grows again from it, whatever breaks off."""

from __future__ import annotations

import io
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely.geometry import box

from guided_gym import (
    Environment,
    InvalidInputError,
    Linkage,
    Problem,
    SearchOptions,
    SearchResult,
    SearchTree,
    StorageError,
    Task,
    guided_search,
    make_distribution,
    make_guidance,
    read_trace,
)
from guided_gym.search.search import NO_NODE
from guided_gym.traces.writing import TraceWriter

COLUMNS = (
    "parents", "configurations", "cost_to_come", "depths", "children", "failures", "failed_nodes",
    "failed_targets", "contacts",
)  # fmt: skip
GUIDANCES = (
    "rrt", "uninformed", "goal_distance", "hybrid", "wavefront", "medial_axis", "oracle",
    "hybrid(lazy_prm, hybrid(rrt, wavefront), rule=round_robin)", "hybrid(rrt, goal_distance, rule=product)",
)  # fmt: skip


@pytest.fixture(scope="module")
def problem() -> Problem:
    return make_distribution("TrapCup").problem(0)


def traced(problem: Problem, guidance: str, path: Path, **options: Any) -> SearchResult:
    return guided_search(problem, guidance, seed=5, max_samples=120, trace=path, **options)


def same(a: SearchTree, b: SearchTree) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in COLUMNS)


def rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize("guidance", GUIDANCES)
@pytest.mark.parametrize("rewire", [False, True])
def test_trace__changes_nothing_and_grows_the_same_tree(
    problem: Problem, guidance: str, rewire: bool, tmp_path: Path
) -> None:
    options = SearchOptions(rewire=rewire)
    plain = guided_search(problem, guidance, seed=5, max_samples=120, options=options)
    result = traced(problem, guidance, tmp_path / "trace.jsonl", options=options)
    assert same(plain.tree, result.tree)
    assert (plain.collision_checks, plain.looks) == (result.collision_checks, result.looks)
    trace = read_trace(tmp_path / "trace.jsonl")
    search = trace.replay()
    assert same(search.tree, result.tree) and search.tree.rewirings == result.tree.rewirings
    assert trace.trouble == "" and trace.end is not None and trace.end["solved"] == result.solved
    assert len(trace) == result.samples == trace.end["samples"]


def test_trace__says_what_the_record_says(problem: Problem, tmp_path: Path) -> None:
    result = traced(problem, "hybrid", tmp_path / "trace.jsonl")
    samples, record = read_trace(tmp_path / "trace.jsonl").samples, result.record
    assert [sample.node for sample in samples] == record.selected.tolist()
    assert [sample.efficiency for sample in samples] == record.efficiency.tolist()
    assert [sample.best for sample in samples] == record.best.tolist()
    assert [sample.contact is None for sample in samples] == (record.child != NO_NODE).tolist()
    # The paper hybrid swaps at each collision.
    turns = [sample.guide for sample in samples]
    swapped = [a != b for a, b in itertools.pairwise(turns)]
    assert swapped == [sample.contact is not None for sample in samples[:-1]]


def test_trace__h_is_that_of_the_chosen_node(problem: Problem, tmp_path: Path) -> None:
    """Goal distance: h is the distance to the goal and a fee for each expansion, by hand."""
    traced(problem, "goal_distance", tmp_path / "trace.jsonl")
    trace, space = read_trace(tmp_path / "trace.jsonl"), problem.space
    nodes, tried = [problem.task.start], [0]
    fee = 0.1 * space.scale
    for sample in trace.samples:
        expected = float(space.distance(nodes[sample.node], problem.task.goal)) + fee * tried[sample.node]
        assert sample.h == pytest.approx(expected, rel=1e-12)
        tried[sample.node] += 1
        if sample.contact is None:
            nodes.append(sample.target)
            tried.append(0)


def test_trace__the_work_remaining_is_the_oracles(problem: Problem, tmp_path: Path) -> None:
    from guided_gym import Measure

    result = traced(problem, "rrt", tmp_path / "trace.jsonl")
    trace = read_trace(tmp_path / "trace.jsonl")
    work = [trace.header["work"], *(sample.work for sample in trace.samples if sample.contact is None)]
    np.testing.assert_array_equal(work, Measure(result).work_remaining)


def test_trace__without_a_metric_has_no_figures(problem: Problem, tmp_path: Path) -> None:
    traced(problem, "rrt", tmp_path / "trace.jsonl", measure=False)
    header, *others = rows(tmp_path / "trace.jsonl")
    assert header["optimum"] is None and header["target"] is None
    assert not any({"s", "b", "t"} & set(row) for row in others)


def test_trace__a_roadmap_loses_edges_as_it_learns(problem: Problem, tmp_path: Path) -> None:
    guidance = make_guidance("lazy_prm")
    guided_search(problem, guidance, seed=5, max_samples=120, trace=tmp_path / "trace.jsonl")
    drawing = guidance.drawing()  # type: ignore[attr-defined]
    weights: dict[int, float | None] = {}
    edges: list[list[int]] = []
    for row in rows(tmp_path / "trace.jsonl")[1:]:
        if "graph" in row:
            edges, weights = row["graph"]["edges"], {}
        weights |= dict(map(tuple, row.get("weights", [])))
    assert edges == drawing["edges"].tolist()
    removed = {edge for edge, weight in weights.items() if weight is None}
    assert removed == set(np.flatnonzero(~drawing["alive"]).tolist()) and removed


def test_trace__of_what_is_told_line_by_line(problem: Problem) -> None:
    """A sink gets whole lines, one a call."""
    calls: list[str] = []

    class Sink:
        def write(self, text: str) -> None:
            calls.append(text)

    guided_search(problem, "medial_axis", seed=0, max_samples=30, trace=Sink())
    assert all(call.endswith("\n") and call.count("\n") == 1 for call in calls)
    assert "end" in json.loads(calls[-1])
    buffer = io.StringIO()
    guided_search(problem, "medial_axis", seed=0, max_samples=30, trace=buffer)
    assert buffer.getvalue() == "".join(calls)


def test_trace__of_an_arm(tmp_path: Path) -> None:
    arm = Linkage.arm([1.0, 0.8, 0.6], 0.1, base=(5, 5), limits=[(-3.0, 3.0), None, 2.5], name="<arm>")
    room = Environment((0, 0, 10, 10), (box(6.5, 5.6, 9, 6.2),))
    problem = Problem(arm, room, Task([-1.2, 0.3, 0.2], [1.3, 0.4, -0.3]), "arm", {"left": box(0, 0, 5, 10)})
    result = traced(problem, "rrt", tmp_path / "trace.jsonl", measure=False)
    trace = read_trace(tmp_path / "trace.jsonl")
    assert trace.problem.fingerprint == problem.fingerprint and trace.problem.robot.name == "<arm>"
    assert same(trace.replay().tree, result.tree)
    header = rows(tmp_path / "trace.jsonl")[0]
    header["problem"]["robot"]["joints"][2]["parent"] = 7
    (tmp_path / "bad.jsonl").write_text(json.dumps(header) + "\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match="expected a parent before it"):
        _ = read_trace(tmp_path / "bad.jsonl").problem


@pytest.mark.parametrize("cut", [1, 7, 40])
def test_read__a_truncated_trace_is_read_up_to_there(problem: Problem, tmp_path: Path, cut: int) -> None:
    result = traced(problem, "rrt", tmp_path / "trace.jsonl")
    text = (tmp_path / "trace.jsonl").read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    (tmp_path / "cut.jsonl").write_text("".join(lines[: cut + 2]) + lines[cut + 2][:9], encoding="utf-8")
    trace = read_trace(tmp_path / "cut.jsonl")
    assert len(trace) == cut and trace.end is None  # one of the lines is the guide's view
    assert trace.trouble == f"line {cut + 3} is cut off"
    nodes = trace.replay().tree.configurations
    np.testing.assert_array_equal(nodes, result.tree.configurations[: len(nodes)])


@pytest.mark.parametrize(
    ("line", "trouble"),
    [
        ("[]", "is no JSON object"),
        ("{", "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ('{"n":1,"x":[1,1,1]}', "selects a node that is not there: 1"),
        ('{"n":true,"x":[1,1,1]}', "selects a node that is not there: True"),
        ('{"n":0,"x":[1,1]}', "needs 3 numbers as 'x'"),
        ('{"n":0,"x":[1,1,NaN]}', "needs 3 numbers as 'x'"),
        ('{"n":0,"x":[1,1,1],"c":null}', "needs 3 numbers as 'c'"),
        ('{"n":0,"x":[1,1,1],"s":"<b>"}', "has a text where a number should be"),
        ('{"n":0,"x":[1,1,1],"g":3}', "names a guide that is not there: 3"),
        ('{"n":0,"x":[1,1,1],"w":[[5,0]]}', "rewires nodes that are not there"),
        ('{"view":4,"cells":true}', "names a guide that is not there: 4"),
        ('{"what":1}', "is neither a sample, nor a gain, nor a view, nor the end"),
    ],
)
def test_read__ends_at_the_first_line_that_is_none(
    problem: Problem, tmp_path: Path, line: str, trouble: str
) -> None:
    traced(problem, "goal_distance", tmp_path / "trace.jsonl")
    header, view, *_ = (tmp_path / "trace.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / "bad.jsonl").write_text(header + view + line + "\n", encoding="utf-8")
    trace = read_trace(tmp_path / "bad.jsonl")
    assert trace.trouble == f"line 3 {trouble}" and len(trace) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "whose first line names its format"),
        ("hello\n", "whose first line names its format"),
        ("[1]\n", "whose first line names its format"),
        ('{"format":"guided-gym trace 9"}\n', "got another version of it: 'guided-gym trace 9'"),
        ('{"format":"something"}\n', "got something else"),
        ('{"format":"guided-gym trace 1"}\n', "a problem with a start"),
        ('{"format":"guided-gym trace 1","problem":{"start":[1,1]},"guides":1}\n', "the guides' names"),
        ('{"format":"guided-gym trace 1","problem":{"start":[1,1]}}\n', "step and rewire"),
    ],
)
def test_read__refuses_what_is_no_trace(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "bad.jsonl").write_text(content, encoding="utf-8")
    with pytest.raises(StorageError, match=message):
        read_trace(tmp_path / "bad.jsonl")


def test_read__bytes_that_are_no_text(problem: Problem, tmp_path: Path) -> None:
    (tmp_path / "bad.jsonl").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(StorageError, match="cannot read"):
        read_trace(tmp_path / "bad.jsonl")
    with pytest.raises(StorageError, match="cannot read"):
        read_trace(tmp_path / "none.jsonl")


def test_read__a_problem_that_reads_other_files_is_refused(problem: Problem, tmp_path: Path) -> None:
    traced(problem, "goal_distance", tmp_path / "trace.jsonl")
    header = rows(tmp_path / "trace.jsonl")[0]
    header["problem"]["map"] = {"file": "secret.pgm"}
    (tmp_path / "bad.jsonl").write_text(json.dumps(header) + "\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match="needs no other file"):
        _ = read_trace(tmp_path / "bad.jsonl").problem


def test_replay__says_where_a_trace_was_changed(problem: Problem, tmp_path: Path) -> None:
    traced(problem, "rrt", tmp_path / "trace.jsonl")
    content = rows(tmp_path / "trace.jsonl")
    failed = next(i for i, row in enumerate(content) if "c" in row)
    content[failed]["c"][0] += 1e-9
    (tmp_path / "bad.jsonl").write_text("\n".join(map(json.dumps, content)), encoding="utf-8")
    with pytest.raises(StorageError, match=f"expected sample {failed - 2} to be what its choice leads to"):
        read_trace(tmp_path / "bad.jsonl").replay()


def test_write__where_nothing_can_be_written(problem: Problem, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="cannot write"):
        guided_search(problem, "rrt", seed=0, max_samples=5, trace=tmp_path)
    with pytest.raises(InvalidInputError, match="expected a file or something to write to"):
        TraceWriter(5)  # type: ignore[arg-type]


def test_write__what_was_drawn_before_an_interruption_is_there(problem: Problem, tmp_path: Path) -> None:
    def stop(samples: int) -> None:
        if samples == 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        traced(problem, "goal_distance", tmp_path / "trace.jsonl", progress=stop)
    trace = read_trace(tmp_path / "trace.jsonl")
    assert len(trace) == 20 and "stops after line" in trace.trouble
