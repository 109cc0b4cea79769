"""Connections: how many there may be and for how long, so that those who only connect keep nobody out.

Each connection takes a file descriptor, and a process that has none left can do nothing any more.  There are never
more connections than half of the descriptors: the next one takes the place of the oldest that is not watching, for a
browser that means it asks at once, gets its answer and is gone, or watches.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST = 512
"""Connections at a time, at the most [count]."""
LEAST = 8
"""Connections at a time that are always allowed: a page is loaded over several [count]."""
SHARE = 2
"""Of the descriptors one in so many may be a connection [count]."""
ASKING = 10.0
"""Time for the headers of a request, the first or the next [s]."""
ANSWERING = 120.0
"""Time for a request and its answer: a report takes seconds, and a slow browser its time [s]."""
LEAVING = 5.0
"""Time from the goodbye until the connection is gone [s]."""


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
    """A connection, and when it is cut off if nothing happens."""

    transport: asyncio.Transport
    deadline: asyncio.TimerHandle | None = None
    watching: bool = False

    def cut_off_in(self, seconds: float | None) -> None:
        """Set the time after which it is cut off; None: never."""
        if self.deadline is not None:
            self.deadline.cancel()
        loop = asyncio.get_running_loop()
        self.deadline = None if seconds is None else loop.call_later(seconds, self.transport.abort)


class Connections:
    """An application in front of the real one, which knows each connection and what it is doing.

    Parameters
    ----------
    app : ASGI application
    most : int
        Connections at a time.
    notice : callable
        Gets a line of text when something had to be cut off.
    """

    def __init__(self, app: ASGIApp, most: int, notice: Callable[[str], None]) -> None:
        self.app, self.most, self._notice = app, most, notice
        self._open: dict[tuple[str, int], _Connection] = {}  # by the address of the other side, the oldest first

    def protocol(self) -> type[H11Protocol]:
        """Return what the server is to make of each connection."""
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
        """Serve a request while its connection's clock runs."""
        client: tuple[str, int] = tuple(scope.get("client") or ("", 0))
        connection = self._open.get(client)
        if connection is None:  # cut off meanwhile: whatever is said goes nowhere
            await self.app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "websocket.accept":
                connection.watching = True
                connection.cut_off_in(None)
            await send(message)

        connection.cut_off_in(ANSWERING)
        try:
            await self.app(scope, receive, answer)
        finally:
            connection.watching = False
            if scope["type"] == "websocket":  # its end is told to the websocket's own protocol, not to ours
                connection.cut_off_in(LEAVING)
                self._closed(client)
            elif client in self._open:
                connection.cut_off_in(ASKING)

    def _opened(self, transport: asyncio.Transport) -> None:
        asyncio.get_running_loop().set_exception_handler(self._failed)
        peer = transport.get_extra_info("peername")
        if peer is None:  # gone already
            transport.abort()
            return
        if len(self._open) >= self.most:
            self._notice(f"more than {self.most} connections: the oldest that do not watch are cut off")
            oldest = next((at for at, found in self._open.items() if not found.watching), None)
            if oldest is None:
                transport.abort()
                return
            self._open.pop(oldest).transport.abort()
        connection = _Connection(transport)
        connection.cut_off_in(ASKING)
        self._open[str(peer[0]), int(peer[1])] = connection

    def _closed(self, client: tuple[str, int] | None) -> None:
        if client is not None:
            self._open.pop(client, None)

    def _failed(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Say what went wrong beside all requests, as when there are no file descriptors for another connection."""
        error = context.get("exception")
        self._notice(" ".join(f"{context.get('message')} ({error})".split()))
