"""The step kernel's buffer: what is stored where, what is drawn, and what a rejected sample leaves behind."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import State
from replant.kernels import schema as at
from replant.kernels.step import single
from replant.kernels.step.stages import KEEP_AFTER_LEAST, KEEP_AFTER_PART, remember
from support.builders import is_finite
from support.cases import every


def prepared(replay: rp.Replay | None, **changes: object) -> State:
    ident = rp.Identifier(
        rp.Structure(poles=1),
        0.1,
        filter=rp.StateVariableFilter(cutoff=2.0),
        scaling=None,
        optimizer=rp.Gradient(gain=1.0),
        replay=replay,
        instruments=False,
    )
    return State.of_settings(dataclasses.replace(ident.settings, **changes), recent=0)


def arrays(state: State) -> tuple[np.ndarray, ...]:
    return state.arrays


def take(state: State, u: float, y: float, t: float = np.nan) -> float:
    return single.by_gradient[0](*arrays(state), u, y, t, np.nan)


def learn_number(state: State, k: float) -> int:
    """Store the number k in the place of a sample; return how many rows are drawn."""
    state.phi[:] = k, -k
    return remember(state.fields, 10.0 * k)


def remember_many(replay: rp.Replay, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Store samples whose regressor and target hold their own number; return the buffer and the rows of each batch."""
    state = prepared(replay)
    batches = []
    for k in range(count):
        size = learn_number(state, k)
        batches.append(state.ints[at.ROWS : at.ROWS + size].copy())
    return state.buffer, batches


@every("count", [1, 7, 8, 9, 20, 163])
def test_a_full_buffer_holds_exactly_the_newest_samples(count: int) -> None:
    buffer, _ = remember_many(rp.Replay(capacity=8, batch_size=3, warmup=2), count)
    numbers = np.arange(max(0, count - 8), count)
    rows = buffer[: numbers.size]
    rows = rows[np.argsort(rows[:, 2])]
    squares = 2.0 * numbers**2
    np.testing.assert_array_equal(rows, np.stack([numbers, -numbers, 10 * numbers, 1 / (1 + squares)], axis=1))
    assert (buffer[numbers.size :] == 0).all()


def test_without_normalisation_every_weight_is_one() -> None:
    state = prepared(rp.Replay(capacity=4), normalize=False)
    state.phi[:] = 3.0, 4.0
    remember(state.fields, 1.0)
    np.testing.assert_array_equal(state.buffer[0], [3.0, 4.0, 1.0, 1.0])


def test_instruments_lie_beside_the_regressor_and_carry_the_weight() -> None:
    """1/m^2 is that of zeta: the noise of phi would correlate with it."""
    state = prepared(rp.Replay(capacity=4), instruments=True)
    state.phi[:] = 3.0, 4.0
    state.zeta[:] = 1.0, 2.0
    remember(state.fields, 7.0)
    np.testing.assert_array_equal(state.buffer[0], [3.0, 4.0, 7.0, 1.0 / 6.0, 1.0, 2.0])


@every(("capacity", "warmup"), [(8, 0), (8, 3), (8, 7), (8, 8), (8, 99), (50, 20)])
def test_batches_begin_once_more_than_the_warm_up_is_stored_or_the_buffer_is_full(capacity: int, warmup: int) -> None:
    _, batches = remember_many(rp.Replay(capacity=capacity, batch_size=5, warmup=warmup), 3 * capacity)
    first = min(warmup + 1, capacity)
    assert [rows.size for rows in batches] == [5 if k + 1 >= first else 1 for k in range(3 * capacity)]


@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_the_newest_sample_comes_last_and_the_others_from_the_filled_part(seed: int) -> None:
    _, batches = remember_many(rp.Replay(capacity=16, batch_size=4, warmup=0, seed=seed), 60)
    for k, rows in enumerate(batches):
        assert rows[-1] == k % 16
        assert rows.min() >= 0
        assert rows.max() <= min(k, 15)


@every("seed", [0, 1, 2**63 - 1])
@every("wraps", [1, 2, 5])
def test_after_wrap_around_every_row_is_drawn_alike(seed: int, wraps: int) -> None:
    """Draws while the buffer is filled over again, as the printed Algorithm 3 would spoil them.

    N draws from 32 rows: Pearson's chi-square has 31 degrees of freedom, mean 31, standard deviation sqrt(62) = 7.9;
    the bound lies eight of these above the mean.
    """
    capacity = 32
    _, batches = remember_many(
        rp.Replay(capacity=capacity, batch_size=101, warmup=0, seed=seed), (wraps + 1) * capacity
    )
    draws = np.concatenate([rows[:-1] for rows in batches[wraps * capacity :]])
    counts = np.bincount(draws, minlength=capacity)
    expected = draws.size / capacity
    assert draws.size == 100 * capacity
    assert counts.min() > 0
    assert float(((counts - expected) ** 2).sum() / expected) < 31 + 8 * np.sqrt(62)
    # and already in the first sample after the wrap, not only once the buffer has filled again
    assert batches[wraps * capacity][:-1].max() > capacity // 2


def test_without_replay_each_sample_is_learned_once() -> None:
    state = prepared(None)
    assert state.buffer.shape == (1, 4)
    for k in range(5):
        assert learn_number(state, k) == 1
        assert state.ints[at.ROWS] == 0
        assert state.buffer[0, 2] == 10.0 * k


@every("replay", [None, rp.Replay(capacity=5, batch_size=3, warmup=1)], ids=["plain", "replay"])
@every(
    ("u", "y", "slot"),
    [
        (np.nan, 1.0, State.not_finite.index),
        (1.0, np.nan, State.not_finite.index),
        (np.inf, 1.0, State.not_finite.index),
        (1.0, -np.inf, State.not_finite.index),
        (1e308, 1.0, State.too_large.index),
        (1.0, -1e308, State.too_large.index),
        (1.0, np.nextafter(at.LARGEST, np.inf), State.too_large.index),
    ],
    ids=repr,
)
def test_a_rejected_sample_changes_its_count_alone(replay: rp.Replay | None, u: float, y: float, slot: int) -> None:
    state = prepared(replay)
    for before in (0, 7):  # a fresh identifier, then one under way
        for k in range(before):
            take(state, np.cos(k), np.sin(k))
        expected, others = state.ints.copy(), [array.tobytes() for array in arrays(state)[1:]]
        expected[slot] += 1
        assert np.isnan(take(state, u, y))
        np.testing.assert_array_equal(state.ints, expected)
        assert [array.tobytes() for array in arrays(state)[1:]] == others


@every(
    ("t", "slot"),
    [
        (np.inf, State.not_finite.index),
        (-np.inf, State.not_finite.index),
        (0.6, State.not_later.index),
        (0.5, State.not_later.index),
        (-1e9, State.not_later.index),
    ],
    ids=repr,
)
def test_a_rejected_stamp_changes_its_count_alone(t: float, slot: int) -> None:
    state = prepared(rp.Replay(capacity=5, batch_size=3, warmup=1))
    for k in range(7):
        take(state, np.cos(k), np.sin(k), 0.1 * k)
    expected, others = state.ints.copy(), [array.tobytes() for array in arrays(state)[1:]]
    expected[slot] += 1
    if slot == State.not_later.index:  # ten in a row would be a clock that was set
        expected[State.earlier_stamps.index] += 1
    assert np.isnan(take(state, 1.0, 1.0, state.last_time if t == 0.6 else t))
    state.earlier_time = 0.0
    np.testing.assert_array_equal(state.ints, expected)
    assert [array.tobytes() for array in arrays(state)[1:]] == others


def test_the_largest_sample_is_still_accepted() -> None:
    state = prepared(None)
    assert np.isfinite(take(state, at.LARGEST, -at.LARGEST))
    assert state.samples == 1
    assert np.isfinite(take(state, 1.0, 1.0))
    assert is_finite(state)


@every(
    "settings",
    [
        {"optimizer": rp.RecursiveLeastSquares(0.999)},
        {"optimizer": rp.RecursiveLeastSquares(), "filter": rp.StateVariableFilter(2.0), "instruments": False},
        {"optimizer": "amsgrad"},
    ],
)
def test_an_estimate_is_kept_at_the_sample_at_which_it_is_due(settings: dict[str, Any]) -> None:
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 250), 8)
    ident = rp.Identifier(rp.Structure(1), 0.05, startup=100, **settings)
    ident.update_many(u, rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.05))
    state = ident._state
    kept = np.sort(state.past[:, 0]).astype(int)
    assert state.past_kept > len(kept) > 2
    for before, sample in zip(kept, [*kept[1:], state.past_due], strict=True):
        assert sample - before == min(max(before // KEEP_AFTER_PART, KEEP_AFTER_LEAST), state.past_step)
