"""Sinks: whole lines at once, datagrams without a receiver, a broker that is away."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import replace

import pytest

from replant.live.outputs import sinks
from replant.live.outputs.message import Notices
from replant.live.outputs.sinks import LineSink, Publisher, open_sink
from support.live_fakes import FakeSink
from support.live_views import estimate
from support.waiting import PATIENCE


def test_lines_go_out_whole_and_at_once() -> None:
    reading, writing = os.pipe()
    LineSink(writing).send(estimate())
    assert os.read(reading, 4096) == estimate().as_json() + b"\n"
    os.close(reading)
    with pytest.raises(BrokenPipeError):
        LineSink(writing).send(estimate())
    os.close(writing)


def test_datagrams_do_not_need_a_listener() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(PATIENCE)
        port = listener.getsockname()[1]
        sink = open_sink(f"udp://127.0.0.1:{port}")
        sink.send(estimate())
        assert json.loads(listener.recv(4096))["sequence"] == 3
    for _ in range(5):
        sink.send(estimate())
    sink.close()


def test_a_datagram_that_finds_no_room_is_behind_until_the_next_goes_out(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def sendto(self, *_: object) -> None:
            raise BlockingIOError

    sink = open_sink("udp://127.0.0.1:9")
    assert sink.behind is False
    with monkeypatch.context() as patch:
        patch.setattr(sink, "_socket", Full())
        sink.send(estimate())
        assert sink.behind is True
    sink.send(estimate())
    assert sink.behind is False
    sink.close()


def test_a_broker_that_is_away_is_said_after_some_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    sink = open_sink(f"mqtt://nobody:secret@127.0.0.1:{port}/rig/1/model")
    assert sink.name == f"mqtt://127.0.0.1:{port}/rig/1/model"  # without the password
    try:
        sink.send(estimate())
        monkeypatch.setattr(sinks, "BROKER_TIMEOUT", -1.0)
        with pytest.raises(ConnectionError, match="the broker does not answer"):
            sink.send(estimate())
    finally:
        sink.close()


def test_trust_is_withdrawn_when_its_time_is_over_and_not_before() -> None:
    sink, now = FakeSink(), [100.0]
    publisher = Publisher([sink], None, 5.0, notices=Notices(print), on_reader_gone=lambda: None, now=lambda: now[0])
    publisher.accepted()
    publisher.mark()
    publisher.send(lambda: replace(estimate(), status="running", verdict="trusted"))
    assert [each.trusted for each in sink.sent] == [True]
    for now[0] in (104.5, 104.9):
        publisher.check()
    assert len(sink.sent) == 1
    now[0] = 105.0
    publisher.check()
    assert [(each.trusted, each.status) for each in sink.sent[1:]] == [(False, "waiting")]
