"""Measure and draw the methods of docs/methods.md: ``python docs/make_methods.py [SEEDS]``.

Each row of `METHODS` is a method of the paper with the expression that builds it here. The program draws what
guides, runs searches over the seeds, and writes the table between the two marks of the page.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from guided_gym import (
    EvaluationSettings,
    GuidanceSpec,
    Search,
    build_path_database,
    evaluate,
    figures,
    make_distribution,
    make_guidance,
    streams,
    summarise,
)

DOCS = Path(__file__).parent
PAGE = DOCS / "methods.md"
BEGIN, END = "<!-- table: docs/make_methods.py -->", "<!-- end of table -->"
ENVIRONMENTS = ("TrapCup", "RandomTrapCup@test")
SEEDS, MAX_SAMPLES, PATHS = 24, 1000, 300
DOTS_PER_INCH = 45  # of a small picture in a table
SHOWN_SEED, SHOWN_SAMPLES = 3, 60


class Method(NamedTuple):
    """A method of the paper, as a composition.

    Attributes:
        name: File name of its picture.
        title: What the paper calls it.
        expression: What builds it; ``paths.db`` is a file of stored paths.
    """

    name: str
    title: str
    expression: str


METHODS = (
    Method("point", "point robot in the workspace", "roadmap(robot=point)"),
    Method("inner", "bounding volume inside the robot", "roadmap(robot=disc)"),
    Method("outer", "bounding volume around the robot", "roadmap(robot=disc(outer=true))"),
    Method("subset", "a subset of the degrees of freedom", "roadmap(robot=subset(2))"),
    Method("pca", "PCA of paths", 'roadmap(robot=principal("paths.db", dimensions=2))'),
    Method("skeleton", "skeleton of the workspace", "skeleton(robot=point)"),
    Method("hierarchy", "skeleton, then workspace, then C", "searched(robot=point, guidance=skeleton)"),
    Method("lazy", "lazy planning", "roadmap(environment=nothing)"),
    Method("without", "without some obstacles", "roadmap(environment=without(0))"),
    Method("revealed", "obstacles as they are met", "roadmap(environment=revealed)"),
    Method("shrunk", "iterative relaxation", "roadmap(environment=shrunk)"),
    Method("hulls", "added constraints: hulls", "roadmap(environment=hulls)"),
    Method("boxes", "added constraints: boxes", "roadmap(environment=boxes)"),
    Method("task", "retrieval by task", 'path_database("paths.db", by=task)'),
    Method("dtw", "retrieval by dynamic time warping", 'path_database("paths.db", by=dtw)'),
    Method("occupancy", "filtered by local occupancy", 'path_database("paths.db", by=occupancy)'),
    Method("mixture", "several paths as a mixture", 'path_database("paths.db", mixture=1.0)'),
    Method("encoder", "encoder and decoder", "learned:se2"),
    Method("wave", "point robot, by a wave", "wave(robot=point)"),
)


def draw(method: Method) -> None:
    """What guides a search on TrapCup, after a few samples."""
    problem = make_distribution("TrapCup").problem(SHOWN_SEED)
    guidance = make_guidance(method.expression)
    search = Search(problem, *streams(SHOWN_SEED)[1:])
    search.attach(guidance)
    search.run(guidance, SHOWN_SAMPLES)
    figure = figures.guiding_space(guidance, search, title="")
    figure.savefig(
        DOCS / "images" / f"method-{method.name}.png", dpi=DOTS_PER_INCH, metadata={"Software": None}
    )


def table(seeds: int) -> str:
    """The table, measured."""
    specs = [GuidanceSpec.of(method.expression, label=method.name) for method in METHODS]
    settings = EvaluationSettings(max_samples=MAX_SAMPLES)
    rows = summarise(evaluate(ENVIRONMENTS, specs, seeds=seeds, settings=settings))
    figures_of = {(row.guidance, row.environment): row.figures for row in rows}
    head = ["method", "expression", "", *(f"{name}: solved, samples, total SE" for name in ENVIRONMENTS)]
    lines = [" | ".join(head), " | ".join("---" for _ in head)]
    for method in METHODS:
        picture = f"![{method.title}](images/method-{method.name}.png)"
        cells = [method.title, f"`{method.expression}`", picture]
        for environment in ENVIRONMENTS:
            found = figures_of[method.name, environment]
            samples, total = found["samples_mean"], found["total_efficiency"]
            cells.append(
                f"{100 * found['solved'].estimate:.0f} %, "
                f"{samples.estimate:.0f} [{samples.low:.0f}, {samples.high:.0f}], "
                f"{total.estimate:.0f} [{total.low:.0f}, {total.high:.0f}]"
            )
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def put_between(page: Path, begin: str, end: str, text: str) -> None:
    """Write a text between two marks of a page, in place of what is there."""
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def main(seeds: int) -> None:
    """Draw, measure, and write the table into the page."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        build_path_database("RandomTrapCup", Path("paths.db"), PATHS)
        for method in METHODS:
            draw(method)
        measured = table(seeds)
    said = f"Seeds 0 to {seeds - 1}; a search gives up after {MAX_SAMPLES} samples."
    put_between(PAGE, BEGIN, END, f"{said}\n\n{measured}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS)
