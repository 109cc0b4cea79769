"""Without accepted samples no receiver holds ``trusted: 1`` for longer than the time to live, whatever fails."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.live.outputs import sinks as publisher_module
from replant.live.outputs.message import ENDED, UNKNOWN, WAITING, EstimateMessage, Notices, time_to_live
from replant.live.outputs.sinks import LineSink, Publisher
from replant.live.streams import Batch
from support.cases import every
from support.live_command import wait_for
from support.live_fakes import DT, FakeObserver, FakeSink, FakeSource, JudgingObserver, make, record
from support.waiting import PATIENCE

TTL = 5.0
NAMES = ("a0", "b0")


def estimate(verdict: str = "trusted", samples: int = 1, ttl: float = 0.0) -> EstimateMessage:
    return EstimateMessage(0.0, None, samples, NAMES, np.ones(2), np.ones(2), "running", verdict, excited=True, ttl=ttl)


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


class Consumer:
    """A receiver: it holds the newest message, and may respect the message's time to live."""

    interval = 0.01

    def __init__(self, clock: Clock, name: str, *, looks_at_ttl: bool, fate: Callable[[], str]) -> None:
        self.name, self.behind = name, False
        self._clock, self._looks, self._fate = clock, looks_at_ttl, fate
        self._message: dict[str, Any] = {"trusted": 0}
        self._until = 0.0

    def send(self, estimate: EstimateMessage) -> None:
        fate = self._fate()
        self.behind = fate == "slow"
        if fate == "error":
            raise OSError(5, "Input/output error")
        if fate == "arrives":
            self._message = json.loads(estimate.as_json())
            self._until = self._clock() + self._message["ttl"]

    def close(self) -> None:
        pass

    @property
    def trusts(self) -> bool:
        return bool(self._message["trusted"]) and (not self._looks or self._clock() < self._until)


def consumers(clock: Clock, generator: np.random.Generator) -> list[Consumer]:
    """Each kind of wire; the lossy one's consumer must go by the time to live, as nothing tells it of a loss."""

    def now_and_then(what: str, part: float) -> Callable[[], str]:
        return lambda: what if generator.random() < part else "arrives"

    return [
        Consumer(clock, "good", looks_at_ttl=False, fate=lambda: "arrives"),
        Consumer(clock, "slow", looks_at_ttl=False, fate=now_and_then("slow", 0.5)),
        Consumer(clock, "failing", looks_at_ttl=False, fate=now_and_then("error", 0.5)),
        Consumer(clock, "lossy", looks_at_ttl=True, fate=now_and_then("lost", 0.7)),
        Consumer(clock, "cut off", looks_at_ttl=True, fate=lambda: "lost" if clock() > 1100.0 else "arrives"),
    ]


@every("seed", range(5), quick=2)
def test_nobody_trusts_for_longer_than_the_time_to_live(seed: int) -> None:
    """Samples come and stay away, are rejected, verdicts change, the session's thread waits: five minutes at random.

    A wire that is slow or fails now and then is tried again every tick: ten in a row are one in a thousand.
    """
    clock, generator = Clock(), np.random.default_rng(seed)
    outside = consumers(clock, generator)
    publisher = Publisher(
        outside, None, TTL, notices=Notices(lambda line: None), on_reader_gone=lambda: None, now=clock
    )
    publisher._newest = estimate()  # as `start` does, without its thread
    newest, accepted, held = estimate(), -np.inf, 0
    phase, phase_ends = "samples", clock() + 20.0
    while clock() < 1300.0:
        clock.now += float(generator.uniform(0.0, publisher_module.TICK))
        if clock() >= phase_ends:
            phase = str(generator.choice(["samples", "rejected", "silence", "stuck"]))
            phase_ends = clock() + float(generator.exponential(12.0))
        if phase == "samples" and generator.random() < 0.5:
            publisher.accepted()
            accepted = clock()
        if phase != "silence" and generator.random() < 0.5:
            newest = estimate(str(generator.choice(["trusted", "trusted", "trusted", "converging"])))
            publisher.mark()
        if phase != "stuck":  # the session's own thread waits for a disk, a solution, a source
            publisher.send(lambda: newest)  # noqa: B023 - called at once
        publisher.check()
        overdue = clock() - accepted - TTL
        for consumer in outside:
            held += consumer.trusts
            patience = 20 * publisher_module.TICK if consumer.name in ("slow", "failing") else publisher_module.TICK
            assert not (consumer.trusts and overdue > patience), consumer.name
    assert held > 300
    publisher.end()
    assert not any(consumer.trusts for consumer in outside if consumer.name == "good")


def test_the_rest_of_the_time_to_live_goes_along() -> None:
    clock, sink = Clock(), FakeSink()
    publisher = Publisher([sink], None, TTL, notices=Notices(print), on_reader_gone=lambda: None, now=clock)
    publisher.mark()
    publisher.send(estimate)
    publisher.accepted()
    for seconds in (0.0, 1.2345, 3.765, 1.0):
        clock.now += seconds
        publisher.mark()
        publisher.send(estimate)
    told = [(one.trusted, one.excited, one.ttl, one.status, one.verdict) for one in sink.sent]
    nothing = (False, False, 0.0, WAITING, UNKNOWN)
    known = [(True, True, ttl, "running", "trusted") for ttl in (5.0, 3.765)]
    assert told == [nothing, *known, nothing, nothing]
    for one in sink.sent:
        assert one.sent == pytest.approx(time.time(), abs=3600.0)


@every("hours", [-1e4, -1.0, 1.0, 1e4])
def test_a_clock_that_is_set_changes_no_trust(hours: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system's clock jumps; the time to live goes by one that cannot: trust neither outlives it nor ends sooner."""
    wall = Clock()
    monkeypatch.setattr(publisher_module.time, "time", wall)
    sink, short = FakeSink(), FakeSink()
    lasting, ending = (
        Publisher([one], None, ttl, notices=Notices(print), on_reader_gone=lambda: None)
        for one, ttl in ((sink, 10.0 * PATIENCE), (short, 0.2))
    )
    for publisher in (lasting, ending):
        publisher.start(estimate("converging"))
        publisher.accepted()
        publisher.mark()
        publisher.send(estimate, immediately=True)
    wall.now += 3600.0 * hours
    lasting.mark()
    lasting.send(estimate, immediately=True)
    assert [one.trusted for one in sink.sent][-2:] == [True, True]
    assert sink.sent[-1].sent == wall.now
    assert sink.sent[-1].ttl <= sink.sent[-2].ttl
    wait_for(lambda: short.sent[-1].status == WAITING)
    assert not short.sent[-1].trusted
    for publisher in (lasting, ending):
        publisher.end()


def test_what_is_not_trusted_stays_so_and_is_not_said_again() -> None:
    clock, sink = Clock(), FakeSink()
    publisher = Publisher([sink], None, TTL, notices=Notices(print), on_reader_gone=lambda: None, now=clock)
    publisher.accepted()
    publisher.mark()
    publisher.send(lambda: estimate("converging"))
    clock.now += 100.0
    for _ in range(10):
        publisher.check()
    assert len(sink.sent) == 1


def test_the_end_is_said_once_whoever_says_it() -> None:
    """Trust expires just as the session ends: the watchdog is about to withdraw it, and sends the last message."""
    sink, asked = FakeSink(), threading.Event()

    class Slow(Clock):
        def __call__(self) -> float:
            if threading.current_thread() is not threading.main_thread():
                asked.set()
                publisher._ended.wait(PATIENCE)
            return self.now

    clock = Slow()
    publisher = Publisher([sink], None, TTL, notices=Notices(print), on_reader_gone=lambda: None, now=clock)
    publisher.accepted()
    publisher.mark()
    publisher.send(estimate)
    clock.now += 2.0 * TTL
    publisher.start(estimate())
    assert asked.wait(PATIENCE)
    publisher.end()
    assert [one.status for one in sink.sent] == ["running", ENDED]


def test_a_slow_plant_gets_more_time() -> None:
    assert time_to_live(1e-3) == 5.0
    assert time_to_live(60.0) == 600.0


# --- the session


class Paced(FakeSource):
    """A record, then whatever is to come of a source that is not well."""

    def __init__(self, after: Callable[[Paced], Iterator[Batch]], samples: int = 1500) -> None:
        u, y = record(samples)
        super().__init__(u, y, numbered=False)
        self._after = after
        self.over, self.go_on = threading.Event(), threading.Event()  # the record is over; what comes after may end

    def batches(self) -> Iterator[Batch]:
        yield from super().batches()
        yield empty()  # the verdict on all of it is there
        self.over.set()
        yield from self._after(self)

    def close(self) -> None:
        self._closed = True
        self.go_on.set()

    @property
    def closed(self) -> bool:
        return self._closed


def empty() -> Batch:
    return Batch(np.zeros(0), np.zeros(0), None, None, time.monotonic())


def blocks(source: Paced) -> Iterator[Batch]:
    source.go_on.wait()
    yield empty()


def is_silent(source: Paced) -> Iterator[Batch]:
    while not source.closed:
        time.sleep(0.005)
        yield empty()


def sends_garbage(source: Paced) -> Iterator[Batch]:
    while not source.closed:
        time.sleep(0.005)
        yield Batch(np.ones(3), np.full(3, np.nan), None, None, time.monotonic())


@every("after", [blocks, is_silent, sends_garbage], quick=1)
def test_without_accepted_samples_trust_is_taken_back(after: Callable[[Paced], Iterator[Batch]]) -> None:
    source, sink, ttl = Paced(after), FakeSink(), 0.3
    session, observer = make(source, observer=JudgingObserver(), sinks=[sink], ttl=ttl)
    running = threading.Thread(target=session.run)
    running.start()
    try:
        assert source.over.wait(PATIENCE)
        expired = time.monotonic() + ttl  # on a busy machine trust may have come and gone before
        last = wait_for(lambda: time.monotonic() > expired and sink.sent[-1].status == WAITING and sink.sent[-1])
        assert any(one.trusted for one in sink.sent)
        assert (last.status, last.verdict, last.excited, last.ttl) == (WAITING, UNKNOWN, False, 0.0)
    finally:
        session.stop()
        running.join()
    assert not any(one.trusted for one in sink.sent[sink.sent.index(last) :])
    assert sink.sent[-1].status == ENDED
    assert observer.infos[-1].silence == 0.0  # the summary is one on all samples, however long it took to end


def test_trust_comes_back_with_the_samples() -> None:
    u, y = record(3000)

    def pauses(source: Paced) -> Iterator[Batch]:
        source.go_on.wait()
        for k in range(1500, 3000, 50):
            yield Batch(u[k : k + 50], y[k : k + 50], None, None, time.monotonic())

    source, sink = Paced(pauses), FakeSink()
    session, observer = make(source, observer=JudgingObserver(), sinks=[sink], ttl=0.3)
    running = threading.Thread(target=session.run)
    running.start()
    wait_for(lambda: sink.sent and sink.sent[-1].status == WAITING and any(one.trusted for one in sink.sent))
    before = len(sink.sent)
    source.go_on.set()
    running.join()
    assert any(one.trusted for one in sink.sent[before:])
    assert sink.sent[-1].status == ENDED
    assert max(info.silence for info in observer.infos) < 60.0


def fails(error: BaseException) -> Callable[[Paced], Iterator[Batch]]:
    def after(_: Paced) -> Iterator[Batch]:
        raise error
        yield empty()

    return after


@every(
    "error",
    [rp.LogError("the wire is gone"), np.linalg.LinAlgError("singular"), MemoryError(), KeyboardInterrupt(),
     SystemExit(3)],
    ids=lambda error: type(error).__name__,
quick=1)  # fmt: skip
def test_however_a_session_ends_its_last_word_is_that_it_has_ended(error: BaseException) -> None:
    sinks = [FakeSink(), FakeSink()]
    session, _ = make(Paced(fails(error)), observer=JudgingObserver(), sinks=sinks)
    with pytest.raises(rp.SystemRefusedError if isinstance(error, MemoryError) else type(error)):
        session.run()
    for sink in sinks:
        assert any(one.trusted for one in sink.sent)
        last = sink.sent[-1]
        assert (last.trusted, last.excited, last.ttl, last.status) == (False, False, 0.0, ENDED)
        assert sink.closed


def test_a_sink_that_raises_what_it_should_not_harms_no_other() -> None:
    bad, good = FakeSink(ValueError("no such payload")), FakeSink()
    session, observer = make(FakeSource(*record(500)), observer=JudgingObserver(), sinks=[bad, good])
    assert session.run()
    assert good.sent[-1].status == ENDED
    assert observer.shown == ["replant: fake sink: no such payload; identification continues"]


def test_a_resumed_session_is_not_trusted_before_its_first_sample() -> None:
    u, y = record()
    identifier = rp.Identifier(**vars(make(FakeSource(u, y))[0].identifier.request))
    identifier.update_many(u, y)
    judged = SimpleNamespace(
        verdict="trusted", excited=True, coefficients=True, parameters=np.full(2, np.nan), std=np.ones(2)
    )
    observer = FakeObserver(judged)
    sink = FakeSink()
    sink.behind = True  # somebody who has just come
    source = Paced(is_silent, samples=0)
    session, _ = make(source, observer=observer, identifier=identifier, sinks=[sink])
    running = threading.Thread(target=session.run)
    running.start()
    wait_for(lambda: len(sink.sent) > 3)
    sink.behind = False
    session.stop()
    running.join()
    assert not any(one.trusted for one in sink.sent)
    assert sink.sent[0].samples == u.size


# --- standard output


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    os.close(writing)


def test_a_slow_reader_finds_one_trusted_line_at_the_most(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    sink = LineSink(writing)
    trusted, doubted = estimate(ttl=TTL), estimate("converging", ttl=TTL)
    for _ in range(100):
        sink.send(trusted)
    assert sink.behind
    assert os.read(reading, 1 << 20) == trusted.as_json() + b"\n"
    sink.send(trusted)
    assert not sink.behind
    sink.send(doubted)  # bad news waits for nobody
    assert not sink.behind
    assert os.read(reading, 1 << 20) == trusted.as_json() + b"\n" + doubted.as_json() + b"\n"
    os.close(reading)


def test_a_reader_that_never_reads_holds_nobody_up(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    sink = LineSink(writing)
    for _ in range(10_000):
        sink.send(estimate("converging"))
    assert sink.behind
    written = os.read(reading, 1 << 20)
    assert written.endswith(b"\n")
    sink.send(estimate("converging"))
    assert not sink.behind
    os.close(reading)


def test_a_reader_that_leaves_lines_behind_is_noticed(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    sink = LineSink(writing)
    sink.send(estimate(ttl=TTL))
    os.close(reading)
    with pytest.raises(BrokenPipeError):
        sink.send(estimate(ttl=TTL))


def test_a_slow_reader_gets_the_newest_when_it_reads_again(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    source = Paced(is_silent)
    session, _ = make(source, observer=JudgingObserver(), sinks=[LineSink(writing)], ttl=3600.0)
    running = threading.Thread(target=session.run)
    running.start()
    wait_for(lambda: session.progress.taken == 1500)
    text = b""
    while b'"samples":1500' not in text:
        text = os.read(reading, 1 << 20)
    newest = json.loads(text.splitlines()[-1])
    session.stop()
    running.join()
    assert newest["timestamp"] == pytest.approx(1500 * DT)
    assert json.loads(os.read(reading, 1 << 20).splitlines()[-1])["status"] == ENDED
    os.close(reading)
