"""The observer's process: views come back, it dies and comes again, and the session never waits for it."""

from __future__ import annotations

import json
import os
import signal
import time
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest

import replant as rp
from live.command import wait_for
from live.fakes import DT, REQUEST, FakeSink, FakeSource, record
from replant.live import observer as observing
from replant.live.background import Background
from replant.live.notices import Notices
from replant.live.observer import Observer
from replant.live.observing import Address, Orders
from replant.live.session import Session
from replant.live.view import Pulse, View
from replant.settings import Request
from replant.sources import Batch

U, Y = record()


@pytest.fixture
def observer() -> Iterator[Observer]:
    started = Observer(Orders(dashboard=Address("127.0.0.1", 0)))
    yield started
    started.close()


def identifier(samples: int) -> rp.Identifier:
    made = rp.Identifier(**vars(REQUEST))
    made.update_many(U[:samples], Y[:samples])
    return made


def seen(observer: Observer, ident: rp.Identifier, *, learned: bool = True) -> View:
    """Hand over, and wait for the view that comes of it."""
    before = observer.last
    pulse = Pulse(at=ident.samples * DT, source="fake://", source_state="connected")

    def newer() -> View | None:
        observer.poll()
        observer.hand(ident, pulse, learned=learned)
        return observer.last if observer.last is not before else None

    found = wait_for(newer)
    assert isinstance(found, View)
    return found


def test_views_come_back_and_go_to_the_page(observer: Observer) -> None:
    ident = identifier(3000)
    view = seen(observer, ident)
    assert observer.view is observer.last
    np.testing.assert_array_equal(view.parameters, ident.parameters)
    assert view.verdict == ident.assess().status
    request = urllib.request.Request(observer.url + "model.json")
    with urllib.request.urlopen(request, timeout=30.0) as answer:
        model = json.load(answer)
    assert model["den"] == [1.0, ident.parameters[0]]
    assert seen(observer, ident, learned=False).samples == 3000  # the pulse alone


def test_commands_come_back_from_the_page(observer: Observer) -> None:
    request = urllib.request.Request(observer.url + "command/freeze", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=30.0) as answer:
        assert answer.status < 300
    assert wait_for(observer.poll) == ["freeze"]


def test_the_report_is_made_of_the_newest_estimate(observer: Observer) -> None:
    ident = identifier(3000)
    seen(observer, ident)
    request = urllib.request.Request(observer.url + "report", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=120.0) as answer:
        page = answer.read().decode()
    assert page.lower().startswith("<!doctype html>")
    assert f"{ident.parameters[0]:.4g}"[:5] in page


def test_it_is_started_again_once_with_its_history_and_then_given_up(
    observer: Observer, capfd: pytest.CaptureFixture
) -> None:
    for samples in (1000, 2000):
        before = seen(observer, identifier(samples))
    first = observer._process.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: observer.poll() == [] and observer._process.pid != first)
    after = seen(observer, identifier(3000))
    np.testing.assert_array_equal(after.history.t[: before.history.t.size], before.history.t)
    assert after.samples == 3000

    second = observer._process.pid
    assert second is not None
    os.kill(second, signal.SIGKILL)
    wait_for(lambda: observer.poll() == [] and not observer._alive)
    assert not observer.hand(identifier(100), Pulse(), learned=True)
    observer.look_again(identifier(100), Pulse())  # does not wait for what cannot come
    said = capfd.readouterr().err.splitlines()
    assert ["started again" in said[0], "no verdict" in said[1]] == [True, True]


@pytest.mark.parametrize("level", ["stuck", "cable off"])
def test_a_sensor_that_fails_is_told_to_controllers_within_two_seconds_of_rig_time(
    observer: Observer, level: str
) -> None:
    """At 1 kHz, a view every 0.2 s of rig time, as it makes them in real time."""
    dt, good, step = 1e-3, 20_000, 200
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 76), 300)[:22_600]
    plant = rp.TransferFunction([2.0], [1.0, 2.0])
    y = 5.0 + plant.simulate(u, dt) + 0.01 * np.random.default_rng(1).standard_normal(u.size)
    y[good:] = y[good - 1] if level == "stuck" else 0.0
    sink = FakeSink()
    request = Request(rp.Structure(1), dt, preprocess=rp.Preprocess("identity", "mean", "mean"))

    class InStep(FakeSource):
        def batches(self) -> Iterator[Batch]:
            yield Batch(u[:good], y[:good], None, np.arange(good), time.monotonic())
            for at in range(good, u.size, step):
                yield from self.until_seen(at)
                part = slice(at, at + step)
                yield Batch(u[part], y[part], None, np.arange(at, at + step), time.monotonic())
            yield from self.until_seen(u.size)

        def until_seen(self, samples: int) -> Iterator[Batch]:
            deadline = time.monotonic() + 120.0
            while time.monotonic() < deadline:
                if observer.last is not None and observer.last.at > dt * (samples - 1.5):
                    return
                time.sleep(0.01)
                yield Batch(np.zeros(0), np.zeros(0), None, None, time.monotonic())

    notices = Notices(print)
    session = Session(
        InStep(u, y), rp.Identifier(**vars(request)), background=Background(notices), notices=notices,
        observer=observer, sinks=[sink],
    )  # fmt: skip
    session.run()
    told = {estimate.timestamp: estimate.verdict for estimate in sink.sent}  # the last of each
    assert told[dt * (good - 1)] == "trusted"
    assert {verdict for at, verdict in told.items() if at > dt * good + 2.0} <= {"inconsistent", "not excited"}


def test_an_old_view_says_nothing_of_the_present(observer: Observer, monkeypatch: pytest.MonkeyPatch) -> None:
    seen(observer, identifier(1000))
    assert observer.view is not None
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + observing.TOO_OLD + 1.0)
    assert observer.view is None
    assert observer.last is not None
