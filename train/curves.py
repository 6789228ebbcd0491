"""Learning curves of `guided-gym train ppo` and `train hybrid`, from the cards of runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned.weights import load_card
from guided_gym.guidance.registry import make_guidance
from guided_gym.train.style import INK, MUTED, PAGE, Looks, new_figure, styled
from guided_gym.train.validation import validated

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Metrics = Mapping[str, Any]

_LABEL_HEIGHT: Final = 0.06  # of the axes
_PROBLEMS: Final = ("environments", "validation", "max_samples")  # options that runs drawn together share


def read_runs(folders: Sequence[Path]) -> list[dict[str, Any]]:
    """The cards of finished runs that were validated on the same problems.

    Raises:
        InvalidInputError: No folder, no reinforcement learning, or runs with other validation problems.
        StorageError: A card cannot be read.
    """
    cards = [load_card(folder / "agent") for folder in folders]
    if not cards:
        raise InvalidInputError("runs: expected at least one folder, got none")
    for folder, card in zip(folders, cards, strict=True):
        training = card.get("training", {})
        if any(name not in training for name in _PROBLEMS) or training.get("method") == "imitation":
            raise InvalidInputError(f"{folder}: expected a run of train ppo or train hybrid, got another")
        if any(training[name] != cards[0]["training"][name] for name in _PROBLEMS):
            raise InvalidInputError(
                f"{folder}: expected {', '.join(_PROBLEMS)} as in {folders[0]}; curves over other "
                "problems cannot be compared"
            )
    return cards


def references(
    card: Metrics, names: Sequence[str], say: Callable[[str], None] = lambda _: None
) -> dict[str, dict[str, float]]:
    """How well named guidances search on a run's validation problems.

    Args:
        card: What `read_runs` gives.
        names: The guidances.
        say: Called with each guidance that is done.

    Raises:
        UnknownNameError: No such guidance.
    """
    options = card["training"]
    distributions = [make_distribution(name) for name in options["environments"]]
    guidances = {name: make_guidance(name) for name in names}
    found: dict[str, dict[str, float]] = {}
    for name, guidance in guidances.items():
        found[name] = validated(
            distributions, guidance, count=options["validation"], max_samples=options["max_samples"]
        )
        say(name)
    return found


@styled
def learning_curves(cards: Sequence[Metrics], against: Mapping[str, Metrics] | None = None) -> Figure:
    """Total SE and SE per sample on validation problems, over the samples learned from; a line per run.

    Args:
        cards: What `read_runs` gives.
        against: What `references` gives: levels, dashed.
    """
    against = against or {}
    looks = Looks(against)
    figure = new_figure(PAGE, 0.36 * PAGE)
    quantities = (("total SE (nats)", _total), ("SE a sample (nats)", _per_sample))
    for axes, (label, quantity) in zip(figure.subplots(1, 2), quantities, strict=True):
        for card in cards:
            history = card["metrics"]["history"]
            axes.plot(
                [row["steps"] / 1000 for row in history],
                [quantity(row) for row in history],
                color=INK, marker="o", markersize=2.2, linewidth=1.1,
            )  # fmt: skip
        levels = {name: quantity(metrics) for name, metrics in against.items()}
        for name, level in levels.items():
            axes.axhline(level, color=looks.colour(name), linewidth=1.0, linestyle=(0, (4, 2)))
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("samples learned from (thousands)")
        axes.set_ylabel(label)
        _name_levels(axes, levels, looks)
    training = cards[0]["training"]
    names = ", ".join(training["environments"])
    title = f"{len(cards)} runs on {names}, {training['validation']} validation problems"
    figure.suptitle(title, fontsize=8.5, color=MUTED)
    return figure


def _name_levels(axes: Axes, levels: Mapping[str, float], looks: Looks) -> None:
    """Labels beside the axes, from the lowest level up, none upon another."""
    low, high = np.log(axes.get_ylim())
    free = 0.0
    for name in sorted(levels, key=lambda name: levels[name]):
        at = max(float((np.log(levels[name]) - low) / (high - low)), free)
        free = at + _LABEL_HEIGHT
        axes.text(
            1.01, at, looks.label(name), transform=axes.transAxes, va="center", fontsize=6.5,
            color=looks.colour(name),
        )  # fmt: skip


def _total(metrics: Metrics) -> float:
    return float(metrics["total_efficiency"])


def _per_sample(metrics: Metrics) -> float:
    """Mean total SE over mean samples; a card has no ratio of each search."""
    return float(metrics["total_efficiency"] / metrics["samples"])
