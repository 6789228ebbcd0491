"""How problems, searches and guiding spaces show themselves in a notebook (`_repr_html_`)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from guided_gym.display.pages import embedded, escaped, page
from guided_gym.display.replay import SCRIPTS, note_rest, shown_lines
from guided_gym.display.svg import Picture, problem_picture
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.solids import SpatialEnvironment
from guided_gym.guidance.cells import Uninformed, Voronoi
from guided_gym.measure.target import Measure
from guided_gym.search.search import NO_NODE, Search
from guided_gym.traces.views import FIELD_CELLS, drawing_of, heuristic_field, leaf_guides
from guided_gym.traces.writing import TraceWriter, label_of

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.planning import SearchResult
    from guided_gym.problems import Problem

MOST_SAMPLES: Final = 3000  # of a search that is played in a notebook, which keeps what it shows
_HEIGHT: Final = 620
_BESIDE: Final = "display: inline-block; vertical-align: top; margin: 0 18px 8px 0"


def facts(title: str, rows: dict[str, object]) -> str:
    """A title and a small table."""
    cells = "".join(
        f'<tr><td style="text-align: left; opacity: 0.7">{escaped(name)}</td>'
        f'<td style="text-align: left">{escaped(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f"<div><b>{escaped(title)}</b><table>{cells}</table></div>"


def beside(*parts: str) -> str:
    """Put parts next to each other, as far as there is room."""
    return "<div>" + "".join(f'<div style="{_BESIDE}">{part}</div>' for part in parts) + "</div>"


def problem_html(problem: Problem) -> str:
    """A problem: its picture, and what it consists of."""
    environment, task = problem.environment, problem.task
    corners = environment.room if isinstance(environment, SpatialEnvironment) else environment.bounds
    ends = np.reshape(corners, (2, -1))
    sides = " x ".join(f"{side:.6g}" for side in ends[1] - ends[0])
    rows: dict[str, object] = {
        "robot": f"{problem.robot.name}, {problem.space.dimension} coordinates",
        "workspace": f"{sides}, {len(environment.obstacles)} obstacles",
        "start": np.round(task.start, 3).tolist(),
        "goal": np.round(task.goal, 3).tolist(),
    }
    if problem.regions:
        rows["regions"] = ", ".join(problem.regions)
    return beside(problem_picture(problem).text(), facts(problem.name, rows))


def search_html(search: Search, title: str = "Search in progress") -> str:
    """A search as it stands."""
    picture = Picture(search.problem, f"{title} on {search.problem.name}")
    path = search.path()
    if path is not None:
        picture.path(path)
    picture.obstacles()
    picture.tree(search.tree)
    picture.task()
    rows: dict[str, object] = {
        "problem": search.problem.name,
        "samples": search.samples,
        "nodes": len(search.tree),
        "collisions": search.tree.failure_count,
        "solved": f"yes, a path of length {search.cost:.4g}" if search.solved else "not yet",
    }
    return beside(picture.text(), facts(title, rows))


def result_html(result: SearchResult) -> str:
    """A search that has ended, with its replay in a frame of its own, which cannot touch the notebook."""
    lines = lines_again(result)
    if lines is None:
        return _still(result)
    body = (
        f'<main style="padding: 4px"><div id="player"></div></main>{embedded({"lines": lines}, kind="trace")}'
    )
    text = page(repr(result), body, scripts=(*SCRIPTS, "inline.js"))
    return (
        f'<iframe title="{escaped(repr(result))}" sandbox="allow-scripts" srcdoc="{escaped(text)}" '
        f'style="width: 100%; height: {_HEIGHT}px; border: 0"></iframe>'
    )


def _still(result: SearchResult) -> str:
    picture = Picture(result.problem, repr(result))
    if result.path is not None:
        picture.path(result.path)
    picture.obstacles()
    picture.tree(result.tree)
    picture.task()
    return beside(picture.text(), facts(repr(result), {}))


class _Lines(list[dict[str, Any]]):
    """What takes the lines of a trace, and keeps them."""

    def write(self, text: str) -> None:
        """Take one line."""
        self.append(json.loads(text))


def lines_again(result: SearchResult) -> list[dict[str, Any]] | None:
    """The trace of a search that was not recorded, from its choices; None where they do not tell its tree.

    The tree is grown again, rewiring included. Of a search of very many samples, the first are shown.
    """
    record, problem, tree = result.record, result.problem, result.tree
    grew = record.child != NO_NODE
    if len(tree) != 1 + int(grew.sum()) or tree.failure_count != int((~grew).sum()):
        return None  # a planner of another library that grows by more than its samples
    targets = np.empty((record.child.size, problem.space.dimension))
    targets[grew] = tree.configurations[record.child[grew]]
    targets[~grew] = tree.failed_targets
    rng = np.random.default_rng(0)  # nobody draws from it
    search = Search(problem, rng, rng, result.options)
    measured = bool(np.isfinite(record.efficiency).all()) and record.efficiency.size > 0
    lines = _Lines()
    writer = TraceWriter(lines)
    writer.begin(search, measure=Measure(search) if measured else None, labels={"title": "Search"})
    for i, node in enumerate(record.selected[:MOST_SAMPLES].tolist()):
        writer.chosen(node)
        expansion = search.expand(node, targets[i])
        writer.became(expansion, float(record.efficiency[i]), float(record.best[i]))
    writer.end(search.path())
    shown = shown_lines(lines[0], lines[1:], problem)
    if result.samples > MOST_SAMPLES:
        note_rest(shown, MOST_SAMPLES, result.samples - MOST_SAMPLES)
    return shown


def guiding_space_html(guide: GuidingSpace) -> str:
    """A guiding space: its options, and once it has been prepared for a search, what it sees there."""
    leaves = leaf_guides(guide)
    rows: dict[str, object] = {}
    if len(leaves) > 1:
        rows["guides"] = ", ".join(map(label_of, leaves))
        rows["rule"] = type(getattr(guide, "rule", None)).__name__
    for name in ("temperature", "expansion_penalty"):
        if getattr(guide, name, 0.0):
            rows[name] = f"{getattr(guide, name):g}"
    search = getattr(guide, "search", None)
    if search is None:
        rows["state"] = "not prepared for a search yet"
        return facts(label_of(guide), rows)
    rows["search"] = f"{search.problem.name}, {search.samples} samples"
    pictures = [_seen(leaf, search) for leaf in leaves]
    return beside(*pictures, facts(label_of(guide), rows))


def _seen(guide: GuidingSpace, search: Search) -> str:
    picture = Picture(search.problem, f"What {label_of(guide)} sees")
    drawing = drawing_of(guide)
    planar = isinstance(search.problem.robot, Robot)
    if "field" in drawing:
        picture.field(drawing["field"], drawing["bounds"])
    elif not drawing and planar and not isinstance(guide, Voronoi | Uninformed):
        bounds, values = heuristic_field(guide, search, FIELD_CELLS)
        picture.field(values, bounds)
    picture.obstacles()
    if "edges" in drawing:
        picture.graph(drawing)
    else:
        picture.tree(search.tree)
    picture.task()
    return picture.text()
