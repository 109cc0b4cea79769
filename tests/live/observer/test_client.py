"""The observer's process: views come back, it dies and comes again, and the session never waits for it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.live.observer import client as observing
from replant.live.observer.client import Observer
from replant.live.observer.process import Address, Orders
from replant.live.observer.view import Pulse, View
from support.live_command import wait_for
from support.live_fakes import DT, REQUEST, record

U, Y = record()


@pytest.fixture(scope="module")
def observer() -> Iterator[Observer]:
    """Return one for all tests: it takes seconds to start."""
    started = Observer(Orders(dashboard=Address("127.0.0.1", 0)))
    yield started
    started.close()


@pytest.fixture
def mortal() -> Iterator[Observer]:
    """Return one that may be killed."""
    started = Observer(Orders())
    yield started
    started.close()


def identifier(samples: int) -> rp.Identifier:
    made = rp.Identifier(**vars(REQUEST))
    made.update_many(U[:samples], Y[:samples])
    return made


def seen(observer: Observer, ident: rp.Identifier, *, learned: bool = True) -> View:
    """Hand over, and wait for the view that comes of it."""
    before = observer.last
    pulse = Pulse(at=ident.samples * DT, source="fake://", source_state="connected")

    def newer() -> View | None:
        observer.poll()
        observer.hand(ident, pulse, learned=learned)
        return observer.last if observer.last is not before else None

    found = wait_for(newer)
    assert isinstance(found, View)
    return found


def test_views_come_back_and_go_to_the_page(observer: Observer) -> None:
    ident = identifier(3000)
    view = seen(observer, ident)
    assert observer.view is observer.last
    np.testing.assert_array_equal(view.parameters, ident.parameters)
    assert view.verdict == ident.assess().status
    request = urllib.request.Request(observer.url + "model.json")
    with urllib.request.urlopen(request, timeout=30.0) as answer:
        model = json.load(answer)
    assert model["den"] == [1.0, ident.parameters[0]]
    assert seen(observer, ident, learned=False).samples == 3000  # the pulse alone


def test_commands_come_back_from_the_page(observer: Observer) -> None:
    request = urllib.request.Request(observer.url + "command/freeze", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=30.0) as answer:
        assert answer.status < 300
    assert wait_for(observer.poll) == ["freeze"]


def test_the_report_is_made_of_the_newest_estimate(observer: Observer) -> None:
    ident = identifier(3000)
    seen(observer, ident)
    request = urllib.request.Request(observer.url + "report", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=120.0) as answer:
        page = answer.read().decode()
    assert page.lower().startswith("<!doctype html>")
    assert f"{ident.parameters[0]:.4g}"[:5] in page


def test_it_is_started_again_once_with_its_history_and_then_given_up(
    mortal: Observer, capfd: pytest.CaptureFixture
) -> None:
    observer = mortal
    for samples in (1000, 2000):
        before = seen(observer, identifier(samples))
    first = observer._process.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: observer.poll() == [] and observer._process.pid != first)
    after = seen(observer, identifier(3000))
    np.testing.assert_array_equal(after.history.t[: before.history.t.size], before.history.t)
    assert after.samples == 3000

    second = observer._process.pid
    assert second is not None
    os.kill(second, signal.SIGKILL)
    wait_for(lambda: observer.poll() == [] and not observer._alive)
    assert not observer.hand(identifier(100), Pulse(), learned=True)
    observer.look_again(identifier(100), Pulse())  # does not wait for what cannot come
    said = capfd.readouterr().err.splitlines()
    assert ["started again" in said[0], "no verdict" in said[1]] == [True, True]


def test_a_crowd_at_the_page_is_none_of_the_sessions_business(observer: Observer) -> None:
    """A hundred pages that do not read, and garbage: views go on, and nothing of it is in this process."""
    seen(observer, identifier(1000))
    threads, port = threading.active_count(), int(observer.url.rstrip("/").rpartition(":")[2])
    upgrade = (
        f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    ).encode()
    with contextlib.ExitStack() as crowd:
        for k in range(100):
            page = crowd.enter_context(socket.create_connection(("127.0.0.1", port), timeout=30.0))
            page.sendall(upgrade)
            if k % 2:
                page.sendall(b"\xff\x00" * 5000)
            assert page.recv(12) == b"HTTP/1.1 101"
        for samples in range(1100, 1500, 100):
            assert seen(observer, identifier(samples)).samples == samples
        assert threading.active_count() == threads


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_that_end_a_session_do_not_reach_it(observer: Observer, number: signal.Signals) -> None:
    """As `timeout`, Ctrl-C and service managers send them to every process: the session takes its last view after."""
    process = observer._process.pid
    assert process is not None
    os.kill(process, number)
    seen(observer, identifier(1000))
    assert observer._process.pid == process


def test_what_is_said_before_the_first_view_is_shown_at_once(capfd: pytest.CaptureFixture) -> None:
    """As that kernels are being compiled, which is over when there is something to look at."""
    started = Observer(Orders(terminal=True))
    try:
        started.show("replant: compiling")
        assert capfd.readouterr().err == "replant: compiling\n"
        seen(started, identifier(300))
        started.show("replant: later")
        seen(started, identifier(400))
        assert wait_for(lambda: "replant: later\n" in capfd.readouterr().err)
    finally:
        started.close()


def test_it_goes_away_with_its_session() -> None:
    """However that ends; a signal would not end it."""
    program = """
from replant.live.observer.client import Observer
from replant.live.observer.process import Orders
if __name__ == "__main__":
    observer = Observer(Orders())
    print(observer._process.pid, flush=True)
    {end}
"""
    for end, code in (("raise SystemExit(3)", 3), ("import os; os._exit(4)", 4)):
        done = subprocess.run(
            [sys.executable, "-c", program.format(end=end)], stdout=subprocess.PIPE, timeout=60.0, check=False
        )  # fmt: skip
        assert done.returncode == code
        left = Path(f"/proc/{int(done.stdout)}")
        wait_for(lambda: not left.exists() or "Z" in (left / "stat").read_text().split()[2])  # noqa: B023


def test_an_old_view_says_nothing_of_the_present(observer: Observer, monkeypatch: pytest.MonkeyPatch) -> None:
    seen(observer, identifier(1000))
    assert observer.view is not None
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + observing.TOO_OLD + 1.0)
    assert observer.view is None
    assert observer.last is not None
