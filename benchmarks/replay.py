"""How fast the page of a replay opens, and how smoothly it scrubs, in a headless Chromium.

Needs playwright and Chromium (tests/browser/install.sh). Frames count what the browser has drawn, not only
what the page's script has spent.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from command_line import command_line, write_figures

from guided_gym import Measure, Search, make_distribution, make_guidance
from guided_gym.display.replay import replay_page
from guided_gym.search.search import Expansion
from guided_gym.traces.writing import TraceWriter

# Name to (guidance, nodes of the tree at which the search ends, samples at which it ends).
CASES = {
    "1,000 samples, goal_distance": ("goal_distance", 10**9, 1000),
    "1,000 samples, lazy_prm": ("lazy_prm", 10**9, 1000),
    "4,000 nodes, rrt with its cells": ("rrt", 4000, 10**9),
    "20,000 nodes, uninformed": ("uninformed", 20_000, 10**9),
}
FRAMES = 120
SCRUBS = {
    "forwards": "i / FRAMES",
    "backwards": "1 - i / FRAMES",
    "at random": "((i * 7919) % FRAMES) / FRAMES",
}
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


class _Tracing:
    """A watcher that measures and records."""

    def __init__(self, writer: TraceWriter, measure: Measure) -> None:
        self._writer, self._measure, self._row = writer, measure, (0.0, 0.0)

    def before(self, node: int) -> None:
        self._writer.chosen(node)
        self._row = self._measure.choice(node)

    def after(self, expansion: Expansion) -> None:
        self._writer.became(expansion, *self._row)

    def take(self, rows: np.ndarray) -> None:
        raise AssertionError("asked one by one")

    def rewiring(self) -> None:
        """No planner is watched here."""

    def changed(self) -> None:
        """No planner is watched here."""


def record(guidance: str, nodes: int, samples: int, path: Path) -> None:
    """Search TrapCup until the tree has so many nodes, solved or not, and write the trace."""
    problem = make_distribution("TrapCup").problem(0)
    search = Search(problem, np.random.default_rng(0), np.random.default_rng(1))
    measure, guide = Measure(search), make_guidance(guidance)
    search.attach(guide)
    with TraceWriter(path) as writer:
        writer.begin(search, guide=guide, measure=measure, seed=0, labels={"guidance": guidance})
        search.run(
            guide,
            samples,
            propose=guide.propose,
            watcher=_Tracing(writer, measure),
            stop=lambda: len(search.tree) >= nodes,
        )
        writer.end(search.path())


def scrub(page, expression: str) -> float:
    """Frames a second that are drawn while the page goes through a search."""
    return page.evaluate(
        """async ([expression, FRAMES]) => {
            const at = new Function("i", "FRAMES", "return " + expression);
            const began = performance.now();
            for (let i = 0; i < FRAMES; i++) {
                player.seek(at(i, FRAMES) * player.length);
                await new Promise((done) => requestAnimationFrame(done));
            }
            return 1000 * FRAMES / (performance.now() - began);
        }""",
        [expression, FRAMES],
    )


def main() -> None:
    """Print a line per case."""
    from playwright.sync_api import sync_playwright

    parser = command_line(__doc__)
    options = parser.parse_args()
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    rows = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for name, (guidance, nodes, samples) in CASES.items():
            trace, file = Path(folder) / "trace.jsonl", Path(folder) / "page.html"
            record(guidance, nodes, samples, trace)
            file.write_text(replay_page([trace]), encoding="utf-8")
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            began = time.perf_counter()
            page.goto(file.as_uri())
            assert page.evaluate("Boolean(window.player)")
            opened = time.perf_counter() - began
            row = {"case": name, "megabytes": file.stat().st_size / 1e6, "open_seconds": opened}
            row |= {f"fps {how}": scrub(page, expression) for how, expression in SCRUBS.items()}
            rows.append(row)
            print("  ".join(f"{k}: {v:.3g}" if isinstance(v, float) else v for k, v in row.items()))
            page.close()
        browser.close()
    write_figures(options.json, rows)


if __name__ == "__main__":
    main()
