"""Connections: limits on their number and duration, so that idle clients do not keep browsers out.

Each connection uses a file descriptor, and a process without free descriptors cannot work.  At most half of the
descriptors are used for connections.  A further connection replaces the oldest one without an open websocket: a
genuine browser sends its request at once and then closes the connection, or opens the websocket.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST = 512  # connections at a time, at the most [count]
LEAST = 8  # connections at a time that are always allowed: a page is loaded over several [count]
SHARE = 2  # of the descriptors one in so many may be a connection [count]
ASKING = 10.0  # time for the headers of a request, the first or the next [s]
ANSWERING = 120.0  # time for a request and its answer: a report takes seconds, and a slow browser its time [s]
LEAVING = 5.0  # time from the goodbye until the connection is gone [s]


def most_connections() -> int:
    """Return how many connections there may be at a time.

    Examples
    --------
    >>> LEAST <= most_connections() <= MOST
    True
    """
    try:
        import resource
    except ImportError:  # Windows, where sockets are no file descriptors
        return MOST
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST if limit < 0 else min(max(limit // SHARE, LEAST), MOST)


@dataclass(eq=False)
class _Connection:
    """A connection, with the time at which it is aborted if nothing happens."""

    transport: asyncio.Transport
    deadline: asyncio.TimerHandle | None = None
    streams: bool = False

    def abort_in(self, seconds: float | None) -> None:
        """Set the time after which the connection is aborted; None: never."""
        if self.deadline is not None:
            self.deadline.cancel()
        loop = asyncio.get_running_loop()
        self.deadline = None if seconds is None else loop.call_later(seconds, self.transport.abort)


class Connections:
    """An ASGI application in front of another one, which limits number and duration of connections."""

    def __init__(self, app: ASGIApp, most: int, notice: Callable[[str], None]) -> None:
        self.app, self.most, self._notice = app, most, notice
        self._open: dict[tuple[str, int], _Connection] = {}  # by the client's address, the oldest first

    def protocol(self) -> type[H11Protocol]:
        """Return the protocol class with which the server handles each connection."""
        connections = self

        class Protocol(H11Protocol):
            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                super().connection_made(transport)
                connections._opened(transport)

            def connection_lost(self, exc: Exception | None) -> None:
                connections._closed(self.client)
                super().connection_lost(exc)

        return Protocol

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, with a limit on its duration."""
        client: tuple[str, int] = tuple(scope.get("client") or ("", 0))
        connection = self._open.get(client)
        if connection is None:  # aborted meanwhile: the answer is not sent
            await self.app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "websocket.accept":
                connection.streams = True
                connection.abort_in(None)
            await send(message)

        connection.abort_in(ANSWERING)
        try:
            await self.app(scope, receive, answer)
        finally:
            connection.streams = False
            if scope["type"] == "websocket":  # its end is reported to the websocket's protocol class, not to this one
                connection.abort_in(LEAVING)
                self._closed(client)
            elif client in self._open:
                connection.abort_in(ASKING)

    def _opened(self, transport: asyncio.Transport) -> None:
        asyncio.get_running_loop().set_exception_handler(self._failed)
        peer = transport.get_extra_info("peername")
        if peer is None:  # closed already
            transport.abort()
            return
        if len(self._open) >= self.most:
            self._notice(f"more than {self.most} connections: the oldest without a websocket are closed")
            oldest = next((at for at, found in self._open.items() if not found.streams), None)
            if oldest is None:
                transport.abort()
                return
            self._open.pop(oldest).transport.abort()
        connection = _Connection(transport)
        connection.abort_in(ASKING)
        self._open[str(peer[0]), int(peer[1])] = connection

    def _closed(self, client: tuple[str, int] | None) -> None:
        if client is not None:
            self._open.pop(client, None)

    def _failed(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Report an error outside of all requests, such as a lack of file descriptors for a connection."""
        error = context.get("exception")
        self._notice(" ".join(f"{context.get('message')} ({error})".split()))
