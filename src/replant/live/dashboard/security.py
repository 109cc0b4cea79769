"""Access control of the page and its commands, and limits on connections.

A foreign web page can make a browser send requests to this server.  Therefore the Host header must name this server,
which prevents DNS rebinding; commands and websockets must have the page's own origin; and a server that other machines
can reach requires a token.

Each connection uses a file descriptor, and a process without free descriptors cannot work.  At most half of the
descriptors are used for connections.  A further connection replaces the oldest one without an open websocket: a
genuine browser sends its request at once and then closes the connection, or opens the websocket.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import socket
from asyncio import get_running_loop
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LONGEST_TOKEN = 1024  # characters of a token that are compared [characters]
PAUSE = 0.5  # delay of the answer to a missing or wrong token; answers come one by one, against guessing [s]
MOST_WAITING = 32  # most requests that wait for that answer; further tokens are not checked [count]


class Guard:
    """Passes on requests with the right host, origin and token, and adds security headers to the answers."""

    def __init__(self, app: ASGIApp, token: str | None, hosts: tuple[str, ...]) -> None:
        self.app = app
        self.token = None if token is None else token.encode()
        self.hosts = {host.lower().strip("[]") for host in hosts}
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request or refuse it."""
        request = HTTPConnection(scope)
        refused = self._refusal(request)

        async def answer(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                sent = MutableHeaders(scope=message)
                sent.update(HEADERS)
                if refused is None and self.token is not None and "token" in request.query_params:
                    cookie = f"{_cookie_name(request)}={self._proof()}; HttpOnly; SameSite=Strict; Path=/"
                    sent.append("Set-Cookie", cookie)
            await send(message)

        if refused is not None and refused[0] == 401:
            self._waiting += 1
            try:
                async with self._turn:
                    await asyncio.sleep(PAUSE)
            finally:
                self._waiting -= 1
        if refused is None:
            await self.app(scope, receive, answer)
        elif scope["type"] == "http":
            await PlainTextResponse(refused[1] + "\n", refused[0])(scope, receive, answer)
        else:  # the websocket is not accepted yet: the browser gets status 403
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refused[1]})

    def _refusal(self, request: HTTPConnection) -> tuple[int, str] | None:
        """Return status and reason of a refusal; None for a request that is allowed."""
        if not self._names_this_server(request):
            return 421, "This server is not known by that name: open the address that it printed."
        if not _is_read_only(request) and not _is_same_origin(request.headers):
            return 403, "Only the dashboard's own page may do that."
        if self.token is None or _is(request.cookies.get(_cookie_name(request), ""), self._proof().encode()):
            return None
        if self._waiting >= MOST_WAITING:
            return 503, "Too many wrong tokens are being tried: try again in a minute."
        if not self._has_token(request):
            return 401, "A token is required: open the whole address that was printed, with ?token= at its end."
        return None

    def _names_this_server(self, request: HTTPConnection) -> bool:
        try:
            (named,) = request.headers.getlist("host")
            parts = urlsplit(f"//{named}")
            parts.port  # noqa: B018 - raises for an invalid port
        except ValueError:  # no Host header, several, or an invalid one
            return False
        server = request.scope.get("server")
        known = self.hosts if server is None else {*self.hosts, server[0]}
        return "@" not in parts.netloc and not parts.path and parts.hostname in known

    def _has_token(self, request: HTTPConnection) -> bool:
        assert self.token is not None
        kind, _, bearer = request.headers.get("authorization", "").partition(" ")
        brought = [bearer.strip()] if kind.lower() == "bearer" else []
        if _is_read_only(request):
            brought += request.query_params.getlist("token")[:1]
        return any(_is(one[:LONGEST_TOKEN], self.token) for one in brought)

    def _proof(self) -> str:
        """Return the cookie's value, which proves knowledge of the token without revealing it."""
        assert self.token is not None
        return hmac.new(self.token, b"replant dashboard", hashlib.sha256).hexdigest()


def _is(given: str, secret: bytes) -> bool:
    return hmac.compare_digest(given.encode(), secret)


def _is_read_only(request: HTTPConnection) -> bool:
    """Return whether a request changes nothing, and a foreign page cannot read its answer."""
    return request.scope["type"] == "http" and request.scope["method"] in ("GET", "HEAD")


def _cookie_name(request: HTTPConnection) -> str:
    """Return the cookie's name, which contains the port: browsers share cookies between all ports of a host."""
    server = request.scope.get("server")
    return f"replant-{server[1] if server else 0}"


def _is_same_origin(headers: Headers) -> bool:
    """Return whether the requesting page was served under the same host and port."""
    try:
        origin = urlsplit(headers.get("origin", ""))
    except ValueError:
        return False
    return origin.scheme in ("http", "https") and origin.netloc.lower() == headers.get("host", "").lower()


MOST = 512  # most simultaneous connections [count]
LEAST = 8  # simultaneous connections that are always allowed: a browser loads a page over several [count]
SHARE = 2  # connections may use at most 1/N of the file descriptors [count]
ASKING = 10.0  # timeout of the headers of a request, the first or the next [s]
ANSWERING = 120.0  # timeout of a request and its answer: a report takes seconds, and browsers may be slow [s]
LEAVING = 5.0  # timeout of a connection after its websocket has ended [s]


def most_connections() -> int:
    """Return the largest number of simultaneous connections."""
    try:
        import resource
    except ImportError:  # Windows, where an event loop handles at most 512 sockets
        return MOST // SHARE
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST if limit < 0 else min(max(limit // SHARE, LEAST), MOST)


class _Connection:
    """A connection with a timeout."""

    def __init__(self, wire: socket.socket) -> None:
        self.wire = wire
        self._deadline: asyncio.TimerHandle | None = None
        self.streams = False
        self.cut_off_in(ASKING)

    def cut_off_in(self, seconds: float | None) -> None:
        """Set the timeout of the connection; None: no timeout."""
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = None if seconds is None else get_running_loop().call_later(seconds, self.cut_off)

    def cut_off(self) -> None:
        """Shut down both directions: the server then reads an end and closes, even if it has more to write."""
        with contextlib.suppress(OSError):
            self.wire.shutdown(socket.SHUT_RDWR)


class Listening(socket.socket):
    """A listening socket that reports each accepted connection to `Connections`, which limits their number."""

    connections: Connections | None = None

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection, in the server's thread."""
        wire, client = super().accept()
        if self.connections is not None:
            self.connections.opened(wire, client)
        return wire, client


class Connections:
    """ASGI middleware that limits the number and the duration of connections."""

    def __init__(self, app: ASGIApp, listening: Listening, most: int, notice: Callable[[str], None]) -> None:
        self.app, self.most, self._notice = app, most, notice
        self._open: dict[tuple[str, int], _Connection] = {}  # by the client's address, the oldest first
        listening.connections = self

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, with a limit on its duration."""
        connection = self._open.get(tuple(scope.get("client") or ("", 0)))
        if connection is None:  # it was cut off: the answer cannot be sent
            await self.app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "websocket.accept":
                connection.streams = True
                connection.cut_off_in(None)
            await send(message)

        connection.cut_off_in(ANSWERING)
        try:
            await self.app(scope, receive, answer)
        finally:
            connection.streams = False
            connection.cut_off_in(LEAVING if scope["type"] == "websocket" else ASKING)

    def opened(self, wire: socket.socket, client: Any) -> None:
        """Register an accepted connection; if there are too many, cut off the oldest without a websocket."""
        get_running_loop().set_exception_handler(self._failed)
        # the server closes the sockets; forget the closed ones
        self._open = {at: found for at, found in self._open.items() if found.wire.fileno() >= 0}
        if len(self._open) >= self.most:
            self._notice(f"more than {self.most} connections: the oldest without a websocket are closed")
            oldest = next((at for at, found in self._open.items() if not found.streams), None)
            if oldest is None:
                wire.shutdown(socket.SHUT_RDWR)
                return
            self._open.pop(oldest).cut_off()
        self._open[str(client[0]), int(client[1])] = _Connection(wire)

    def _failed(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Report an error outside of requests, such as a lack of file descriptors for a connection."""
        error = context.get("exception")
        self._notice(" ".join(f"{context.get('message')} ({error})".split()))
