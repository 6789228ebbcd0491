"""Independent tasks on a Ray cluster: the executor for more than one machine (extra ``ray``)."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import os
import pickle
import platform
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from guided_gym.checks import shown
from guided_gym.compute.workers import (
    MapTasks,
    be_worker,
    check_importable,
    checked_workers,
    unknown_there,
)
from guided_gym.doors import doors
from guided_gym.errors import GuidedGymError, InvalidInputError, UnknownNameError

if TYPE_CHECKING:
    from types import ModuleType

T = TypeVar("T")
R = TypeVar("R")

_PER_CORE: Final = 2  # tasks handed out for each of the cluster's cores: none waits, and a stop drops few
_RETRIES: Final = 5  # of a task whose worker or node was lost
_LOOK: Final = 5.0  # seconds between looks at how many cores there are, and at Ctrl-C
_PATIENCE: Final = 5.0  # seconds that an address has to answer
_PORT: Final = 6379


@doors
@dataclass(frozen=True)
class OnRay:
    """The nodes of a Ray cluster.

    Each node needs this package, in this version, and the files that guiding spaces read at the same paths.
    The task of a worker or node that is lost is done again elsewhere, up to 5 times; what was finished is
    not. Nodes that join are used.

    Attributes:
        address: The cluster: ``HOST:PORT`` of its head node, ``auto`` for one that runs on this machine; None
            starts one here, which ends with the context.
        workers: Cores of the cluster that is started here.

    Raises:
        InvalidInputError: The number of workers is not positive.
    """

    address: str | None = None
    workers: int = 2

    def __post_init__(self) -> None:
        checked_workers(self.workers)

    @property
    def alone(self) -> bool:
        """False: other processes do the work."""
        return False

    @contextlib.contextmanager
    def pool(self, prepare: Callable[[], None] | None = None) -> Iterator[MapTasks]:
        """See `guided_gym.compute.workers.worker_pool`.

        Raises:
            GuidedGymError: Ray is not installed, no cluster answers, or a node has another version.
        """
        check_importable(prepare)
        ray = _ray()
        ours = not ray.is_initialized()
        if ours:
            _connect(ray, self)
        try:
            yield _RayMapper(ray, prepare)
        finally:
            if ours:
                ray.shutdown()


def _ray() -> ModuleType:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else it warns
    try:
        import ray
    except ImportError as error:
        raise GuidedGymError(
            "expected Ray for the executor ray, but it is not installed: pip install 'guided-gym[ray]'"
        ) from error
    module: ModuleType = ray
    return module


def _connect(ray: Any, executor: OnRay) -> None:
    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    if executor.address is None:
        # "local": without an address Ray joins whatever cluster runs on this machine already.
        ray.init(address="local", num_cpus=executor.workers, include_dashboard=False, **quiet)
        return
    _check_answers(executor.address)
    try:
        ray.init(address=executor.address, **quiet)
    except Exception as error:  # Ray has no family of errors for this
        raise GuidedGymError(
            f"expected a Ray cluster at {executor.address}, but none could be joined: "
            f"{str(error).strip().splitlines()[0]}"
        ) from error


def _check_answers(address: str) -> None:
    """Ask for a connection: Ray itself tries for a minute.

    Raises:
        InvalidInputError: No address.
        GuidedGymError: Nobody answers.
    """
    if address == "auto":
        return
    place = address.removeprefix("ray://")
    host, _, port = place.rpartition(":") if ":" in place else (place, "", str(_PORT))
    if not host or not port.isdigit():
        raise InvalidInputError(f"address: expected HOST:PORT or auto, got {shown(address)}")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except OSError as error:
        raise GuidedGymError(
            f"expected a Ray cluster at {address}, but nobody answers there ({error}); `ray start --head` "
            "starts one"
        ) from error


class _RayMapper:
    """Hands tasks to a cluster, so many at a time as it has cores for; each result comes back once."""

    def __init__(self, ray: Any, prepare: Callable[[], None] | None) -> None:
        self._ray = ray
        setup = pickle.dumps((prepare, fingerprint()))
        self._setup = ray.put(setup)
        self._remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(_do)

    def __call__(self, work: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        check_importable(work)
        ray, queue = self._ray, iter(tasks)
        running: list[Any] = []
        shared, exhausted = ray.put(pickle.dumps(work)), False
        window, looked = self._window(), time.monotonic()
        try:
            while True:
                while not exhausted and len(running) < window:
                    try:
                        running.append(self._remote.remote(self._setup, shared, pickle.dumps(next(queue))))
                    except StopIteration:
                        exhausted = True
                if not running:
                    return
                done, running = ray.wait(running, num_returns=1, timeout=_LOOK)
                if time.monotonic() - looked > _LOOK:
                    window, looked = self._window(), time.monotonic()
                for reference in done:
                    yield self._result(reference)
        finally:
            for reference in running:  # whoever stops does not want to wait for the tasks at hand
                ray.cancel(reference, force=True)

    def _window(self) -> int:
        return max(1, _PER_CORE * int(self._ray.cluster_resources().get("CPU", 1)))

    def _result(self, reference: Any) -> Any:
        """What a worker gave; its errors are those that it would have raised here."""
        errors = self._ray.exceptions
        try:
            return pickle.loads(self._ray.get(reference))
        except errors.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, UnknownNameError):
                raise unknown_there(cause) from error
            if isinstance(cause, ModuleNotFoundError | AttributeError) and "guided_gym" in str(cause):
                raise GuidedGymError(
                    f"expected guided-gym on every node of the cluster, but one lacks it, or has another "
                    f"version: {cause}"
                ) from error
            raise (cause if isinstance(cause, Exception) else error) from None
        except errors.RayError as error:
            raise GuidedGymError(
                f"expected the cluster's workers to survive, but one was lost {_RETRIES + 1} times at the "
                f"same task ({str(error).strip().splitlines()[0]}); what was finished is kept"
            ) from error


_ready: set[bytes] = set()


def _do(setup: bytes, work: bytes, task: bytes) -> bytes:
    """One task, in a worker of the cluster, which gets ready first."""
    if setup not in _ready:
        be_worker()
        prepare, expected = pickle.loads(setup)
        if fingerprint() != expected:
            raise GuidedGymError(
                f"expected {_version(expected)} on every node of the cluster, but {platform.node()} has "
                f"{_version(fingerprint())}"
            )
        if prepare is not None:
            prepare()
        _ready.add(setup)
    return pickle.dumps(pickle.loads(work)(pickle.loads(task)))


@cache
def fingerprint() -> tuple[str, str]:
    """The version of this package, and a hash of its source: what has to be the same on every node."""
    digest, folder = hashlib.sha256(), Path(__file__).parents[1]
    for file in sorted(folder.rglob("*.py")):
        digest.update(str(file.relative_to(folder)).encode() + file.read_bytes())
    return importlib.metadata.version("guided-gym"), digest.hexdigest()[:12]


def _version(found: tuple[str, str]) -> str:
    return f"guided-gym {found[0]} (source {found[1]})"
