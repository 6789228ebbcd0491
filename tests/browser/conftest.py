"""A headless Chromium for the tests of pages; they skip where there is none (see install.sh)."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 120_000  # ms; on a machine that is busy with much else
HOW = "run tests/browser/install.sh"

Open = Callable[..., Any]


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, started once for all tests of a process."""
    api = pytest.importorskip("playwright.sync_api", reason=f"playwright is not installed: {HOW}")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"no Chromium found: {HOW}")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"], timeout=PATIENCE)
        yield started
        started.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Opens a file or address; a message on the console or an error in a page fails the test at its end."""
    contexts: list[Any] = []
    messages: list[str] = []
    asked: list[str] = []

    def open_it(place: Path | str, *, width: int = 1280, height: int = 900, theme: str = "light") -> Any:
        touch = width < 500
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=theme, has_touch=touch
        )
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(place.as_uri() if isinstance(place, Path) else place)
        return page

    open_it.messages, open_it.asked = messages, asked  # type: ignore[attr-defined]
    yield open_it
    for context in contexts:
        context.close()
    assert messages == []


@pytest.fixture
def pixels() -> Callable[[Any], np.ndarray[Any, Any]]:
    """(H, W, 4) pixels of a canvas or page, as somebody would see them."""
    image = pytest.importorskip("PIL.Image")

    def shot(what: Any) -> np.ndarray[Any, Any]:
        return np.asarray(image.open(io.BytesIO(what.screenshot())).convert("RGBA"))

    return shot
