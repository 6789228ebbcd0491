"""What the pages show works: their Python blocks run, and their links lead somewhere."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

import guided_gym.catalogue.table
import guided_gym.guidance.registry

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page
    for page in (*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"))
    if page.name != "CHANGELOG.md"
)
NO_RUN = "<!-- no-run -->"


def blocks(text: str) -> Iterator[tuple[int, str]]:
    """(line before the first one, source) of each ```python block that is not marked `<!-- no-run -->`."""
    lines = text.splitlines()
    start: int | None = None
    fence = ""
    for number, line in enumerate(lines):
        opening = re.match(r"\s*(```+)\s*(\w*)", line)
        if start is None and opening:
            fence = opening[1]
            start, language = number + 1, opening[2]
        elif start is not None and line.strip() == fence:
            before = next((text.strip() for text in reversed(lines[: start - 1]) if text.strip()), "")
            if language == "python" and before != NO_RUN:
                yield start, "\n".join(lines[start:number])
            start = None


def test_blocks__finds_what_runs_and_skips_what_does_not() -> None:
    text = f"```python\na = 1\n```\n\n{NO_RUN}\n\n```python\nb\n```\n```bash\nls\n```\n```python\nc\nd\n```"
    assert list(blocks(text)) == [(1, "a = 1"), (13, "c\nd")]


RUNNABLE = [page for page in PAGES if list(blocks(page.read_text(encoding="utf-8")))]


@pytest.mark.parametrize("page", RUNNABLE, ids=[str(page.relative_to(REPOSITORY)) for page in RUNNABLE])
def test_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page run in their order, in one namespace and an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # What a page registers is gone after it.
    registry = guided_gym.guidance.registry
    for table in (registry.GUIDANCES, registry.ROBOT_TABLE, registry.ENVIRONMENT_TABLE):
        monkeypatch.setattr(table, "rows", dict(table.rows))
    catalogue = guided_gym.catalogue.table
    monkeypatch.setattr(catalogue, "_CATALOGUE", dict(catalogue._CATALOGUE))
    module = types.ModuleType("page")  # a real module: dataclasses look up the one that they are defined in
    monkeypatch.setitem(sys.modules, "page", module)
    for line, source in blocks(page.read_text(encoding="utf-8")):
        # Blank lines before the source give errors the page's own line numbers.
        exec(compile("\n" * line + source, str(page), "exec"), module.__dict__)


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(REPOSITORY)) for page in PAGES])
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    local = [target for target in targets if "://" not in target and not target.startswith("mailto:")]
    assert [target for target in local if not (page.parent / target).exists()] == []
