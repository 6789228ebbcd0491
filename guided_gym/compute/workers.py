"""Executors of independent tasks: processes here, or others; results as they come, and clean stops."""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import multiprocessing.reduction
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar

from guided_gym.checks import count, shown
from guided_gym.doors import doors
from guided_gym.errors import GuidedGymError, InvalidInputError, UnknownNameError

WORKER_DIED = (
    "expected the worker processes to live, but one died (killed, out of memory, or started from a script "
    "without `if __name__ == '__main__':`)"
)

_SECONDS_TO_STOP = 5.0  # that a pool without processes may take to notice

T = TypeVar("T")
R = TypeVar("R")

_WINDOW_PER_WORKER = 2  # tasks handed out per worker: it never waits, and a stop drops few

_PROCESS = 10**6  # bytes that a process takes at the very least
_WORKER = "GUIDED_GYM_WORKER"  # set in worker processes
_before_workers: list[Callable[[], None]] = []


class MapTasks(Protocol):
    """Applies a function to tasks; see `worker_pool`."""

    def __call__(self, work: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Results of ``work`` on each task, as they are finished."""


class Executor(Protocol):
    """An executor of independent tasks. Their results are the same, whoever does them."""

    @property
    def alone(self) -> bool:
        """Whether this process does the tasks itself, one after the other."""

    def pool(self, prepare: Callable[[], None] | None) -> contextlib.AbstractContextManager[MapTasks]:
        """A function that maps functions over tasks, as long as the context lasts; see `worker_pool`."""


Workers = int | Executor
"""A number of processes on this machine, or another executor."""


def checked_workers(workers: object, least: int = 1) -> int:
    """How many processes do the work.

    Raises:
        InvalidInputError: It is no integer, too small, or more than any machine has room for.
    """
    return count("workers", workers, least=least, each=_PROCESS, what="so many processes")


def executor_of(workers: Workers) -> Executor:
    """The executor that an argument ``workers`` stands for.

    Raises:
        InvalidInputError: A number that is not positive, or something else.
    """
    if isinstance(workers, int | float | str) or not hasattr(workers, "pool"):
        return Local(checked_workers(workers))
    return workers


def map_tasks(
    work: Callable[[T], R],
    tasks: Iterable[T],
    workers: Workers,
    prepare: Callable[[], None] | None = None,
) -> Iterator[R]:
    """Results of ``work`` on each task, as they are finished; see `worker_pool` for the rest."""
    with worker_pool(workers, prepare) as run:
        yield from run(work, tasks)


def worker_pool(
    workers: Workers, prepare: Callable[[], None] | None = None
) -> contextlib.AbstractContextManager[MapTasks]:
    """Workers for as long as the context lasts; it gives a function that maps functions over tasks.

    Ctrl-C is left to this process. The workers are stopped when the context ends with an error.

    Args:
        workers: Processes (see `Local`), or another executor.
        prepare: Called once in each process before any work; importable, like what is mapped: a function at
            the top level of a module, or a partial of one.

    Raises:
        InvalidInputError: workers is not positive, or what they are to run is not importable.
        GuidedGymError: A worker died.
    """
    return executor_of(workers).pool(prepare)


@doors
@dataclass(frozen=True)
class Local:
    """Processes on this machine.

    The processes end by themselves when this one is killed.

    Attributes:
        workers: How many; with 1, this process does the work, in order. More are spawned, not forked: a fork
            copies the locks of threads that do not come along.
    """

    workers: int = 1

    @property
    def alone(self) -> bool:
        """Whether this process does the work itself."""
        return self.workers == 1

    def pool(self, prepare: Callable[[], None] | None = None) -> contextlib.AbstractContextManager[MapTasks]:
        """See `worker_pool`."""
        return _local_pool(self.workers, prepare)


@contextlib.contextmanager
def _local_pool(workers: int, prepare: Callable[[], None] | None) -> Iterator[MapTasks]:
    if workers == 1:
        if prepare is not None:
            prepare()
        yield in_order
        return
    pool = start_workers(workers, prepare)
    try:
        yield _Mapper(pool, workers * _WINDOW_PER_WORKER)
        pool.shutdown()
    except BrokenProcessPool as error:
        raise GuidedGymError(f"{WORKER_DIED}; what was finished is kept") from error
    except BaseException:
        # Whoever pressed Ctrl-C does not want to wait for the tasks at hand.
        stop_workers(pool)
        raise


def start_workers(
    workers: int, prepare: Callable[[], None] | None = None
) -> concurrent.futures.ProcessPoolExecutor:
    """Worker processes as in `worker_pool`, for callers that hand out tasks and stop them by hand.

    Raises:
        InvalidInputError: workers is not positive, or ``prepare`` is not importable.
    """
    checked_workers(workers)
    check_importable(prepare)
    for hook in _before_workers:
        hook()
    return concurrent.futures.ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(prepare,),
    )


def stop_workers(pool: concurrent.futures.ProcessPoolExecutor) -> None:
    """End the processes of `start_workers` at once, whatever they are doing."""
    # Public only from Python 3.14 on, as `terminate_workers`.
    processes = list((getattr(pool, "_processes", None) or {}).values())
    manager: threading.Thread | None = getattr(pool, "_executor_manager_thread", None)
    results = getattr(pool, "_result_queue", None)
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    if results is not None:
        # Whoever reads a result that was cut off would wait for the rest as long as somebody could write it.
        results._writer.close()
    if manager is not None:
        manager.join(_SECONDS_TO_STOP)  # else it may close, as Python ends, what Python is about to use


def in_order(work: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
    """Have this process do the tasks, one after the other."""
    return map(work, tasks)


class _Mapper:
    """Hands tasks to a pool, no more than ``window`` at a time."""

    def __init__(self, pool: concurrent.futures.Executor, window: int) -> None:
        self._pool = pool
        self._window = window

    def __call__(self, work: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        check_importable(work)
        queue = iter(tasks)
        running: set[concurrent.futures.Future[R]] = set()
        exhausted = False
        while True:
            while not exhausted and len(running) < self._window:
                try:
                    running.add(self._pool.submit(work, next(queue)))
                except StopIteration:
                    exhausted = True
            if not running:
                return
            done, running = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in done:
                yield _result(future)


def _result(future: concurrent.futures.Future[R]) -> R:
    """What a worker gave; of a name that it does not know, what to do."""
    try:
        return future.result()
    except UnknownNameError as error:
        raise unknown_there(error) from error


def unknown_there(error: UnknownNameError) -> InvalidInputError:
    """What to do about a name that a worker process does not know."""
    return InvalidInputError(
        f"{error.subject}: expected a name that the worker processes know, too; they do not know what a "
        "notebook registers, or a script under `if __name__ == '__main__':`. Put that into a module, and "
        "name it with --import (in Python, imports=[...]), or use one worker"
    )


def check_importable(function: Callable[..., object] | None) -> None:
    """Refuse what another process could not import.

    Raises:
        InvalidInputError: It is no function at the top level of a module, nor a partial of one.
    """
    try:
        multiprocessing.reduction.ForkingPickler.dumps(function)
    except Exception as error:  # pickle raises whatever the object does
        raise InvalidInputError(
            f"expected a function at the top level of a module for worker processes, "
            f"got {shown(function)}: {error}"
        ) from error


def before_workers(hook: Callable[[], None]) -> Callable[[], None]:
    """Decorator: calls a function before processes start, such as one that warns once for all of them."""
    _before_workers.append(hook)
    return hook


def in_worker() -> bool:
    """Whether this process is one of `start_workers`: warnings are its parent's to give."""
    return _WORKER in os.environ


def be_worker() -> None:
    """Have `in_worker` say so in this process."""
    os.environ[_WORKER] = "1"


def _start_worker(prepare: Callable[[], None] | None) -> None:
    """Leave Ctrl-C, which a terminal sends to the workers too, to the parent; end when it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    be_worker()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # nobody is left to hand results to; a worker would wait for work for ever
