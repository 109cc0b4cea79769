"""Ensembles: every member is the single identifier that it would be by itself."""

from __future__ import annotations

import _thread
import copy
import itertools
import multiprocessing
import pickle
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import replant as rp
from replant.estimation.engine import vector_blocks
from replant.estimation.optimizers import OPTIMIZERS
from replant.kernels import schema as at
from replant.kernels.lanes import LANES
from replant.online import ensemble_members
from replant.online.ensemble_members import LEAST
from support.builders import G2, identifier
from support.cases import every, examples

DT, SAMPLES, STRUCTURE = 0.02, 240, rp.Structure(poles=2, zeros=1)
MEMBERS = LANES + LEAST  # a block that is full and one that is not
GRADIENTS = [name for name in OPTIMIZERS if not OPTIMIZERS[name].keeps_covariance]
FILTERS = {
    "exact": rp.StateVariableFilter(cutoff=5.0),
    "foh": rp.StateVariableFilter(cutoff=5.0, input_hold="foh"),
    "gbt": rp.StateVariableFilter(cutoff=5.0, method="gbt"),
}
Members = list[rp.Identifier]


def streams(members: int, samples: int = SAMPLES, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Each member's own input and noisy output, (samples, members)."""
    generator = np.random.default_rng(seed)
    u = generator.choice([-1.0, 1.0], (samples // 8 + 1, members)).repeat(8, axis=0)[:samples]
    y = np.stack([G2.simulate(column, DT) for column in u.T], axis=1)
    return u, y + 0.02 * generator.standard_normal(y.shape)


def spoilt(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The streams with samples that are rejected: at the beginning, at warm-up, and later, of some members alone."""
    u, y = u.copy(), y.copy()
    u[0, 1], y[1, 2], y[3, 3] = np.nan, np.inf, 1e200
    y[5:9, 4], y[:, 6] = np.nan, np.nan
    u[100] = np.nan
    y[150::7, 1] = -np.inf
    return u, y


def follow(members: Sequence[rp.Identifier], u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors (K, M) and parameters (M, K, P) of single identifiers."""
    traces = [member.update_many(u[:, number], y[:, number]) for number, member in enumerate(members)]
    return np.stack([trace.errors for trace in traces], 1), np.stack([trace.parameters for trace in traces])


def state(member: rp.Identifier) -> list[bytes]:
    """All arrays to the bit, but work space: also the drawn rows and the backup, written anew before they are read."""
    arrays = member.clone()._state
    arrays.backup[:] = 0.0
    arrays.work[:] = 0.0
    arrays.ints[at.ROWS :] = 0
    return [one.tobytes() for one in arrays.arrays]


def check_twins(make: Callable[[], Members], u: np.ndarray, y: np.ndarray, **options: Any) -> rp.Ensemble:
    """Compare an ensemble with its members by themselves, to the bit."""
    alone, ensemble = make(), rp.Ensemble(make(), **options)
    errors, parameters = follow(alone, u, y)
    traces = ensemble.trace(u, y)
    np.testing.assert_array_equal(np.stack([trace.errors for trace in traces], 1), errors)
    np.testing.assert_array_equal(np.stack([trace.parameters for trace in traces]), parameters)
    np.testing.assert_array_equal(ensemble.parameters, parameters[:, -1])
    for number, single in enumerate(alone):
        assert state(ensemble.member(number)) == state(single)
    return ensemble


def sweep(
    optimizer: str, replay: rp.Replay | None, which: str = "exact", members: int = MEMBERS, **changes: Any
) -> Members:
    """Members of one optimizer, each with a scaling of its own."""
    made = OPTIMIZERS[optimizer].suggested(DT, 5)
    return [
        identifier(
            made, structure=STRUCTURE, dt=DT, filter=FILTERS[which], replay=replay,
            scaling=rp.Scaling(0.5 + 0.1 * number, (1.0, 2.0, 0.5, 1.5)), **changes,
        )
        for number in range(members)
    ]  # fmt: skip


REPLAY = rp.Replay(capacity=60, batch_size=5, warmup=6)


@every("replay", [None, REPLAY], ids=["plain", "replay"])
@every("optimizer", GRADIENTS, quick=3)
def test_every_optimizer_in_a_block_gives_the_same_bits(optimizer: str, replay: rp.Replay | None) -> None:
    ensemble = check_twins(lambda: sweep(optimizer, replay), *streams(MEMBERS))
    assert [block.members for block in ensemble._blocks] == [LANES, LEAST]
    assert set(ensemble.status) == {"running"}


@every("which", FILTERS)
@every("replay", [None, REPLAY], ids=["plain", "replay"])
def test_rejected_samples_touch_their_own_member_alone(which: str, replay: rp.Replay | None) -> None:
    def make() -> Members:
        return sweep("amsgrad", replay, which, preprocess=rp.Preprocess("square", 0.3, -0.2))

    u, y = spoilt(*streams(MEMBERS))
    ensemble = check_twins(make, u, y)
    accepted = np.isfinite(u) & (np.abs(y) <= 1e150)
    assert ensemble.samples.tolist() == accepted.sum(axis=0).tolist()


LANE = [0, LANES // 2 - 1, LANES // 2, LANES - 1]


@pytest.mark.slow
@every("lane", LANE)
@every("value", [1e200, np.nan, -np.inf])
@every("which", [0, 1], ids=["u", "y"])
def test_a_sample_that_is_rejected_is_noticed_in_any_lane(which: int, value: float, lane: int) -> None:
    signals = streams(LANES, 60)
    signals[which][40, lane] = value
    ensemble = check_twins(lambda: sweep("adam", REPLAY, members=LANES), *signals)
    assert ensemble.samples.tolist() == [60 - (number == lane) for number in range(LANES)]


@every("lane", LANE)
def test_a_member_that_diverges_is_noticed_in_any_lane(lane: int) -> None:
    def make() -> Members:
        return [
            identifier(rp.Gradient(1e160 if number == lane else 0.5), structure=STRUCTURE, dt=DT, normalize=False)
            for number in range(LANES)
        ]

    ensemble = check_twins(make, *streams(LANES, 60))
    assert [number for number, status in enumerate(ensemble.status) if status == "diverged"] == [lane]


def test_members_of_other_seeds_and_settings() -> None:
    def make() -> Members:
        return [
            identifier(
                rp.AMSGrad(1e-3 * (1 + number)), structure=STRUCTURE, dt=DT * (1 + number % 2), normalize=number != 5,
                filter=rp.StateVariableFilter(cutoff=3.0 + number),
                replay=rp.Replay(capacity=50 + 10 * (number == 9), batch_size=4, warmup=4, seed=number // 2),
            )
            for number in range(LANES + 2)
        ]  # fmt: skip

    ensemble = check_twins(make, *streams(LANES + 2))
    together = [number for number in range(LANES + 2) if number not in (5, 9)]
    assert [block.numbers.tolist() for block in ensemble._blocks] == [together]


def test_a_member_that_diverges_is_undone_and_the_others_do_not_see_it() -> None:
    def make() -> Members:
        gains = [0.5] * 9
        gains[4] = 1e160
        return [
            identifier(rp.Gradient(gain), structure=STRUCTURE, dt=DT, normalize=False, replay=REPLAY) for gain in gains
        ]

    ensemble = check_twins(make, *streams(9))
    assert [number for number, status in enumerate(ensemble.status) if status == "diverged"] == [4]
    assert np.isfinite(ensemble.parameters).all()


def test_every_kind_of_member_beside_the_others() -> None:
    def make() -> Members:
        return [
            rp.Identifier(STRUCTURE, DT, startup=100),
            *sweep("adam", REPLAY, members=LEAST),
            rp.Identifier(STRUCTURE, DT, optimizer="amsgrad", instruments=False, startup=60),
            identifier("recursive-least-squares", structure=STRUCTURE, dt=DT),
            identifier("kalman-tracking", structure=STRUCTURE, dt=DT),
            identifier(structure=rp.Structure(2, 1, delay=0.05), dt=DT),
            *sweep("gradient", None, members=LEAST),
            identifier(structure=STRUCTURE, dt=DT, preprocess=rp.Preprocess(input_map=np.tanh)),
        ]

    ensemble = check_twins(make, *streams(6 + 2 * LEAST), n_jobs=2)
    assert sorted(block.members for block in ensemble._blocks) == [LEAST, LEAST]


def test_a_start_up_of_their_own_then_a_block_together() -> None:
    def make() -> Members:
        return [rp.Identifier(STRUCTURE, DT, optimizer="amsgrad", instruments=False, startup=60) for _ in range(6)]

    u, y = streams(6)
    y[10, 2] = np.nan  # begins one sample later, so lies in no block with the others
    ensemble = check_twins(make, u, y)
    assert [block.numbers[: block.members].tolist() for block in ensemble._blocks] == [[0, 1, 3, 4, 5]]


@settings(max_examples=examples(25), deadline=None)
@given(
    cuts=st.lists(st.integers(0, 120), max_size=5),
    bad=st.lists(st.tuples(st.integers(0, 119), st.integers(0, 9)), max_size=12),
    seeds=st.lists(st.integers(0, 2), min_size=10, max_size=10),
    batch=st.integers(1, 6),
    replay=st.booleans(),
)
def test_any_chunks_rejections_and_seeds(
    cuts: list[int], bad: list[tuple[int, int]], seeds: list[int], batch: int, replay: bool
) -> None:
    def make() -> Members:
        return [
            identifier(
                rp.Adam(0.01), structure=STRUCTURE, dt=DT,
                replay=rp.Replay(capacity=30, batch_size=batch, warmup=9, seed=seed) if replay else None,
            )
            for seed in seeds
        ]  # fmt: skip

    u, y = streams(10, 120)
    for k, number in bad:
        y[k, number] = np.nan
    alone, ensemble = make(), rp.Ensemble(make())
    expected, _ = follow(alone, u, y)
    edges = [0, *sorted(cuts), 120]
    errors = [ensemble.update_many(u[a:b], y[a:b]) for a, b in itertools.pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(errors), expected)
    for number, single in enumerate(alone):
        assert state(ensemble.member(number)) == state(single)


@pytest.mark.parametrize("tile", [1, 7, SAMPLES - 1])
def test_how_many_samples_a_block_takes_at_once_changes_nothing(tile: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector_blocks, "TILE", tile)
    check_twins(lambda: sweep("amsgrad", REPLAY), *spoilt(*streams(MEMBERS)))


def test_sample_by_sample() -> None:
    u, y = spoilt(*streams(MEMBERS, 180))
    alone, ensemble = sweep("amsgrad", REPLAY), rp.Ensemble(sweep("amsgrad", REPLAY))
    expected, parameters = follow(alone, u, y)
    errors = np.stack([ensemble.update(*one) for one in zip(u, y, strict=True)])
    np.testing.assert_array_equal(errors, expected)
    np.testing.assert_array_equal(ensemble.parameters, parameters[:, -1])


def test_one_input_or_one_record_for_all_members() -> None:
    u, y = streams(MEMBERS)
    one, many = (rp.Ensemble(sweep("adam", REPLAY)) for _ in range(2))
    all_u, all_y = np.repeat(u[:, :1], MEMBERS, axis=1), np.repeat(y[:, :1], MEMBERS, axis=1)
    np.testing.assert_array_equal(one.update_many(u[:, 0], y), many.update_many(all_u, y))
    np.testing.assert_array_equal(one.update_many(u[:, 0], y[:, 0]), many.update_many(all_u, all_y))
    np.testing.assert_array_equal(one.update(1.0, 2.0), many.update(np.ones(MEMBERS), np.full(MEMBERS, 2.0)))
    np.testing.assert_array_equal(one.parameters, many.parameters)


@pytest.mark.parametrize("n_jobs", [2, -1, -100])
def test_threads_change_nothing(n_jobs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble_members, "PORTION", 50)  # so that they take turns at the same members
    u, y = streams(2 * MEMBERS)
    one, many = (
        rp.Ensemble(sweep("adam", REPLAY, members=2 * MEMBERS)),
        rp.Ensemble(sweep("adam", REPLAY, members=2 * MEMBERS), n_jobs=n_jobs),
    )
    np.testing.assert_array_equal(many.update_many(u, y), one.update_many(u, y))
    np.testing.assert_array_equal(many.parameters, one.parameters)


@pytest.fixture
def helpers(monkeypatch: pytest.MonkeyPatch) -> list[threading.Event]:
    """Threads that ensembles have begun: each event says that one has ended."""
    begun: list[threading.Event] = []
    start = _thread.start_new_thread

    def begin(run: Callable[..., None], given: tuple[Any, ...]) -> int:
        ended = threading.Event()
        begun.append(ended)
        return start(lambda: (run(*given), ended.set()), ())

    monkeypatch.setattr(ensemble_members._thread, "start_new_thread", begin)
    return begun


def test_a_thread_helps_with_one_chunk_after_the_other_and_ends_with_the_ensemble(
    helpers: list[threading.Event],
) -> None:
    u, y = streams(2 * MEMBERS)
    ensemble = rp.Ensemble(sweep("adam", REPLAY, members=2 * MEMBERS), n_jobs=2)
    for _ in range(3):
        ensemble.update_many(u, y)
    (ended,) = helpers
    assert not ended.is_set()
    del ensemble
    assert ended.wait(60.0)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems begin a process anew")
def test_a_fork_has_a_helper_of_its_own(helpers: list[threading.Event]) -> None:
    u, y = streams(2 * MEMBERS)
    ensemble = rp.Ensemble(sweep("adam", REPLAY, members=2 * MEMBERS), n_jobs=2)
    ensemble.update_many(u, y)
    assert len(helpers) == 1
    queue = multiprocessing.get_context("fork").SimpleQueue()
    process = multiprocessing.get_context("fork").Process(
        target=lambda: queue.put((ensemble.update_many(u, y), len(helpers)))
    )
    process.start()
    errors, begun = queue.get()
    process.join()
    np.testing.assert_array_equal(errors, ensemble.update_many(u, y))
    assert (begun, len(helpers)) == (2, 1)


def test_a_member_goes_on_by_itself_with_time_stamps_too() -> None:
    u, y = streams(MEMBERS)
    alone, ensemble = sweep("amsgrad", REPLAY), rp.Ensemble(sweep("amsgrad", REPLAY))
    follow(alone, u, y)
    ensemble.update_many(u, y)
    member, t = ensemble.member(3), np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, SAMPLES)) * DT
    before = ensemble.parameters
    expected = alone[3].update_many(u[:, 3], y[:, 3], t)
    np.testing.assert_array_equal(member.update_many(u[:, 3], y[:, 3], t).parameters, expected.parameters)
    np.testing.assert_array_equal(ensemble.parameters, before)


def test_members_that_have_begun_come_as_they_are() -> None:
    u, y = streams(MEMBERS)
    begun = sweep("amsgrad", REPLAY)
    for number, member in enumerate(begun):
        member.update_many(u[: 3 * number, number], y[: 3 * number, number])
    ensemble = rp.Ensemble(begun)
    errors = ensemble.update_many(u[60:], y[60:])
    expected, _ = follow(begun, u[60:], y[60:])
    np.testing.assert_array_equal(errors, expected)


def test_freeze_resume_and_reset() -> None:
    u, y = streams(MEMBERS)
    ensemble, alone = rp.Ensemble(sweep("adam", REPLAY)), sweep("adam", REPLAY)
    first = ensemble.update_many(u, y)
    ensemble.freeze()
    frozen = ensemble.parameters
    ensemble.update_many(u, y)
    np.testing.assert_array_equal(ensemble.parameters, frozen)
    ensemble.resume()
    ensemble.update_many(u, y)
    for number, single in enumerate(alone):
        single.update_many(u[:, number], y[:, number])
        single.freeze()
        single.update_many(u[:, number], y[:, number])
        single.resume()
        single.update_many(u[:, number], y[:, number])
        assert state(ensemble.member(number)) == state(single)
    ensemble.reset()
    assert ensemble.samples.tolist() == [0] * MEMBERS
    np.testing.assert_array_equal(ensemble.update_many(u, y), first)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
def test_a_copy_goes_on_by_itself(again: Callable[[rp.Ensemble], rp.Ensemble]) -> None:
    u, y = streams(MEMBERS)
    ensemble = rp.Ensemble(sweep("adam", REPLAY), n_jobs=2)
    ensemble.update_many(u, y)
    other, before = again(ensemble), ensemble.parameters
    after = other.update_many(u, y)
    np.testing.assert_array_equal(ensemble.parameters, before)
    np.testing.assert_array_equal(ensemble.update_many(u, y), after)


def test_what_an_ensemble_shows() -> None:
    mine = identifier(structure=STRUCTURE, dt=DT)
    ensemble = rp.Ensemble(mine, members=4)
    ensemble.update_many(*(column[:, 0] for column in streams(4)))
    assert len(ensemble) == 4
    assert ensemble.names == STRUCTURE.names
    assert ensemble.samples.tolist() == [SAMPLES] * 4
    assert mine.samples == 0
    assert [G.num.size for G in ensemble.transfer_functions] == [2] * 4
    assert len(rp.Ensemble(mine)) == 1


@every(
    ("make", "message"),
    [
        (lambda: rp.Ensemble([]), "empty"),
        (lambda: rp.Ensemble(identifier(), members=0), "members must be at least 1"),
        (lambda: rp.Ensemble([identifier()], members=2), "members goes with one identifier"),
        (lambda: rp.Ensemble([identifier(), identifier(structure=rp.Structure(1))]), "same parameters"),
        (lambda: rp.Ensemble([identifier(), 3]), "got a int among them"),
        (lambda: rp.Ensemble(identifier(), 2, n_jobs=0), "n_jobs must not be 0"),
        (lambda: rp.Ensemble(identifier(), 2, n_jobs=1.5), "n_jobs must be a whole number"),
        (lambda: rp.Ensemble(3), "identifiers must be an Identifier .* or a sequence of them, got int"),
        (lambda: rp.Ensemble(identifier(), 2).update(np.zeros(3), 0.0), r"u must be a number or have shape \(2,\)"),
        (lambda: rp.Ensemble(identifier(), 2).update_many([1.0], [[1.0] * 3]), r"\(K, 2\), a column a member"),
        (lambda: rp.Ensemble(identifier(), 2).update_many(np.zeros(3), np.zeros(4)), "same length, got 3 and 4"),
        (lambda: rp.Ensemble(identifier(), 2).update_many(["a"], [1.0]), "u must hold real numbers"),
        (lambda: rp.Ensemble(rp.Identifier(STRUCTURE, DT), 2).freeze(), "freezing needs a model"),
    ],
)  # fmt: skip
def test_mistakes(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(rp.ReplantError, match=message):
        make()


def test_an_ensemble_says_what_it_is_in_a_line() -> None:
    ensemble = rp.Ensemble(rp.Identifier(STRUCTURE, DT), 3)
    assert repr(ensemble) == "<Ensemble of 3 identifiers of a1, a0, b1, b0: 0 samples, 3 starting>"
    u, y = streams(3, 2000)
    y[:, 2] = np.nan
    ensemble.update_many(u, y)
    assert repr(ensemble) == "<Ensemble of 3 identifiers of a1, a0, b1, b0: 2,000 samples, 2 running, 1 starting>"
