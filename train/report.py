"""One page of an evaluation: what was run, tables, figures, replays, and what was not solved."""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from guided_gym.display.pages import embedded, escaped, page
from guided_gym.display.replay import SCRIPTS, trace_content
from guided_gym.errors import GuidedGymError, StorageError
from guided_gym.options import OracleOptions, TargetParameters
from guided_gym.storage.whole_file import write_whole
from guided_gym.train.chosen_runs import CHOICES, Chosen, trace_runs
from guided_gym.train.evaluation import Plan
from guided_gym.train.results import RESULTS_FILE, Results, ResultsFile, Run
from guided_gym.train.specs import (
    EvaluationSettings,
    GuidanceSpec,
    file_label,
    fingerprint,
    package_version,
    settings_content,
)
from guided_gym.train.statistics import paired_difference, significant
from guided_gym.train.table import (
    DISTRIBUTION_MEASURES,
    LEAST_PAIRS,
    MEASURES,
    Comparison,
    Measure,
    Row,
    ranking_measure,
    summarise,
    verdicts,
)

EVALUATION_FILE: Final = "evaluation.json"
REPORT_FILE: Final = "report.html"
_FORMAT: Final = "guided-gym evaluation 1"
_COMPARED: Final = (
    "total_efficiency",
    "excess_efficiency",
    "samples_median",
    "collision_checks",
    "processor",
)
_UNITS: Final = ("%", "median", "mean", "nats", "ms", "µs a sample")
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_FIGURE_SCALE: Final = 0.55  # CSS pixels for one of a figure's
_FIGURES: Final = {
    "efficiency": "Sampling efficiency over samples, and how many searches are solved",
    "regions": "Total SE by region of the selected node",
    "places": "Total SE by place of the selected node",
    "cost": "SE over processor time",
    "trees": "The tree of the first seed, coloured by the target Q",
    "guiding-spaces": "What guides, at the end of the first seed",
}


@dataclass(frozen=True)
class Evaluation:
    """What was run, and wrote its results into a folder.

    Attributes:
        plans: Environments, guidances and settings.
        prints: The settings fingerprint of each plan, by which its rows are found.
        seeds: The seeds.
        command: The command that repeats it.
        version: Of guided-gym.
    """

    plans: tuple[Plan, ...]
    prints: tuple[str, ...]
    seeds: tuple[int, ...]
    command: str
    version: str


def note_evaluation(folder: Path, plans: Sequence[Plan], seeds: Sequence[int], command: str) -> Path:
    """Write down what was run, for `report`.

    Raises:
        StorageError: The file cannot be written.
    """
    content = {
        "format": _FORMAT,
        "version": package_version(),
        "command": command,
        "seeds": list(seeds),
        "plans": [
            {
                "environment": plan.environment,
                "guidance": [plan.spec.name, [list(pair) for pair in plan.spec.options], plan.spec.label],
                "settings": asdict(plan.settings),
                "fingerprint": fingerprint(settings_content(plan.environment, plan.spec, plan.settings)),
            }
            for plan in plans
        ],
    }
    file = folder / EVALUATION_FILE
    write_whole(file, json.dumps(content, indent=1, default=str) + "\n")
    return file


def read_evaluation(folder: Path) -> Evaluation:
    """What was run, and wrote its results into a folder.

    Raises:
        StorageError: It holds no evaluation, or a damaged one.
    """
    file = folder / EVALUATION_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StorageError(
            f"expected a folder that `guided-gym evaluate` has written, but there is no {file}"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise StorageError(f"cannot read {file}: {error}") from error
    try:
        if content["format"] != _FORMAT:
            raise StorageError(f"{file}: expected {_FORMAT!r}, got {str(content['format'])[:60]!r}")
        plans = tuple(_plan(one) for one in content["plans"])
        prints = tuple(str(one["fingerprint"]) for one in content["plans"])
        seeds = tuple(int(seed) for seed in content["seeds"])
        command, version = str(content["command"]), str(content["version"])
    except (KeyError, TypeError, ValueError) as error:
        raise StorageError(f"{file} is damaged: {error}; evaluate again to write it anew") from error
    return Evaluation(plans, prints, seeds, command, version)


def _plan(content: Any) -> Plan:
    name, options, label = content["guidance"]
    settings = dict(content["settings"])
    target, oracle = TargetParameters(**settings.pop("target")), OracleOptions(**settings.pop("oracle"))
    spec = GuidanceSpec(str(name), tuple((str(key), value) for key, value in options), str(label))
    return Plan(
        str(content["environment"]), spec, EvaluationSettings(**settings, target=target, oracle=oracle)
    )


def results_of(folder: Path, evaluation: Evaluation) -> Results:
    """The rows of an evaluation, as they are in the folder; nothing is computed.

    Raises:
        StorageError: There are none, or the file is damaged.
    """
    runs: list[Run] = []
    skipped: dict[str, dict[int, str]] = {}
    if not (folder / RESULTS_FILE).is_file():
        raise StorageError(f"expected results in {folder}, but there is no {RESULTS_FILE}")
    with ResultsFile.in_folder(folder) as file:
        for plan, key in zip(evaluation.plans, evaluation.prints, strict=True):
            place = (plan.environment, plan.spec.label, key)
            runs += file.runs(*place, evaluation.seeds)
            left = {k: why for k, why in file.skipped(*place).items() if k in evaluation.seeds}
            if left:
                skipped.setdefault(plan.environment, {}).update(left)
    if not runs:
        raise StorageError(f"expected the rows of {EVALUATION_FILE} in {folder / RESULTS_FILE}, got none")
    protocols = dict.fromkeys(plan.settings.protocol for plan in evaluation.plans)
    most = max(plan.settings.max_samples for plan in evaluation.plans)
    return Results(tuple(runs), most, skipped, " and ".join(protocols))


def write_report(
    folder: Path,
    out: Path | None = None,
    *,
    replays: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the page of an evaluation.

    Args:
        folder: Where `guided-gym evaluate` has written.
        out: The page; ``report.html`` in the folder by default.
        replays: Whether to search the best, median and worst seeds again, to show them.
        progress: Called with (searches done, searches to do).

    Returns:
        The page.

    Raises:
        StorageError: The folder holds no evaluation, a damaged one, or the page cannot be written.
        UnknownNameError: An environment or guidance is not known here; import the module that registers it.
    """
    evaluation = read_evaluation(folder)
    results = results_of(folder, evaluation)
    chosen = trace_runs(results, evaluation.plans, CHOICES, folder, progress) if replays else []
    out = folder / REPORT_FILE if out is None else out
    write_whole(out, report_page(folder, evaluation, results, chosen))
    return out


def report_page(folder: Path, evaluation: Evaluation, results: Results, chosen: Sequence[Chosen] = ()) -> str:
    """The page as HTML; arguments as the parts that `write_report` puts together."""
    title = f"Evaluation of {', '.join(results.environments())}"
    rows = summarise(results)
    parts = [
        f'<main>\n<div class="top"><h1>{escaped(title)}</h1></div>',
        _what_was_run(evaluation, results),
    ]
    said = verdicts(results)
    for environment in results.environments():
        own = [row for row in rows if row.environment == environment]
        line = next((line for line in said if line.startswith(f"{environment}: ")), "")
        parts += [
            f"<h2>{escaped(environment)}</h2>",
            f"<p>{escaped(line.removeprefix(f'{environment}: '))}</p>" if line else "",
            _table(own),
            _differences(results, environment),
            _replays([one for one in chosen if one.plan.environment == environment], own),
            _figures(folder, environment),
            _unsolved(results, environment, own),
        ]
    parts.append("</main>")
    parts += [embedded(_replay_content(one), name=_trace_id(one), kind="trace") for one in chosen]
    return page(title, "\n".join(parts), scripts=(*SCRIPTS, "report.js"), styles=("theme.css", "report.css"))


def results_html(results: Results) -> str:
    """The figures of a notebook's cell: a table per environment, without scripts."""
    rows = summarise(results)
    parts = []
    for environment in results.environments():
        own = [row for row in rows if row.environment == environment]
        shown = [one for one in MEASURES if one.part == "quality" and one.key in own[0].figures]
        heads = "".join(f"<th>{escaped(_title(one))}</th>" for one in shown)
        body = "".join(
            f"<tr><td>{row.rank}</td><td>{escaped(row.guidance)}</td>"
            f"{''.join(_cell(row, one) for one in shown)}</tr>"
            for row in own
        )
        parts.append(
            f"<div><b>{escaped(environment)}</b>, {own[0].seeds} seeds<table><thead><tr><th></th>"
            f"<th>guidance</th>{heads}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return "".join(parts)


# Parts --------------------------------------------------------------------------------------------------


def _what_was_run(evaluation: Evaluation, results: Results) -> str:
    from guided_gym.catalogue.table import make_distribution

    settings = evaluation.plans[0].settings
    seeds = evaluation.seeds
    said = f"{len(seeds)}, {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else str(seeds[0])
    plain = EvaluationSettings()
    changed = [
        f"{name} = {value}"
        for name, value in vars(settings).items()
        if name not in ("max_samples", "protocol") and value != getattr(plain, name)
    ]
    facts = [
        *((name, _about(make_distribution, name)) for name in results.environments()),
        ("guidances", ", ".join(dict.fromkeys(plan.spec.label for plan in evaluation.plans))),
        ("seeds", said),
        ("samples at most", f"{results.max_samples:,}"),
        ("protocol", results.protocol),
        ("settings", "; ".join(changed) or "the defaults"),
        ("version", evaluation.version),
    ]
    items = "".join(f"<dt>{escaped(name)}</dt><dd>{escaped(text)}</dd>" for name, text in facts)
    command = f"<pre><code>{escaped(evaluation.command)}</code></pre>"
    return f"<dl>{items}</dl><p>This command repeats it, or resumes it:</p>{command}"


def _about(make: Callable[[str], Any], name: str) -> str:
    try:
        return str(make(name).summary)
    except (GuidedGymError, AttributeError):
        return "not known here"


def _number(value: float, scale: float = 1.0) -> str:
    return significant(value * scale) if math.isfinite(value) else "–"


def _table(rows: Sequence[Row]) -> str:
    """Rows that can be sorted, intervals below the figures."""
    measures = [one for one in (*MEASURES, *DISTRIBUTION_MEASURES) if one.key in rows[0].figures]
    heads = "".join(_head(_title(one), one.better) for one in measures)
    body = []
    for row in rows:
        cells = [f'<td data-value="{row.rank}">{row.rank}</td><th scope="row">{escaped(row.guidance)}</th>']
        cells += [_cell(row, measure) for measure in measures]
        body.append(f"<tr>{''.join(cells)}</tr>")
    note = (
        "SE in nats, lower is better; 95 % intervals over seeds. * none is known to be better (paired "
        "seeds, 95 %). ≥ some searches were not solved; in comparisons each of those counts as the worst."
    )
    head = f"<tr>{_head('rank')}{_head('guidance', kind='text')}{heads}</tr>"
    return _scrolled(head, body, note)


def _head(title: str, better: str = "", kind: str = "number") -> str:
    arrow = {"low": "lower is better", "high": "higher is better"}.get(better, "")
    hint = f' title="{arrow}"' if arrow else ""
    return f'<th scope="col" data-kind="{kind}"><button type="button"{hint}>{escaped(title)}</button></th>'


def _scrolled(head: str, body: Sequence[str], note: str) -> str:
    table = f'<table class="sortable"><thead>{head}</thead><tbody>{"".join(body)}</tbody></table>'
    return f'<div class="scrolled" tabindex="0">{table}</div><p class="muted">{escaped(note)}</p>'


def _cell(row: Row, measure: Measure) -> str:
    interval = row.figures[measure.key]
    estimate, low, high = (
        _number(value, measure.scale) for value in (interval.estimate, interval.low, interval.high)
    )
    if not math.isfinite(interval.estimate):
        return "<td>–</td>"
    sign = "≥ " if measure.censored and row.unsolved else ""
    shown = f"{sign}{estimate}"
    shown = f"<b>{shown}*</b>" if measure.key in row.best else shown
    kind = ' class="bad"' if measure.key == "solved" and row.unsolved else ""
    return f'<td data-value="{interval.estimate!r}"{kind}>{shown}<br><small>{low} – {high}</small></td>'


def _differences(results: Results, environment: str) -> str:
    """Each guidance less the best ranked, seed by seed."""
    comparison = Comparison(results, environment)
    known = {measure.key: measure for measure in MEASURES}
    order = comparison.ranked(known[ranking_measure(results.protocol)])
    if len(order) < 2:
        return ""
    first, measures = order[0], [known[key] for key in _COMPARED]
    body = []
    for guidance in order[1:]:
        cells = []
        for measure in measures:
            scores = comparison.scores(measure)
            difference = paired_difference(scores[guidance], scores[first])
            real = comparison.pairs >= LEAST_PAIRS and difference.outside(0.0, 0.0)
            low, high = _number(difference.low, measure.scale), _number(difference.high, measure.scale)
            text = f"{'+' if difference.estimate > 0 else ''}{_number(difference.estimate, measure.scale)}"
            chance = "" if real else ' <span class="muted">may be chance</span>'
            cells.append(
                f'<td data-value="{difference.estimate!r}">{text}{chance}<br>'
                f"<small>{low} – {high}</small></td>"
            )
        body.append(f'<tr><th scope="row">{escaped(guidance)}</th>{"".join(cells)}</tr>')
    heads = "".join(_head(_title(measure)) for measure in measures)
    head = f"<tr>{_head('guidance', kind='text')}{heads}</tr>"
    note = (
        f"More or less than {first} by so much, on the mean of {comparison.pairs} paired seeds, with 95 % "
        "intervals. A search that was not solved counts as the worst run of the table."
    )
    return f"<h3>Differences from {escaped(first)}</h3>" + _scrolled(head, body, note)


def _title(measure: Measure) -> str:
    """The heading of a measure in one line: its unit or statistic after a comma."""
    first, _, last = measure.title.rpartition("\n")
    if not first:
        return last
    return f"{first}, {last}" if last in _UNITS else f"{first} {last}"


def _replay_content(one: Chosen) -> dict[str, Any]:
    content = trace_content(one.path)
    header = content["lines"][0]
    header["title"] = f"{one.plan.spec.label}, {' and '.join(one.names)}"
    header["seed"] = one.run.seed
    if not one.same:
        header.setdefault("notices", []).append(
            "Searched again, this seed went otherwise: the code has changed since the evaluation."
        )
    return content


def _replays(chosen: Sequence[Chosen], rows: Sequence[Row]) -> str:
    """Menus of the searches that can be played, one or two side by side."""
    if not chosen:
        return ""
    from guided_gym.train.chosen_runs import TRACES

    rank = {row.guidance: row.rank for row in rows}
    order = sorted(chosen, key=lambda one: rank.get(one.plan.spec.label, 99))
    options = "".join(
        f'<option value="{escaped(_trace_id(one))}">{escaped(one.plan.spec.label)}: '
        f"{escaped(' and '.join(one.names))}, seed {one.run.seed}</option>"
        for one in order
    )
    return (
        "<h3>Searches</h3>"
        "<p>Best and worst by total SE; those that were not solved come last.</p>"
        f'<div class="replays"><div class="bar"><label>Show <select class="left">{options}</select></label> '
        f'<label>beside <select class="right"><option value="">nothing</option>{options}</select></label>'
        "</div>"
        '<div class="show"></div></div>'
        f'<p class="muted">The traces are in {escaped(TRACES)}/, for <code>guided-gym replay</code>.</p>'
    )


def _trace_id(one: Chosen) -> str:
    return one.path.stem


def _figures(folder: Path, environment: str) -> str:
    shown = []
    for name, caption in _FIGURES.items():
        file = folder / "figures" / f"{file_label(environment)}-{name}.png"
        if not file.is_file():
            continue
        png = file.read_bytes()
        if not png.startswith(_PNG) or len(png) < 24:
            continue  # cut off, or no picture
        # The same scale for all: letters are as large in a narrow figure as in a wide one.
        width, height = (round(_FIGURE_SCALE * side) for side in struct.unpack(">II", png[16:24]))
        data = base64.b64encode(png).decode("ascii")
        shown.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{escaped(caption)}" width="{width}" '
            f'height="{height}" loading="lazy"><figcaption>{escaped(caption)}</figcaption></figure>'
        )
    return f"<h3>Figures</h3>{''.join(shown)}" if shown else ""


def _unsolved(results: Results, environment: str, rows: Sequence[Row]) -> str:
    """Which seeds were not solved, and what is known of why."""
    items = []
    for row in rows:
        runs = results.group(environment, row.guidance)
        items += [f"<li>{escaped(_why(run, row.guidance))}</li>" for run in runs if not run.solved][:20]
        more = row.unsolved - 20
        if more > 0:
            items.append(f"<li>{escaped(row.guidance)}: and {more} more seeds</li>")
    left = rows[0].skipped
    items += [
        f"<li>seed {seed}: left out, {escaped(reason)}</li>" for seed, reason in list(left.items())[:20]
    ]
    if not items:
        return "<h3>Not solved</h3><p>Every search found a path.</p>"
    return f"<h3>Not solved</h3><ul>{''.join(items)}</ul>"


def _why(run: Run, guidance: str) -> str:
    """What is known of a search that found no path: where it was spent, and how well it chose."""
    said = f"{guidance}, seed {run.seed}: gave up after {run.samples:,} samples and {run.nodes:,} nodes"
    regions = {name: count for name, (_, count) in run.regions.items()}
    if run.samples and len(regions) > 1:
        name = max(regions, key=lambda one: regions[one])
        said += f"; {regions[name] / run.samples:.0%} of the samples started from nodes in {name}"
    if run.samples:
        collisions = 1 - (run.nodes - 1) / run.samples
        said += f"; {max(collisions, 0.0):.0%} collided"
        excess = run.excess_efficiency / run.samples
        said += f"; a choice was {significant(excess)} nats worse than the best on its tree, on average"
    return said
