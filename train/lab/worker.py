"""A process of the lab that runs one search: it reads a job from stdin and writes JSON lines to stdout.

A process of its own, so that a search can be ended at any moment and has memory and time of its own. It is
started ahead of time, and waits for its job with everything imported.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from typing import Any, Final

from guided_gym.display.replay import rounded_row
from guided_gym.display.scene import digits_of, scene_of
from guided_gym.errors import GuidedGymError
from guided_gym.planning import SearchResult, guided_search
from guided_gym.problems import Problem
from guided_gym.train.lab.documents import checked_guidance, problem_of_document

_FLUSH_SECONDS: Final = 0.05


class Lines:
    """Takes the lines of a trace and passes them on to the page, rounded to what an eye can see.

    Args:
        problem: The problem, which the page gets as a scene.
    """

    def __init__(self, problem: Problem) -> None:
        self._scene = scene_of(problem)
        self._digits = digits_of(problem.environment.extent)
        self._flushed = 0.0

    def write(self, text: str) -> None:
        """Take one line of a trace."""
        row = json.loads(text)
        if "format" in row:
            del row["problem"]
            row["scene"] = self._scene
        elif "n" in row:
            row = rounded_row(row, self._digits)
        self.send(row)

    def send(self, row: dict[str, Any]) -> None:
        """Pass a line on, now or within `_FLUSH_SECONDS`."""
        sys.stdout.write(json.dumps(row, separators=(",", ":")) + "\n")
        now = time.monotonic()
        if now - self._flushed >= _FLUSH_SECONDS:
            self._flushed = now
            sys.stdout.flush()


def facts(result: SearchResult) -> dict[str, Any]:
    """What the page's table says of a search."""
    return {
        "solved": result.solved,
        "samples": result.samples,
        "nodes": len(result.tree),
        "checks": result.collision_checks,
        "total": result.total_efficiency if result.samples else 0.0,
        "length": result.length if result.solved else None,
        "preparation": result.preparation,
        "seconds": result.seconds,
    }


def search(job: dict[str, Any]) -> None:
    """Run a job: ``document``, ``guidance``, ``seed``, ``samples``."""
    problem = problem_of_document(job["document"])
    lines = Lines(problem)
    result = guided_search(
        problem,
        checked_guidance(job["guidance"]),
        seed=job["seed"],
        max_samples=job["samples"],
        trace=lines,
    )
    lines.send({"facts": facts(result)})


def limit_memory(megabytes: int) -> None:
    """Limit the memory of this process, where the system can."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        most = megabytes * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main() -> None:
    """Read one job, and run it."""
    limit_memory(int(sys.argv[1]))
    text = sys.stdin.readline()
    if not text:
        return
    try:
        search(json.loads(text))
    except GuidedGymError as error:
        print(json.dumps({"error": str(error)}))
    except MemoryError:
        print(json.dumps({"error": f"this search needs more than {sys.argv[1]} MB of memory"}))
    except BrokenPipeError:  # nobody listens any more
        os._exit(0)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
