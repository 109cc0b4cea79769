"""The session's loop: it learns to the bit what the identifier learns; its ends; its outputs."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.live.outputs.message import ENDED, UNKNOWN
from replant.live.progress import Limits, Progress, resume
from replant.live.streams.addresses import Address
from replant.live.streams.serial_and_network import PipeSource
from replant.online import saving
from support.live_fakes import DT, REQUEST, FakeObserver, FakeSink, FakeSource, make, record
from support.waiting import PATIENCE, wait_until


def learned(u: np.ndarray, y: np.ndarray, t: np.ndarray | None = None) -> bytes:
    """The state of an identifier that took a record at once."""
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y, t)
    return identifier.to_bytes()


def view(verdict: str, *, excited: bool = True, coefficients: bool = True) -> Any:
    parameters, std = np.full(2, np.nan), np.array([0.25, 0.5])
    return SimpleNamespace(verdict=verdict, excited=excited, coefficients=coefficients, parameters=parameters, std=std)


# --- what is learned


@pytest.mark.parametrize("stamped", [False, True])
def test_batches_of_any_size_give_the_bits_of_the_whole_record(stamped: bool) -> None:
    u, y = record()
    t = 5.0 + DT * np.arange(u.size) if stamped else None
    session, _ = make(FakeSource(u, y, numbered=False, t=t))
    assert session.run()
    assert session.identifier.to_bytes() == learned(u, y, t)
    assert session.progress.taken == u.size
    assert session.progress.at == pytest.approx(t[-1] if stamped else u.size * DT)


@pytest.mark.slow
def test_numbers_without_stamps_stand_for_a_regular_clock() -> None:
    """Lost samples count as time: otherwise, with a tenth lost, the plant would seem a tenth faster."""
    u, y = record(6000)
    kept = np.flatnonzero(np.random.default_rng(3).random(u.size) > 0.1)

    class Lossy(FakeSource):
        def batches(self) -> Any:
            for batch in super().batches():
                chosen = np.isin(batch.sequence, kept)
                yield type(batch)(
                    batch.u[chosen], batch.y[chosen], None, batch.sequence[chosen], batch.arrived
                )  # fmt: skip

    session, _ = make(Lossy(u, y))
    session.run()
    assert session.identifier.samples == kept.size
    a0, b0 = session.identifier.parameters
    assert a0 == pytest.approx(0.5, rel=0.02)
    assert b0 == pytest.approx(2.0, rel=0.02)
    assert session.identifier.to_bytes() == learned(u[kept], y[kept], kept * DT)


def test_a_device_that_starts_anew_is_followed() -> None:
    """Its stamps begin at zero again: no sample but the first is rejected, and the estimate goes on."""
    u, y = record(4000)
    t = np.concatenate([500.0 + DT * np.arange(2000), DT * np.arange(2000)])
    session, observer = make(FakeSource(u, y, numbered=False, t=t))
    session.run()
    assert session.identifier.rejected["not later"] == 1
    assert session.identifier.samples == u.size - 1
    assert session.identifier.parameters[0] == pytest.approx(0.5, rel=0.02)
    assert session.progress.at > 600.0
    assert ["clock" in line for line in observer.shown] == [True]


def test_why_no_sample_comes_is_said_once_a_minute() -> None:
    source = FakeSource(np.zeros(0), np.zeros(0), endless=True)
    source.trouble = "Connection refused"
    session, observer = make(source, limits=Limits(seconds=0.1))
    session.run()
    assert observer.shown == ["replant: fake://: Connection refused; trying again"]


# --- when it ends


@pytest.mark.parametrize("limit", [1, 217, 2999])
def test_a_limit_on_samples_is_exact(limit: int) -> None:
    u, y = record()
    session, _ = make(FakeSource(u, y), limits=Limits(samples=limit))
    session.run()
    assert session.progress.taken == limit
    assert session.identifier.to_bytes() == learned(u[:limit], y[:limit], DT * np.arange(limit))


def test_a_limit_on_time_ends_a_silent_source() -> None:
    session, _ = make(FakeSource(np.zeros(0), np.zeros(0), endless=True), limits=Limits(seconds=0.05))
    assert session.run()


def test_until_trusted_ends_when_the_observer_says_so() -> None:
    u, y = record()
    observer = FakeObserver(view("converging"))

    def at_last(done: int) -> None:
        if done > 1000:
            observer.view = view("trusted")

    session, _ = make(FakeSource(u, y, between=at_last), observer=observer, limits=Limits(until_trusted=True))
    assert session.run()
    assert 1000 < session.progress.taken < 1200


def test_a_stream_that_ends_before_the_verdict_is_told_apart() -> None:
    session, _ = make(FakeSource(*record(500)), limits=Limits(until_trusted=True))
    assert not session.run()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_a_last_checkpoint(tmp_path: Path, number: signal.Signals) -> None:
    u, y = record()
    before = signal.getsignal(number)
    sink = FakeSink()

    def ask(done: int) -> None:
        if done >= u.size:
            os.kill(os.getpid(), number)

    source = FakeSource(u, y, between=ask, endless=True)
    session, _ = make(source, path=tmp_path / "rig", every=1e9, sinks=[sink])
    assert session.run()
    assert signal.getsignal(number) is before
    loaded = saving.load(tmp_path / "rig")
    assert loaded.identifier.to_bytes() == learned(u, y, DT * np.arange(u.size))
    assert loaded.progress["sequence"] == u.size - 1
    assert sink.closed
    assert sink.sent[-1].samples == u.size


def test_what_has_come_in_already_is_learned_before_it_ends() -> None:
    u, y = record(1000)

    class Draining(FakeSource):
        def close(self) -> None:
            """Closed, it still hands over what is complete."""

    source = Draining(u, y, between=lambda done: session.stop())
    session, _ = make(source)
    session.run()
    assert session.progress.taken == u.size


def test_a_checkpoint_is_written_before_anything_that_may_take_long(tmp_path: Path) -> None:
    class Slow(FakeObserver):
        def wait_for_view(self, *_: Any) -> None:
            self.found = saving.load(tmp_path / "rig").progress["taken"] == 300

    observer = Slow()
    session, _ = make(FakeSource(*record(300)), observer=observer, path=tmp_path / "rig", every=1e9)
    session.run()
    assert observer.found


def test_it_can_be_stopped_from_another_thread() -> None:
    learned = threading.Event()
    session, _ = make(FakeSource(*record(100), endless=True, between=lambda done: learned.set()))
    other = threading.Thread(target=lambda: (learned.wait(PATIENCE), session.stop()))
    other.start()
    assert session.run()
    other.join()


# --- estimates


def test_estimates_carry_the_newest_verdict_and_the_last_one_always_goes_out() -> None:
    u, y = record()
    sink, slow = FakeSink(), FakeSink()
    slow.interval = 1e9
    session, _ = make(FakeSource(u, y), observer=FakeObserver(view("trusted")), sinks=[sink, slow])
    session.run()
    assert np.isnan(sink.sent[0].parameters).all()
    assert sink.sent[0].status == "starting"
    last, farewell = sink.sent[-2:]
    assert (farewell.samples, farewell.status, farewell.trusted) == (u.size, ENDED, False)
    assert (last.samples, last.sequence, last.timestamp) == (u.size, u.size - 1, DT * (u.size - 1))
    assert (last.verdict, last.trusted, last.excited) == ("trusted", True, True)
    np.testing.assert_array_equal(last.parameters, session.identifier.parameters)
    np.testing.assert_array_equal(last.std, [0.25, 0.5])
    assert [estimate.samples for estimate in slow.sent] == [sink.sent[0].samples, u.size, u.size]


def test_a_verdict_is_of_the_model_that_was_judged() -> None:
    """An estimate that has changed significantly since is another model."""
    u, y = record()
    told = {}
    for moved in (3.0, 5.0):
        ident = rp.Identifier(**vars(REQUEST))
        ident.update_many(u, y)
        std = np.array([0.25, 0.5])
        judged = SimpleNamespace(
            verdict="trusted", excited=True, coefficients=True,
            parameters=ident.parameters + moved * np.array([0.0, std[1]]), std=std,
        )  # fmt: skip
        sink = FakeSink()
        session, _ = make(FakeSource(u, y), observer=FakeObserver(judged), sinks=[sink])
        session.run()
        told[moved] = (sink.sent[-2].verdict, sink.sent[-2].excited, np.isnan(sink.sent[-2].std).all())
        assert sink.sent[-2].coefficients is (moved < 4.0)
    assert told == {3.0: ("trusted", True, False), 5.0: (UNKNOWN, False, True)}


def test_that_the_input_rests_is_sent_though_the_verdict_stays() -> None:
    """Also where no sample comes: the last ones are judged a little later than they are learned."""
    sink, observer = FakeSink(), FakeObserver(view("trusted"))
    source = FakeSource(*record(1000), endless=True)
    session, _ = make(source, observer=observer, sinks=[sink])
    running = threading.Thread(target=session.run)
    running.start()
    try:
        before = wait_until(lambda: sink.sent and sink.sent[-1].samples == 1000 and sink.sent[-1])
        observer.view = view("trusted", excited=False)
        after = wait_until(lambda: sink.sent[-1] is not before and sink.sent[-1])
    finally:
        session.stop()
        running.join()
    assert [(one.samples, one.trusted) for one in (before, after)] == 2 * [(1000, True)]
    assert (before.excited, after.excited) == (True, False)


def test_without_an_observer_no_verdict_is_claimed() -> None:
    sink = FakeSink()
    session, _ = make(FakeSource(*record()), sinks=[sink])
    session.run()
    assert {(estimate.verdict, estimate.excited) for estimate in sink.sent} == {(UNKNOWN, False)}
    assert np.isnan(sink.sent[-1].std).all()


def test_a_sink_that_fails_is_said_once_and_the_others_go_on() -> None:
    good, bad = FakeSink(), FakeSink(OSError(101, "Network is unreachable"))
    session, observer = make(FakeSource(*record()), sinks=[bad, good])
    session.run()
    assert len(good.sent) > 10
    assert observer.shown == ["replant: fake sink: Network is unreachable; identification continues"]


def test_a_reader_that_has_gone_ends_the_session() -> None:
    session, observer = make(FakeSource(*record()), sinks=[FakeSink(BrokenPipeError(32, "Broken pipe"))])
    assert session.run()
    assert session.progress.taken < 100
    assert observer.shown == []


# --- what the dashboard asks for


def test_commands_are_obeyed_and_one_that_cannot_be_is_said() -> None:
    u, y = record()
    observer = FakeObserver(commands=("freeze",))
    seen: list[tuple[int, bool]] = []

    def between(done: int) -> None:
        seen.append((session.identifier.samples, session.identifier.adapting))
        if 1000 < done < 1050:
            observer.ask("freeze")
        elif 2000 < done < 2050:
            observer.ask("adapt")
        elif 2500 < done < 2550:
            observer.ask("reset")

    session, _ = make(FakeSource(u, y, between=between), observer=observer)
    session.run()
    assert "freezing needs a model, and the samples for the first one are still being collected" in observer.shown[0]
    assert {adapting for samples, adapting in seen if 1100 < samples < 2000} == {False}
    assert {adapting for samples, adapting in seen if 2100 < samples < 2500} == {True}
    assert session.identifier.samples < 600
    assert session.progress.taken == u.size


def test_what_a_command_changed_is_handed_over_as_what_samples_changed_is() -> None:
    class Noting(FakeObserver):
        def hand_over(self, identifier: rp.Identifier, info: Any, *, learned: bool) -> bool:
            told.append(learned)
            return super().hand_over(identifier, info, learned=learned)

    told: list[bool] = []
    session, observer = make(FakeSource(*record(10)), observer=Noting())
    session._serve_outputs(0.0)
    observer.ask("reset")
    session._serve_outputs(0.0)
    session._serve_outputs(0.0)
    assert told == [False, True, False]


# --- checkpoints


def test_a_source_that_fails_leaves_a_checkpoint(tmp_path: Path) -> None:
    u, y = record(1000)

    def fail(done: int) -> None:
        if done >= 900:
            raise rp.LogError("the wire is gone")

    session, _ = make(FakeSource(u, y, between=fail), path=tmp_path / "rig", every=1e9)
    with pytest.raises(rp.LogError, match="the wire is gone"):
        session.run()
    assert saving.load(tmp_path / "rig").progress["taken"] == session.progress.taken >= 900


def test_a_record_has_a_checkpoint_from_its_first_sample_on(tmp_path: Path) -> None:
    """After a power cut the same command goes on, even before a checkpoint was due."""
    found: list[Any] = []

    def cut(done: int) -> None:
        if not found:
            (tmp_path / "cut").write_bytes((tmp_path / "rig").read_bytes())
            found.append(saving.load(tmp_path / "cut").progress["taken"])

    u, y = record()
    make(FakeSource(u, y, between=cut), path=tmp_path / "rig", every=1e9)[0].run()
    assert found == [0]
    loaded = resume(tmp_path / "cut", REQUEST)
    assert loaded is not None
    progress = loaded.progress
    session, _ = make(FakeSource(u, y), path=tmp_path / "cut", identifier=loaded.identifier, progress=progress)
    session.run()
    assert session.identifier.to_bytes() == learned(u, y, DT * np.arange(u.size))


@pytest.mark.parametrize("before", [False, True])
def test_a_damaged_checkpoint_is_refused_with_what_to_do(before: bool, tmp_path: Path) -> None:
    path = tmp_path / "rig"
    for each in (path, tmp_path / "rig.previous") if before else (path,):
        each.write_bytes(b"")
    with pytest.raises(rp.DamagedCheckpointError, match=r"it is empty.*; move .*rig.* away to start anew") as refused:
        resume(path, REQUEST)
    assert ("its .previous" in str(refused.value)) == before


def test_counters_go_on_over_a_resumption(tmp_path: Path) -> None:
    u, y = record(600)
    for k in range(1, 4):
        loaded = resume(tmp_path / "rig", REQUEST)
        source = FakeSource(u, y)
        source.counters = {"lost": 2}
        session, _ = make(source, path=tmp_path / "rig", progress=Progress() if loaded is None else loaded.progress)
        session.run()
        assert session.info.counters == {"lost": 2 * k}


def test_a_resumed_session_goes_on_to_the_bit_and_uses_no_sample_twice(tmp_path: Path) -> None:
    u, y = record()
    path = tmp_path / "rig"
    taken = 0
    for limit in (150, 151, 700, 1234, 3000):
        loaded = resume(path, REQUEST)
        assert (loaded is None) == (taken == 0)
        arguments = {} if loaded is None else {
            "identifier": loaded.identifier, "progress": loaded.progress
        }  # fmt: skip
        session, _ = make(FakeSource(u, y, seed=limit), path=path, limits=Limits(samples=limit), **arguments)
        assert session.progress.taken == taken
        session.run()
        taken = session.progress.taken
    assert session.identifier.to_bytes() == learned(u, y, DT * np.arange(u.size))


def test_a_checkpoint_of_another_structure_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "rig"
    rp.Identifier(**vars(REQUEST)).save(path)
    with pytest.raises(
        rp.InvalidArgumentError, match=r"rig: the checkpoint was made with dt 0.05, and 0.1 is requested now"
    ):
        resume(path, type(REQUEST)(**{**vars(REQUEST), "dt": 0.1}))
    with pytest.raises(
        rp.InvalidArgumentError, match=r"structure 1 pole, and 2 poles is .* move .* away to start anew"
    ):
        resume(path, type(REQUEST)(**{**vars(REQUEST), "structure": rp.Structure(2)}))
    assert resume(path, REQUEST) is not None
    assert resume(tmp_path / "none", REQUEST) is None


def piped(text: str) -> PipeSource:
    """A source of lines from a pipe that has ended."""
    end, begin = os.pipe()
    os.write(begin, text.encode())
    os.close(begin)
    return PipeSource(Address("-", ""), file=end)


@pytest.mark.parametrize(
    ("text", "more", "said", "counters"),
    [
        ("0;1;2\n1;1;2\n", {},
         r"^-: no sample could be read; the first line is '0;1;2': not a number; "
         "separate numbers by commas: 0,1,2; expected u,y or t,u,y or n,t,u,y, or",
         {"not a number": 2}),
        ("0;1;2\n1;2;3\n", {"progress": Progress(taken=100)}, "no sample could be read", {"not a number": 2}),
        ("u,y,\x1b[2Jz\n1;2;3\n", {}, "expected u,y, or JSON objects", {"not a number": 1}),
    ],
    ids=["no header", "going on from a checkpoint", "a header with other columns"],
)  # fmt: skip
def test_a_session_that_could_read_no_line_ends_with_the_first_one_and_what_was_expected(
    text: str, more: dict[str, Progress], said: str, counters: dict[str, int]
) -> None:
    session, _ = make(piped(text), **more)
    with pytest.raises(rp.LogError, match=said):
        session.run()
    assert session.source.counters == counters


@pytest.mark.parametrize("text", ["", "time;u;y\n1,2\n3,4\n"])
def test_a_stream_without_lines_or_with_a_title_ends_as_usual(text: str) -> None:
    session, _ = make(piped(text))
    assert session.run()


@pytest.mark.parametrize(
    ("samples", "before", "trouble", "stopped", "words"),
    [
        (0, 0, "", False, "no sample came; check that the source sends any"),
        (0, 0, "refused", False, "no sample came: refused"),
        (0, 10, "refused", False, "no sample came: refused"),
        (0, 10, "", False, ""),  # a log whose samples were learned before
        (0, 0, "refused", True, ""),
        (10, 0, "refused", False, ""),
    ],
)
def test_that_no_sample_came_is_told_unless_somebody_has_stopped_the_session(
    samples: int, before: int, trouble: str, stopped: bool, words: str
) -> None:
    session, _ = make(FakeSource(*record(samples)), limits=Limits(seconds=0.1), progress=Progress(taken=before))
    session.source.trouble = trouble
    if stopped:
        session.stop()
    session.run()
    assert session.missed == words


def test_while_no_line_can_be_read_the_first_one_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replant.live.session.PATIENCE", 0.0)
    session, observer = make(FakeSource(*record(0), endless=True))
    session.source.refused = "'0;1;2': not a number"
    threading.Timer(0.2, session.stop).start()
    with pytest.raises(rp.LogError, match="no sample could be read"):
        session.run()
    assert observer.shown == ["replant: fake://: no sample yet; the first line is '0;1;2': not a number"]
