"""The hub: the newest view and never a queue; commands and reports on their way back."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable

import pytest

from replant.errors import ReplantError
from replant.live.dashboard import app
from replant.live.dashboard.app import DIGITS, Hub
from support.waiting import PATIENCE


def silent() -> Hub:
    return Hub(command=lambda name: None, report=bytes)


def numbered(number: int) -> dict[str, object]:
    return {"samples": number, "history": {"t": [float(number)]}}


class Browser:
    """A websocket that notes the views that it is sent, and calls ``then`` with their number."""

    def __init__(self, then: Callable[[int], None] = lambda views: None) -> None:
        self.seen: list[int] = []
        self._then = then

    async def send_text(self, text: str) -> None:
        if "view" in (message := json.loads(text)):
            self.seen.append(message["view"]["samples"])
            self._then(len(self.seen))


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Views are sent as fast as they are read."""
    monkeypatch.setattr(app, "PERIOD", 0.0)
    monkeypatch.setattr(app, "LOOK", 0.0)


def test_a_late_browser_gets_the_newest_view_and_a_slow_one_skips_some() -> None:
    hub = silent()

    def meanwhile(views: int) -> None:
        if views == 3:
            hub.ended = True
            return
        for number in range(10 * views, 10 * views + 7):  # seven while the first is still looked at
            hub.publish(numbered(number))

    browser = Browser(meanwhile)
    for number in range(5):
        hub.publish(numbered(number))
    asyncio.run(asyncio.wait_for(app._send(hub, browser), PATIENCE))
    assert browser.seen == [4, 16, 26]


def test_views_come_from_any_thread() -> None:
    hub, browser = silent(), Browser()

    def publish() -> None:
        for number in range(2000):
            hub.publish(numbered(number))
        hub.ended = True

    publisher = threading.Thread(target=publish)
    publisher.start()
    asyncio.run(asyncio.wait_for(app._send(hub, browser), PATIENCE))
    publisher.join()
    assert browser.seen == sorted(set(browser.seen))
    assert browser.seen[-1] == 1999


def test_what_is_drawn_is_cut_to_the_digits_that_are_seen_and_the_model_is_not() -> None:
    hub = silent()
    third = 1.0 / 3.0
    model = {"num": [third], "den": [1.0, third]}
    hub.publish({"num": [third], "model": model, "window": {"y": [third, None]}, "history": {"t": [third]}})
    frame = hub.frame()
    assert frame is not None
    view = json.loads(frame["view"])["view"]
    assert view["window"]["y"] == [round(third, DIGITS), None]
    assert json.loads(frame["history"])["history"]["t"] == [round(third, DIGITS)]
    assert view["num"] == [third]
    assert not {"history", "model"} & set(view)
    assert hub.newest is not None
    assert hub.newest["model"] == model
    assert hub.newest["window"]["y"] == [third, None]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_json_does_not_have_is_never_sent(value: float) -> None:
    """A browser could not parse it: unknown numbers are None."""
    hub = silent()
    hub.publish({"samples": 2, "window": {"y": [value]}})
    with pytest.raises(ValueError, match="JSON"):
        hub.frame()


def test_nothing_is_written_while_nobody_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[object] = []
    monkeypatch.setattr(app, "_text", lambda message: written.append(message) or json.dumps(message))
    hub = silent()
    for number in range(5):
        hub.publish(numbered(number))
    assert written == []
    assert hub.frame() is hub.frame()
    assert written == [{"view": {"samples": 4}}, {"history": {"t": [4.0]}}]  # once for both


def test_one_report_at_a_time() -> None:
    async def two() -> tuple[bytes, bytes]:
        begun, let_go = threading.Event(), threading.Event()

        def report() -> bytes:
            begun.set()
            assert let_go.wait(PATIENCE)
            return threading.current_thread().name.encode()

        hub = Hub(command=print, report=report)
        first = asyncio.create_task(hub.report())
        await asyncio.to_thread(begun.wait, PATIENCE)
        with pytest.raises(ReplantError, match="already being made"):
            await hub.report()
        let_go.set()
        return await first, await hub.report()

    first, second = asyncio.run(two())
    assert threading.current_thread().name.encode() not in (first, second)
