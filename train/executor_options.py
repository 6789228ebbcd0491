"""``--executor``, ``--address`` and ``--workers``: who does the work of a command."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from guided_gym.errors import InvalidInputError

if TYPE_CHECKING:
    from guided_gym.compute.workers import Executor


class Kind(StrEnum):
    """The executors that there are."""

    LOCAL = "local"
    RAY = "ray"


ValidationWorkers = Annotated[int, typer.Option(help="Processes that search the validation problems.")]
ExecutorKind = Annotated[
    Kind, typer.Option(help="Who does the work: processes on this machine, or a Ray cluster.")
]
Address = Annotated[
    str | None,
    typer.Option(
        help="With --executor ray: HOST:PORT of the cluster's head, or auto; all of its cores work. Without, "
        "a cluster is started here, with as many cores as --workers says."
    ),
]


def executor(kind: Kind, address: str | None, workers: int) -> Executor:
    """What the options ask for.

    Raises:
        InvalidInputError: An address without Ray, or a number of workers that is not positive.
    """
    from guided_gym.compute.workers import executor_of

    if kind is Kind.RAY:
        from guided_gym.compute.on_ray import OnRay

        return OnRay(address, workers)
    if address is not None:
        raise InvalidInputError(f"address: expected none with --executor local, got {address!r}")
    return executor_of(workers)
