"""Pictures of plans and of what is wrong with a problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from guided_gym.envs.rendering import trace
from guided_gym.train import workspace_axes as workspace
from guided_gym.train.style import COLUMN, PAGE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from guided_gym.catalogue.inspection import Gap
    from guided_gym.geometry.environment import Environment
    from guided_gym.geometry.robots import Robot
    from guided_gym.problems import Problem
    from guided_gym.train.plans import Answer

FloatArray = NDArray[np.float64]

_GAP = "#CC79A7"
_SHADES = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255")
_MOST_ROBOTS = 8  # tasks beyond which only lines are drawn


@styled
def plan_figure(problem: Problem, answers: Sequence[Answer]) -> Figure:
    """The workspace and the paths found in it, with the robot along the path of a single one."""
    figure, axes = _sheet(problem.environment, PAGE * 0.8)
    workspace.draw_workspace(axes, problem.environment)
    for index, answer in enumerate(answers):
        if len(answers) <= _MOST_ROBOTS:
            workspace.draw_task(axes, problem.asking(answer.task))
        if answer.path is None:
            continue
        if len(answers) == 1:
            workspace.draw_path(axes, problem, answer.path, alone=True)
        else:
            colour = _SHADES[index % len(_SHADES)]
            axes.plot(*trace(problem.space, answer.path).T, color=colour, linewidth=1.0, zorder=6)
    solved = [answer for answer in answers if answer.solved]
    if len(answers) == 1 and solved:
        one = solved[0]
        axes.set_title(f"{problem.name}: length {one.length:.4g}, clearance {one.clearance:.3g}")
    else:
        axes.set_title(f"{problem.name}: {len(solved)} of {len(answers)} tasks solved")
    return figure


@styled
def history_figure(answer: Answer) -> Figure:
    """Length of the shortest path so far over time."""
    figure = new_figure(COLUMN * 1.2, COLUMN * 0.8)
    axes = figure.subplots()
    seconds = np.append(answer.history[:, 0], answer.seconds)
    lengths = np.append(answer.history[:, 2], answer.history[-1:, 2])
    axes.step(seconds, lengths, where="post", color=_SHADES[1])
    axes.plot(*answer.history[:, [0, 2]].T, "o", color=_SHADES[1], markersize=3)
    axes.set(xlabel="seconds", ylabel="length of the path", xlim=(0.0, None))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    return figure


@styled
def check_figure(
    environment: Environment,
    robot: Robot | None,
    poses: Sequence[tuple[str, Sequence[float], bool]],
    gaps: Sequence[Gap],
    title: str,
) -> Figure:
    """The workspace, start and goal even where they are in collision, and the narrow gaps, numbered.

    Args:
        environment: The workspace.
        robot: The robot, if there is one.
        poses: Label, configuration, and whether it is free.
        gaps: From the narrowest on.
        title: Above it.
    """
    figure, axes = _sheet(environment, PAGE * 0.8)
    workspace.draw_workspace(axes, environment)
    for number, gap in enumerate(gaps, start=1):
        axes.plot(*gap.ends.T, color=_GAP, linewidth=1.6, zorder=6, solid_capstyle="round")
        _write(axes, str(number), gap.middle, 4, _GAP)
    for label, q, free in poses:
        if robot is None:
            continue
        colour = workspace.PATH if not free else workspace.START if label == "start" else workspace.GOAL
        workspace.draw_outline(axes, robot, np.asarray(q, np.float64), colour)
        if not free:
            text = f"{label}: not free"
            _write(axes, text, q, 8, colour)
    axes.set_title(title)
    return figure


def _write(axes: Axes, text: str, place: Sequence[float] | FloatArray, away: int, colour: str) -> None:
    """Text beside a place, so many points away."""
    at = float(place[0]), float(place[1])
    note = axes.annotate(text, at, xytext=(away, away), textcoords="offset points", color=colour, zorder=9)
    note.set_path_effects([withStroke(linewidth=2.0, foreground="white")])  # readable on walls, too


def _sheet(environment: Environment, width: float) -> tuple[Figure, Axes]:
    xmin, ymin, xmax, ymax = environment.bounds
    height = min(max(width * (ymax - ymin) / (xmax - xmin), 1.0), 9.0)
    figure = new_figure(width, height + 0.3)
    return figure, figure.subplots()
