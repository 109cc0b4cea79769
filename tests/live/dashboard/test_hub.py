"""The hub: the newest view and never a queue; commands and reports on their way back."""

from __future__ import annotations

import asyncio
import json
import threading

import pytest

from replant.errors import ReplantError
from replant.live.dashboard import app as hub_module
from replant.live.dashboard.app import DIGITS, Hub
from support.waiting import PATIENCE


def silent() -> Hub:
    return Hub(command=lambda name: None, report=bytes)


def numbered(number: int) -> dict[str, object]:
    return {"samples": number, "history": {"t": [float(number)]}}


def test_who_comes_late_gets_the_newest_and_who_is_slow_skips() -> None:
    async def watch() -> list[int]:
        hub, seen = silent(), []
        for number in range(5):
            hub.publish(numbered(number))
        async for frame in hub.subscribe():
            seen.append(json.loads(frame.view)["view"]["samples"])
            if len(seen) == 3:
                return seen
            for number in range(10 * len(seen), 10 * len(seen) + 7):  # seven while the first is still looked at
                hub.publish(numbered(number))
        return seen

    assert asyncio.run(watch()) == [4, 16, 26]


def test_views_come_from_any_thread() -> None:
    async def watch() -> list[int]:
        hub, seen = silent(), []
        publisher = threading.Thread(target=lambda: [hub.publish(numbered(number)) for number in range(2000)])
        publisher.start()
        async for frame in hub.subscribe():
            seen.append(json.loads(frame.view)["view"]["samples"])
            if seen[-1] == 1999:
                break
        publisher.join()
        return seen

    seen = asyncio.run(asyncio.wait_for(watch(), PATIENCE))
    assert seen == sorted(set(seen))


def test_a_subscriber_that_leaves_is_forgotten() -> None:
    async def come_and_go() -> tuple[int, int]:
        hub = silent()
        tasks = [asyncio.create_task(anext(hub.subscribe())) for _ in range(3)]
        await asyncio.sleep(0)
        there = len(hub._waiting)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return there, len(hub._waiting)

    assert asyncio.run(come_and_go()) == (3, 0)


def test_what_is_drawn_is_cut_to_the_digits_that_are_seen_and_the_model_is_not() -> None:
    hub = silent()
    third = 1.0 / 3.0
    model = {"num": [third], "den": [1.0, third]}
    hub.publish({"num": [third], "model": model, "window": {"y": [third, None]}, "history": {"t": [third]}})
    frame = asyncio.run(anext(hub.subscribe()))
    view = json.loads(frame.view)["view"]
    assert view["window"]["y"] == [round(third, DIGITS), None]
    assert json.loads(frame.history)["history"]["t"] == [round(third, DIGITS)]
    assert view["num"] == [third]
    assert not {"history", "model"} & set(view)
    assert hub.model() == model
    assert hub.newest is not None
    assert hub.newest["window"]["y"] == [third, None]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_json_does_not_have_is_never_sent(value: float) -> None:
    """A browser could not read it: what is not known is None."""
    hub = silent()
    hub.publish({"samples": 2, "window": {"y": [value]}})
    with pytest.raises(ValueError, match="JSON"):
        asyncio.run(anext(hub.subscribe()))


def test_nothing_is_written_while_nobody_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    async def two_watch() -> None:
        await asyncio.gather(anext(hub.subscribe()), anext(hub.subscribe()))

    written: list[object] = []
    monkeypatch.setattr(hub_module, "_text", lambda message: written.append(message) or json.dumps(message))
    hub = silent()
    for number in range(5):
        hub.publish(numbered(number))
    assert written == []
    asyncio.run(two_watch())
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
        with pytest.raises(ReplantError, match="being made already"):
            await hub.report()
        let_go.set()
        return await first, await hub.report()

    first, second = asyncio.run(two())
    assert threading.current_thread().name.encode() not in (first, second)
