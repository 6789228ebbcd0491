"""OMPL beside the paper's guidances: three tables, that a second call does not compute anew."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from guided_gym import InvalidInputError
from guided_gym.train import ompl_report as reports

pytest.importorskip("ompl", reason="the extra ompl is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ompl")


@pytest.fixture(scope="module")
def report(folder: Path) -> reports.OmplReport:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reports, "MOMENTS", (0.02, 0.05))
        patch.setattr(reports, "ANYTIME", ("RRTstar",))
        patch.setattr(reports, "OURS", ("rrt",))
        return reports.ompl_report(environments=["Cup"], planners=["RRTConnect", "FMT"], seeds=2, out=folder)


def test_report__has_each_run_once(report: reports.OmplReport) -> None:
    assert report.results.pairs() == [("Cup", "rrt"), ("Cup", "ompl:RRTConnect"), ("Cup", "ompl:FMT")]
    assert len({row.key for row in report.unwatched}) == len(report.unwatched) == 2 * (1 + 2 * 3)
    assert all(row.free for row in report.unwatched if row.solved and row.resolution == 0)
    assert [row["guidance"] for row in report.lengths] == ["hybrid", "ompl:RRTstar"]


def test_report__is_not_computed_twice(
    report: reports.OmplReport, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "unwatched", None)  # nobody may call it
    monkeypatch.setattr(reports, "TIMED", ())
    monkeypatch.setattr(reports, "OURS", ("rrt",))
    (folder / reports.UNWATCHED_FILE).open("a").write('{"environment": "Cu')  # as a kill leaves it
    again = reports.ompl_report(environments=["Cup"], planners=["RRTConnect", "FMT"], seeds=2, out=folder)
    assert again.unwatched == report.unwatched


def test_truth__counts_paths_that_collide() -> None:
    def row(seed: int, *, solved: bool = True, free: bool = True) -> reports.Unwatched:
        return reports.Unwatched("Cup", "FMT", 0.01, seed, solved, free, 0.01 * seed, 10, 1.5, "")

    rows = [row(1), row(2, free=False), row(3, solved=False, free=False), row(4)]
    none = reports.OmplReport(reports.Results((), 1000), rows, [])
    (record,) = reports.truth_records(none)
    assert record["solved"] == 0.75
    assert record["colliding"] == pytest.approx(1 / 3)
    assert record["check"] == "1 %"
    assert record["processor_ms"] == pytest.approx(25)


def test_fastest__is_nobody_whose_paths_collide() -> None:
    def record(
        guidance: str, check: str, colliding: float, time: float, solved: float = 1.0
    ) -> dict[str, object]:
        return {
            "environment": "Cup", "guidance": guidance, "check": check, "solved": solved,
            "colliding": colliding, "processor_ms": time,
        }  # fmt: skip

    rows = [
        record("rrt", "certified", 0.0, 1.0, solved=0.9),
        record("hybrid", "certified", 0.0, 5.0),
        record("ompl:A", "1 %", 0.02, 1.0),
        record("ompl:B", "1 %", 0.01, 4.0),
        record("ompl:C", "certified", 0.0, 6.0),
    ]
    ours, theirs = reports.fastest(rows, "Cup")
    assert (ours["guidance"], theirs["guidance"]) == ("hybrid", "ompl:B")
    with pytest.raises(InvalidInputError, match="solve 95 %"):
        reports.fastest(rows[:1], "Cup")


def test_page__has_the_three_tables(report: reports.OmplReport, folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reports, "MOMENTS", (0.02, 0.05))
        patch.setattr(reports, "OURS", ("rrt",))
        files = reports.save_ompl_report(report, folder)
    page = (folder / "ompl.md").read_text()
    assert "### Cup, 2 seeds" in page
    assert "| ompl:FMT | 0.05 % |" in page
    assert "### Path over optimum over time" in page
    truth = json.loads((folder / "truth.json").read_text())
    assert {(row["guidance"], row["check"]) for row in truth} >= {
        ("rrt", "certified"), ("ompl:FMT", "certified"), ("ompl:FMT", "1 %"), ("ompl:FMT", "0.05 %"),
    }  # fmt: skip
    assert all(file.exists() for file in files)
