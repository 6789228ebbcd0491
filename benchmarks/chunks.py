"""Many motions of some robots judged chunk by chunk, with progress, and what the chunks add up to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress

R = TypeVar("R")


def judged(
    robots: Mapping[str, R],
    motions: int,
    chunk: int,
    judge: Callable[[R, int, int, int], dict[str, float]],
    console: Console,
    seconds: float = math.inf,
) -> dict[str, dict[str, float]]:
    """Totals of each robot over so many motions, or over as many as the processor time allows.

    ``judge`` takes a robot, its number, the number of the chunk and how many motions, and gives counts,
    ``motions`` among them.
    """
    totals: dict[str, dict[str, float]] = {}
    with Progress(console=console) as progress:
        task = progress.add_task("motions", total=motions * len(robots))
        for number, (name, robot) in enumerate(robots.items()):
            left, seed, began = motions, 0, time.process_time()
            while left > 0 and time.process_time() - began < seconds:
                counts = judge(robot, number, seed, min(chunk, left))
                total = totals.setdefault(name, dict.fromkeys(counts, 0))
                for key, value in counts.items():
                    total[key] += value
                progress.advance(task, counts["motions"])
                left, seed = left - chunk, seed + 1
    return totals
