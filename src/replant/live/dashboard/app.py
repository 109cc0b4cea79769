"""The application: the hub between identification and browsers; page and assets, websocket, commands, downloads."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from replant.errors import ReplantError
from replant.live.dashboard.security import HEADERS, Guard, most_connections
from replant.report.findings import VERDICTS
from replant.report.page_frame import SIGNS, uplot
from replant.report.page_frame import asset as report_asset

#: The commands that a page may send to the identification.
COMMANDS = ("freeze", "adapt", "reset")
DIGITS = 7  # digits of numbers that are only drawn: a screen shows four [count]
_SLOW = ("bode", "step", "truth")  # parts that change slowly and are sent with the history
_DRAWN = ("window", "more_inputs", *_SLOW, "history")


#: A view serialized once for all browsers, as two JSON objects: "view" without its slow parts, "history" with these.
Frame = dict[str, str]


class Hub:
    """Holds the newest view for browsers; views are not queued, so a slow browser skips some."""

    def __init__(
        self,
        *,
        command: Callable[[str], None] = lambda name: None,
        report: Callable[[], bytes] = bytes,
        notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.command, self.notice = command, notice  # `command` sends a name of `COMMANDS` to the identification
        self._report = report
        self.ended = False  # whether the newest view is the last one; browsers that have it are then disconnected
        self.browsers = 0  # number of browsers with an open websocket
        self.newest: dict[str, Any] | None = None  # the view published last, None before the first
        self._framed: dict[str, Any] | None = None  # the view that the frame shows
        self._frame: Frame | None = None
        self._reporting = threading.Lock()

    def publish(self, view: dict[str, Any]) -> None:
        """Replace the newest view; from any thread."""
        self.newest = view

    def frame(self) -> Frame | None:
        """Return the newest view as a frame, serialized at the first request."""
        view = self.newest
        if view is not None and view is not self._framed:
            shown = {key: _rounded(value) if key in _DRAWN else value for key, value in view.items()}
            history = shown.pop("history", None)
            shown.pop("model", None)  # only for downloads
            slow = {key: shown.pop(key) for key in _SLOW if key in shown}
            long = {"history": history, **({"slow": slow} if slow else {})}
            self._framed, self._frame = view, {"view": _text({"view": shown}), "history": _text(long)}
        return self._frame

    async def report(self) -> bytes:
        """Return a report of the identification as HTML; it takes seconds, in a thread."""
        if not self._reporting.acquire(blocking=False):
            raise ReplantError("a report is already being made: try again when it is finished")
        try:
            return await asyncio.to_thread(self._report)
        finally:
            self._reporting.release()


def _rounded(value: Any) -> Any:
    """Round the numbers in ``value`` to `DIGITS` digits, which halves the number of bytes."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return value


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))


PERIOD = 0.2  # time between two views to a browser [s]
HISTORY_PERIOD = 1.0  # time between two messages of history and responses, which are long and change slowly [s]
LOOK = 0.05  # time between two checks for a newer view [s]
MOST_WATCHING = 256  # most simultaneous browsers [count]
_OVER, _TRY_LATER, _POLICY = 1000, 1013, 1008  # close codes of a websocket [number]
PAGE = "index.html"
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_OF_REPORT = ("chart.js", "format.js", "palette.css")  # shared with the report


def create_app(hub: Hub, *, token: str | None, hosts: tuple[str, ...]) -> Starlette:
    """Return the dashboard of ``hub`` as an ASGI application."""
    return page_app("replant.live.dashboard", _routes(hub), token=token, hosts=hosts)


def page_app(
    package: str, routes: Sequence[Route | WebSocketRoute], *, token: str | None, hosts: tuple[str, ...]
) -> Starlette:
    """Return an application of a package's page, its assets and further routes, with the access control of all."""
    assets = dashboard_assets() | assets_of(package)
    page = resources.files(package).joinpath("assets", PAGE).read_bytes()

    async def index(_: Request) -> Response:
        return Response(page, media_type="text/html")

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in assets:
            return PlainTextResponse("There is nothing here.\n", 404)
        return Response(assets[name], media_type=_TYPES[Path(name).suffix])

    return Starlette(
        routes=[Route("/", index), Route("/assets/{name}", asset), *routes],
        middleware=[
            Middleware(Guard, token=token, hosts=hosts),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=4),
        ],
        exception_handlers={ReplantError: _refused, Exception: _failed},
    )


async def _refused(_: Request, error: Exception) -> Response:
    """Answer a request that cannot be fulfilled with its reason, in one line."""
    return PlainTextResponse(f"{error}\n", 409)


async def _failed(_: Request, __: Exception) -> Response:
    """Answer a request that raised an unexpected error, which the server logs; the guard does not add its headers."""
    return PlainTextResponse("The request failed: the terminal shows the reason.\n", 500, headers=HEADERS)


def _routes(hub: Hub) -> list[Route | WebSocketRoute]:
    """Return the routes of views, commands, models and reports."""

    async def model(request: Request) -> Response:
        found = (hub.newest or {}).get("model")  # with all digits
        if not found:
            return PlainTextResponse("There is no model yet.\n", 404)
        if request.url.path == "/model.py":
            return file_answer(python_of(found).encode(), "text/x-python", "model.py")
        return file_answer(f"{json.dumps(found, indent=2)}\n".encode(), "application/json", "model.json")

    async def command(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in COMMANDS:
            return PlainTextResponse(f"There is no command of that name: {', '.join(COMMANDS)}.\n", 404)
        hub.command(name)
        return Response(status_code=204)

    async def report(_: Request) -> Response:
        try:
            return file_answer(await hub.report(), "text/html", "report.html")
        except ReplantError as error:
            return PlainTextResponse(f"{error}\n", 503)
        except Exception:
            logging.getLogger("replant.live").exception("the report could not be made")
            return PlainTextResponse("The report could not be made: the terminal shows the reason.\n", 500)

    return [
        WebSocketRoute("/live", partial(stream, hub)),
        Route("/model.json", model),
        Route("/model.py", model),
        Route("/command/{name}", command, methods=["POST"]),
        Route("/report", report, methods=["POST"]),
    ]


async def stream(hub: Hub, socket: WebSocket) -> None:
    """Send views until the last one, or until the browser closes the websocket or sends a message."""
    if hub.browsers >= min(MOST_WATCHING, most_connections() // 2):
        await socket.close(_TRY_LATER, "too many browsers are connected")
        return
    hub.browsers += 1
    tasks: list[asyncio.Task[Any]] = []
    try:
        await socket.accept()
        heard = asyncio.create_task(socket.receive())
        tasks = [asyncio.create_task(_send(hub, socket)), heard]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        if not heard.done() and hub.ended:
            await socket.close(_OVER, "the session has ended")
        elif heard.done() and heard.result()["type"] == "websocket.receive":
            await socket.close(_POLICY, "messages are not accepted")
    finally:
        hub.browsers -= 1
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send(hub: Hub, socket: WebSocket) -> None:
    """Send views until the last one, and history and responses less often."""
    periods = {"view": PERIOD, "history": HISTORY_PERIOD}
    sent: dict[str, Frame | None] = dict.fromkeys(periods)
    due = dict.fromkeys(periods, 0.0)
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the browser has closed the websocket
        while True:
            ended, frame = hub.ended, hub.frame()  # in this order: once `ended` is true, the frame is the last one
            for part, period in periods.items():
                if frame is not None and frame is not sent[part] and (ended or time.monotonic() >= due[part]):
                    sent[part], due[part] = frame, time.monotonic() + period
                    await socket.send_text(frame[part])
            if ended:
                return
            await asyncio.sleep(LOOK)


def file_answer(content: bytes, kind: str, name: str) -> Response:
    """Return an answer that the browser saves as a file."""
    return Response(content, media_type=kind, headers={"Content-Disposition": f'attachment; filename="{name}"'})


def python_of(model: dict[str, Any]) -> str:
    """Return a program that makes the model's transfer function; for several inputs a dictionary of them by name."""
    verdict = " ".join(str(model["verdict"]["status"]).split())  # in one line, so that it cannot end the comment
    return (
        f"# identified by replant from {int(model['samples'])} samples; verdict: {verdict}\n"
        "from replant import TransferFunction\n\n"
        f"G = {_plants(model)}\n"
        "print(G)\n"
    )


def _plants(model: dict[str, Any]) -> str:
    if isinstance(model["delay"], list):
        parts = zip(*(model[key] for key in ("num", "den", "delay", "input")), strict=True)
        each = [{"num": num, "den": den, "delay": delay, "input": one} for num, den, delay, one in parts]
        return "".join(["{\n", *(f"    {str(one['input']['name'])!r}: {_plants(one)},\n" for one in each), "}"])
    num, den = ([float(value) for value in model[key]] for key in ("num", "den"))
    return f"TransferFunction(num={num}, den={den}, delay={float(model['delay'])})"


def assets_of(package: str) -> dict[str, bytes]:
    """Return the files that a package's page loads, by name."""
    files = resources.files(package).joinpath("assets").iterdir()
    return {each.name: each.read_bytes() for each in files if each.name != PAGE and Path(each.name).suffix in _TYPES}


@cache
def dashboard_assets() -> dict[str, bytes]:
    """Return all files that the page loads, by name."""
    found = assets_of("replant.live.dashboard") | {name: report_asset(name).encode() for name in _OF_REPORT}
    words = {status: [each.gravity, each.headline, each.text] for status, each in VERDICTS.items()}  # the report's
    verdicts = f"export const VERDICTS = new Map(Object.entries({json.dumps(words)}));\n"
    found["words.js"] = f"{verdicts}export const SIGNS = {json.dumps(SIGNS)};\n".encode()
    found["uPlot.js"], found["uPlot.css"] = (text.encode() for text in uplot())
    return found
