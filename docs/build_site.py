"""What the documentation site has beside the pages of this folder (a hook of mkdocs; see mkdocs.yml).

The reference, exactly the public names of `guided_gym`, a page for each room; the README and its neighbours,
their links turned to what they are on the site; and, at the end, a check that no link of a page is broken.
"""

from __future__ import annotations

import html.parser
import posixpath
import re
import urllib.parse
from pathlib import Path
from typing import Any, Final

REPOSITORY: Final = Path(__file__).resolve().parents[1]
# Files of the repository that have a page, or lie beside the pages, and where.
ELSEWHERE: Final[dict[str, str]] = {
    "README.md": "overview.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "LICENSE": "LICENSE.txt",
    "CITATION.cff": "CITATION.cff",
}
# Programs and their settings, which pages link to; browsers show a text, and mkdocs leaves out *.py.
ELSEWHERE.update(
    (f"examples/{path}", f"examples/{path}.txt")
    for path in sorted(
        file.relative_to(REPOSITORY / "examples").as_posix()
        for file in (REPOSITORY / "examples").rglob("*")
        if file.suffix in (".py", ".yml", ".toml")
    )
)
REFERENCE: Final = "reference"
ROOMS: Final = {
    "problems": "Problems",
    "geometry": "Robots and workspaces",
    "planning": "Guided search",
    "options": "Options",
    "guidance": "Guiding spaces",
    "search": "Trees and expansions",
    "measure": "The oracle and the metric",
    "catalogue": "Catalogue and files",
    "storage": "Stored paths",
    "trajectories": "Paths for robots",
    "traces": "Traces",
    "randomness": "Randomness",
    "errors": "Errors",
    "envs": "Environments",
    "agents": "Agents",
    "train": "Evaluation and planning programs",
}


def title_of(room: str) -> str:
    """What the page of a room is called."""
    return ROOMS.get(room, room.capitalize())


def reference_pages() -> dict[str, str]:
    """The pages of the reference by their names: one for each room, and the list of all."""
    from guided_gym import _HOMES

    rooms: dict[str, list[tuple[str, str]]] = {}
    for module, names in _HOMES.items():
        rooms.setdefault(module.partition(".")[0], []).extend((module, name) for name in names)
    pages = {}
    listed = [
        "# Reference",
        "",
        "What is public, and nothing else. All of it is imported from `guided_gym`.",
        "",
    ]
    for room in sorted(rooms, key=[*ROOMS, *rooms].index):
        title = title_of(room)
        body = [f"# {title}", ""]
        listed += [f"**[{title}]({room}.md)**", ""]
        for module, name in sorted(rooms[room], key=lambda one: one[1].lower()):
            identifier = f"guided_gym.{module}.{name}"
            body += [f"::: {identifier}", "    options:", f"      heading: {name}", ""]
            listed += [f"[`{name}`][{identifier}]"]
        listed += [""]
        pages[f"{REFERENCE}/{room}.md"] = "\n".join(body)
    pages[f"{REFERENCE}/index.md"] = "\n".join(listed)
    return pages


def on_config(config: Any) -> Any:
    """Put the reference's pages where the navigation says ``reference/``, made of the installed package."""
    import guided_gym

    # Not the checkout's folder, in which not all rooms have the names under which they are installed.
    package = Path(guided_gym.__file__).resolve().parents[1]
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [str(package)]
    pages = [f"{REFERENCE}/index.md", *({title_of(Path(page).stem): page} for page in sorted_rooms())]
    config.nav = [
        {"Reference": pages} if entry == {"Reference": f"{REFERENCE}/"} else entry for entry in config.nav
    ]
    return config


on_config.mkdocs_priority = 100  # type: ignore[attr-defined]  # before mkdocstrings reads its paths


def sorted_rooms() -> list[str]:
    """The pages of the rooms, in the order of `ROOMS`."""
    return [page for page in reference_pages() if not page.endswith("/index.md")]


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are no files of this folder."""
    from mkdocs.structure.files import File

    for source, name in ELSEWHERE.items():
        files.append(File.generated(config, name, abs_src_path=str(REPOSITORY / source)))
    for name, text in reference_pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Turn the links of a page to where the files of the repository are on the site."""
    name = page.file.src_uri
    if name.startswith(f"{REFERENCE}/"):
        return markdown
    sources = {site: source for source, site in ELSEWHERE.items()}
    return turned_links(markdown, sources.get(name, f"docs/{name}"), name)


def on_page_content(content: str, page: Any, config: Any, files: Any) -> str:
    """Give the page the room of its table of contents where that has nothing but the title."""
    if all(not title.children for title in page.toc):
        page.meta["hide"] = ["toc"]
    return content


def turned_links(markdown: str, source: str, name: str) -> str:
    """Markdown whose relative links lead to pages of the site.

    Args:
        markdown: The text of a page.
        source: Its file in the repository.
        name: Its name on the site.
    """

    def turn(match: re.Match[str]) -> str:
        target, rest = match[2], match[3]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        there = ELSEWHERE.get(path) or path.removeprefix("docs/")
        if "://" in target or (path == there and path not in ELSEWHERE):
            return match[0]
        return f"{match[1]}{posixpath.relpath(there, posixpath.dirname(name) or '.')}{rest}"

    return re.sub(r'(\]\(|src=")([^)#\s"]+)([^)"]*[)"])', turn, markdown)


# The check --------------------------------------------------------------------------------------------------


class _Links(html.parser.HTMLParser):
    """The ids of a page, and what it refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.targets: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value and name in ("id", "name"):
                self.ids.add(value)
            if value and name in ("href", "src") and tag != "base":
                self.targets.append(value)


def broken_links(folder: Path) -> list[str]:
    """The links of the pages in a folder that lead nowhere: to a file or place in it that is not there."""
    pages = {}
    for file in sorted(folder.rglob("*.html")):
        pages[file] = _Links()
        pages[file].feed(file.read_text(encoding="utf-8"))
    broken = []
    for file, links in pages.items():
        if file.name == "404.html":  # its links are absolute
            continue
        for target in dict.fromkeys(links.targets):
            parts = urllib.parse.urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            there = (file.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else file
            there = there / "index.html" if there.is_dir() else there
            fragment = urllib.parse.unquote(parts.fragment)
            if not there.exists() or (fragment and there in pages and fragment not in pages[there].ids):
                broken.append(f"{file.relative_to(folder)}: {target}")
    return broken


def on_post_build(config: Any) -> None:
    """Refuse a site with broken links, or whose reference lacks a public name."""
    from mkdocs.exceptions import PluginError

    import guided_gym

    folder = Path(config.site_dir)
    broken = broken_links(folder)
    if broken:
        raise PluginError("links that lead nowhere:\n  " + "\n  ".join(broken))
    described = _Links()
    for page in sorted_rooms():
        described.feed((folder / page).with_suffix(".html").read_text(encoding="utf-8"))
    lacking = {
        name
        for module, names in guided_gym._HOMES.items()
        for name in names
        if f"guided_gym.{module}.{name}" not in described.ids
    }
    if lacking:
        raise PluginError(f"the reference lacks {sorted(lacking)}")
