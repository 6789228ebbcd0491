"""Pictures of the pages that `guided-gym replay` and `report` make, for docs/replay.md.

    python docs/make_screenshots.py

Needs playwright, Chromium (tests/browser/install.sh) and pillow.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from guided_gym import guided_search, make_distribution
from guided_gym.display.replay import replay_page

IMAGES = Path(__file__).parent / "images"
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
EVALUATION = ["--env", "TrapCup", "--guidance", "rrt,lazy_prm,medial_axis,hybrid", "--seeds", "16"]


def save(png: bytes, name: str, width: int) -> None:
    """Write a picture, small and with few colours."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    few = image.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(IMAGES / f"{name}.png", optimize=True)


def main() -> None:
    """Make the pages, and photograph them."""
    problem = make_distribution("TrapCup").problem(0)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        for guidance in ("hybrid", "wavefront"):
            guided_search(problem, guidance, seed=3, trace=folder / f"{guidance}.jsonl")
            page = replay_page([folder / f"{guidance}.jsonl"])
            (folder / f"{guidance}.html").write_text(page, encoding="utf-8")
        command = [sys.executable, "-m", "guided_gym.train.cli", "evaluate", *EVALUATION, "--report"]
        subprocess.run([*command, "--out", "results/trapcup"], cwd=folder, check=True)
        program = next(filter(None, map(shutil.which, PROGRAMS)), None)
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 1280, "height": 860})
        shown.goto((folder / "hybrid.html").as_uri())
        shown.evaluate("player.seek(58); player.stages[0].guide = 1; player.draw()")
        save(shown.screenshot(), "replay-light", 900)
        narrow = browser.new_context(
            viewport={"width": 390, "height": 844}, color_scheme="dark", device_scale_factor=2
        ).new_page()
        narrow.goto((folder / "wavefront.html").as_uri())
        narrow.evaluate("player.seek(player.length)")
        save(narrow.screenshot(), "replay-dark-narrow", 390)
        report = browser.new_page(viewport={"width": 1280, "height": 1180})
        report.goto((folder / "results" / "trapcup" / "report.html").as_uri())
        save(report.screenshot(), "report-light", 900)
        browser.close()


if __name__ == "__main__":
    main()
