"""The workbench: opens logs or a session, and serves their page, what it asks for and what it does, until Ctrl-C."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import webbrowser
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from replant.errors import InvalidArgumentError, ReplantError
from replant.live.dashboard.app import dashboard_assets, file_answer, page_app, stream
from replant.live.dashboard.hub import Hub
from replant.live.dashboard.server import Dashboard, serve
from replant.live.session.progress import stop_on_signals
from replant.numerics.operating_system import Worker
from replant.workbench import actions
from replant.workbench.actions import ACTIONS, Upload
from replant.workbench.session import SUFFIX, Session, newest_session, read, session_of, token

PERIOD = 2.0  # time between two looks at whether a log has changed [s]


def start(logs: Sequence[Path], host: str, port: int) -> None:
    """Serve the workbench of logs, or of a session's file, until Ctrl-C."""
    ended = threading.Event()
    with opened(logs, host, port) as served, stop_on_signals(ended.set):
        print(f"replant: the workbench is at {served.url}", file=sys.stderr)
        print("replant: Ctrl-C ends it; the session is kept", file=sys.stderr, flush=True)
        if sys.stdout.isatty():
            webbrowser.open(served.url)
        while served.alive and not ended.wait(0.5):
            pass


@contextmanager
def opened(logs: Sequence[Path], host: str = "127.0.0.1", port: int = 0) -> Iterator[Dashboard]:
    """Open logs, or the file of a session, and serve their workbench for the ``with`` block."""
    for path in logs:
        if not path.exists():
            raise InvalidArgumentError(f"{path}: no such file; check the path")
    own = logs[0] if len(logs) == 1 and logs[0].suffix == SUFFIX else None
    if own is None and any(path.suffix == SUFFIX for path in logs):
        raise InvalidArgumentError(f"open one session ({SUFFIX}) by itself, or logs")
    kept_in = own or (session_of(logs) if logs else newest_session())
    hub = Hub(notice=lambda text: print(f"replant: {json.dumps(text)[1:-1]}", file=sys.stderr))
    session, ended = Session(kept_in, hub.publish), threading.Event()

    def watch() -> None:
        while not ended.wait(PERIOD):
            session.look_for_growth()

    try:
        if kept_in.exists():
            session.restore(read(kept_in), str(kept_in))
        for path in [] if own else logs:
            session.open(path)
        session.changed()
        Worker(watch).start()
        with _served(session, hub, host, port) as served:
            yield served
            served.announce_end()
    finally:
        ended.set()
        session.close()


def _served(session: Session, hub: Hub, host: str, port: int) -> Dashboard:
    """Serve a session, on the next free port where the wanted one is in use."""
    word, application = token(), partial(create_app, session)
    try:
        return serve(hub, host, port, word, application)
    except InvalidArgumentError as error:
        if "in use" not in str(error):
            raise
        return serve(hub, host, 0, word, application)


LARGEST = 1 << 20  # body of an action [bytes]
_SCRIPTS = ("workbench", "page", "data", "marks", "models", "compare", "keep", "curves")
_OWN = (*(f"{name}.js" for name in _SCRIPTS), "workbench.css")


def create_app(session: Session, hub: Hub, *, token: str | None, hosts: tuple[str, ...]) -> Starlette:
    """Return the workbench of a session as an ASGI application."""
    return page_app(_own("index.html"), _assets(), _routes(session, hub), token=token, hosts=hosts)


def _routes(session: Session, hub: Hub) -> list[Route | WebSocketRoute]:
    async def live(socket: WebSocket) -> None:
        await stream(hub, socket)

    async def act(request: Request) -> Response:
        action = ACTIONS.get(request.path_params["name"])
        if action is None:
            return PlainTextResponse("There is no action of that name.\n", 404)
        given = await _body(request)
        found = await asyncio.to_thread(action, session, given)
        session.changed()
        return JSONResponse(found or {})

    async def upload(request: Request) -> Response:
        with Upload(session, request.query_params.get("name", "")) as coming:
            async for block in request.stream():
                await asyncio.to_thread(coming.write, block)
            found = await asyncio.to_thread(coming.finish)
        session.changed()
        return JSONResponse(found)

    async def ask(request: Request) -> Response:
        asked = actions.ASKED.get(request.path_params["name"])
        if asked is None:
            return PlainTextResponse("There is nothing here.\n", 404)
        return JSONResponse(await asyncio.to_thread(asked, session, dict(request.query_params)))

    async def model(request: Request) -> Response:
        card = session.card(request.path_params["name"])
        if not card.model:
            return PlainTextResponse("This card has no model yet.\n", 404)
        return file_answer(card.model.encode(), "application/json", "model.json")

    async def report(request: Request) -> Response:
        card = session.card(request.path_params["name"])
        return file_answer(await asyncio.to_thread(actions.report, card), "text/html", "report.html")

    async def kept(_: Request) -> Response:
        return file_answer(session.written().encode(), "application/json", f"session{SUFFIX}")

    return [
        WebSocketRoute("/live", live),
        Route("/do/{name}", _told(act), methods=["POST"]),
        Route("/logs", _told(upload), methods=["POST"]),
        Route("/ask/{name}", _told(ask)),
        Route("/models/{name}/model.json", _told(model)),
        Route("/models/{name}/report", _told(report), methods=["POST"]),
        Route("/session", _told(kept)),
    ]


def _told(answer: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
    """Have a user's mistake answered in one line."""

    async def answered(request: Request) -> Response:
        try:
            return await answer(request)
        except ReplantError as error:
            return PlainTextResponse(f"{error}\n", 409)

    return answered


async def _body(request: Request) -> dict[str, Any]:
    content = bytearray()
    async for block in request.stream():
        content += block
        if len(content) > LARGEST:
            raise InvalidArgumentError("the request is too long")
    try:
        found = json.loads(content or b"{}")
    except ValueError:
        raise InvalidArgumentError("the request is no JSON") from None
    if not isinstance(found, dict):
        raise InvalidArgumentError("the request must be an object of JSON")
    return found


@cache
def _assets() -> dict[str, bytes]:
    """Return everything that the page loads: the dashboard's parts, and its own."""
    return dashboard_assets() | {name: _own(name) for name in _OWN}


def _own(name: str) -> bytes:
    return resources.files("replant.workbench").joinpath("assets", name).read_bytes()
