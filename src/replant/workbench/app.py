"""The workbench: opens logs or a session, and serves their page with its requests and actions until Ctrl-C."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute

from replant.errors import InvalidArgumentError, ReplantError, shown
from replant.live.dashboard.app import Hub, file_answer, page_app, stream
from replant.live.dashboard.server import Dashboard, InUseError, serve
from replant.live.progress import stop_on_signals
from replant.logs.recording import digest
from replant.numerics.operating_system import Worker, one_line
from replant.workbench import tasks
from replant.workbench.choices import Setup, text
from replant.workbench.model_cards import Card, judged
from replant.workbench.opened_log import with_role
from replant.workbench.session import SUFFIX, Session, folder, newest_session, read, session_of, token

POINTS = 1200  # default number of points of a curve [count]
MOST_POINTS = 4000  # most points of a curve that the page may request [count]
LONGEST_NAME = 120  # longest name of a dropped file [characters]

Asked = dict[str, str]


def _points(asked: Asked) -> int:
    found = asked.get("points", "")
    return min(max(int(found), 16), MOST_POINTS) if found.isdecimal() and len(found) < 9 else POINTS


def _between(asked: Asked) -> tuple[float, float] | None:
    if "from" not in asked:
        return None
    try:
        begin, end = float(asked["from"]), float(asked.get("to", ""))
    except ValueError:
        raise InvalidArgumentError("from and to must be times in s") from None
    if not (math.isfinite(begin) and math.isfinite(end) and begin < end):
        raise InvalidArgumentError("from and to must be times in s, and from must be before to")
    return begin, end


def signals(session: Session, asked: Asked) -> dict[str, Any]:
    """Return the signals of a log between two times."""
    return session.log(asked.get("log", "")).drawn(_between(asked), _points(asked))


def _excerpt(session: Session, asked: Asked) -> tasks.Excerpt:
    log = session.log(asked.get("log", ""))
    log.setup.check()
    number, stretches = asked.get("part", ""), log.setup.validate_on
    part = stretches[int(number)] if number.isdecimal() and int(number) < len(stretches) else None  # all of the log
    setup = replace(log.setup, use=(), leave_out=(), validate_on=())
    return tasks.Excerpt(str(log.path), log.modified, setup, part, _between(asked), _points(asked))


def conditioned(session: Session, asked: Asked) -> dict[str, Any]:
    """Return the conditioned input and output."""
    return session.work.do(tasks.conditioned, _excerpt(session, asked))


def compared(session: Session, asked: Asked) -> dict[str, Any]:
    """Return the outputs of the compared models, and the measured output, for a part of a log."""
    excerpt = _excerpt(session, asked)
    found = session.work.do(tasks.compared, _models(session), excerpt)
    for name, each in found["models"].items():
        card = session.card(name)
        is_unseen = str(card.path) != excerpt.path or excerpt.part in card.setup.validate_on
        if "verdict" in each:  # on its own samples a model keeps its verdict: a validation assumes unseen samples
            each["verdict"] = judged(each["verdict"] if is_unseen else card.found["verdict"])
    return found


def responses(session: Session, _: Asked) -> dict[str, Any]:
    """Return the responses of the compared models."""
    return session.work.do(tasks.responses, _models(session))


def _models(session: Session) -> dict[str, str]:
    """Return the contents of the compared models' files."""
    cards = [session.card(name) for name in session.compared]
    return {card.name: card.model for card in cards if card.model}


ASKED: dict[str, Callable[[Session, Asked], dict[str, Any]]] = {
    "signals": signals,
    "conditioned": conditioned,
    "compared": compared,
    "responses": responses,
}


def report_of(card: Card) -> bytes:
    """Return the report of a card, written by its command."""
    with tempfile.TemporaryDirectory(prefix="replant-report-") as folder:
        done = subprocess.run(
            [sys.executable, "-m", "replant", *card.words, "--quiet", "--json", "--out", folder],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False,
        )  # fmt: skip
        written = Path(folder, "report.html")
        if done.returncode or not written.is_file():
            raise ReplantError((done.stderr.strip().splitlines() or ["the report could not be made"])[-1])
        return written.read_bytes()


def opened_file(session: Session, dropped: Path) -> str:
    """Open a log or a session's file that was dropped on the page; return the name of the active log."""
    if dropped.suffix == SUFFIX:
        session.restore(read(dropped, dropped.name), dropped.name)
        return session.active
    # use the equal file of that name in the working folder, or else keep the copy
    named, known = Path.cwd() / dropped.name, digest(dropped)
    if not (named.is_file() and named.stat().st_size == dropped.stat().st_size and digest(named) == known):
        named = folder("logs") / known[:16] / dropped.name
        named.parent.mkdir(exist_ok=True)
        dropped.replace(named)
    return session.open(named).name


def _safe(name: str) -> str:
    """Return the name of a dropped file without its folder; raise if it is not a valid name."""
    name = name.replace("\\", "/").rpartition("/")[2]
    if not name or name.startswith(".") or not name.isprintable() or len(name) > LONGEST_NAME:
        raise InvalidArgumentError(f"{shown(name)} is not a name of a log: rename the file, with a suffix such as .csv")
    return name


def _choice(change: Callable[..., Setup]) -> Callable[..., None]:
    return lambda session, log, *given: session.choose(log, lambda opened: change(opened, *given))


#: For each action of the pages the method of the session, and what the page gives it.
ACTIONS: dict[str, tuple[Callable[..., list[str] | None], *tuple[str, ...]]] = {
    "activate": (Session.activate, "log"),
    "close": (Session.close_log, "log"),
    "read-again": (lambda session, log: session.log(log).read_again(), "log"),
    "role": (_choice(with_role), "log", "column", "role"),
    "setup": (_choice(lambda opened, given: opened.setup.changed(given)), "log", "setup"),
    "stretch": (_choice(lambda opened, *given: opened.setup.with_stretch(*given)), "log", "kind", "before", "after"),
    "wish": (Session.set_wish, "log", "wish"),
    "fit": (Session.fit, "log", "wish"),
    "stop": (Session.stop, "card"),
    "repeat": (Session.again, "card"),
    "rename": (Session.rename, "card", "title"),
    "remove": (Session.remove, "card"),
    "sort": (Session.sort, "order"),
    "show": (Session.show, "card", "chosen"),
}


def _argument(name: str, given: dict[str, Any]) -> Any:
    """Return what a page gives for an argument: an object, or a text; the session checks stretches."""
    if name in ("before", "after"):
        return given.get(name)
    if name == "chosen":
        return bool(given.get(name))
    if name not in ("setup", "wish"):
        return text(name, given.get(name, ""))
    found = given.get(name, {})
    if not isinstance(found, dict):
        raise InvalidArgumentError(f"{name} must be an object of JSON")
    return found


PERIOD = 2.0  # time between two checks whether a log has changed [s]


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
            session.restore(read(kept_in, str(kept_in)), str(kept_in))
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


LAST_PORT = 65535  # highest port of TCP [count]


def _served(session: Session, hub: Hub, host: str, port: int) -> Dashboard:
    """Serve a session on the wanted port, or on the next free one if it is in use."""
    word, application = token(), partial(create_app, session)
    for free in range(port, max(port, LAST_PORT) + 1):  # a port beyond the last is refused with its number
        with suppress(InUseError):
            return serve(hub, host, free, word, application)
    raise InUseError(f"port {port} of {host} is in use, and so is each above it: choose a lower one")


LONGEST_BODY = 1 << 20  # largest body of an action's request [bytes]


def create_app(session: Session, hub: Hub, *, token: str | None, hosts: tuple[str, ...]) -> Starlette:
    """Return the workbench of a session as an ASGI application."""
    return page_app("replant.workbench", _routes(session, hub), token=token, hosts=hosts)


def _routes(session: Session, hub: Hub) -> list[Route | WebSocketRoute]:
    async def act(request: Request) -> Response:
        if request.path_params["name"] not in ACTIONS:
            return PlainTextResponse("There is no action of that name.\n", 404)
        action, *names = ACTIONS[request.path_params["name"]]
        given = await _body(request)
        made = await asyncio.to_thread(action, session, *(_argument(name, given) for name in names))
        return JSONResponse({**({} if made is None else {"made": made}), "revision": session.changed()})

    async def upload(request: Request) -> Response:
        name = _safe(request.query_params.get("name", ""))
        with tempfile.TemporaryDirectory(prefix="drop-", dir=folder("logs")) as held:
            dropped = Path(held, name)
            try:
                with dropped.open("wb") as file:
                    async for block in request.stream():
                        await asyncio.to_thread(file.write, block)
            except OSError as cause:
                raise ReplantError(f"{name}: {one_line(cause)}") from None
            shown = await asyncio.to_thread(opened_file, session, dropped)
        session.changed()
        return JSONResponse({"log": shown})

    async def ask(request: Request) -> Response:
        asked = ASKED.get(request.path_params["name"])
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
        return file_answer(await asyncio.to_thread(report_of, card), "text/html", "report.html")

    async def kept(_: Request) -> Response:
        return file_answer(session.written().encode(), "application/json", f"session{SUFFIX}")

    return [
        WebSocketRoute("/live", partial(stream, hub)),
        Route("/do/{name}", act, methods=["POST"]),
        Route("/logs", upload, methods=["POST"]),
        Route("/ask/{name}", ask),
        Route("/models/{name}/model.json", model),
        Route("/models/{name}/report", report, methods=["POST"]),
        Route("/session", kept),
    ]


async def _body(request: Request) -> dict[str, Any]:
    content = bytearray()
    async for block in request.stream():
        content += block
        if len(content) > LONGEST_BODY:
            raise InvalidArgumentError("the request is too long")
    try:
        found = json.loads(content or b"{}")
    except ValueError:
        raise InvalidArgumentError("the request is not JSON") from None
    if not isinstance(found, dict):
        raise InvalidArgumentError("the request must be an object of JSON")
    return found
