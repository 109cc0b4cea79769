"""What is served: page, assets, downloads, and views over a websocket that no client can hold up."""

from __future__ import annotations

import ast
import asyncio
import contextlib
import json
import socket
import struct
import time
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed

import replant as rp
from replant.errors import InvalidArgumentError, ReplantError
from replant.live.dashboard import app
from replant.live.dashboard.app import Hub
from replant.live.dashboard.server import Dashboard, serve
from support.cases import every
from support.dashboard_feed import Feed
from support.dashboard_watcher import numbered, until, view_of, watch
from support.http_request import ask
from support.waiting import PATIENCE


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> Hub:
    """A hub whose views are a number and ballast, sent as fast as they are read."""
    monkeypatch.setattr(app, "PERIOD", 0.0)
    monkeypatch.setattr(app, "LOOK", 0.001)
    return Hub(command=print, report=bytes)


# --- page and downloads ---


def test_the_page_asks_for_nothing_but_what_is_served(dashboard: Dashboard) -> None:
    status, headers, page = ask(dashboard.port, "GET /")
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    named = {part.split(b'"')[0] for mark in (b'href="', b'src="') for part in page.split(mark)[1:]}
    assert {b"/assets/dashboard.js", b"/assets/uPlot.js", b"/assets/palette.css"} <= named
    for path in sorted(named):
        assert path.startswith(b"/")
        assert ask(dashboard.port, f"GET {path.decode()}")[0] == 200
    assert b"<script>" not in page
    assert b"style=" not in page


@every("path", ["/assets/none.js", "/assets/../app.py", "/assets/%2e%2e/app.py", "/assets//etc/passwd"])
def test_nothing_else_is_served(dashboard: Dashboard, path: str) -> None:
    assert ask(dashboard.port, f"GET {path}")[0] == 404


def test_the_page_and_all_that_it_loads_weigh_little(dashboard: Dashboard) -> None:
    weight = 0
    for path in ("", *(f"assets/{name}" for name in app.dashboard_assets())):
        status, headers, body = ask(dashboard.port, f"GET /{path}", "Accept-Encoding: gzip")
        assert (status, headers.get("content-encoding", "gzip")) == (200, "gzip")
        weight += len(body)
    assert weight < 75_000


def test_the_model_comes_down_with_all_its_digits(dashboard: Dashboard, feed: Feed) -> None:
    model = feed.identifier.transfer_function
    _, headers, body = ask(dashboard.port, "GET /model.json")
    assert headers["content-disposition"] == 'attachment; filename="model.json"'
    told = json.loads(body)
    assert told["num"] == model.num.tolist()
    assert told["den"] == model.den.tolist()
    verdict = feed.identifier.assess()
    assert (told["verdict"]["status"], told["verdict"]["excited"]) == (verdict.status, verdict.excited)
    assert rp.Model.from_json(body) == feed.identifier.model


def test_the_python_download_makes_the_same_model(dashboard: Dashboard, feed: Feed) -> None:
    _, headers, body = ask(dashboard.port, "GET /model.py")
    assert headers["content-disposition"] == 'attachment; filename="model.py"'
    made: dict[str, Any] = {}
    exec(compile(body, "model.py", "exec"), made)
    assert isinstance(made["G"], rp.TransferFunction)
    np.testing.assert_array_equal(made["G"].num, feed.identifier.transfer_function.num)
    np.testing.assert_array_equal(made["G"].den, feed.identifier.transfer_function.den)


def test_words_cannot_leave_the_comment_of_the_python_download() -> None:
    model = {"num": [1.0], "den": [1.0, 2.0], "delay": 0.0, "samples": 1}
    model["verdict"] = {"status": "x\nimport os\r\nos.abort()\x0c1"}
    assert [type(node) for node in ast.parse(app.python_of(model)).body] == [ast.ImportFrom, ast.Assign, ast.Expr]


def test_before_the_first_model_there_is_nothing_to_save(bare: Hub) -> None:
    with serve(bare) as served:
        for path in ("/model.json", "/model.py"):
            assert ask(served.port, f"GET {path}")[::2] == (404, b"There is no model yet.\n")


def test_the_report_comes_down_and_its_failure_is_told(dashboard: Dashboard, feed: Feed) -> None:
    origin = f"Origin: http://127.0.0.1:{dashboard.port}"
    status, headers, body = ask(dashboard.port, "POST /report", origin)
    assert (status, body) == (200, b"<!doctype html><title>report</title>")
    assert headers["content-disposition"] == 'attachment; filename="report.html"'

    def fail() -> None:
        raise ReplantError("no samples are kept")

    feed.before_report = fail
    assert ask(dashboard.port, "POST /report", origin)[::2] == (503, b"no samples are kept\n")
    feed.before_report = lambda: 1 / 0
    status, _, body = ask(dashboard.port, "POST /report", origin)
    assert status == 500
    assert b"ZeroDivisionError" not in body


# --- views ---


def test_a_browser_gets_the_newest_view_at_once_and_then_its_followers(dashboard: Dashboard, feed: Feed) -> None:
    with watch(dashboard.port) as watcher:
        assert view_of(watcher.recv(PATIENCE))["samples"] == feed.taken
        history = json.loads(watcher.recv(PATIENCE))["history"]
        np.testing.assert_allclose(history["parameters"], [row[1] for row in feed.history], rtol=1e-6)
        feed.advance(20)
        assert view_of(watcher.recv(PATIENCE))["samples"] == feed.taken


def test_views_come_at_most_five_times_a_second(dashboard: Dashboard, feed: Feed) -> None:
    with watch(dashboard.port) as watcher:
        until(watcher, feed.taken)
        begun = time.monotonic()
        for _ in range(5):
            feed.advance(1)
            until(watcher, feed.taken)
        assert time.monotonic() - begun >= 0.75  # a slow machine only makes it longer


def test_a_client_that_does_not_read_skips_to_the_newest_and_holds_up_nobody(bare: Hub) -> None:
    views, ballast = 200, 100_000
    bare.publish(numbered(0, ballast))
    with serve(bare) as served:
        wire = socket.socket()
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.connect(("127.0.0.1", served.port))
        with watch(served.port, sock=wire, max_queue=1) as slow, watch(served.port) as fast:
            view_of(slow.recv(PATIENCE))
            until(fast, 0)
            for number in range(1, views):
                bare.publish(numbered(number, ballast))
                until(fast, number)  # every single one
            behind = until(slow, views - 1)
            assert behind == sorted(set(behind))
            assert len(behind) < views / 2  # what the sockets' buffers held, and then the newest


def test_a_hundred_browsers_all_see_the_newest(bare: Hub) -> None:
    async def one(port: int, ready: asyncio.Barrier) -> int:
        origin = f"http://127.0.0.1:{port}"
        async with connect_async(
            f"ws://127.0.0.1:{port}/live", origin=origin, proxy=None, open_timeout=None, ping_timeout=None
        ) as watcher:
            await watcher.recv()
            await ready.wait()
            while True:
                samples = view_of(await watcher.recv()).get("samples", 0)
                if samples == 50:
                    return samples

    async def all_of_them(port: int) -> list[int]:
        ready = asyncio.Barrier(101)
        watchers = [asyncio.create_task(one(port, ready)) for _ in range(100)]
        await ready.wait()
        assert bare.browsers == 100
        for number in range(1, 51):
            bare.publish(numbered(number, 20_000))
            await asyncio.sleep(0)
        return await asyncio.gather(*watchers)

    bare.publish(numbered(0))
    with serve(bare) as served:
        assert asyncio.run(asyncio.wait_for(all_of_them(served.port), PATIENCE)) == [50] * 100


def test_too_many_browsers_are_asked_to_come_later(bare: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MOST_WATCHING", 2)
    bare.publish(numbered(0))
    with serve(bare) as served, watch(served.port) as first, watch(served.port) as second:
        until(first, 0)
        until(second, 0)
        assert ask(served.port, "GET /live", *_handshake(served.port))[0] == 403
        first.close()
        second.close()


# --- garbage ---

FRAME = b"\x81\xfe" + struct.pack(">H", 200)  # a masked text of 200 bytes ...
GARBAGE = {
    "text": b"\x81\x85\0\0\0\0hello",
    "binary": b"\x82\x84\0\0\0\0\x00\xff\x00\xff",
    "half a frame": FRAME + b"\0\0\0\0only this",
    "unmasked": b"\x81\x05hello",
    "unknown kind": b"\x8b\x80\0\0\0\0",
    "not UTF-8": b"\x81\x82\0\0\0\0\xff\xfe",
    "ten megabytes": b"\x81\xff" + struct.pack(">Q", 10_000_000) + bytes(4),
    "noise": bytes(range(256)) * 40,
}


@every("kind", GARBAGE)
def test_garbage_closes_its_own_connection_and_no_other(bare: Hub, kind: str) -> None:
    bare.publish(numbered(0))
    with serve(bare) as served, watch(served.port) as good:
        until(good, 0)
        with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) as bad:
            request = ["GET /live HTTP/1.1", f"Host: 127.0.0.1:{served.port}", *_handshake(served.port)]
            bad.sendall(("\r\n".join(request) + "\r\n\r\n").encode())
            answer = bad.recv(65536)
            assert answer.startswith(b"HTTP/1.1 101")
            bad.sendall(GARBAGE[kind])
            if kind == "half a frame":
                bad.shutdown(socket.SHUT_WR)
            said = b""
            with contextlib.suppress(ConnectionResetError):
                while b"\x88" not in said and (more := bad.recv(65536)):  # a close frame, or the end
                    said = more
        bare.publish(numbered(1))
        until(good, 1)
    assert bare.browsers == 0


@every("request_line", [b"\0\1\2\3\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"A" * 200_000])
def test_garbage_instead_of_a_request_is_answered_and_forgotten(dashboard: Dashboard, request_line: bytes) -> None:
    with socket.create_connection(("127.0.0.1", dashboard.port), timeout=PATIENCE) as wire:
        try:
            wire.sendall(request_line)
            answer = wire.recv(65536)
        except ConnectionError:
            answer = b""
        assert answer == b"" or answer.startswith(b"HTTP/1.1 4")
    assert ask(dashboard.port, "GET /")[0] == 200


def _handshake(port: int) -> tuple[str, ...]:
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    origin = f"Origin: http://127.0.0.1:{port}"
    return ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", key, origin)


# --- the server ---


def test_stopping_says_goodbye_to_all_and_frees_the_port(feed: Feed) -> None:
    served = serve(feed.hub)
    with watch(served.port) as watcher:
        until(watcher, feed.taken)
        watcher.recv(PATIENCE)  # its history
        served.stop()
        with pytest.raises(ConnectionClosed):
            watcher.recv(PATIENCE)
    with serve(feed.hub, port=served.port) as again, watch(again.port) as watcher:
        assert until(watcher, feed.taken) == [feed.taken]
        assert ask(again.port, "GET /")[0] == 200


def test_a_port_in_use_is_said_in_one_line(dashboard: Dashboard, feed: Feed) -> None:
    with pytest.raises(InvalidArgumentError, match=rf"cannot listen on 127\.0\.0\.1:{dashboard.port}: ") as told:
        serve(feed.hub, port=dashboard.port)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none_is_refused(feed: Feed, port: int) -> None:
    with pytest.raises(InvalidArgumentError, match="port must be from 0 to 65535"):
        serve(feed.hub, port=port)
