"""Threads, processes and copies: calls on one object go one after the other, and copies share nothing."""

from __future__ import annotations

import asyncio
import copy
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.online.locking import Turn
from support.waiting import PATIENCE

DT = 0.1
FIXED = {"filter": rp.StateVariableFilter(cutoff=1.0), "instruments": False, "startup": 20}


def record(samples: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 8 + 1), 8)[:samples]
    return u, rp.TransferFunction([2.0], [1.0, 1.2, 1.0]).simulate(u, dt=DT) + 0.03 * rng.standard_normal(samples)


def adapting(step: float) -> rp.Identifier:
    return rp.Identifier(rp.Structure(2), DT, optimizer=rp.AMSGrad(step), **FIXED)


@contextmanager
def eager_threads() -> Iterator[None]:
    """Let the interpreter change threads as often as it can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def at_once(*works: Callable[[], Any]) -> list[Any]:
    """Run each in a thread; return their results."""
    ready = threading.Barrier(len(works))

    def run(work: Callable[[], Any]) -> Any:
        ready.wait(PATIENCE)
        return work()

    with eager_threads(), ThreadPoolExecutor(len(works)) as pool:
        return [done.result(PATIENCE) for done in [pool.submit(run, work) for work in works]]


def given_by_threads(ident: rp.Identifier, u: FloatArray, y: FloatArray) -> None:
    """Two threads give samples one by one, one in chunks, one reads: through start-up, solutions and looks."""

    def one_by_one() -> None:
        for k in range(u.size):
            ident.update(u[k], y[k])

    def in_chunks() -> None:
        for k in range(0, u.size, 50):
            ident.update_many(u[k : k + 50], y[k : k + 50])

    def read() -> None:
        for _ in range(5):
            rp.Identifier.from_bytes(ident.to_bytes())  # a torn state is refused
            assert np.isfinite(ident.parameters).all()
            assert ident.assess().status
            if ident.has_model:
                assert ident.model.parameters.size == 3

    at_once(one_by_one, one_by_one, in_chunks, read)
    assert ident.taken == 3 * u.size
    rp.Identifier.from_bytes(ident.to_bytes())


def test_no_sample_is_lost_however_many_threads_give_them() -> None:
    given_by_threads(rp.Identifier(poles=2, dt=DT, startup=100), *record(300))
    for _ in range(2):
        given_by_threads(adapting(1e-3), *record(600))


@pytest.mark.slow
def test_no_sample_is_lost_in_many_runs() -> None:
    for seed in range(2):
        given_by_threads(rp.Identifier(poles=2, dt=DT, startup=100), *record(500, seed))


@pytest.mark.slow
def test_no_sample_of_an_ensemble_is_lost_however_many_threads_give_them() -> None:
    u, y = record(400)
    steps = [adapting(step) for step in (1e-4, 1e-3, 1e-2)]
    sweep = rp.Ensemble([*steps, rp.Identifier(rp.Structure(2), DT, startup=100)], n_jobs=2)

    def one_by_one() -> None:
        for k in range(u.size):
            sweep.update(u[k], y[k])

    def read() -> None:
        for _ in range(10):
            assert len(set(sweep.samples.tolist())) == 1  # all members have taken as many
            assert np.isfinite(sweep.parameters).all()

    at_once(one_by_one, lambda: [sweep.update_many(u[k : k + 40], y[k : k + 40]) for k in range(0, 400, 40)], read)
    assert sweep.taken == 800
    assert sweep.samples.tolist() == [800] * 4


def test_samples_may_come_from_a_new_thread_each_time() -> None:
    u, y = record(1000)
    plain, ident = (rp.Identifier(poles=2, dt=DT, startup=100) for _ in range(2))
    plain.update_many(u, y)

    async def run() -> None:
        for k in range(0, u.size, 50):
            await asyncio.to_thread(ident.update_many, u[k : k + 50], y[k : k + 50])

    asyncio.run(run())
    assert ident.to_bytes() == plain.to_bytes()


def test_what_waits_for_its_turn_gets_it() -> None:
    ident = rp.Identifier(poles=2, dt=DT)
    with ident._turn.lock, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(ident.update, 1.0, 0.5)
        with pytest.raises(TimeoutError):
            waiting.result(0.05)
        assert ident.taken == 0
        ident._turn.lock.release()
        assert np.isnan(waiting.result(PATIENCE))
        ident._turn.lock.acquire()
    assert ident.taken == 1


# --- copies


STATEFUL = {
    "starting": lambda: taken(rp.Identifier(poles=2, dt=DT), 300),
    "running": lambda: taken(rp.Identifier(poles=2, dt=DT, startup=200), 900),
    "fixed": lambda: taken(adapting(1e-3), 300),
    "ensemble": lambda: taken(rp.Ensemble([adapting(step) for step in (1e-4, 1e-3, 1e-2)]), 300),
}
COPIES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}


def taken(one: Any, samples: int) -> Any:
    one.update_many(*record(samples))
    return one


def states(one: Any) -> list[bytes]:
    return [one.member(n).to_bytes() for n in range(len(one))] if isinstance(one, rp.Ensemble) else [one.to_bytes()]


@pytest.mark.parametrize("how", COPIES)
def test_copies_are_equal_and_share_nothing(how: str) -> None:
    u, y = record(700, 1)
    for name, build in STATEFUL.items():
        one = build()
        before, again = states(one), COPIES[how](one)
        assert states(again) == before, name
        again.update_many(u, y)
        assert states(one) == before, f"{name}: the copy's samples reached the original"
        changed = states(again)
        one.update(1.0, 1.0)
        assert states(again) == changed, f"{name}: the original's sample reached the copy"


def test_a_clone_is_a_copy() -> None:
    one = STATEFUL["running"]()
    assert one.clone().to_bytes() == one.to_bytes()


# --- processes


def in_child(work: Callable[[], int]) -> int:
    """Return the exit code of a forked process that does some work; the parent's threads are not in it."""
    pid = os.fork()
    if pid == 0:
        code = 99
        try:
            code = work()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot fork")


@needs_fork
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize(("changing", "expected"), [(False, 7), (True, 8)], ids=["reads", "changes"])
def test_a_forked_process_does_not_wait_for_a_thread_that_it_has_not_got(changing: bool, expected: int) -> None:
    ident = rp.Identifier(poles=2, dt=DT)
    held, over = threading.Event(), threading.Event()

    def hold() -> None:
        with ident._turn.lock, ident._turn.inside:
            ident._turn.changing = changing
            held.set()
            over.wait(PATIENCE)

    thread = threading.Thread(target=hold, daemon=True)
    thread.start()
    assert held.wait(PATIENCE)

    def work() -> int:
        try:
            ident.update(1.0, 0.5)
        except rp.InUseError:
            return 8
        return 7 if ident.taken == 1 else 9

    try:
        assert in_child(work) == expected
    finally:
        over.set()
        thread.join(PATIENCE)


@needs_fork
def test_a_fork_within_a_call_of_the_same_thread_goes_on() -> None:
    turn = Turn()
    with turn.lock, turn.inside:
        turn.begin_child()
        assert turn.inside.locked()
    with turn.lock:
        pass


def test_a_new_process_gets_a_copy() -> None:
    one = STATEFUL["running"]()
    work = "import pickle, sys; sys.stdout.buffer.write(pickle.load(sys.stdin.buffer).to_bytes())"
    done = subprocess.run([sys.executable, "-c", work], input=pickle.dumps(one), stdout=subprocess.PIPE, check=True)
    assert done.stdout == one.to_bytes()
