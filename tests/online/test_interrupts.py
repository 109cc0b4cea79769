"""An interrupt leaves the state after a whole number of samples, with all that was due: nothing is half done."""

from __future__ import annotations

import copy
import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.online import ensemble_members, lifecycle, revision
from support.cases import every, examples
from support.interrupts import interrupt

DT = 0.1
SAMPLES = examples(480, 400)
CONFIRMS = SAMPLES // 3 + 1  # the sample that confirms a leap of the input
FIXED = {"filter": rp.StateVariableFilter(cutoff=1.0), "instruments": False, "startup": 20}


def stream(seed: int) -> tuple[FloatArray, FloatArray]:
    """Return a record with a start-up, solutions, reviews, an alarm, rejected samples and inputs that leap."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 8 + 1), 8)[:SAMPLES]
    y = rp.TransferFunction([2.0], [1.0, 1.2, 1.0]).simulate(u, dt=DT) + 0.03 * rng.standard_normal(SAMPLES)
    y[3 * SAMPLES // 5 :] *= 3.0
    y[SAMPLES // 8], y[SAMPLES // 2] = np.nan, 50.0
    u[SAMPLES // 4], u[SAMPLES // 3 : SAMPLES // 3 + 2] = 1e7, 1e7
    return u, y


def go_on(one: Any, u: FloatArray, y: FloatArray, rng: np.random.Generator) -> Callable[[], None]:
    """Return what takes some of the samples that are left: one by one, or a chunk."""
    begin, step = one.taken, int(rng.choice([1, 20, 100]))
    if step > 1:
        return lambda: one.update_many(u[begin : begin + step], y[begin : begin + step])

    def one_by_one() -> None:
        for k in range(begin, min(begin + 20, u.size)):
            one.update(u[k], y[k])

    return one_by_one


def interrupted(one: Any, twin: Any, seed: int, most: int, same: Callable[[Any, Any], bool]) -> int:
    """Take a stream with interrupts at random instants; compare after each; return how many there were."""
    u, y = stream(seed)
    rng, count = np.random.default_rng(seed), 0
    while one.taken < u.size:
        work, after = go_on(one, u, y, rng), int(10.0 ** rng.uniform(0.3, 4.2))
        if count >= most:
            work()
        elif interrupt(work, after):
            count += 1
            done = one.taken
            twin.update_many(u[twin.taken : done], y[twin.taken : done])
            if done == CONFIRMS:  # it may have been looked at, so that the one before is taken
                one.update_many(u[done : done + 1], y[done : done + 1])
                twin.update_many(u[done : done + 1], y[done : done + 1])
            assert same(one, twin), f"seed {seed}, interrupt {count}, {done} samples"
    twin.update_many(u[twin.taken :], y[twin.taken :])
    assert same(one, twin), f"seed {seed}, at the end"
    return count


def equal(one: rp.Identifier, twin: rp.Identifier) -> bool:
    return one.to_bytes() == twin.to_bytes()


def all_equal(one: rp.Ensemble, twin: rp.Ensemble) -> bool:
    """Whether all that members show is equal to the bit; a block's work space is not a member's."""
    pairs = [(one.member(n), twin.member(n)) for n in range(len(one))]
    return all(
        a.samples == b.samples
        and a.taken == b.taken
        and np.array_equal(a.parameters, b.parameters)
        and np.array_equal(a.recent, b.recent)
        and a.rejected == b.rejected
        for a, b in pairs
    )


def identifier(seed: int) -> rp.Identifier:
    return rp.Identifier(poles=2, dt=DT, startup=(100, 150, 200)[seed % 3])


def sweep(n_jobs: int, defaults: int = 2) -> rp.Ensemble:
    steps = [rp.Identifier(rp.Structure(2), DT, optimizer=rp.AMSGrad(step), **FIXED) for step in (1e-4, 1e-3, 1e-2)]
    return rp.Ensemble([*steps, *(identifier(seed) for seed in range(defaults))], n_jobs=n_jobs)


def test_an_interrupted_identifier_goes_on_as_if_it_had_not_been() -> None:
    assert interrupted(identifier(1), identifier(1), 1, 4, equal) == 4


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_an_interrupted_identifier_goes_on_as_if_it_had_not_been_at_many_instants(seed: int) -> None:
    assert interrupted(identifier(seed), identifier(seed), seed, 25, equal) > 0  # the others came after the work's end


@pytest.mark.slow
@pytest.mark.parametrize("n_jobs", [1, 2])
def test_an_interrupted_ensemble_goes_on_as_if_it_had_not_been_at_many_instants(
    n_jobs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ensemble_members, "PORTION", 64)
    assert interrupted(sweep(n_jobs), sweep(1), 0, 6, all_equal) == 6


def test_what_is_interrupted_can_be_done_again() -> None:
    done_again("freeze", 500)


@pytest.mark.slow
def test_what_is_interrupted_can_be_done_again_at_many_instants() -> None:
    for what in ("finish", "freeze", "resume", "reset"):
        done_again(what, 40)


def done_again(what: str, growth: int) -> None:
    """Interrupt a call at instants each so many times as late as the one before; it is whole or was not begun."""
    u, y = stream(0)
    start = identifier(0)
    start.update_many(u[: SAMPLES // 2], y[: SAMPLES // 2])
    assert start._state.alarm  # to be looked into
    whole = start.clone()
    getattr(whole, what)()
    after = 1
    while True:
        one = start.clone()
        if not interrupt(getattr(one, what), after):
            break
        assert one.to_bytes() in (start.to_bytes(), whole.to_bytes()), f"{what}, instant {after}"
        getattr(one, what)()
        assert one.to_bytes() == whole.to_bytes(), f"{what}, instant {after}"
        after = growth * after
    assert after > 1


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="the system has no interval timer")
def test_a_long_chunk_answers_a_signal() -> None:
    """A handler that raises, as that of Ctrl-C does, is called within the chunk, long before its end."""
    u, y = stream(0)
    ident = rp.Identifier(poles=2, dt=DT, startup=200)
    begun = SAMPLES // 2
    ident.update_many(u[:begun], y[:begun])
    u, y = np.tile(u[begun - 80 : begun], 5000), np.tile(y[begun - 80 : begun], 5000)  # some 0.4 s

    class StopError(Exception):
        pass

    def stop(*_: object) -> None:
        raise StopError

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(StopError):
            ident.update_many(u, y)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert begun <= ident.taken < begun + u.size


@pytest.mark.slow
def test_every_sample_is_counted_once() -> None:
    u, y = stream(3)
    t = DT * np.arange(u.size)
    misread = SAMPLES // 2
    t[misread] = 1e6
    t[-110:] += 1e3  # a gap, confirmed
    t[-70] = t[-71]
    ident = identifier(0)
    for k in range(u.size):
        ident.update(u[k], y[k], t[k])
        if k % 50 == 0 or abs(k - misread) < 10 or k > SAMPLES - 10:
            assert ident.taken == k + 1
    assert rp.Identifier.from_bytes(ident.to_bytes()).taken == copy.copy(ident).taken == u.size


def test_samples_dropped_in_a_long_start_up_are_counted() -> None:
    ident = rp.Identifier(poles=2, dt=DT, startup=20_000)
    u, y = np.zeros(25_000), np.zeros(25_000)
    ident.update_many(u, y)
    assert ident.samples < ident.taken == 25_000
    assert rp.Identifier.from_bytes(ident.to_bytes()).taken == 25_000


def test_a_handler_may_read_and_save_and_may_not_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """The record is solved again within a call; a signal may be handled meanwhile."""
    u, y = (signal[: SAMPLES // 2] for signal in stream(1))  # before the plant changes
    plain, ident = identifier(0), identifier(0)
    plain.update_many(u, y)
    whole, saved = revision.renew, []

    def handled(*given: Any) -> Any:
        saved.append((ident.taken, ident.to_bytes()))
        with pytest.raises(rp.InUseError, match="signal handler"):
            ident.update(1.0, 1.0)
        return whole(*given)

    monkeypatch.setattr(revision, "renew", handled)
    ident.update_many(u, y)
    monkeypatch.undo()
    assert equal(ident, plain)
    assert saved
    for taken, data in (saved[0], saved[-1]):
        again = rp.Identifier.from_bytes(data)
        again.update_many(u[taken:], y[taken:])
        assert equal(again, plain)


@every("seed", [1, 0, 2], quick=1)
def test_a_review_writes_to_none_of_the_raw_samples_it_was_given(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupted one is begun again with the same samples, of which it has no copy."""
    u, y = stream(seed)
    ident, looked, whole = identifier(seed), [], lifecycle.revise

    def watched(state: Any, *given: Any) -> Any:
        before, array = state.recent.copy(), state.recent
        result = whole(state, *given)
        looked.append(np.array_equal(before, array))
        return result

    monkeypatch.setattr(lifecycle, "revise", watched)
    ident.update_many(u, y)
    assert len(looked) > 3
    assert all(looked)
