"""What is due is computed by a second Python: the bits do not depend on whether, when and by whom that is done."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.errors import DamagedCheckpointError, SystemRefusedError
from replant.online import second_process
from replant.online.background import CatchUp
from support.waiting import PATIENCE, wait_until

DT = 0.1
CHANGE, SAMPLES = 900, 1600
SLOW = (
    "import sys; sys.path += sys.argv[1:]; import time; from replant.online import background; "
    "real = background.outcome; background.outcome = lambda *given: (time.sleep(1.0), real(*given))[1]; "
    "background.serve()"
)


@pytest.fixture(scope="module")
def record() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 10), 10)
    before, after = (
        rp.TransferFunction([gain], [1.0, pole]).simulate(u, DT) for gain, pole in ((2.0, 0.5), (3.0, 0.8))
    )
    y = np.where(np.arange(SAMPLES) < CHANGE, before, after) + 0.05 * rng.standard_normal(SAMPLES)
    y[700], y[705], y[960], u[740] = 40.0, np.nan, np.nan, np.inf  # an outlier, some that are missing, a rejected one
    return u, y


@pytest.fixture(scope="module")
def whole(record: tuple[np.ndarray, np.ndarray]) -> rp.Identifier:
    ident = identifier()
    ident.update_many(*record)
    return ident


@pytest.fixture
def new_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the next identifier start a second Python of its own."""
    monkeypatch.setattr(second_process, "_worker", None)


def identifier(**settings: object) -> rp.Identifier:
    return rp.Identifier(poles=1, dt=DT, background=True, **settings)  # type: ignore[arg-type]


def until_pending(ident: rp.Identifier, u: np.ndarray, y: np.ndarray, since: int = 0) -> int:
    """Take samples until a job is pending and its samples are sent; return how many were taken."""
    for k in range(since, u.size):
        ident.update(float(u[k]), float(y[k]))
        if ident._job is not None and ident._job._sent is not None:
            return k + 1
    raise AssertionError("nothing was due")


def test_the_change_is_found(record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier) -> None:
    before = rp.Identifier(poles=1, dt=DT)
    before.update_many(*record)
    np.testing.assert_allclose(whole.parameters, before.parameters, rtol=1e-2)
    assert whole.samples == before.samples == SAMPLES - 1
    assert whole.rejected == before.rejected
    np.testing.assert_array_equal(whole.recent[:, [0, 2]], before.recent[:, [0, 2]])  # a missing output is the model's


def test_one_by_one_is_equal_to_the_bit(record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier) -> None:
    single = identifier()
    for sample in zip(*(each.tolist() for each in record), strict=True):
        single.update(*sample)
    assert single.to_bytes() == whole.to_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("new_worker")
def test_a_slow_second_python_changes_no_bit(
    record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second_process, "BEGIN", SLOW)
    slow = identifier()
    slow.update_many(*record)
    assert slow.forced_waits > 0
    assert slow.to_bytes() == whole.to_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("new_worker")
def test_a_second_python_that_is_killed_changes_no_bit(
    record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second_process, "BEGIN", SLOW)
    (u, y), ident = record, identifier()
    taken = until_pending(ident, u, y)
    first = second_process._worker
    assert first is not None
    os.kill(first._process.pid, signal.SIGKILL)
    wait_until(lambda: not first.lives())
    monkeypatch.undo()
    ident.update_many(u[taken:], y[taken:])
    assert ident.forced_waits > 0
    assert second_process._worker is not first
    assert ident.to_bytes() == whole.to_bytes()


def test_saved_and_continued_equals_not_interrupted(
    record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier
) -> None:
    """While the samples are copied, while the result is computed, and at any time else."""
    (u, y), ident, pending = record, identifier(), 0
    ways = (
        lambda one: rp.Identifier.from_bytes(one.to_bytes()),
        copy.deepcopy,
        lambda one: pickle.loads(pickle.dumps(one)),
    )
    for k in range(0, SAMPLES, 17):
        ident.update_many(u[k : k + 17], y[k : k + 17])
        if ident._job is not None:
            pending += 1
            again = ways[pending % 3](ident)
            assert again.to_bytes() == ident.to_bytes()
            ident = again
    assert pending > 10
    assert ident.to_bytes() == whole.to_bytes()


@pytest.mark.parametrize("history", [100, 200])
def test_a_short_history_is_saved_and_continued(record: tuple[np.ndarray, np.ndarray], history: int) -> None:
    """The second Python gets fewer raw samples than are kept: what is laid out does not follow from these."""
    (u, y), whole, ident = record, identifier(history=history), identifier(history=history)
    whole.update_many(u, y)
    for k in range(0, SAMPLES, 50):
        ident.update_many(u[k : k + 50], y[k : k + 50])
        ident = rp.Identifier.from_bytes(ident.to_bytes())
    assert ident.to_bytes() == whole.to_bytes()
    assert ident.parameters == pytest.approx([0.8, 3.0], rel=0.05)


class StoppedError(Exception):
    """Stands for Ctrl-C."""


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_result_that_is_early_changes_no_bit(
    record: tuple[np.ndarray, np.ndarray], stamped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new state then learns in advance: saved, copied or interrupted meanwhile it begins to do so again."""
    times = ((1e9 + np.arange(SAMPLES) * DT),) if stamped else ()
    whole, ident = identifier(), identifier()
    whole.update_many(*record, *times)
    learn, seen, stopped = CatchUp._learn, 0, 0

    def interrupted(*given: Any) -> None:
        learn(*given)
        if seen > 40 and not stopped:
            raise StoppedError

    monkeypatch.setattr(CatchUp, "_learn", interrupted)
    for sample in zip(*(each.tolist() for each in (*record, *times)), strict=True):
        try:
            ident.update(*sample)
        except StoppedError:  # in what was due before the sample
            stopped += 1
            ident.update(*sample)
        job = ident._job
        if job is not None and job._sent is not None:
            job.wait()
            if job._ahead is not None:
                seen += 1
                if seen % 40 == 30:
                    ident = ident.clone() if seen == 30 else rp.Identifier.from_bytes(ident.to_bytes())
    assert seen > 60
    assert stopped > 0
    assert ident.to_bytes() == whole.to_bytes()


@pytest.mark.slow
def test_what_only_reads_changes_no_bit(record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier) -> None:
    (u, y), ident = record, identifier()
    for k in range(0, SAMPLES, 60):
        ident.update_many(u[k : k + 60], y[k : k + 60])
        ident.assess()
    assert ident.to_bytes() == whole.to_bytes()


@pytest.mark.slow
def test_freeze_and_reset_drop_what_is_pending(record: tuple[np.ndarray, np.ndarray], whole: rp.Identifier) -> None:
    (u, y), ident = record, identifier()
    taken = until_pending(ident, u, y)
    ident.freeze()
    estimate = ident.parameters
    ident.update_many(u[taken : taken + 300], y[taken : taken + 300])
    np.testing.assert_array_equal(ident.parameters, estimate)
    ident.reset()
    until_pending(ident, u, y)
    ident.reset()
    ident.update_many(u, y)
    assert ident.to_bytes() == whole.to_bytes()


@pytest.mark.slow
def test_finish_drops_what_is_pending(record: tuple[np.ndarray, np.ndarray]) -> None:
    (u, y), ident, direct = record, identifier(), rp.Identifier(poles=1, dt=DT)
    taken = until_pending(ident, u, y)
    direct.update_many(u[:taken], y[:taken])
    for each in (ident, direct):
        each.finish()
    np.testing.assert_allclose(ident.parameters, direct.parameters, rtol=1e-6)
    ident.update_many(u[taken:], y[taken:])
    assert ident.samples == SAMPLES - 1


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [False, True])
def test_a_ring_that_is_full(record: tuple[np.ndarray, np.ndarray], stamped: bool) -> None:
    """The oldest samples are written over while the others are looked into; stamps leap and samples are held back."""
    u, y = record
    t = np.arange(SAMPLES) * DT
    t[1000:] += 30 * DT  # a gap
    t[1500] += 70 * DT  # misread: held back
    times = (t,) if stamped else ()
    chunk, single = identifier(history=600), identifier(history=600)
    chunk.update_many(u, y, *times)
    for k, sample in enumerate(zip(u.tolist(), y.tolist(), *(each.tolist() for each in times), strict=True)):
        single.update(*sample)
        if k % 300 == 299:
            single = rp.Identifier.from_bytes(single.to_bytes())
    assert single.to_bytes() == chunk.to_bytes()
    assert len(single.recent) == 600
    np.testing.assert_allclose(np.unique(single.recent[:, 0]), [-1.0, 1.0])


@pytest.mark.slow
def test_with_a_reference(record: tuple[np.ndarray, np.ndarray]) -> None:
    u, y = record
    r = np.roll(u, 3)
    r[900] = np.nan
    chunk, single = identifier(), identifier()
    chunk.update_many(u, y, r=r)
    for k in range(SAMPLES):
        single.update(float(u[k]), float(y[k]), r=float(r[k]))
    assert single.to_bytes() == chunk.to_bytes()


@pytest.mark.usefixtures("new_worker")
def test_where_no_process_can_be_started_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_process.sys, "executable", "/nowhere/python")
    with pytest.raises(SystemRefusedError, match=r"background=True needs a second Python.*did not start"):
        identifier()
    monkeypatch.setattr(second_process, "SharedMemory", None)
    with pytest.raises(SystemRefusedError, match="background=True needs shared memory"):
        identifier()


def test_an_ensemble_knows_no_background() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="background=False"):
        rp.Ensemble(identifier(), 2)


def test_a_checkpoint_whose_job_is_of_other_samples_is_refused(record: tuple[np.ndarray, np.ndarray]) -> None:
    (u, y), ident = record, identifier()
    until_pending(ident, u, y)
    assert ident._job is not None
    ident._job.numbers.samples += 1
    ident._job.numbers.recent_head += 1
    with pytest.raises(DamagedCheckpointError, match="pending job"):
        rp.Identifier.from_bytes(ident.to_bytes())


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="the system does not show a process's environment")
@pytest.mark.usefixtures("new_worker")
def test_linear_algebra_of_the_second_python_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    second_process.start()
    worker = second_process.worker()
    assert worker is not None
    given = Path(f"/proc/{worker._process.pid}/environ").read_bytes().split(b"\0")
    assert b"OPENBLAS_NUM_THREADS=1" in given


def test_the_second_python_outlives_who_asked() -> None:
    """An identifier that is dropped gives its memory back, maybe before it was seen."""
    second_process.start()
    worker = second_process.worker()
    assert worker is not None
    for _ in range(3):
        worker.send(second_process.Place(0))
    identifier()
    assert second_process.worker() is worker


def test_the_second_python_ends_with_the_first() -> None:
    script = (
        "import os, signal, replant as rp; from replant.online import second_process; "
        "ident = rp.Identifier(poles=1, dt=0.1, background=True); "
        "print(second_process.worker()._process.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE)
    wait_until(lambda: not _runs(int(done.stdout)), "the second one had ended")


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not (status.exists() and status.read_text().split(") ")[1].startswith("Z"))  # nobody may wait for it


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system has no signal masks")
def test_ctrl_c_while_the_second_python_starts_does_not_end_it() -> None:
    made = second_process.Worker()
    os.kill(made._process.pid, signal.SIGINT)
    made.wait()
    assert made.lives()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_that_was_forked_gives_its_memory_back() -> None:
    script = """
import multiprocessing
from replant.online.second_process import Place
kept = [Place(0)]
child = multiprocessing.get_context("fork").Process(target=lambda: kept.append(Place(0)))
child.start()
child.join()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_belongs_to_the_process_that_this_one_was_forked_from_is_closed() -> None:
    made = second_process.Worker()
    process = made._process
    made.forget()
    assert process.stdin.closed
    assert process.stdout.closed
