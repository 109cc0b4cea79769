"""Samples that leap, in time or input: held back until the next one tells, by `update` as by `update_many`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.kernels import schema as at
from support.builders import state
from support.cases import every

DT, PLANT, STRUCTURE = 0.05, rp.TransferFunction([2.0], [1.0, 0.5]), rp.Structure(1)
OPTIMIZERS: dict[str, dict[str, Any]] = {
    "default": {},
    "tracking": {"optimizer": rp.KalmanTracking(1e-3)},
    "gradient": {"optimizer": "amsgrad", "instruments": False},
}


def made(name: str = "default", startup: int = 100) -> rp.Identifier:
    return rp.Identifier(STRUCTURE, DT, startup=startup, **OPTIMIZERS[name])


def measured(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    u = np.repeat(generator.choice([-1.0, 1.0], -(-samples // 8)), 8)[:samples]
    return u, PLANT.simulate(u, DT) + 0.02 * generator.standard_normal(samples), DT * np.arange(samples)


def garbled(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A record with gaps, set clocks, misread stamps and inputs, lone and several in a row, and missing outputs."""
    u, y, t = measured(samples)
    generator = np.random.default_rng(seed)
    for k in generator.integers(0, samples, 4):
        t[k:] += generator.choice([3.0, 3600.0, -7.0, -3600.0])
    for k in generator.integers(0, samples, 12):
        t[k : k + generator.integers(1, 3)] = generator.choice([1e6, 1e12, 1e16, 1e300, -1e300, -1.0, 0.0, math.inf])
    for k in generator.integers(0, samples, 6):
        u[k : k + generator.integers(1, 3)] = generator.choice([2.0**32, 1e16, 1e300, math.nan, -1e6])
    for k in generator.integers(0, samples, 6):
        y[k : k + generator.integers(1, 9)] = generator.choice([math.nan, 1e16, 1e300])
    return u, y, t


@every("seed", range(3), quick=1)
@every("name", OPTIMIZERS, quick=2)
def test_chunks_and_checkpoints_at_any_place_change_no_bit(name: str, seed: int) -> None:
    u, y, t = garbled(250, seed)
    whole, loop, parts = (made(name) for _ in range(3))
    expected = whole.update_many(u, y, t)
    errors = [loop.update(*one) for one in zip(u.tolist(), y.tolist(), t.tolist(), strict=True)]
    places = np.random.default_rng([seed, 1]).choice(np.arange(1, u.size), 30, replace=False)
    pieces = []
    for part in np.split(np.arange(u.size), np.sort(places)):
        pieces.append(parts.update_many(u[part], y[part], t[part]))
        parts = rp.Identifier.from_bytes(parts.to_bytes())
    np.testing.assert_array_equal(errors, expected.errors)
    np.testing.assert_array_equal(np.concatenate([piece.errors for piece in pieces]), expected.errors)
    assert whole.rejected == loop.rejected == parts.rejected
    assert whole.to_bytes() == loop.to_bytes() == parts.to_bytes()


@pytest.mark.slow
@every("seed", range(6), quick=2)
def test_every_sample_is_accepted_or_counted(seed: int) -> None:
    ident = made()
    ident.update_many(*garbled(600, seed))
    bridged = ("outlier", "stuck", "no output")
    assert ident.samples + sum(n for reason, n in ident.rejected.items() if reason not in bridged) == 600


@every("name", OPTIMIZERS)
@every("gap", [60 * DT, 3600.0, 1e7])
def test_a_gap_costs_no_sample(name: str, gap: float) -> None:
    """Held back and taken is the same as taken at once."""
    u, y, t = measured(500)
    t[300:] += gap
    ident, at_once = made(name), made(name)
    ident.update_many(u, y, t)
    at_once.update_many(u[:300], y[:300], t[:300])
    at_once._state.held_at = at.BELIEVED  # the first one is not held back
    at_once._steps(
        *at_once._state.arrays, u[300:301], y[300:301], t[300:301], np.empty(0), np.empty(1), np.empty((1, 0))
    )
    at_once._state.held_at = 0
    at_once.update_many(u[301:], y[301:], t[301:])
    assert ident._state.held_at == 0
    held = [
        at.StateSlots.held_input.index,
        at.StateSlots.held_output.index,
        at.StateSlots.held_time.index,
        at.StateSlots.held_reference.index,
    ]
    at_once._state.reals[held] = ident._state.reals[held]
    assert ident.samples == 500
    assert ident.rejected["time leap"] == 0
    assert state(ident) == state(at_once)


def test_while_it_is_held_back_a_sample_counts_as_rejected() -> None:
    u, y, t = measured(300)
    ident = made()
    ident.update_many(u, y, t)
    assert math.isnan(ident.update(1.0, 0.5, t[-1] + 100.0))
    assert (ident.samples, ident.rejected["time leap"]) == (300, 1)
    assert math.isfinite(ident.update(1.0, 0.5, t[-1] + 100.0 + DT))
    assert (ident.samples, ident.rejected["time leap"]) == (302, 0)


def test_stamps_that_always_leap_are_followed_one_sample_late() -> None:
    """A rig that is much slower than was said."""
    u, y, t = measured(300)
    ident = made()
    ident.update_many(u, y, 60.0 * t)
    assert ident.samples + ident.rejected["time leap"] == 300
    assert ident.samples >= 290


@every("where", [0, 1, 50, 99, 100, 101, 250], quick=3)
@every("stamp", [1e12, 1e16, 1e300, -1e300], quick=2)
@every("times", [1, 2], quick=1)
def test_stamps_that_are_misread_end_nothing(where: int, stamp: float, times: int) -> None:
    u, y, t = measured(400)
    t[where : where + times] = stamp + DT * np.arange(times)
    ident = made()
    ident.update_many(u, y, t)
    assert ident.samples >= 400 - times - 11
    assert ident._state.learned == ident.samples
    away = (ident.parameters - [0.5, 2.0]) / ident.uncertainty.std
    assert (np.abs(away) < 5.0).all()


@pytest.mark.slow
@every("regular", [True, False], quick=1)
@every("where", [0, 50, 99, 100, 101, 250], quick=3)
@every("value", [1e4, 2.0**32, -1e16, 1e149], quick=2)
def test_an_input_that_is_misread_is_left_out(where: int, value: float, regular: bool) -> None:
    u, y, t = measured(400)
    u[where] = value
    ident = made()
    ident.update_many(u, y, None if regular else t)
    assert ident.rejected["input leap"] == 1
    assert ident.samples == 399
    assert (np.abs(ident.parameters - [0.5, 2.0]) < (0.1 if regular else 5.0 * ident.uncertainty.std)).all()


def test_an_input_that_stays_far_away_is_believed() -> None:
    u, y, t = measured(400)
    u[300:] *= 1e5
    y[300:] = PLANT.simulate(u, DT)[300:]
    ident = made()
    ident.update_many(u, y, t)
    assert ident.rejected["input leap"] == 0
    assert ident.samples == 400


# --- an output that is missing


def test_of_a_sample_without_output_the_input_is_used() -> None:
    """A third of the outputs is missing, many beside a move of the input; without stamps, too."""
    u, y, t = measured(3000)
    lost = np.random.default_rng(1).random(3000) < 0.33
    lost[:200] = False
    for stamps in (t, None):
        ident = made()
        trace = ident.update_many(u, np.where(lost, math.nan, y), stamps)
        assert ident.rejected["no output"] == lost.sum()
        assert ident.samples == 3000
        assert np.isnan(trace.errors[lost]).all()
        assert np.isfinite(trace.errors[200:][~lost[200:]]).all()
        assert np.isfinite(ident.recent).all()
        assert (np.abs(ident.parameters - [0.5, 2.0]) < 5.0 * ident.uncertainty.std).all()


def test_nothing_is_learned_from_an_output_that_is_missing() -> None:
    u, y, t = measured(500)
    ident = made()
    ident.update_many(u, y, t)
    before = ident.parameters
    ident.update_many(np.tile([1.0, -1.0], 50), np.full(100, math.nan), t[-1] + DT * np.arange(1, 101))
    # the record may have been solved again meanwhile, from the same outputs
    np.testing.assert_allclose(ident.parameters, before, rtol=1e-4)
    assert (ident.samples, ident.rejected["no output"]) == (600, 100)
    assert ident.assess().status != "trusted"


# --- checkpoints


def test_a_checkpoint_that_holds_a_sample_from_the_future_is_refused() -> None:
    ident = made()
    ident.update_many(*measured(200))
    for value in (at.BELIEVED, 10_000):
        ident._state.held_at = value
        with pytest.raises(rp.CheckpointError, match="points outside"):
            rp.Identifier.from_bytes(ident.to_bytes())
