"""Photograph the lab for docs/lab.md: ``python docs/make_lab_picture.py`` (needs playwright and Chromium)."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

FILE = Path(__file__).parent / "images" / "lab.png"
PORT = 8799
COLOURS = 255


def searched(page: Page) -> None:
    """Wait until both searches have ended and were played."""
    done = "window.lab && lab.runs.length && lab.runs.every((run) => !run.running)"
    while not page.evaluate(f"!!({done}) && lab.player.sample >= lab.player.length"):
        page.wait_for_timeout(100)


def main() -> None:
    """Open the lab with a problem of two guidances, and write the picture."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        command = [
            sys.executable,
            "-m",
            "guided_gym.train.cli",
            "lab",
            folder,
            "--no-browser",
            "--port",
            str(PORT),
        ]
        server = subprocess.Popen(command)
        try:
            browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            for _ in range(60):
                time.sleep(1)
                try:
                    page.goto(f"http://127.0.0.1:{PORT}/")
                    break
                except Exception:  # not listening yet
                    continue
            page.wait_for_timeout(2000)
            page.get_by_role("button", name="Leave out rrt").click()
            page.get_by_label("A guidance or an expression").fill("medial_axis")
            page.get_by_role("button", name="Add").click()
            page.get_by_role("button", name="Search", exact=True).click()
            searched(page)
            page.wait_for_timeout(500)
            # As high as the page: the controls stick to the end of the window.
            page.set_viewport_size({"width": 1280, "height": page.evaluate("document.body.scrollHeight")})
            page.wait_for_timeout(500)
            picture = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
            few = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
            few.save(FILE, optimize=True)
            print(f"{FILE}: {picture.size}, {FILE.stat().st_size / 1e3:.0f} kB")
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
