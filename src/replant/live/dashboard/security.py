"""Security: who may see the page and who may act on the identification; in front of everything that is served.

A page on the network can make a browser send requests here: so the Host header must name this server (no rebound
names), what acts or streams must come from this page's own origin, and whoever listens elsewhere needs a token.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
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
LONGEST_TOKEN = 1024
"""Characters of a token that are compared at all [characters]."""
PAUSE = 0.5
"""Time before a missing or wrong token is answered, one after the other: nobody tries many [s]."""
MOST_WAITING = 32
"""Requests that may wait for that answer at a time; while so many do, a token is not even looked at [count]."""
_SAFE = ("GET", "HEAD")


class Guard:
    """Lets through what comes from the right place with the right token, and adds the headers to what goes out.

    Parameters
    ----------
    app : ASGI application
    token : str or None
        What a browser must bring: once as ``?token=...`` and from then on in a cookie; a program brings it as
        ``Authorization: Bearer ...``.  None asks for nothing.
    hosts : tuple of str
        Names by which this server may be called; the very address that a connection came in on always may, for
        nobody can make a browser take a number for another.
    """

    def __init__(self, app: ASGIApp, token: str | None, hosts: tuple[str, ...]) -> None:
        self.app = app
        self.token = None if token is None else token.encode()
        self.hosts = {host.lower().strip("[]") for host in hosts}
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request or refuse it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refused = self._refusal(scope, headers)

        async def answer(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                sent = MutableHeaders(scope=message)
                sent.update(HEADERS)
                if refused is None and self.token is not None and "token" in _query(scope):
                    sent.append("Set-Cookie", self._cookie(scope))
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
        else:  # before it is accepted: the browser gets 403
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refused[1]})

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Return status and reason, None for a request that may pass."""
        if not self._is_for_us(scope, headers):
            return 421, "This server does not go by that name: open it under the address that it printed."
        acts = scope["type"] == "websocket" or scope["method"] not in _SAFE
        if acts and not _is_same_origin(headers):
            return 403, "Only the dashboard's own page may do that."
        if self.token is None or self._brings_cookie(scope, headers):
            return None
        if self._waiting >= MOST_WAITING:
            return 503, "Too many wrong tokens are being tried: try again in a minute."
        if not self._brings_token(scope, headers):
            return 401, "A token is needed: open the whole address that was printed, with ?token= at its end."
        return None

    def _is_for_us(self, scope: Scope, headers: Headers) -> bool:
        named = headers.getlist("host")
        name = _host(f"//{named[0]}") if len(named) == 1 else None
        if name is None:
            return False
        server = scope.get("server")
        return name in self.hosts or (server is not None and name == server[0])

    def _brings_token(self, scope: Scope, headers: Headers) -> bool:
        assert self.token is not None
        kind, _, bearer = headers.get("authorization", "").partition(" ")
        brought = [bearer.strip()] if kind.lower() == "bearer" else []
        if scope["type"] == "http" and scope["method"] in _SAFE:
            brought += _query(scope).get("token", [])[:1]
        return any(hmac.compare_digest(one[:LONGEST_TOKEN].encode(), self.token) for one in brought)

    def _brings_cookie(self, scope: Scope, headers: Headers) -> bool:
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self._cookie_name(scope))
        except CookieError:
            return False
        return morsel is not None and hmac.compare_digest(morsel.value.encode(), self._proof().encode())

    def _cookie(self, scope: Scope) -> str:
        return f"{self._cookie_name(scope)}={self._proof()}; HttpOnly; SameSite=Strict; Path=/"

    def _cookie_name(self, scope: Scope) -> str:
        """Return a name with the port in it: a browser keeps one cookie for all ports of a host."""
        server = scope.get("server")
        return f"replant-{server[1] if server else 0}"

    def _proof(self) -> str:
        """Return what the cookie holds: it shows that the token was known, and does not hold it."""
        assert self.token is not None
        return hmac.new(self.token, b"replant dashboard", hashlib.sha256).hexdigest()


def _query(scope: Scope) -> dict[str, list[str]]:
    return parse_qs(scope["query_string"].decode("latin-1"))


def _is_same_origin(headers: Headers) -> bool:
    """Whether the page that asks was served under the very host and port that it asks."""
    try:
        origin = urlsplit(headers.get("origin", ""))
    except ValueError:
        return False
    return origin.scheme in ("http", "https") and origin.netloc.lower() == headers.get("host", "").lower()


def _host(address: str) -> str | None:
    """Return the name in an address without port and brackets, None if it has none."""
    try:
        parts = urlsplit(address)
        parts.port  # noqa: B018 - raises for a port that is none
    except ValueError:
        return None
    return None if "@" in parts.netloc or parts.path else parts.hostname
