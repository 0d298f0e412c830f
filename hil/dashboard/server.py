"""The addresses of the live page.

| request | answer |
|---|---|
| `GET /` and `GET /page/...` | the page and its files: nothing of any night |
| `GET /api/stream` | server-sent events: everything, then once a second what changed |
| `GET /report/KEY/NIGHT` | the report that `hil report` made since the last record; KEY stands in the stream |
| `GET /units/KEY/SERIAL` | the archive's units, or the life of one; KEY stands in the stream |
| `POST /api/ask` | pause, continue, abort, confirm, refuse: `{night, kind, who, why, prompt}` |

There is nothing else, and no other method.
"""

import asyncio
import errno
import json
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from importlib.resources import files
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from hil.dashboard.access import Access, Guard
from hil.dashboard.watcher import Watcher
from hil.errors import InputError
from hil.files.strict import NAME, one_line
from hil.records.requests import request as ask_controller
from hil.records.requests import wait_for_answer
from procedures.requests import RequestKind

_STATIC = str(files("hil.dashboard") / "static")
_UNBUFFERED = {"x-accel-buffering": "no"}  # what tells a reverse proxy to pass on every line at once
_STILL = {"content-security-policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"}
_NOT_HERE = {
    errno.EADDRINUSE: "another program does already, perhaps an earlier hil dashboard",
    errno.EADDRNOTAVAIL: "this machine has no such address",
    errno.EACCES: "a port below 1024 is the administrator's",
}
_LARGEST_BODY = 8192
_ANSWER_S = 5.0
_PATIENCE_S = 10.0
_CONNECTIONS, _WAITING, _AT_ONCE = 512, 256, 128  # in all, before their first request, and new ones in one instant


def create_app(watcher: Watcher, access: Access) -> Guard:
    """Return the application that serves the nights of `watcher` to whom `access` lets in."""

    @asynccontextmanager
    async def watching(app: Starlette) -> AsyncIterator[None]:  # noqa: ARG001 - the signature of a lifespan
        async with watcher.watching():
            yield

    async def page(request: Request) -> Response:  # noqa: ARG001 - the signature of an endpoint
        return FileResponse(f"{_STATIC}/index.html")

    async def stream(request: Request) -> Response:
        if not access.may_read(request.headers):
            return _refused("the token is needed to read")
        return StreamingResponse(_events(watcher), media_type="text/event-stream", headers=_UNBUFFERED)

    async def report(request: Request) -> Response:
        try:
            found = watcher.night(request.path_params["night"]).report
        except InputError as error:
            return _refused(str(error), 404)
        none = "there is no report since the last record; hil report makes one"
        return FileResponse(found, headers=_STILL) if found else _refused(none, 404)

    async def units(request: Request) -> Response:
        try:
            text = await run_in_threadpool(_units, watcher, request.path_params["serial"], request.query_params)
        except InputError as error:
            return _refused(str(error), 404)
        return HTMLResponse(text, headers=_STILL)

    async def ask(request: Request) -> Response:
        if not access.may_ask(request.headers):
            return _refused("the token is not right")
        status = 400  # it is no request
        try:
            asked = _asked(await asyncio.wait_for(_body(request), _PATIENCE_S))
            status = 409  # it is one that cannot be done
            return JSONResponse(await run_in_threadpool(_ask, watcher, *asked))
        except TimeoutError:
            return JSONResponse({"error": "what was sent did not come to its end"}, status_code=408)
        except InputError as error:
            return JSONResponse({"error": str(error)}, status_code=status)

    routes = [
        Route("/", page, methods=["GET"]),
        Route("/api/stream", stream, methods=["GET"]),
        Route("/api/ask", ask, methods=["POST"]),
        Route(f"{watcher.reports}{{night:path}}", report, methods=["GET"]),
        Mount("/page", StaticFiles(directory=_STATIC)),
        *([Route(f"{watcher.units}{{serial:path}}", units, methods=["GET"])] if watcher.units else []),
    ]
    return Guard(Starlette(routes=routes, lifespan=watching), access)


def _units(watcher: Watcher, serial: str, asked: Mapping[str, str]) -> str:
    """Return the page of the archive's units, or of one; raise `InputError` where there is none."""
    from hil.archive.history import history  # only who asks for it waits for what solves
    from hil.archive.index import opened_index
    from hil.archive.page import history_page, units_page

    if watcher.archive is None:
        raise InputError("there is no archive on this page")
    with opened_index(watcher.archive) as index:
        if not serial:
            return units_page(index.units(), index.behind(), watcher.units)
        return history_page(history(index, serial, asked.get("model")))


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; raise `InputError` where that is not possible."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        why = _NOT_HERE.get(error.errno or 0, error.strerror or error)
        raise InputError(f"{host}:{port}: cannot be listened at: {why}; choose another --port or --host") from error


def server(app: Guard) -> uvicorn.Server:
    """Return what serves until SIGINT or SIGTERM, then cuts off streams: `server(app).run(sockets=[listener])`."""
    settings = uvicorn.Config(
        app,
        http=_Connection,
        backlog=_AT_ONCE,
        limit_concurrency=_CONNECTIONS,
        log_level="critical",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(settings)


class _Connection(H11Protocol):
    """A connection, closed where no whole request comes, or, of too many, the one that has waited longest."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._patience = self.loop.call_later(_PATIENCE_S, self._judge, None)
        others = (each for each in self.connections if isinstance(each, _Connection))
        waiting = [each for each in others if each.cycle is None and not each.transport.is_closing()]
        if len(waiting) > _WAITING:
            min(waiting, key=lambda each: each._patience.when()).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._patience.cancel()
        super().connection_lost(exc)

    def _judge(self, before: RequestResponseCycle | None) -> None:
        """Close where the last request is the one of `before`, and has been answered."""
        if self.cycle is before and (before is None or before.response_complete):
            self.transport.abort()
        else:
            self._patience = self.loop.call_later(_PATIENCE_S, self._judge, self.cycle)


async def _events(watcher: Watcher) -> AsyncIterator[bytes]:
    async with watcher.page() as updates:
        while True:
            yield await updates.get()


def _refused(why: str, status: int = 401) -> Response:
    return JSONResponse({"error": why}, status_code=status, headers={"www-authenticate": "Bearer"})


async def _body(request: Request) -> dict[str, Any]:
    """Return the JSON object that was sent; raise `InputError` where it is none, or too long."""
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > _LARGEST_BODY:
            raise InputError("what was sent is too long")
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise InputError("what was sent is no JSON object")
    return document


def _asked(document: dict[str, Any]) -> tuple[str, RequestKind, str, str, int | None]:
    """Return the night, what is asked of its controller, by whom and why, of which question; or raise `InputError`."""
    kinds = sorted(each.value for each in RequestKind)
    if document.get("kind") not in kinds:
        raise InputError(f"kind: one of {', '.join(kinds)}")
    kind = RequestKind(document["kind"])
    who = one_line("who", document.get("who", ""), NAME)
    if not who:
        raise InputError("who: a name is needed, for the journal")
    prompt = document.get("prompt")
    answers = kind in (RequestKind.CONFIRM, RequestKind.REFUSE)
    if answers and not (type(prompt) is int and 0 <= prompt < 2**63):  # what the journal can hold
        raise InputError("prompt: the number of the question that is answered")
    why = one_line("why", document.get("why", ""))
    return str(document.get("night", "")), kind, who, why, prompt if answers else None


def _ask(watcher: Watcher, night: str, kind: RequestKind, who: str, why: str, prompt: int | None) -> dict[str, Any]:
    """Put the request into the journal, and wait for the answer for a while: `accepted` is null where none came."""
    folder = watcher.night(night).night
    number = ask_controller(folder, kind, f"{who} (live page)", why, prompt=prompt)
    answered = wait_for_answer(folder, number, _ANSWER_S)
    return {"accepted": answered.accepted, "answer": answered.answer}
