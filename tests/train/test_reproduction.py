"""The reproduction, at the smallest scale that has every part."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.train import claims, cli, drawing, reproduction
from guided_gym.train.arm_claims import ARM, arm_claims
from guided_gym.train.arm_claims import GUIDANCES as ARM_GUIDANCES
from guided_gym.train.claims import paper_claims
from guided_gym.train.reproduction import OWN_TITLE, PAPER_TITLE, paper_plans
from guided_gym.train.specs import GuidanceSpec

SIZES = (2, 3, 4)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Databases of a few paths."""
    for module in (claims, drawing, reproduction):
        monkeypatch.setattr(module, "DATABASE_SIZES", SIZES)
    # Writing PDFs is half of the time, and tested elsewhere.
    monkeypatch.setattr(drawing.figures, "save", partial(drawing.figures.save, formats=("png",)))


def test_plans__are_the_papers() -> None:
    plans = paper_plans(Path("paths.sqlite"))
    assert len(plans) == 4 * 4 + 1 + 2 + 6
    assert {plan.settings.max_samples for plan in plans} == {1000}
    targets = {(t.epsilon, t.delta, t.tau) for t in (plan.settings.target for plan in plans)}
    assert targets == {(1e-4, 0.1, 0.1)}
    needed = {key for claim in paper_claims() for key in claim.needs}
    assert needed <= {(plan.environment, plan.spec.label) for plan in plans}
    assert len(paper_plans(Path("paths.sqlite"), baselines=True)) == len(plans) + 4 * 2


def test_arm_claims__ask_of_what_is_run() -> None:
    labels = {GuidanceSpec(name).label for name in ARM_GUIDANCES}
    assert {key for claim in arm_claims() for key in claim.needs} <= {(ARM, label) for label in labels}
    assert len(arm_claims()) == 9


@pytest.mark.usefixtures("small")
def test_reproduce__runs_checks_draws_and_resumes(tmp_path: Path) -> None:
    command = ["reproduce", "--seeds", "2", "--workers", "1", "--out", str(tmp_path)]
    result = CliRunner().invoke(cli.app, command)
    assert result.exit_code == 0, result.output
    assert "holds" in result.stdout
    written = json.loads((tmp_path / "claims.json").read_text())
    assert [row["of"] for row in written].count("paper") == len(paper_claims())
    assert {row["verdict"] for row in written} <= {"holds", "does not hold", "open"}
    assert all(row["words"] for row in written if row["of"] == "paper")
    page = (tmp_path / "claims.md").read_text()
    assert page.count("\n| ") == len(written) + 2  # and a head for each of the two tables
    assert PAPER_TITLE in page and OWN_TITLE in page
    drawn = {path.stem for path in (tmp_path / "figures").glob("*.png")}
    assert {"problems", "rrt-efficiency", "TrapCup-regions", "database", "paper-trees"} <= drawn
    again = CliRunner().invoke(cli.app, [*command, "--no-figures"])
    tables = [output.stdout.partition("\nIn ")[0] for output in (result, again)]
    assert tables[0] == tables[1]
