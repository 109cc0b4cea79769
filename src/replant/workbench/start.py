"""Start: opens the logs that were named, serves the page until Ctrl-C, and keeps the session."""

from __future__ import annotations

import json
import sys
import threading
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError
from replant.live.dashboard import Dashboard, Hub, serve
from replant.live.session.progress import stop_on_signals
from replant.numerics.operating_system import Worker
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
    hub = Hub(command=_nothing, report=bytes, notice=_say)
    session, ended = Session(kept_in, hub.publish), threading.Event()
    try:
        if kept_in.exists():
            session.restore(read(kept_in), str(kept_in))
        for path in [] if own else logs:
            session.open(path)
        session.changed()
        Worker(lambda: _watch(session, ended)).start()
        with _served(session, hub, host, port) as served:
            yield served
            served.announce_end()
    finally:
        ended.set()
        session.close()


def _watch(session: Session, ended: threading.Event) -> None:
    while not ended.wait(PERIOD):
        session.look_for_growth()


def _served(session: Session, hub: Hub, host: str, port: int) -> Dashboard:
    """Serve a session, on the next free port where the wanted one is in use."""

    def application(hub: Hub, **protections: Any) -> Any:
        from replant.workbench.app import create_app

        return create_app(session, hub, **protections)

    word = token()
    try:
        return serve(hub, host, port, word, application)
    except InvalidArgumentError as error:
        if "in use" not in str(error):
            raise
        return serve(hub, host, 0, word, application)


def _nothing(_: str) -> None:
    """Take no command: what a page does comes as an action."""


def _say(text: str) -> None:
    print(f"replant: {json.dumps(text)[1:-1]}", file=sys.stderr)
