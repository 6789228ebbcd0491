"""The paper's experiments (paper, Experiments): searches, figures, and its claims with a verdict each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from guided_gym.train.claims import DATABASE_SIZES, DRAWN, PROBLEMS, ClaimResult, check_claims, database_label
from guided_gym.train.evaluation import Plan, checked_seeds, run_plans
from guided_gym.train.paths import build_path_database
from guided_gym.train.results import RESULTS_FILE, Results
from guided_gym.train.specs import DATABASE_GUIDANCE, GuidanceSpec
from guided_gym.train.table import rich_tables, save, save_records, summarise

if TYPE_CHECKING:
    from rich.table import Table

SEEDS = 128
GUIDANCES = ("rrt", "lazy_prm", "medial_axis", "oracle")
BASELINES = ("goal_distance", "uninformed")
DATABASE_FILE = f"paths-{DRAWN}.sqlite"

Progress = Callable[[int, int, str], None]
"""Called with (done, total, what is going on)."""


@dataclass(frozen=True)
class Report:
    """What the reproduction found.

    Attributes:
        results: All runs.
        claims: The paper's claims with their verdicts.
        plans: What was run.
    """

    results: Results
    claims: list[ClaimResult]
    plans: list[Plan]

    def tables(self) -> list[Table]:
        """For `rich.print`: the figures per problem, then the claims."""
        return [*rich_tables(summarise(self.results)), claims_table(self.claims)]


def paper_plans(database: Path, baselines: bool = False) -> list[Plan]:
    """The paper's experiments: 1,000 samples at most, epsilon = 1e-4, delta = tau = 0.1."""
    guidances = [*GUIDANCES, *(BASELINES if baselines else ())]
    plans = []
    for environment in PROBLEMS:
        names = [*guidances, "hybrid"] if environment == "TrapCup" else guidances
        plans += [Plan(environment, GuidanceSpec(name)) for name in names]
    plans += [Plan(DRAWN, GuidanceSpec(name)) for name in ("rrt", "oracle")]
    for size in DATABASE_SIZES:
        spec = GuidanceSpec.of(
            DATABASE_GUIDANCE, label=database_label(size), database=str(database), paths=size
        )
        plans.append(Plan(DRAWN, spec))
    return plans


def reproduce(
    *,
    seeds: int = SEEDS,
    workers: int = 1,
    out: str | Path = "results/paper",
    baselines: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Run the paper's experiments and check its claims; resumable like `guided_gym.train.evaluate`.

    Args:
        seeds: Searches per problem and guidance.
        workers: Processes.
        out: Folder of the results and of the path database, which is built first if it is not there.
        baselines: Whether to run goal_distance and uninformed on every problem too.
        progress: Called with (done, total, what is going on).

    Raises:
        StorageError: The results file or the database is corrupt, foreign or not accessible.
        InvalidInputError: seeds or workers is out of range.
    """
    checked_seeds(seeds)
    out = Path(out)
    database = out / DATABASE_FILE
    build_path_database(
        DRAWN,
        database,
        DATABASE_SIZES[-1],
        workers=workers,
        progress=_named(progress, "Building the path database"),
    )
    plans = paper_plans(database, baselines)
    results = run_plans(plans, seeds=seeds, workers=workers, out=out, progress=_named(progress, "Searching"))
    return Report(results, check_claims(results), plans)


def _named(progress: Progress | None, what: str) -> Callable[[int, int], None] | None:
    return None if progress is None else partial(_call, progress, what)


def _call(progress: Progress, what: str, done: int, total: int) -> None:
    progress(done, total, what)


def claims_table(claims: list[ClaimResult]) -> Table:
    """The claims with their verdicts and figures."""
    from rich.table import Table

    held = sum(claim.holds is True for claim in claims)
    table = Table(
        title=f"The paper's claims: {held} of {len(claims)} hold", title_justify="left", show_lines=True,
        caption="Means with 95 % bootstrap intervals over seeds; compared ones must not overlap.",
        caption_justify="left",
    )  # fmt: skip
    table.add_column("claim", overflow="fold", ratio=4)
    table.add_column("figures", overflow="fold", ratio=5)
    table.add_column("verdict", no_wrap=True)
    colours = {True: "green", False: "bold red", None: "yellow"}
    for claim in claims:
        verdict = f"[{colours[claim.holds]}]{claim.verdict}[/]"
        table.add_row(claim.statement, claim.figures.replace("[", r"\["), verdict)
    return table


def claims_markdown(claims: list[ClaimResult]) -> str:
    """The claims as a Markdown table, for a page."""
    rows = [f"| {claim.statement} | {claim.figures} | {claim.verdict} |" for claim in claims]
    return "\n".join(["| claim | figures | verdict |", "|---|---|---|", *rows, ""])


def save_report(
    report: Report, folder: Path, *, figures: bool = True, drawn: Callable[[str], None] | None = None
) -> list[Path]:
    """Write the tables and the claims, and draw the paper's evaluation figures; returns the files.

    Args:
        report: What `reproduce` found.
        folder: Where the files go.
        figures: Whether to draw.
        drawn: Called with the name of each figure when it is written.

    Raises:
        StorageError: The folder cannot be written.
    """
    written = [folder / RESULTS_FILE, *save(summarise(report.results), folder)]
    written += save_records([claim.record() for claim in report.claims], folder, "claims")
    page = folder / "claims.md"
    page.write_text(claims_markdown(report.claims), encoding="utf-8")
    written.append(page)
    if figures:
        from guided_gym.train.drawing import draw_paper

        written += draw_paper(report.results, report.plans, folder / "figures", drawn)
    return written
