"""Options that several commands share: each is written down once, and commands take them by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError

if TYPE_CHECKING:
    from guided_gym.compute.workers import Executor

Command = TypeVar("Command", bound=Callable[..., None])

Options = Mapping[str, tuple[Any, Any]]
"""Names to what typer makes of them (an annotation), and their defaults."""


def takes(options: Options) -> Callable[[Command], Command]:
    """Give a command these options in place of its ``**given``, in which it finds their values."""

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        rows = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for name, (annotation, default) in options.items()
        ]
        command.__signature__ = signature.replace(parameters=[*own, *rows])  # type: ignore[attr-defined]
        return command

    return decorate


class Kind(StrEnum):
    """The executors that there are."""

    LOCAL = "local"
    RAY = "ray"


_ON: Final[Options] = {
    "executor": (
        Annotated[
            Kind,
            typer.Option(
                help="Who does the work: processes on this machine (local), or a Ray cluster (ray)."
            ),
        ],
        Kind.LOCAL,
    ),
    "address": (
        Annotated[
            str | None,
            typer.Option(
                help="With --executor ray: HOST:PORT of the cluster's head, or auto; all of its cores work. "
                "Default: start a cluster on this machine, with as many cores as --workers says."
            ),
        ],
        None,
    ),
}
WORK: Final[Options] = {
    "workers": (Annotated[int, typer.Option(help="Processes that search.")], 2),
    **_ON,
}
VALIDATION_WORK: Final[Options] = {
    "workers": (Annotated[int, typer.Option(help="Processes that search the validation problems.")], 1),
    **_ON,
}
"""``--workers``, ``--executor`` and ``--address``: who does the work of a command."""


def executor_of(given: dict[str, Any]) -> Executor:
    """The executor that the options of `WORK` ask for; they are taken out of ``given``.

    Raises:
        InvalidInputError: An address without Ray, or a number of workers that is not positive.
    """
    from guided_gym.compute.workers import executor_of as local

    workers, kind, address = (given.pop(name) for name in WORK)
    if kind is Kind.RAY:
        from guided_gym.compute.on_ray import OnRay

        return OnRay(address, workers)
    if address is not None:
        raise InvalidInputError(f"address: expected none with --executor local, got {shown(address)}")
    return local(workers)
