"""Idle clients exclude nobody: connections are limited in number and time, and file descriptors remain free."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from replant.live.dashboard import app, security, server
from replant.live.dashboard.app import Hub
from replant.live.dashboard.server import serve
from support.cases import every
from support.dashboard_watcher import numbered, until, watch
from support.http_request import ask
from support.live_command import PATIENCE, wait_for

MOST = 12
IDLE = {
    "nothing": b"",
    "half a line": b"GET / HT",
    "half the headers": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n",
    "half a body": b"POST /report HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nabc",
    "an upgrade to nothing": b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n",
}


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, said: list[str]) -> Hub:
    """A hub with one view, for servers that let few in."""
    monkeypatch.setattr(security, "MOST", MOST)
    monkeypatch.setattr(app, "PERIOD", 0.0)
    monkeypatch.setattr(app, "LOOK", 0.001)
    made = Hub(command=print, report=bytes, notice=said.append)
    made.publish(numbered(0))
    return made


@contextlib.contextmanager
def crowd(port: int, size: int, first: bytes = b"") -> Iterator[list[socket.socket]]:
    """Connections that say this and then nothing."""
    with contextlib.ExitStack() as stack:
        found = []
        for _ in range(size):
            wire = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE))
            with contextlib.suppress(ConnectionError):
                wire.sendall(first)
            found.append(wire)
        yield found


def is_cut_off(wire: socket.socket) -> bool:
    """Wait until the other side has hung up; whatever it answered before that."""
    with contextlib.suppress(ConnectionError):
        while wire.recv(65536):
            pass
    return True


@pytest.mark.slow
@pytest.mark.parametrize("kind", IDLE)
def test_a_crowd_that_only_connects_keeps_nobody_out(hub: Hub, said: list[str], kind: str) -> None:
    with serve(hub) as served, watch(served.port) as watcher:
        until(watcher, 0)
        with crowd(served.port, 5 * MOST, IDLE[kind]):
            for number in range(1, 4):
                assert ask(served.port, "GET /")[0] == 200
                hub.publish(numbered(number))
                until(watcher, number)
            with watch(served.port) as another:
                until(another, 3)
    assert any("connections" in line for line in said)


@every("kind", IDLE, quick=2)
def test_a_client_that_stops_sending_is_cut_off(hub: Hub, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    with serve(hub) as served, watch(served.port) as watcher:
        monkeypatch.setattr(security, "ASKING", 0.2)  # a busy machine takes longer for the watcher's handshake
        monkeypatch.setattr(security, "ANSWERING", 0.2)
        with crowd(served.port, 3, IDLE[kind]) as wires:
            assert all(is_cut_off(wire) for wire in wires)
        hub.publish(numbered(1))
        until(watcher, 1)  # who watches is not


def test_a_client_that_sends_single_bytes_is_cut_off(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    """Single bytes postpone the server's own timeout between two requests."""
    monkeypatch.setattr(security, "ASKING", 0.5)
    with serve(hub) as served, crowd(served.port, 1, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n") as (wire,):
        wire.settimeout(0.05)

        def is_cut_off() -> bool:
            try:
                wire.sendall(b"G")
                return wire.recv(65536) == b""
            except TimeoutError:
                return False
            except ConnectionError:
                return True

        wait_for(is_cut_off)


@pytest.mark.slow
def test_an_answer_that_nobody_fetches_is_given_up(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    hub.publish({"num": [1.0], "den": [1.0, 2.0], "names": ["x" * 50_000_000], "delay": 0.0})
    request = b"GET /model.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with serve(hub) as served, crowd(served.port, 1, request) as (wire,):
        assert wire.recv(1)  # it begins to answer
        monkeypatch.setattr(security, "ASKING", 0.2)
        wait_for(lambda: not served._server.server_state.connections)


def test_watchers_leave_room_for_others(hub: Hub) -> None:
    with serve(hub) as served, contextlib.ExitStack() as stack:
        for _ in range(MOST // 2):
            until(stack.enter_context(watch(served.port)), 0)
        assert ask(served.port, "GET /")[0] == 200
        line = "GET /live"
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
        handshake = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", key)
        assert ask(served.port, line, *handshake, f"Origin: http://127.0.0.1:{served.port}")[0] == 403


def test_a_new_connection_replaces_the_oldest_without_a_websocket(hub: Hub) -> None:
    with serve(hub) as served, watch(served.port) as watcher:
        until(watcher, 0)
        with crowd(served.port, MOST - 1) as (oldest, *others), crowd(served.port, 1):
            assert is_cut_off(oldest)
            hub.publish(numbered(1))
            until(watcher, 1)  # older still, and at work
            for wire in others:
                wire.setblocking(False)
                with pytest.raises(BlockingIOError):  # nothing to read, no end
                    wire.recv(1)


def test_waiting_requests_with_wrong_tokens_are_bounded(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(security, "MOST_WAITING", 3)
    monkeypatch.setattr(security, "PAUSE", 1.0)
    with serve(hub, token="right") as served, ThreadPoolExecutor(16) as pool:
        cookie = ask(served.port, "GET /?token=right")[1]["set-cookie"].partition(";")[0]
        tries = [pool.submit(ask, served.port, "GET /?token=wrong") for _ in range(8)]
        statuses = [one.result()[0] for one in tries]
        assert set(statuses) == {401, 503}
        assert ask(served.port, "GET /", f"Cookie: {cookie}")[0] == 200


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="sockets are no file descriptors there")
def test_four_hundred_idle_connections_at_a_limit_of_256_descriptors() -> None:
    """The page answers, views go on, the observer lives, and one line says what happened."""
    command = [sys.executable, "-W", "error", "-m", "replant", "live", "demo", "--dashboard", "127.0.0.1:0"]
    process = subprocess.Popen(
        ["/bin/sh", "-c", 'ulimit -n 256; exec "$@"', "sh", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=dict(os.environ),
    )  # fmt: skip
    assert process.stderr is not None
    try:
        found = None
        text = b""
        while found is None:
            text += (line := process.stderr.readline())
            assert line, text
            found = re.search(rb"http://127\.0\.0\.1:(\d+)/", text)
        port = int(found[1])
        before = wait_for(lambda: model(port))
        with crowd(port, 400):
            wait_for(lambda: model(port).get("samples", 0) > before["samples"] + 2000)
        process.send_signal(signal.SIGTERM)
        _, rest = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    said = (text + rest).decode()
    assert process.returncode == 0
    assert "Traceback" not in said
    assert "it restarts in" not in said
    assert said.count("connections: the oldest without a websocket are closed") == 1


def model(port: int) -> dict[str, Any]:
    """The model that the page offers; empty before there is one."""
    with (
        contextlib.suppress(OSError),
        urllib.request.urlopen(f"http://127.0.0.1:{port}/model.json", timeout=PATIENCE) as got,
    ):
        found: dict[str, Any] = json.load(got)
        return found
    return {}


def test_a_server_that_does_not_end_is_abandoned(hub: Hub, said: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "LEFT_BEHIND", 0.5)
    goes_on, dashboard = threading.Event(), serve(hub)

    async def never(sockets: object = None) -> None:
        while not goes_on.is_set():
            await asyncio.sleep(0.01)

    monkeypatch.setattr(dashboard._server, "shutdown", never)
    dashboard.stop()
    assert dashboard.alive
    assert said == ["its server has not ended within 0.5 s, and is abandoned"]
    goes_on.set()
    wait_for(lambda: not dashboard.alive)
