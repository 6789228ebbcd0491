"""What the pages show works: their Python blocks run, and their links lead somewhere."""

from __future__ import annotations

import contextlib
import importlib.util
import pkgutil
import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

import guided_gym
import guided_gym.catalogue.table
import guided_gym.guidance.registry

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page
    for page in (*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"))
    if page.name != "CHANGELOG.md"
)
NO_RUN = "<!-- no-run -->"
NEEDS = re.compile(r"<!-- needs: ([\w ]+) -->")  # packages without which a page's blocks are skipped


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
    text = page.read_text(encoding="utf-8")
    for package in " ".join(NEEDS.findall(text)).split():
        pytest.importorskip(package)
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
    for line, source in blocks(text):
        # Blank lines before the source give errors the page's own line numbers.
        exec(compile("\n" * line + source, str(page), "exec"), module.__dict__)


def without_code(page: Path) -> str:
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Where links into a page may lead: its headings, as GitHub and the site name them."""
    headings = re.findall(r"^#+ (.+)$", without_code(page), flags=re.MULTILINE)
    plain = (re.sub(r"[`*]|\]\([^)]*\)|\[", "", heading).lower() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(REPOSITORY)) for page in PAGES])
def test_links_lead_somewhere(page: Path) -> None:
    text = without_code(page)
    targets = re.findall(r"\]\(([^)\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    broken = []
    for target in targets:
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        if "://" in target or target.startswith("mailto:"):
            continue
        if not there.exists() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(REPOSITORY)) for page in PAGES])
def test_names_of_the_package_exist(page: Path) -> None:
    """`guided_gym.room.name` in the text is a module, or something in one."""
    names = set(re.findall(r"`(guided_gym(?:\.\w+)+)", without_code(page)))
    assert sorted(name for name in names if not exists(name)) == []


def exists(name: str) -> bool:
    """A module is there even if what it needs is an extra that is not."""
    for look in (pkgutil.resolve_name, importlib.util.find_spec):
        with contextlib.suppress(ImportError, AttributeError):
            if look(name) is not None:
                return True
    return False


# The site --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site() -> types.ModuleType:
    """docs/build_site.py, which makes what the site has beside the pages."""
    spec = importlib.util.spec_from_file_location("build_site", REPOSITORY / "docs" / "build_site.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_has_exactly_the_public_names(site: types.ModuleType) -> None:
    pages = site.reference_pages()
    described = re.findall(r"^::: (guided_gym\.\S+)$", "\n".join(pages.values()), flags=re.MULTILINE)
    assert sorted(name.rpartition(".")[2] for name in described) == sorted(
        name for name in guided_gym.__all__ if name != "__version__"
    )
    for name in described:
        assert f"[{name}]" in pages["reference/index.md"]
        home, _, last = name.rpartition(".")
        module = importlib.import_module(home)
        assert hasattr(module, last) or importlib.import_module(name)


def test_the_navigation_has_every_page(site: types.ModuleType) -> None:
    text = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8")
    listed = set(re.findall(r"[\w/-]+\.md", text[text.index("nav:\n") :]))
    there = {str(page.relative_to(REPOSITORY / "docs")) for page in (REPOSITORY / "docs").rglob("*.md")}
    elsewhere = {name for name in site.ELSEWHERE.values() if name.endswith(".md")}
    assert listed == there | elsewhere


@pytest.mark.parametrize(
    ("source", "name", "link", "turned"),
    [
        ("docs/index.md", "index.md", "[a](../README.md)", "[a](overview.md)"),
        ("docs/index.md", "index.md", "[a](framework.md#b)", "[a](framework.md#b)"),
        ("docs/tutorials/a.md", "tutorials/a.md", "[a](../maps.md)", "[a](../maps.md)"),
        ("docs/tutorials/a.md", "tutorials/a.md", "[a](../../README.md#x)", "[a](../overview.md#x)"),
        ("README.md", "overview.md", "[a](docs/maps.md#x)", "[a](maps.md#x)"),
        ("README.md", "overview.md", "![a](docs/images/a.png)", "![a](images/a.png)"),
        ("README.md", "overview.md", '<img src="docs/images/a.png">', '<img src="images/a.png">'),
        ("README.md", "overview.md", "[a](LICENSE)", "[a](LICENSE.txt)"),
        ("README.md", "overview.md", "[a](https://x.org/docs/b.md)", "[a](https://x.org/docs/b.md)"),
        ("README.md", "overview.md", "[a](#docs)", "[a](#docs)"),
    ],
)
def test_links_are_turned(site: types.ModuleType, source: str, name: str, link: str, turned: str) -> None:
    assert site.turned_links(link, source, name) == turned


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(REPOSITORY)) for page in PAGES])
def test_what_pages_link_to_is_on_the_site(site: types.ModuleType, page: Path) -> None:
    source = str(page.relative_to(REPOSITORY))
    if not source.startswith("docs/") and source not in site.ELSEWHERE:
        return  # no page of the site
    for target in re.findall(r"\]\(([^)\s#]+)", without_code(page)):
        there = page.parent.joinpath(target).resolve()
        if "://" not in target and not there.is_relative_to(REPOSITORY / "docs"):
            assert there.relative_to(REPOSITORY).as_posix() in site.ELSEWHERE, target


def test_a_broken_link_of_the_site_is_found(site: types.ModuleType, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "index.html").write_text('<h2 id="there">x</h2><img src="../a.png">')
    (tmp_path / "index.html").write_text(
        '<a href="b/index.html#there"></a><a href="b/"></a><a href="#none"></a><a href="b/index.html#no"></a>'
        '<a href="c.html"></a><a href="https://x.org/no"></a><p id="me"></p><a href="#me"></a>'
    )
    assert site.broken_links(tmp_path) == [
        "b/index.html: ../a.png",
        "index.html: #none",
        "index.html: b/index.html#no",
        "index.html: c.html",
    ]
