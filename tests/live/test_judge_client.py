"""The observer's process: it returns views and is restarted after a crash, and the session never waits for it."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import replant as rp
from replant.live import judge_client as observing
from replant.live import judge_process as process_module
from replant.live.judge_client import Observer
from replant.live.judge_process import (
    DashboardAddress,
    Handover,
    ObserverMessage,
    ObserverOptions,
)
from replant.live.view import SessionInfo, View
from support.live_command import wait_for
from support.live_fakes import DT, REQUEST, record
from support.waiting import PATIENCE

U, Y = record()


@pytest.fixture(scope="module")
def observer() -> Iterator[Observer]:
    """Return one for all tests: it takes seconds to start."""
    started = Observer(ObserverOptions(dashboard=DashboardAddress("127.0.0.1", 0)))
    yield started
    started.close()


@pytest.fixture
def mortal() -> Iterator[Observer]:
    """Return one that may be killed."""
    started = Observer(ObserverOptions())
    yield started
    started.close()


def identifier(samples: int) -> rp.Identifier:
    made = rp.Identifier(**vars(REQUEST))
    made.update_many(U[:samples], Y[:samples])
    return made


def seen(observer: Observer, ident: rp.Identifier, *, learned: bool = True) -> View:
    """Hand over, and wait for the view that comes of it."""
    before = observer.last
    info = SessionInfo(at=ident.samples * DT, source="fake://", source_state="connected")

    def newer() -> View | None:
        observer.poll()
        if observer.last is not before:
            return observer.last
        observer.hand_over(ident, info, learned=learned)
        return None

    found = wait_for(newer)
    assert isinstance(found, View)
    return found


def test_views_come_back_and_go_to_the_page(observer: Observer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observing, "TOO_OLD", PATIENCE)
    ident = identifier(3000)
    view = seen(observer, ident)
    assert observer.view is observer.last
    np.testing.assert_array_equal(view.parameters, ident.parameters)
    assert view.verdict == ident.assess().status
    assert seen(observer, ident, learned=False).samples == 3000  # the info alone; the page has the view before by now
    request = urllib.request.Request(observer.url + "model.json")
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        model = json.load(answer)
    assert model["den"] == [1.0, ident.parameters[0]]


def test_commands_come_back_from_the_page(observer: Observer) -> None:
    request = urllib.request.Request(observer.url + "command/freeze", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        assert answer.status < 300
    assert wait_for(observer.poll) == ["freeze"]


@pytest.mark.slow
def test_the_report_is_made_of_the_newest_estimate(observer: Observer) -> None:
    ident = identifier(3000)
    seen(observer, ident)
    request = urllib.request.Request(observer.url + "report", method="POST", data=b"")
    request.add_header("Origin", observer.url.rstrip("/"))
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        page = answer.read().decode()
    assert page.lower().startswith("<!doctype html>")
    assert f"{ident.parameters[0]:.4g}"[:5] in page


def pid(observer: Observer) -> int | None:
    """The number of the process that is at work; None while there is none."""
    observer.poll()
    return observer._process.process.pid if observer._alive else None


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, pytest.param(10, marks=pytest.mark.slow)])
def test_a_killed_observer_restarts_each_time_and_keeps_its_history(
    mortal: Observer, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    monkeypatch.setattr(observing, "PAUSES", (0.01, 0.02))
    mortal._pause = 0.01
    for samples in (1000, 2000):
        before = seen(mortal, identifier(samples))
    for _ in range(times):
        killed = wait_for(lambda: pid(mortal))
        os.kill(killed, signal.SIGKILL)
        wait_for(lambda: pid(mortal) not in (None, killed))  # noqa: B023 - called in this round only
    after = seen(mortal, identifier(3000))
    np.testing.assert_array_equal(after.history.t[: before.history.t.size], before.history.t)
    assert after.samples == 3000
    assert after.counters[observing.RESTARTS] == times  # seen at the terminal and on the page
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1  # once a minute
    assert "(signal 9); it restarts in" in said[0]


def test_pauses_between_two_starts_grow_up_to_a_limit_and_begin_anew_after_a_long_life(mortal: Observer) -> None:
    assert [mortal._next_pause() for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    mortal._process.start -= 2.0 * observing.LONG_LIFE
    os.kill(wait_for(lambda: pid(mortal)), signal.SIGKILL)
    wait_for(lambda: pid(mortal) is None)
    assert mortal._next_pause() == 1.0


def test_without_a_process_nothing_is_said_of_the_present_and_nothing_waits(mortal: Observer) -> None:
    seen(mortal, identifier(1000))
    mortal._pause = 3600.0
    os.kill(wait_for(lambda: pid(mortal)), signal.SIGKILL)
    wait_for(lambda: pid(mortal) is None)
    assert mortal.view is None
    assert mortal.last is not None
    assert not mortal.hand_over(identifier(100), SessionInfo(), learned=True)
    mortal.wait_for_view(identifier(100), SessionInfo())  # returns at once: no view can come


def test_a_start_that_fails_is_tried_again(
    mortal: Observer, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example without file descriptors or processes: the session continues, and so do the attempts."""
    monkeypatch.setattr(observing, "PAUSES", (0.01, 0.02))
    mortal._pause = 0.01
    made, tries = observing.ObserverProcess, []

    def fails_twice(options: ObserverOptions) -> object:
        tries.append(1)
        if len(tries) <= 2:
            raise OSError(24, "Too many open files")
        return made(options)

    monkeypatch.setattr(observing, "ObserverProcess", fails_twice)
    os.kill(wait_for(lambda: pid(mortal)), signal.SIGKILL)
    wait_for(lambda: pid(mortal) and len(tries) == 3)
    assert seen(mortal, identifier(1000)).samples == 1000
    assert (
        "cannot be started: Too many open files; raise the limit on open files (ulimit -n); trying again"
        in capfd.readouterr().err
    )


def test_a_view_that_fails_gives_one_notice_and_the_next_is_made(
    mortal: Observer, capfd: pytest.CaptureFixture
) -> None:
    """In the process itself: two unreadable states between two readable ones."""
    seen(mortal, identifier(1000))
    process = mortal._process.process.pid
    for _ in range(2):
        mortal._process.outbox.put(Handover(SessionInfo(at=7.0), (), b"no state at all"))
    doubted = wait_for(lambda: mortal.poll() == [] and mortal.last.at == 7.0 and mortal.last)
    assert (doubted.verdict, doubted.excited, doubted.at) == ("unknown", False, 7.0)
    assert "the estimate could not be judged" in doubted.reasons[0]
    # the view of the second one may come first
    again = wait_for(lambda: (view := seen(mortal, identifier(1500))).samples == 1500 and view)
    assert again.verdict == identifier(1500).assess().status
    assert (mortal._process.process.pid, mortal._restarts) == (process, 0)
    said = capfd.readouterr().err
    assert said.count("the estimate could not be judged") == 1
    assert "Traceback" not in said


@pytest.mark.parametrize("fails", ["make_view", "to_json"])
def test_after_any_error_of_a_view_a_handover_without_samples_restores_no_trust(
    fails: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = multiprocessing.Pipe()
    work = process_module._Observing(theirs, ObserverOptions())
    state, info = identifier(3000).to_bytes(), SessionInfo(at=1.0)
    assert work._judge(Handover(info, (), state)).verdict == "trusted"
    if fails == "to_json":
        work._hub = SimpleNamespace(publish=lambda view: view)
        monkeypatch.setattr(View, "to_json", lambda view: 1 / 0)
        work._show(work._view, ())
        assert "could not be shown" in ours.recv().text
        return
    with monkeypatch.context() as patched:
        patched.setattr(process_module, "make_view", lambda *_, **__: np.linalg.inv(np.zeros((2, 2))))
        assert work._judge(Handover(info, (), state)).verdict == "unknown"
    assert "LinAlgError" in ours.recv().text
    assert work._judge(Handover(info)).verdict == "unknown"
    assert work._judge(Handover(info, (), state)).verdict == "trusted"


def test_a_view_of_a_session_without_samples_claims_nothing() -> None:
    _, theirs = multiprocessing.Pipe()
    work = process_module._Observing(theirs, ObserverOptions())
    assert work._judge(Handover(SessionInfo(at=1.0), (), identifier(3000).to_bytes())).verdict == "trusted"
    silent = work._judge(Handover(SessionInfo(at=1.0, silence=12.0)))
    assert (silent.verdict, silent.reasons) == ("unknown", ("no sample has been accepted for 12 s",))
    assert work._judge(Handover(SessionInfo(at=1.1))).verdict == "trusted"


def test_a_dashboard_that_cannot_be_served_later_on_ends_nothing(
    mortal: Observer, capfd: pytest.CaptureFixture
) -> None:
    """For example after a kill, when another program has taken the port."""
    mortal._receive(ObserverMessage("serving", "http://127.0.0.1:8710/"))
    mortal._receive(ObserverMessage("failed", "the dashboard cannot listen on 127.0.0.1:8710"))
    assert "cannot listen on 127.0.0.1:8710; trying again" in capfd.readouterr().err
    seen(mortal, identifier(300))


def test_a_crowd_at_the_page_does_not_affect_the_session(observer: Observer) -> None:
    """A hundred pages that do not read, and garbage: views go on, and nothing of it is in this process."""
    seen(observer, identifier(1000))
    threads, port = threading.active_count(), int(observer.url.rstrip("/").rpartition(":")[2])
    upgrade = (
        f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    ).encode()
    with contextlib.ExitStack() as crowd:
        for k in range(100):
            page = crowd.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE))
            page.sendall(upgrade)
            if k % 2:
                page.sendall(b"\xff\x00" * 5000)
            assert page.recv(12) == b"HTTP/1.1 101"
        for samples in range(1100, 1500, 100):
            assert seen(observer, identifier(samples)).samples == samples
        assert threading.active_count() == threads


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_that_end_a_session_do_not_reach_it(observer: Observer, number: signal.Signals) -> None:
    """`timeout`, Ctrl-C and service managers signal every process, but the session needs the last view afterwards."""
    process = wait_for(lambda: pid(observer))
    os.kill(process, number)
    seen(observer, identifier(1000))
    assert pid(observer) == process


def test_what_is_said_before_the_first_view_is_shown_at_once(capfd: pytest.CaptureFixture) -> None:
    """It does not wait for the first view."""
    started = Observer(ObserverOptions(terminal=True))
    try:
        started.show("replant: sooner")
        assert capfd.readouterr().err == "replant: sooner\n"
        seen(started, identifier(300))
        started.show("replant: later")
        seen(started, identifier(400))
    finally:
        started.close()
    assert "replant: later\n" in capfd.readouterr().err  # read once: what comes while it is read is lost


def test_it_goes_away_with_its_session() -> None:
    """However that ends; a signal would not end it."""
    program = """
from replant.live.judge_client import Observer
from replant.live.judge_process import ObserverOptions
if __name__ == "__main__":
    observer = Observer(ObserverOptions())
    print(observer._process.process.pid, flush=True)
    {end}
"""
    for end, code in (("raise SystemExit(3)", 3), ("import os; os._exit(4)", 4)):
        done = subprocess.run(
            [sys.executable, "-c", program.format(end=end)], stdout=subprocess.PIPE, timeout=PATIENCE, check=False
        )  # fmt: skip
        assert done.returncode == code
        left = Path(f"/proc/{int(done.stdout)}")
        wait_for(lambda: not left.exists() or "Z" in (left / "stat").read_text().split()[2])  # noqa: B023


def test_an_outdated_view_is_not_used(observer: Observer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observing, "TOO_OLD", PATIENCE)
    seen(observer, identifier(1000))
    assert observer.view is not None
    now = time.monotonic()
    with monkeypatch.context() as later:  # the module's clock alone: other threads of this process go by theirs
        later.setattr(
            observing, "time", SimpleNamespace(**vars(time) | {"monotonic": lambda: now + observing.TOO_OLD + 1.0})
        )
        assert observer.view is None
        assert observer.last is not None
