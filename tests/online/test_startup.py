"""The start-up: what it collects, by which rules, and that neither chunks nor checkpoints matter to it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import STORED
from replant.numerics.arguments import BoolArray, FloatArray
from support.builders import state
from support.cases import every

DT, STRUCTURE = 0.05, rp.Structure(2)
PLANT, TRUE = rp.TransferFunction([4.0], [1.0, 1.2, 4.0]), np.array([1.2, 4.0, 4.0])


def measured(seed: int, samples: int, noise: float = 0.02, hold: int = 3) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], -(-samples // hold)), hold)[:samples]
    return u, PLANT.simulate(u, DT) + noise * random.standard_normal(samples)


def some_missing(y: FloatArray, share: float, seed: int) -> tuple[FloatArray, BoolArray]:
    lost = np.random.default_rng(seed).random(y.size) < share
    lost[0] = False
    return np.where(lost, math.nan, y), lost


def until(outputs: int, lost: BoolArray) -> int:
    """Samples up to the one with the last of so many outputs."""
    return int(np.flatnonzero(np.cumsum(~lost) == outputs)[0]) + 1


# --- outputs that are missing


@pytest.mark.slow
@every("share", [0.05, 0.15], quick=1)
@every("stamped", [False, True])
def test_with_missing_outputs_the_first_model_is_that_of_fit(share: float, stamped: bool) -> None:
    for seed in range(3):
        u, y = measured(seed, 800)
        y, lost = some_missing(y, share, seed)
        samples = until(500, lost)
        t = np.cumsum(DT * (1.0 + 0.2 * np.random.default_rng(seed).random(u.size))) if stamped else None
        ident = rp.Identifier(STRUCTURE, DT)
        ident.update_many(u[: samples - 1], y[: samples - 1], None if t is None else t[: samples - 1])
        assert ident.status == "starting"
        ident.update(u[samples - 1], y[samples - 1], None if t is None else t[samples - 1])
        assert ident.status == "running"
        whole = rp.fit(u[:samples], y[:samples], DT, poles=2, t=None if t is None else t[:samples])
        away = (ident.parameters - whole.parameters) / np.sqrt(np.diag(whole.covariance))
        assert (np.abs(away) < 0.01).all(), seed
        assert ident.samples == samples
        assert ident.rejected["no output"] == lost[:samples].sum() > 0


def test_the_input_of_a_missing_output_is_used() -> None:
    """Without noise the model is exact: the input moves at every sample, and at most of those without an output."""
    u, y = measured(1, 800, noise=0.0, hold=1)
    y, lost = some_missing(y, 0.15, 1)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[: until(500, lost)], y[: until(500, lost)])
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-3)


def test_an_output_that_stands_still_is_said_where_no_first_model_comes() -> None:
    ident = rp.Identifier(STRUCTURE, DT, startup=50)
    ident.update_many(measured(2, 400)[0], np.full(400, 7.0))
    verdict = ident.assess()
    assert verdict.status == "inconsistent"
    assert verdict.reasons[0].startswith("the output is constant over the last ")


def test_an_output_that_is_the_input_is_said_from_the_start_up_on() -> None:
    u = measured(2, 400)[0]
    for samples in (200, 400):
        ident = rp.Identifier(STRUCTURE, DT, startup=300)
        ident.update_many(u[:samples], u[:samples])
        assert ident.assess().reasons[0].startswith("the output is a copy of the input"), samples


def test_a_start_up_counts_outputs_not_samples() -> None:
    u, y = measured(2, 400)
    y, lost = some_missing(y, 0.5, 2)
    ident = rp.Identifier(STRUCTURE, DT, startup=100)
    ident.update_many(u[: until(99, lost)], y[: until(99, lost)])
    assert ident.assess().reasons[0] == "starting: 99 of the 100 samples for the first model"
    there = np.isfinite(y[: ident.samples])
    np.testing.assert_array_equal(ident.bridged, ~there)
    np.testing.assert_array_equal(ident.judged, there)
    np.testing.assert_array_equal(ident.recent[there, 1], y[: ident.samples][there])
    np.testing.assert_array_equal(ident.recent[:, 0], u[: ident.samples])
    assert np.isfinite(ident.recent).all()


def test_before_the_first_output_a_sample_is_rejected() -> None:
    u, y = measured(3, 600)
    y[:50] = math.nan
    late, plain = rp.Identifier(STRUCTURE, DT), rp.Identifier(STRUCTURE, DT)
    late.update_many(u, y)
    plain.update_many(u[50:], y[50:])
    assert late.rejected["not finite"] == 50
    assert late.samples == 550
    np.testing.assert_array_equal(late.parameters, plain.parameters)


def test_an_optimizer_that_does_not_examine_outputs_rejects_such_samples() -> None:
    u, y = measured(4, 300)
    y, lost = some_missing(y, 0.1, 4)
    ident = rp.Identifier(STRUCTURE, DT, optimizer="amsgrad", startup=100)
    ident.update_many(u, y)
    assert ident.rejected["not finite"] == lost.sum()
    assert ident.samples == 300 - lost.sum()


def test_an_output_that_never_comes_again_fills_no_memory() -> None:
    """Nor does it keep the start-up from its end: a few outputs that give no model are let go of."""
    u, y = measured(5, 5)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y)
    for _ in range(8):
        ident.update_many(np.tile([1.0, -1.0], 5000), np.full(10_000, math.nan))
        assert ident.samples <= STORED
    assert ident.status == "starting"
    u, y = measured(6, 1000)
    ident.update_many(u, y)
    assert ident.status == "running"
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.1)


# --- the rules of later samples


def test_a_clock_that_is_set_costs_ten_samples_and_none_before() -> None:
    u, y = measured(7, 800)
    t = DT * np.arange(800)
    t[200:] -= 7.0
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    assert ident.rejected["not later"] == 10
    assert ident.samples == 790
    assert (np.abs(ident.parameters - TRUE) < 5.0 * ident.uncertainty.std).all()


@pytest.mark.parametrize("where", [0, 1, 40])
def test_a_misread_input_before_the_first_move_is_left_out(where: int) -> None:
    """How far apart inputs may be is not known by then: later ones tell, and a second one stands out as well."""
    u, y = measured(8, 800)
    u[:40], u[where], u[300] = 0.0, 1e6, 1e6
    y = PLANT.simulate(np.where(u == 1e6, np.roll(u, 1), u), DT)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, DT * np.arange(800))
    assert ident.rejected["input leap"] == 2
    assert ident.samples == 798
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.05)


def test_pulses_of_one_sample_are_no_misread_inputs() -> None:
    u = np.zeros(800)
    u[40::97] = 10.0
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, PLANT.simulate(u, DT))
    assert not any(ident.rejected.values())
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-6)


# --- chunks, checkpoints, and what else may come meanwhile

KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "tracking": {"optimizer": rp.KalmanTracking(1e-3)},
    "gradient": {"optimizer": "amsgrad", "instruments": True},
    "square": {"preprocess": rp.Preprocess("square", "mean", "first")},
}


@every("kind", KINDS, quick=1)
def test_neither_chunks_nor_checkpoints_change_a_bit(kind: str) -> None:
    u, y = measured(10, 420)
    u = u + np.where(np.arange(420) % 2 == 0, 0.1, 0.0)
    y, _ = some_missing(y, 0.2, 10)
    t, y[7] = DT * np.arange(420.0), math.inf
    t[50:] += 100.0
    t[80], u[90] = 1e9, 1e9
    t[200:] -= 50.0
    for stamps in (None, t):
        whole, loop, parts = (rp.Identifier(STRUCTURE, DT, startup=250, **KINDS[kind]) for _ in range(3))
        expected, rows, errors = whole.update_many(u, y, stamps), [], []
        for k in range(420):
            errors.append(loop.update(u[k], y[k], None if stamps is None else stamps[k]))
            rows.append(loop.parameters)
        for k in range(0, 420, 7):
            some = slice(k, k + 7)
            parts.update_many(u[some], y[some], None if stamps is None else stamps[some])
            parts = rp.Identifier.from_bytes(parts.to_bytes())
        np.testing.assert_array_equal(errors, expected.errors)
        np.testing.assert_array_equal(rows, expected.parameters)
        assert state(whole) == state(loop) == state(parts)
        assert whole.to_bytes() == loop.to_bytes() == parts.to_bytes()
        assert whole.settings is not None


def test_a_copy_goes_on_by_itself_and_a_reset_forgets() -> None:
    u, y = measured(11, 300)
    y, _ = some_missing(y, 0.1, 11)
    ident, plain = (rp.Identifier(STRUCTURE, DT, startup=200) for _ in range(2))
    ident.update_many(u[:100], y[:100])
    copy = ident.clone()
    ident.reset()
    assert ident.to_bytes() == plain.to_bytes()
    plain.update_many(u, y)
    copy.update_many(u[100:], y[100:])
    assert copy.to_bytes() == plain.to_bytes()


@pytest.mark.slow
def test_finish_ends_it_with_the_outputs_there_are() -> None:
    u, y = measured(12, 300)
    y, lost = some_missing(y, 0.15, 12)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y)
    ident.finish()
    assert ident.status == "running"
    assert (ident.samples, ident.rejected["no output"]) == (300, lost.sum())
    whole = rp.fit(u, y, DT, poles=2)
    assert (np.abs(ident.parameters - whole.parameters) < 0.01 * np.sqrt(np.diag(whole.covariance))).all()
    ident.update_many(u, np.abs(y))
    assert ident.samples == 600


@pytest.mark.parametrize("gap", [100.0, 1e7])
def test_how_long_a_gap_lasts_does_not_matter(gap: float) -> None:
    u, y = measured(13, 800)
    t = DT * np.arange(800)
    t[250:] += gap
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[:500], y[:500], t[:500])
    assert ident.status == "running"
    assert (np.abs(ident.parameters - TRUE) < 4.0 * ident.uncertainty.std).all()
    assert (ident.uncertainty.std < 0.05 * TRUE).all()


def test_of_a_constant_output_each_attempt_that_failed_is_said_and_at_the_end_no_further_one() -> None:
    u = np.random.default_rng(1).choice([-1.0, 1.0], 150).repeat(10)
    ident = rp.Identifier(rp.Structure(2), 0.02, startup=150)
    ident.update_many(u, np.full(1500, 5.0))
    assert (
        ident.assess().reasons[-1]
        == "starting: 1500 of the 2400 samples for the first model; the attempts before gave no usable model"
    )
    ident.finish()
    assert ident.assess().reasons[-1] == "the record of 1500 samples gives no usable model"
    assert rp.Identifier.from_bytes(ident.to_bytes()).assess().reasons == ident.assess().reasons
    assert ident.loads == ()
    assert ident.left_out.size == 0
    ident.update(1.0, 5.0)
    assert ident.assess().reasons[-1].startswith("starting: 1501 of the 2400 samples")


def test_a_start_up_that_was_finished_and_goes_on_can_be_saved() -> None:
    ident = rp.Identifier(rp.Structure(2), 0.02)
    ident.update_many(np.ones(12_000), np.zeros(12_000))
    ident.finish()
    ident.update_many(np.ones(4_500), np.zeros(4_500))  # the older samples are dropped
    assert rp.Identifier.from_bytes(ident.to_bytes()).assess().reasons == ident.assess().reasons
