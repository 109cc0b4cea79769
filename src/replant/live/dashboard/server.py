"""The server of the dashboard, in a thread; an address that other machines can reach requires a token."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from replant.errors import InvalidArgumentError, ReplantError, needs, shown
from replant.numerics.operating_system import Worker, reason_of

if TYPE_CHECKING:
    import uvicorn

    from replant.live.dashboard.app import Hub
    from replant.live.dashboard.security import Listening

GRACE = 1.0  # timeout for browsers to disconnect [s]
LEFT_BEHIND = 10.0  # timeout for the end of the server's thread [s]
PAGES_NEED = "the dashboard needs starlette, uvicorn and websockets"
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Dashboard(AbstractContextManager["Dashboard"]):
    """A running server of the dashboard, until `stop` or the end of a ``with`` block."""

    def __init__(
        self, hub: Hub, server: uvicorn.Server, listening: socket.socket, host: str, token: str | None
    ) -> None:
        self.port: int = listening.getsockname()[1]
        name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, host)
        query = "" if token is None else f"?token={quote(token, safe='')}"
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{self.port}/{query}"
        self._hub, self._server, self._listening = hub, server, listening
        self._thread = Worker(self._run)
        self._thread.start()
        while not server.started and self._thread.is_alive():
            time.sleep(0.005)
        if not server.started:
            raise ReplantError("the dashboard's server did not start: the lines above say why")

    def _run(self) -> None:
        try:
            # this loop calls `accept` of the socket, also on Windows
            with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
                runner.run(self._server.serve(sockets=[self._listening]))
        except Exception as error:
            self._hub.notice(f"its server ended: {type(error).__name__}: {error}")
        finally:
            self._listening.close()

    @property
    def alive(self) -> bool:
        """Whether the server is running."""
        return self._thread.is_alive()

    def announce_end(self) -> None:
        """Tell all browsers that the session has ended, so that they do not connect again."""
        self._hub.ended = True
        given_up = time.monotonic() + GRACE
        while self._hub.browsers and self.alive and time.monotonic() < given_up:
            time.sleep(0.01)

    def stop(self) -> None:
        """Close all connections and end the thread; without `announce_end` browsers try to connect again."""
        # the session must not wait for the page: a server that does not end is abandoned
        self._server.should_exit = True
        self._thread.join(LEFT_BEHIND)
        if self.alive:
            self._hub.notice(f"its server has not ended within {LEFT_BEHIND:g} s, and is abandoned")

    def __exit__(self, *_: object) -> None:
        """Stop serving."""
        self.stop()


class InUseError(InvalidArgumentError):
    """Another program listens on the port."""


def serve(
    hub: Hub,
    host: str = "127.0.0.1",
    port: int = 0,
    token: str | None = None,
    application: Callable[..., Any] | None = None,
) -> Dashboard:
    """Serve the dashboard of ``hub``, or another ``application``, from a thread; return when the server is ready."""
    _check(host, port, token)
    with needs(PAGES_NEED, "live"):
        import uvicorn

        from replant.live.dashboard.app import create_app
        from replant.live.dashboard.security import Connections, Listening, most_connections
    app = (application or create_app)(hub, token=token, hosts=_names(host))
    most = most_connections()
    listening = _bound(host, port, Listening)
    config = uvicorn.Config(
        Connections(app, listening, most, hub.notice),
        http="h11",
        backlog=max(most // 4, 1),  # connections that may wait to be accepted
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="websockets-sansio",
        ws_max_size=1024,  # the page sends no messages
        ws_per_message_deflate=False,  # for a hundred browsers compression would take a core
        timeout_graceful_shutdown=int(GRACE),
        proxy_headers=False,
    )
    return Dashboard(hub, uvicorn.Server(config), listening, host, token)


def _check(host: str, port: int, token: str | None) -> None:
    if not 0 <= port <= 65535:
        raise InvalidArgumentError(f"port must be from 0 to 65535, got {shown(port)}")
    if token is not None and not (token and token.isascii() and token.isprintable() and " " not in token):
        raise InvalidArgumentError("token must be printable ASCII without spaces, and not empty")
    if token is None and not _is_loopback(host):
        raise InvalidArgumentError(f"other machines can reach {host}: give a token, or use 127.0.0.1")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _names(host: str) -> tuple[str, ...]:
    """Return the host names under which a server on ``host`` can be requested."""
    if _is_loopback(host):
        return _LOOPBACK
    name = socket.gethostname()  # getfqdn would wait for a name server if there is no network
    return (host, name, f"{name}.local", *_LOOPBACK)


def _bound(host: str, port: int, kind: type[Listening]) -> Listening:
    """Return a socket bound in the calling thread, so that an address in use raises its error there."""
    try:
        family, of, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = kind(family, of, protocol)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
        except OSError:
            listening.close()
            raise
    except OSError as error:
        kind_of = InUseError if error.errno == errno.EADDRINUSE else InvalidArgumentError
        raise kind_of(f"the dashboard cannot listen on {host}:{port}: {reason_of(error)}") from None
    return listening
