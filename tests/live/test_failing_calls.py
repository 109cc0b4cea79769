"""The n-th open, write, fsync, rename, socket, thread, process or allocation of a live session fails.

It goes on, or ends with one line and exit code 2; its last checkpoint loads in any case.  Here a choice of calls fails,
drawn with a fixed seed; ``make faults`` lets all of them fail.
"""

from __future__ import annotations

import errno
import random
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from failing.cases import ERRORS, LARGE, SAMPLES, Fault, Mother, Outcome, findings, mother
from replant import cli
from replant.errors import SystemRefusedError
from replant.live.outputs.message import DiskWriter, Notices
from replant.online import saving
from replant.online.identifier import Identifier
from support.cases import every
from support.live_command import ReplayingPeer, lines
from support.live_fakes import DT, FakeObserver, FakeSink, FakeSource, make, record

#: How many calls of each kind fail here, by role: each costs about a second.
TRIES = {
    "session": {
        "open": 1,
        "write": 1,
        "send": 1,
        "read": 1,
        "sync": 1,
        "rename": 1,
        "socket": 1,
        "fork": 1,
        "alloc": 1,
    },
    "observer": {"send": 1, "alloc": 1, "socket": 1, "fork": 1},
}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mother]:
    if not sys.platform.startswith("linux") or shutil.which("gcc") is None:
        pytest.skip("calls fail by a library that gcc builds, on Linux")
    with mother(tmp_path_factory.mktemp("failing")) as process:
        yield process


@pytest.fixture(scope="module")
def clean(running: Mother) -> Outcome:
    """A session in which nothing fails, its calls counted."""
    outcome = running.run(Fault("alloc", 0, errno.ENOMEM, least=LARGE))
    assert outcome.code == 0, outcome.err
    assert findings(outcome, None) == []
    return outcome


def test_all_kinds_of_calls_are_counted(clean: Outcome) -> None:
    assert [kind for kind in ERRORS if not clean.counts["session"][kind]] == []
    assert clean.fired == 0


@every(("role", "kind"), [(role, kind) for role, kinds in TRIES.items() for kind in kinds], quick=3)
def test_a_call_that_fails_neither_kills_nor_hangs_the_session(
    running: Mother, clean: Outcome, role: str, kind: str
) -> None:
    generator = random.Random(f"{role} {kind}")
    calls = clean.counts[role][kind]
    for k in range(TRIES[role][kind]):
        nth, fired = generator.randint(1, calls), False
        while nth and not fired:  # the number of some calls depends on the clock: where one is not made, an earlier one
            # two in three once, with each error in turn; every third from then on, as a disk that is full
            fault = Fault(
                kind, nth, ERRORS[kind][k % len(ERRORS[kind])], k % 3 == 2, role, LARGE if kind == "alloc" else 0
            )
            outcome = running.run(fault)
            assert findings(outcome, fault) == [], f"{fault} ({outcome.call}):\n{outcome.err}\n{running.trace()}"
            nth, fired = nth // 2, outcome.fired > 0
        assert fired


def test_an_observer_that_cannot_work_does_not_end_the_session(running: Mother) -> None:
    fault = Fault("read", 3, errno.EIO, lasting=True, role="observer")
    outcome = running.run(fault, None, "--dashboard", "off")
    assert findings(outcome, fault) == [], outcome.err
    assert outcome.code == 0


def test_a_pipe_that_cannot_be_read_ends_with_what_was_learned(running: Mother, tmp_path: Path) -> None:
    u, y = record(SAMPLES)
    rows = tmp_path / "rows"
    rows.write_bytes(b"".join(lines(u, y, DT * np.arange(SAMPLES), first=0)))
    for nth in range(1, 3):
        fault = Fault("read", nth, errno.EIO)
        outcome = running.run(fault, "-", "--dashboard", "off", stdin=rows)
        assert findings(outcome, fault) == [], outcome.err
        assert outcome.fired


def test_a_tcp_line_that_fails_is_connected_again(running: Mother) -> None:
    u, y = record(SAMPLES)
    peer = ReplayingPeer(lines(u, y, DT * np.arange(SAMPLES), first=0))
    options = (peer.url, "--samples", str(SAMPLES), "--dashboard", "off")
    try:
        calls = running.run(Fault("socket", 0, 0), *options).counts["session"]["socket"]
        for nth in (calls, calls - 1):  # connecting; the socket to connect with
            fault = Fault("socket", nth, errno.ENOBUFS)
            outcome = running.run(fault, *options)
            assert findings(outcome, fault) == [], outcome.err
            assert outcome.fired
            assert outcome.code == 0
    finally:
        peer.close()


# --- without a process


def test_memory_that_is_refused_while_learning_ends_with_the_checkpoint_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The identifier may have learned a part of the samples: what it is then is nobody's checkpoint."""
    u, y = record(1000)
    path = tmp_path / "rig"
    make(FakeSource(u[:500], y[:500]), path=path)[0].run()
    kept, loaded, sink = path.read_bytes(), saving.load(path), FakeSink()
    source = FakeSource(u, y)
    source.seek(499)
    session, observer = make(source, path=path, identifier=loaded.identifier, sinks=[sink])
    learn = Identifier.update_many

    def refuse(self: Identifier, *batch: Any) -> rp.Trace:
        learn(self, *batch)
        raise MemoryError

    monkeypatch.setattr(Identifier, "update_many", refuse)
    with pytest.raises(SystemRefusedError, match="after 0 samples: out of memory; free memory"):
        session.run()
    assert path.read_bytes() == kept
    assert "replant: no last checkpoint: learning was interrupted; the one before is kept" in observer.shown
    assert sink.closed


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.EMFILE, "Too many open files")])
def test_what_is_no_part_of_learning_is_spared(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = record()

    class Refused(FakeObserver):
        def hand_over(self, *arguments: Any, **more: Any) -> bool:
            raise error

        wait_for_view = hand_over

    session, observer = make(FakeSource(u, y), observer=Refused(), sinks=[FakeSink(error)])
    assert session.run()
    assert session.progress.taken == u.size
    assert len([line for line in observer.shown if line.startswith("replant: observer: ")]) == 1
    assert len([line for line in observer.shown if line.endswith("identification continues")]) == len(observer.shown)


def test_a_mistake_of_ours_is_no_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    session, observer = make(FakeSource(*record()))
    monkeypatch.setattr(observer, "hand_over", lambda *arguments, **more: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        session.run()


def test_jobs_go_on_where_not_even_a_failure_can_be_said() -> None:
    done: list[int] = []

    def refuse(line: str) -> None:
        raise MemoryError

    def fail() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    disk_writer = DiskWriter(Notices(refuse))
    for job in (fail, lambda: done.append(1)):
        assert disk_writer.submit("job", job)
    disk_writer.wait()
    disk_writer.close()
    assert done == [1]


@every(
    ("error", "words"),
    [
        (MemoryError("Unable to allocate 8 GiB"), "out of memory (Unable to allocate 8 GiB); free memory"),
        (OSError(errno.EMFILE, "Too many open files", "log.csv"), "Too many open files: 'log.csv'; raise the limit"),
        (RuntimeError("can't start new thread"), "the system starts no more threads; raise the limit"),
        (ImportError("libx.so: cannot open shared object file"), "libx.so: cannot open shared object file; install"),
    ],
)
def test_what_the_system_refuses_ends_any_command_in_one_line(
    error: Exception, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*arguments: Any, **more: Any) -> None:
        raise error

    monkeypatch.setattr(cli.cli, "main", refuse)
    with pytest.raises(SystemExit) as ended:
        cli.main(["live", "demo"])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.startswith(f"replant: {words}")
    assert said.count("\n") == 1
