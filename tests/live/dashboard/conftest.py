"""A dashboard being served, fed from a simulated plant, and requests to it as bytes on the wire."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from browsing import chromium
from live.dashboard.feed import Feed
from live.dashboard.pages import Page
from replant.live.dashboard import Dashboard, serve


@pytest.fixture(scope="session")
def watched() -> Iterator[tuple[Feed, Dashboard]]:
    """A feed, and its dashboard on a free port."""
    feed = Feed()
    with serve(feed.hub) as served:
        yield feed, served


@pytest.fixture
def feed(watched: tuple[Feed, Dashboard]) -> Feed:
    """The feed: it has found its plant, has just published, and has heard no command yet."""
    feed = watched[0]
    if not feed.adapting:
        feed.obey("adapt")
    feed.forget()
    while feed.taken < 4000:
        feed.advance(100)
    feed.advance()
    return feed


@pytest.fixture
def dashboard(watched: tuple[Feed, Dashboard], feed: Feed) -> Dashboard:
    """The dashboard of the feed."""
    return watched[1]


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """The system's Chromium; not for longer than a module: its loop would stand in the way of others."""
    with chromium() as launched:
        yield launched


@pytest.fixture
def opened(browser, dashboard: Dashboard, feed: Feed) -> Iterator[Page]:
    """The page, which must not have complained by the end."""
    page = Page(browser, dashboard.url)
    yield page
    page.close()
    assert page.complaints == []


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
