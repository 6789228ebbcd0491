"""The paper's experiments (paper, Experiments): searches, figures, and its claims with a verdict each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from guided_gym.compute.workers import Workers
from guided_gym.doors import door
from guided_gym.storage.whole_file import write_whole
from guided_gym.train.arm_claims import ARM, arm_claims
from guided_gym.train.arm_claims import GUIDANCES as ARM_GUIDANCES
from guided_gym.train.claims import (
    DATABASE_SIZES,
    DRAWN,
    PROBLEMS,
    ClaimResult,
    check_claims,
    database_label,
    own_checks,
    paper_claims,
)
from guided_gym.train.evaluation import Plan, checked_seeds, run_plans
from guided_gym.train.paths import build_path_database
from guided_gym.train.results import RESULTS_FILE, Results
from guided_gym.train.specs import DATABASE_GUIDANCE, GuidanceSpec
from guided_gym.train.table import rich_tables, save, save_records, summarise
from guided_gym.train.terminal import Progress, named

if TYPE_CHECKING:
    from rich.table import Table

SEEDS = 128
GUIDANCES = ("rrt", "lazy_prm", "medial_axis", "oracle")
BASELINES = ("goal_distance", "uninformed")
DATABASE_FILE = f"paths-{DRAWN}.sqlite"
PAPER_TITLE = "The paper's claims"
OWN_TITLE = "Our own checks, which the paper does not claim"
HOW = (
    "Differences of paired seeds and shares with 95 % intervals. Holds, or does not hold: the whole interval "
    "lies on that side; open: it does not."
)


@dataclass(frozen=True)
class Report:
    """What the reproduction found.

    Attributes:
        results: All runs.
        claims: The paper's claims with their verdicts.
        checks: Our own, which the paper does not make.
        plans: What was run.
    """

    results: Results
    claims: list[ClaimResult]
    checks: list[ClaimResult]
    plans: list[Plan]

    def tables(self) -> list[Table]:
        """For `rich.print`: the figures per problem, the paper's claims, and our own checks."""
        return [
            *rich_tables(summarise(self.results)),
            claims_table(self.claims, PAPER_TITLE),
            claims_table(self.checks, OWN_TITLE),
        ]


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


def reproduce_arms(
    *,
    seeds: int = SEEDS,
    workers: Workers = 1,
    out: str | Path = "results/arms",
    progress: Progress | None = None,
) -> Report:
    """Check the paper's claims on an arm (`guided_gym.train.arm_claims`); arguments as `reproduce`."""
    checked_seeds(seeds)
    plans = [Plan(ARM, GuidanceSpec(name)) for name in ARM_GUIDANCES]
    results = run_plans(plans, seeds=seeds, workers=workers, out=out, progress=named(progress, "Searching"))
    asked = check_claims(results, arm_claims())
    return Report(results, asked, check_claims(results, own_checks(results, drawn=False)), plans)


@door
def reproduce(
    *,
    seeds: int = SEEDS,
    workers: Workers = 1,
    out: str | Path = "results/paper",
    baselines: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Run the paper's experiments and check its claims; resumable like `guided_gym.evaluate`.

    Args:
        seeds: Searches per problem and guidance.
        workers: Processes, or another executor, such as `guided_gym.OnRay`.
        out: Folder of the results and of the path database, which is built first if it is not there.
        baselines: Whether to run goal_distance and uninformed on every problem, too.
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
        progress=named(progress, "Building the path database"),
    )
    plans = paper_plans(database, baselines)
    results = run_plans(plans, seeds=seeds, workers=workers, out=out, progress=named(progress, "Searching"))
    checks = check_claims(results, own_checks(results))
    return Report(results, check_claims(results, paper_claims()), checks, plans)


def claims_table(claims: list[ClaimResult], title: str) -> Table:
    """Claims with their verdicts and figures, and explanations of those that do not hold."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=f"{title}: {_count(claims)}", title_justify="left", show_lines=True,
        caption=HOW, caption_justify="left",
    )  # fmt: skip
    table.add_column("claim", overflow="fold", ratio=4)
    table.add_column("figures", overflow="fold", ratio=5)
    table.add_column("verdict", no_wrap=True)
    colours = {"holds": "green", "does not hold": "bold red"}
    for each in claims:
        words = f"“{each.claim.words}”\n" if each.claim.words else ""
        why = f"\nWhy: {each.why}" if each.why else ""
        colour = colours.get(each.verdict, "yellow")
        table.add_row(
            escape(words + each.claim.statement),
            escape(each.outcome.figures + why),
            f"[{colour}]{each.verdict}[/]",
        )
    return table


def _count(claims: list[ClaimResult]) -> str:
    """How many of them hold, do not, or neither."""
    verdicts = [each.verdict for each in claims]
    counts = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
    order = ("holds", "does not hold", "open", "not evaluated")
    said = [f"{counts[verdict]} {_PLURAL[verdict]}" for verdict in order if verdict in counts]
    return f"of {len(claims)}, {', '.join(said)}"


_PLURAL = {
    "holds": "hold",
    "does not hold": "do not hold",
    "open": "are open",
    "not evaluated": "were not evaluated",
}


def claims_markdown(claims: list[ClaimResult], title: str) -> str:
    """Claims as a Markdown table, for a page."""
    rows = [
        f"| {f'“{each.claim.words}”: ' if each.claim.words else ''}{each.claim.statement} "
        f"| {each.outcome.figures}{f' *Why:* {each.why}' if each.why else ''} | {each.verdict} |"
        for each in claims
    ]
    head = [f"### {title}: {_count(claims)}", "", HOW, "", "| claim | figures | verdict |", "|---|---|---|"]
    return "\n".join([*head, *rows, ""])


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
    records = [{"of": "paper", **each.record()} for each in report.claims]
    records += [{"of": "us", **each.record()} for each in report.checks]
    written += save_records(records, folder, "claims")
    page = folder / "claims.md"
    text = claims_markdown(report.claims, PAPER_TITLE) + "\n" + claims_markdown(report.checks, OWN_TITLE)
    write_whole(page, text)
    written.append(page)
    if figures:
        from guided_gym.train.drawing import draw_paper

        written += draw_paper(report.results, report.plans, folder / "figures", drawn)
    return written
