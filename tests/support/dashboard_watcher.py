"""A client that watches the views of a dashboard over its websocket."""

from __future__ import annotations

import json
from typing import Any

from websockets.sync.client import ClientConnection, connect

from support.waiting import PATIENCE


def watch(port: int, **options: Any) -> ClientConnection:
    origin = f"http://127.0.0.1:{port}"
    url = f"ws://127.0.0.1:{port}/live"
    return connect(url, origin=origin, proxy=None, open_timeout=PATIENCE, ping_timeout=None, **options)


def view_of(message: str | bytes) -> dict[str, Any]:
    """The view in a message, empty for a history."""
    return json.loads(message).get("view", {})


def until(watcher: ClientConnection, samples: int) -> list[int]:
    """Read until the view that counts so many samples; return all counts that were read."""
    seen: list[int] = []
    while not seen or seen[-1] != samples:
        view = view_of(watcher.recv(PATIENCE))
        seen += [view["samples"]] if view else []
    return seen


def numbered(number: int, ballast: int = 0) -> dict[str, Any]:
    return {"samples": number, "source": "x" * ballast}
