"""A dashboard being served, fed from a simulated plant, and requests to it as bytes on the wire."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from live.dashboard.feed import Feed
from replant.live.dashboard import Dashboard, serve


@pytest.fixture(scope="session")
def watched() -> Iterator[tuple[Feed, Dashboard]]:
    """A feed with a model, and its dashboard on a free port."""
    feed = Feed()
    feed.advance(1000)
    with serve(feed.hub) as served:
        yield feed, served


@pytest.fixture
def feed(watched: tuple[Feed, Dashboard]) -> Feed:
    """The feed, no command heard yet, with a model even after a reset."""
    feed = watched[0]
    feed.forget()
    if feed.identifier.status == "starting":
        feed.advance(1000)
    return feed


@pytest.fixture
def dashboard(watched: tuple[Feed, Dashboard]) -> Dashboard:
    """The feed's dashboard."""
    return watched[1]


def ask(port: int, line: str, *headers: str, host: str | None = "127.0.0.1") -> tuple[int, dict[str, str], bytes]:
    """Send a request with just these headers, and return status, headers in lower case, and body."""
    lines = [f"{line} HTTP/1.1", *([f"Host: {host}:{port}"] if host else []), *headers]
    lines += [] if "Connection: Upgrade" in headers else ["Connection: close"]
    with socket.create_connection(("127.0.0.1", port), timeout=20) as wire:
        wire.sendall(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
        answer = b"".join(iter(lambda: wire.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *rest = head.decode("latin-1").split("\r\n")
    pairs = (line.partition(": ") for line in rest)
    return int(first.split()[1]), {name.lower(): value for name, _, value in pairs}, body
