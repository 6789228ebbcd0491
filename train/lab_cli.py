"""``guided-gym lab``: a local page on which one draws problems and watches searches."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from guided_gym.errors import StorageError
from guided_gym.train.terminal import console


def register(app: typer.Typer) -> None:
    """Add the commands of this module to an application."""
    app.command()(lab)


def lab(
    place: Annotated[Path, typer.Argument(help="Problem file to open, or folder of such files.")] = Path("."),
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes any that is free.")] = 8765,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
    seconds: Annotated[float, typer.Option(min=1, help="Seconds that a search may take.")] = 300.0,
    memory: Annotated[int, typer.Option(min=1024, help="Megabytes of memory that a search may take.")] = 4096,
) -> None:
    """Draw problems, search them and watch the searches, in a page on this machine."""
    try:
        from guided_gym.train.lab.server import Lab, Limits, bound_socket, serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        raise StorageError("the lab needs an extra: pip install 'guided-gym[lab]'") from None
    folder, first = (place, None) if place.is_dir() else (place.parent, place.name)
    if first is not None and not place.is_file():
        raise StorageError(f"{place}: expected a problem file or a folder, got neither")
    opened = Lab(folder, Limits(seconds, memory), first)
    taken = bound_socket(port)
    address = f"http://127.0.0.1:{taken.getsockname()[1]}/"
    console().print(f"The lab of {opened.folder.path} is at {address} (Ctrl-C ends it)", markup=False)
    if browser:
        import webbrowser

        webbrowser.open(address)
    serve(opened, taken)
