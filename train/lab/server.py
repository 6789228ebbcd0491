"""The lab's server: the page, its files, and searches as streams of lines, for browsers of this machine."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from guided_gym.catalogue.table import distribution_names, make_distribution
from guided_gym.display.pages import web_file
from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.guidance.learned.folders import shipped_agents
from guided_gym.guidance.registry import guidance_names
from guided_gym.train.lab.documents import (
    LARGEST,
    Folder,
    checked_document,
    checked_guidance,
    document_of_text,
    example,
    view_of,
    whole,
)

HOST: Final = "127.0.0.1"
MOST_SAMPLES: Final = 20_000  # of a search
AT_ONCE: Final = 4  # searches
_LOOK_SECONDS: Final = 0.2  # between two looks whether a page still listens

_STATIC: Final = {
    "theme.css": "text/css",
    "lab.css": "text/css",
    "view.js": "text/javascript",
    "player.js": "text/javascript",
    "lab.js": "text/javascript",
}
_POLICY: Final = (
    b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    b"base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    b"content-security-policy": _POLICY,
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-resource-policy": b"same-origin",
    b"cross-origin-opener-policy": b"same-origin",
    b"cache-control": b"no-store",
}
_NEEDS_A_FILE: Final = ("path_database", "paths")
_IN_SPACE: Final = ("SpatialArm", "RandomSpatialArm")  # what the lab cannot draw
_FIRST: Final = "TrapCup"


@dataclass(frozen=True)
class Limits:
    """What a search may take.

    Attributes:
        seconds: Of time, the making of its guide and oracle included.
        megabytes: Of memory.
    """

    seconds: float = 300.0
    megabytes: int = 4096


class Guard:
    """Lets through requests of a browser on this machine from the page's own origin, and nothing else.

    Refused are other names of the host (somebody may point one at 127.0.0.1, and a foreign page would be of
    this origin), other origins, and what is sent as anything but JSON.

    Args:
        app: Who answers what is let through.
        port: The server's.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}" for name in (HOST, "localhost")}
        if port == 80:
            self._hosts |= {HOST, "localhost"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request (ASGI)."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        trouble = "only HTTP" if scope["type"] != "http" else self._trouble(scope)
        answer: ASGIApp = self._app
        if trouble:
            answer = JSONResponse({"error": f"refused: {trouble}"}, 403)

        async def send_guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *_HEADERS.items()]
            await send(message)

        await answer(scope, receive, send_guarded)

    def _trouble(self, scope: Scope) -> str:
        headers: dict[str, str] = {}
        for name, value in scope["headers"]:
            key = name.decode("latin-1").lower()
            if key in headers and key in ("host", "origin"):
                return f"expected one {key}, got several"
            headers[key] = value.decode("latin-1")
        if headers.get("host", "") not in self._hosts:
            return "expected a request to this host"
        origin = headers.get("origin")
        if origin is not None and origin.removeprefix("http://") not in self._hosts:
            return "expected a request of this page's origin"
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return "expected a request of this page's origin"
        if scope["method"] == "POST" and headers.get("content-type", "").split(";")[0] != "application/json":
            return "expected JSON"
        return ""


class Workers:
    """Processes that search, one of them always ready for the next job.

    Args:
        limits: What each may take.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._running: set[asyncio.subprocess.Process] = set()
        self._spare: asyncio.subprocess.Process | None = None
        self._jobs = 0

    async def _start(self) -> asyncio.subprocess.Process:
        # -P: a file in the current folder cannot stand in for a module.
        command = (sys.executable, "-P", "-m", "guided_gym.train.lab.worker", str(self._limits.megabytes))
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe)
        self._running.add(process)
        return process

    async def ready(self) -> None:
        """See to it that a process waits for a job."""
        if self._spare is None:
            self._spare = await self._start()

    async def run(self, job: dict[str, Any], gone: Callable[[], Awaitable[bool]]) -> AsyncIterator[bytes]:
        """The lines of a job, in pieces.

        Args:
            job: See `guided_gym.train.lab.worker`.
            gone: Whether nobody listens any more, which ends the process.
        """
        if self._jobs >= AT_ONCE:
            yield _line({"error": f"{AT_ONCE} searches run already: cancel one, or wait"})
            return
        self._jobs += 1
        process, self._spare = self._spare or await self._start(), None
        watch = asyncio.create_task(_end_when(gone, process))
        try:
            async for piece in self._lines(process, job):
                yield piece
        finally:
            self._jobs -= 1
            watch.cancel()
            await self._end(process)
            with contextlib.suppress(Exception):
                await self.ready()

    async def _lines(self, process: asyncio.subprocess.Process, job: dict[str, Any]) -> AsyncIterator[bytes]:
        assert process.stdin is not None and process.stdout is not None  # both are pipes
        deadline = asyncio.get_running_loop().time() + self._limits.seconds
        with contextlib.suppress(ConnectionError):  # it died: what it leaves says so
            process.stdin.write(json.dumps(job).encode() + b"\n")
            await process.stdin.drain()
        try:
            async with asyncio.timeout_at(deadline):
                while piece := await process.stdout.read(2**16):
                    yield piece
                code = await process.wait()
        except TimeoutError:
            yield _line({"error": f"stopped after {self._limits.seconds:g} s, the lab's limit for a search"})
            return
        if code:
            most = self._limits.megabytes
            yield _line(
                {"error": f"the search ended with code {code}; it may have needed more than {most} MB"}
            )

    async def _end(self, process: asyncio.subprocess.Process) -> None:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        self._running.discard(process)
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(process.wait())

    async def close(self) -> None:
        """End them all."""
        for process in list(self._running):
            await self._end(process)


async def _end_when(gone: Callable[[], Awaitable[bool]], process: asyncio.subprocess.Process) -> None:
    while not await gone():
        await asyncio.sleep(_LOOK_SECONDS)
    with contextlib.suppress(ProcessLookupError):
        process.kill()


def _line(row: dict[str, Any]) -> bytes:
    return b"\n" + json.dumps(row).encode() + b"\n"  # the line before may have broken off


Answer = Callable[[Request], Awaitable[Response]]


class Lab:
    """The lab of one folder.

    Args:
        folder: Its problem files are read and written, and nothing else.
        limits: What a search may take.
        first: The file that the page opens with; an example if None.
    """

    def __init__(self, folder: Path, limits: Limits | None = None, first: str | None = None) -> None:
        self.folder, self.limits = Folder(folder), limits or Limits()
        self.first = None if first is None else self.folder.file(first).name
        self.workers = Workers(self.limits)

    def application(self, port: int) -> ASGIApp:
        """The application that a server on that port runs."""

        @contextlib.asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            await self.workers.ready()
            yield
            await self.workers.close()

        routes = [
            Route("/", self._page),
            Route("/static/{name}", self._static),
            Route("/api/start", _answered(self._start)),
            Route("/api/files", _answered(self._files)),
            Route("/api/open", _answered(self._open), methods=["POST"]),
            Route("/api/save", _answered(self._save), methods=["POST"]),
            Route("/api/view", _answered(self._view), methods=["POST"]),
            Route("/api/run", _answered(self._run), methods=["POST"]),
        ]
        return Guard(Starlette(routes=routes, lifespan=lifespan), port)

    async def _page(self, request: Request) -> Response:
        return HTMLResponse(web_file("lab.html"))

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _STATIC:
            return JSONResponse({"error": "no such file"}, 404)
        return Response(web_file(name), media_type=_STATIC[name])

    async def _start(self, request: Request) -> Response:
        """What the page has to know once."""
        names = [name for name in guidance_names() if name not in _NEEDS_A_FILE]
        names += [f"learned:{name}" for name in shipped_agents()]
        drawn = [name for name in distribution_names() if name not in _IN_SPACE]
        examples = {name: make_distribution(name).fixed for name in drawn}
        return JSONResponse(
            {
                "folder": str(self.folder.path),
                "files": await run_in_threadpool(self.folder.names),
                "first": {"name": self.first} if self.first else {"example": _FIRST, "seed": 0},
                "examples": examples,
                "guidances": names,
                "limits": {"samples": MOST_SAMPLES, **vars(self.limits)},
            }
        )

    async def _files(self, request: Request) -> Response:
        return JSONResponse({"files": await run_in_threadpool(self.folder.names)})

    async def _open(self, request: Request) -> Response:
        """A document: of a file of the folder, of a text that the browser read, or of the catalogue."""
        asked = await body(request)
        if "example" in asked:
            document = await run_in_threadpool(example, asked["example"], asked.get("seed", 0))
        elif "text" in asked:
            document = await run_in_threadpool(document_of_text, asked.get("name"), asked["text"])
        else:
            document = await run_in_threadpool(self.folder.read, asked.get("name"))
        return JSONResponse({"document": document})

    async def _save(self, request: Request) -> Response:
        asked = await body(request)
        replace = asked.get("replace") is True
        document = checked_document(asked.get("document"))
        if not replace and self.folder.file(asked.get("name")).exists():
            return JSONResponse({"exists": True})
        await run_in_threadpool(self.folder.write, asked.get("name"), document, replace=replace)
        return JSONResponse({"files": await run_in_threadpool(self.folder.names)})

    async def _view(self, request: Request) -> Response:
        asked = await body(request)
        return JSONResponse(await run_in_threadpool(view_of, checked_document(asked.get("document"))))

    async def _run(self, request: Request) -> Response:
        asked = await body(request)
        job = {
            "document": checked_document(asked.get("document")),
            "guidance": checked_guidance(asked.get("guidance")),
            "seed": whole("seed", asked.get("seed"), most=2**31),
            "samples": whole("samples", asked.get("samples"), least=1, most=MOST_SAMPLES),
        }
        return StreamingResponse(
            self.workers.run(job, request.is_disconnected), media_type="application/x-ndjson"
        )


def _answered(answer: Answer) -> Answer:
    """Errors of ours as an answer that the page shows; no failure, which browsers report as the page's."""

    async def answered(request: Request) -> Response:
        try:
            return await answer(request)
        except GuidedGymError as error:
            return JSONResponse({"error": str(error)})

    return answered


async def body(request: Request) -> dict[str, Any]:
    """The JSON object that was sent.

    Raises:
        InvalidInputError: It is none, or too large.
    """
    data = bytearray()
    async for piece in request.stream():
        data += piece
        if len(data) > 2 * LARGEST:
            raise InvalidInputError(f"expected at most {2 * LARGEST // 2**20} MiB, got more")
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"expected JSON, got {type(error).__name__}") from None
    if not isinstance(content, dict):
        raise InvalidInputError(f"expected an object, got {type(content).__name__}")
    return content


def bound_socket(port: int) -> socket.socket:
    """A socket of this machine's own address.

    Raises:
        StorageError: The port is in use, or may not be taken.
    """
    taken = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if sys.platform != "win32":  # there, it would let two servers share a port
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        taken.bind((HOST, port))
    except (OSError, OverflowError) as error:
        taken.close()
        raise StorageError(
            f"port {port} of {HOST} cannot be used ({error}): perhaps a lab is open there already; "
            "--port 0 takes any that is free"
        ) from None
    return taken


def serve(lab: Lab, taken: socket.socket) -> None:
    """Serve a lab until Ctrl-C."""
    import uvicorn

    app = lab.application(taken.getsockname()[1])
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, timeout_graceful_shutdown=1
    )
    uvicorn.Server(config).run(sockets=[taken])
