"""Access control: token, host, origin, and the headers that exclude foreign content."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from starlette.requests import HTTPConnection

from replant.errors import InvalidArgumentError
from replant.live.dashboard import security
from replant.live.dashboard.app import Hub
from replant.live.dashboard.security import HEADERS
from replant.live.dashboard.server import Dashboard, serve
from support.cases import every
from support.dashboard_feed import Feed
from support.http_request import ask
from support.waiting import wait_until

TOKEN = "correct-horse+/=&?"
HANDSHAKE = (
    "Upgrade: websocket",
    "Connection: Upgrade",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)
EVERYTHING = (
    "GET /",
    "GET /assets/dashboard.js",
    "GET /model.json",
    "POST /command/reset",
    "POST /report",
    "GET /none",
)


@pytest.fixture(scope="module")
def guarded(watched: tuple[Feed, Dashboard]) -> Iterator[Dashboard]:
    """The feed's dashboard, asking for a token."""
    with serve(watched[0].hub, token=TOKEN) as served:
        yield served


@pytest.fixture(autouse=True)
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have refusals come at once."""
    monkeypatch.setattr(security, "PAUSE", 0.0)


def origin(port: int, host: str = "127.0.0.1") -> str:
    return f"Origin: http://{host}:{port}"


# --- host ---


@every("host", ["127.0.0.1", "localhost", "LOCALHOST"])
def test_its_own_names_are_answered(dashboard: Dashboard, host: str) -> None:
    assert ask(dashboard.port, "GET /", host=host)[0] == 200


@every(
    "host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "user@127.0.0.1", "10.0.0.1", "[::2]"]
)
@every("line", EVERYTHING)
def test_any_other_name_is_refused(dashboard: Dashboard, feed: Feed, line: str, host: str) -> None:
    """An attacker can make any name resolve to this machine."""
    status, headers, body = ask(dashboard.port, line, f"Origin: http://{host}:{dashboard.port}", host=host)
    assert (status, feed.commands) == (421, [])
    assert b"is not known by that name" in body
    assert "content-security-policy" in headers


def test_two_hosts_or_none_are_refused(dashboard: Dashboard) -> None:
    assert ask(dashboard.port, "GET /", host=None)[0] == 400
    assert ask(dashboard.port, "GET /", "Host: evil.example")[0] in (400, 421)


@pytest.mark.parametrize(("host", "known"), [("192.0.2.7:8710", True), ("192.0.2.8:8710", False), ("8710", False)])
def test_the_address_that_a_request_came_to_is_a_name_of_the_server(host: str, known: bool) -> None:
    """A server that listens at every address of the machine cannot list all their names."""
    guard = security.Guard(lambda *_: None, None, ())  # type: ignore[arg-type,return-value]
    scope = {"type": "http", "method": "GET", "server": ("192.0.2.7", 8710), "headers": [(b"host", host.encode())]}
    assert (guard._refusal(HTTPConnection(scope)) is None) == known


# --- origin ---


def test_a_command_from_its_own_page_arrives(dashboard: Dashboard, feed: Feed) -> None:
    for name in ("freeze", "adapt", "reset"):
        assert ask(dashboard.port, f"POST /command/{name}", origin(dashboard.port))[0] == 204
    assert feed.commands == ["freeze", "adapt", "reset"]


@every(
    "headers",
    [
        (),
        ("Origin: null",),
        ("Origin: http://evil.example",),
        ("Origin: http://127.0.0.1",),
        ("Origin: http://[",),
        ("Origin: http://127.0.0.1:1",),
        ("Origin: file://127.0.0.1:PORT",),
        ("Referer: http://127.0.0.1:PORT/",),
    ],
)
@every("line", ["POST /command/reset", "POST /report"])
def test_a_post_from_elsewhere_does_nothing(
    dashboard: Dashboard, feed: Feed, line: str, headers: tuple[str, ...]
) -> None:
    sent = [header.replace("PORT", str(dashboard.port)) for header in headers]
    status, _, body = ask(dashboard.port, line, *sent)
    assert (status, feed.commands) == (403, [])
    assert body == b"Only the dashboard's own page may do that.\n"


def test_a_get_changes_nothing(dashboard: Dashboard, feed: Feed) -> None:
    assert ask(dashboard.port, "GET /command/reset", origin(dashboard.port))[0] == 405
    assert ask(dashboard.port, "GET /report", origin(dashboard.port))[0] == 405
    assert ask(dashboard.port, "POST /command/shutdown", origin(dashboard.port))[0] == 404
    assert feed.commands == []


@pytest.mark.parametrize("foreign", ["Origin: http://evil.example", "X-Nothing: 1"])
def test_a_websocket_from_elsewhere_is_refused(dashboard: Dashboard, foreign: str) -> None:
    """Websockets know no same-origin policy: without this any page could read along."""
    assert ask(dashboard.port, "GET /live", *HANDSHAKE, foreign)[0] == 403


# --- token ---


@every("line", EVERYTHING)
@every(
    "brought",
    [
        (),
        ("Authorization: Bearer wrong",),
        ("Authorization: Bearer",),
        (f"Authorization: Basic {TOKEN}",),
        (f"Authorization: Bearer {TOKEN}x",),
        (f"Authorization: Bearer {TOKEN[:-1]}",),
        (f"Cookie: replant-PORT={TOKEN}",),
        ("Cookie: replant-PORT=; ;;=,",),
        ("Cookie: \xff\xfe",),
    ],
)
def test_without_the_token_nothing_is_told(guarded: Dashboard, feed: Feed, line: str, brought: tuple[str, ...]) -> None:
    sent = [header.replace("PORT", str(guarded.port)) for header in brought]
    status, headers, body = ask(guarded.port, line, origin(guarded.port), *sent)
    assert (status, feed.commands) == (401, [])
    assert TOKEN.encode() not in body
    assert "set-cookie" not in headers


def test_a_program_brings_the_token_in_a_header(guarded: Dashboard, feed: Feed) -> None:
    bearer = f"Authorization: Bearer {TOKEN}"
    status, headers, _ = ask(guarded.port, "GET /model.json", bearer)
    assert (status, "set-cookie" in headers) == (200, False)
    assert ask(guarded.port, "POST /command/freeze", bearer, origin(guarded.port))[0] == 204
    assert ask(guarded.port, "POST /command/reset", bearer)[0] == 403  # the token does not replace the origin
    assert feed.commands == ["freeze"]


def test_a_browser_brings_it_once_and_then_a_cookie(guarded: Dashboard, feed: Feed) -> None:
    path = guarded.url.removeprefix(f"http://127.0.0.1:{guarded.port}")
    status, headers, _ = ask(guarded.port, f"GET {path}")
    cookie, *limits = headers["set-cookie"].split("; ")
    assert status == 200
    assert set(limits) == {"HttpOnly", "SameSite=Strict", "Path=/"}
    assert TOKEN not in cookie
    assert ask(guarded.port, "GET /assets/dashboard.js", f"Cookie: {cookie}")[0] == 200
    others = 'theme={"dark":true}; a@b=1'  # which another server on this host may have set
    assert ask(guarded.port, "GET /assets/dashboard.js", f"Cookie: {others}; {cookie}")[0] == 200
    assert ask(guarded.port, "POST /command/freeze", f"Cookie: {cookie}", origin(guarded.port))[0] == 204
    assert feed.commands == ["freeze"]


def test_a_token_in_the_address_does_not_act(guarded: Dashboard, feed: Feed) -> None:
    query = guarded.url.partition("?")[2]
    assert ask(guarded.port, f"POST /command/reset?{query}", origin(guarded.port))[0] == 401
    assert feed.commands == []


def test_a_websocket_needs_the_token_too(guarded: Dashboard) -> None:
    assert ask(guarded.port, "GET /live", *HANDSHAKE, origin(guarded.port))[0] == 403


def test_tokens_are_tried_one_after_the_other_and_who_has_the_right_one_does_not_wait(
    guarded: Dashboard, monkeypatch: pytest.MonkeyPatch
) -> None:
    let_go, pausing, most, pauses = threading.Event(), 0, 0, []

    async def pause(seconds: float) -> None:
        nonlocal pausing, most
        pausing += 1
        most = max(most, pausing)
        while not let_go.is_set():
            await asyncio.sleep(0.005)
        pauses.append(seconds)
        pausing -= 1

    monkeypatch.setattr(security, "PAUSE", 0.5)
    monkeypatch.setattr(security, "asyncio", SimpleNamespace(sleep=pause))
    with ThreadPoolExecutor() as pool:
        tries = [pool.submit(ask, guarded.port, "GET /", f"Authorization: Bearer {k}") for k in range(4)]
        try:
            wait_until(lambda: pausing, "a wrong token's answer waits")
            assert ask(guarded.port, "GET /", f"Authorization: Bearer {TOKEN}")[0] == 200
            assert not any(answer.done() for answer in tries)
        finally:
            let_go.set()
        assert [answer.result()[0] for answer in tries] == [401] * 4
    assert (most, pauses) == (1, [0.5] * 4)


# --- where it listens ---


@every(
    ("place", "message"),
    [
        *(
            ({"host": host}, r"other machines can reach .*: give a token, or use 127\.0\.0\.1")
            for host in ("0.0.0.0", "::", "192.0.2.1", "example.org")
        ),
        *(
            ({"token": token}, "token must be printable ASCII")
            for token in ("", " ", "two words", "naïve", "line\nbreak")
        ),
    ],
)
def test_the_network_without_a_token_and_tokens_that_no_header_can_carry_are_refused(
    place: dict[str, str], message: str
) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        serve(Hub(command=print, report=bytes), **place)


def test_with_a_token_it_listens_everywhere_and_still_knows_its_names(feed: Feed) -> None:
    with serve(feed.hub, "0.0.0.0", token=TOKEN) as served:
        bearer = f"Authorization: Bearer {TOKEN}"
        assert ask(served.port, "GET /", bearer)[0] == 200
        assert ask(served.port, "GET /", bearer, host="evil.example")[0] == 421
        assert ask(served.port, "GET /")[0] == 401


# --- headers ---


@every("line", [*EVERYTHING, "GET /model.py", "GET /assets/../server.py", "PUT /", "OPTIONS /report"])
def test_every_answer_forbids_foreign_content(dashboard: Dashboard, line: str) -> None:
    _, headers, _ = ask(dashboard.port, line, origin(dashboard.port))
    policy = dict(entry.strip().split(" ", 1) for entry in headers["content-security-policy"].split(";"))
    assert policy.pop("default-src") == "'none'"
    assert policy.pop("frame-ancestors") == "'none'"
    assert set(policy.values()) <= {"'self'", "'none'"}
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"
    assert headers["x-frame-options"] == "DENY"
    assert not [name for name in headers if name.startswith("access-control")]
    assert "server" not in headers


def test_the_answer_to_an_internal_error_has_the_headers_too() -> None:
    """The answer does not contain the error; the terminal shows it."""

    class Secret:
        """What JSON cannot hold."""

    hub = Hub(command=print, report=bytes)
    hub.publish({"model": {"num": Secret()}})
    with serve(hub) as served:
        status, headers, body = ask(served.port, "GET /model.json")
    assert status == 500
    assert b"Secret" not in body
    assert HEADERS.items() <= {name.title(): value for name, value in headers.items()}.items()
