"""Worker processes for independent tasks: results as they come, clean stops."""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from guided_gym.errors import GuidedGymError, InvalidInputError

T = TypeVar("T")
R = TypeVar("R")

_WINDOW_PER_WORKER = 2  # tasks handed out per worker: it never waits, and a stop drops few


def map_tasks(
    work: Callable[[T], R],
    tasks: Iterable[T],
    workers: int,
    prepare: Callable[[], None] | None = None,
) -> Iterator[R]:
    """Results of ``work`` on each task, as they are finished.

    Args:
        work: A function at the top level of a module (or a partial of one) if there are several workers.
        tasks: What it is called with.
        workers: Processes; with 1, this one does the work, in order. More are spawned, not forked: a fork
            copies the locks of threads that do not come along.
        prepare: Called once in each process before any work, likewise importable.

    Raises:
        InvalidInputError: workers is not positive.
        GuidedGymError: A worker died.
    """
    if workers < 1:
        raise InvalidInputError(f"workers: expected at least 1, got {workers!r}")
    if workers == 1:
        if prepare is not None:
            prepare()
        yield from map(work, tasks)
        return
    with _pool(workers, prepare) as pool:
        yield from _in_window(pool, work, iter(tasks), workers * _WINDOW_PER_WORKER)


@contextlib.contextmanager
def _pool(
    workers: int, prepare: Callable[[], None] | None
) -> Iterator[concurrent.futures.ProcessPoolExecutor]:
    before = set(multiprocessing.active_children())
    pool = concurrent.futures.ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(prepare,),
    )
    try:
        yield pool
        pool.shutdown()
    except BrokenProcessPool as error:
        raise GuidedGymError(
            "expected the worker processes to live, but one died (killed, out of memory, or started from a "
            "script without `if __name__ == '__main__':`); what was finished is kept"
        ) from error
    except BaseException:
        # Whoever pressed Ctrl-C does not want to wait for the tasks at hand.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        raise


def _in_window(
    pool: concurrent.futures.Executor, work: Callable[[T], R], tasks: Iterator[T], window: int
) -> Iterator[R]:
    running: set[concurrent.futures.Future[R]] = set()
    exhausted = False
    while True:
        while not exhausted and len(running) < window:
            try:
                running.add(pool.submit(work, next(tasks)))
            except StopIteration:
                exhausted = True
        if not running:
            return
        done, running = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
        for future in done:
            yield future.result()


def _start_worker(prepare: Callable[[], None] | None) -> None:
    """Leave Ctrl-C, which a terminal sends to the workers too, to the parent; end when it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # nobody is left to hand results to; a worker would wait for work for ever
