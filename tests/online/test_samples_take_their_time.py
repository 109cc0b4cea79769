"""Without stamps a sample that cannot be used takes its time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.errors import DamagedCheckpointError
from support.builders import state

DT, SAMPLES = 0.02, 1500
PLANT, OTHER = rp.TransferFunction([6.0], [1.0, 3.0, 4.0]), rp.TransferFunction([2.0], [1.0, 2.0])
UNUSABLE = np.array([np.nan, np.inf, -np.inf, 1e200])


def measured(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two inputs (K, 2) and the output (K,) of both plants, of which one sample of 15 lacks an input."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((SAMPLES // 15, 2)), 15, axis=0)
    y = PLANT.simulate(u[:, 0], DT) + OTHER.simulate(u[:, 1], DT) + 0.02 * rng.standard_normal(SAMPLES)
    lost = rng.random(SAMPLES) < 1.0 / 15.0
    u[lost, 0] = rng.choice(UNUSABLE, lost.sum())
    return u, y


def made(inputs: int) -> Any:
    return rp.Identifier(poles=(2, 1), dt=DT) if inputs == 2 else rp.Identifier(poles=2, dt=DT)


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_the_estimate_is_right(inputs: int, seed: int) -> None:
    u, y = measured(seed)
    true = [3.0, 4.0, 6.0] if inputs == 1 else [3.0, 4.0, 6.0, 2.0, 2.0]
    ident = made(inputs)
    if inputs == 1:
        y = y - OTHER.simulate(u[:, 1], DT)
        u = u[:, 0]
    ident.update_many(u, y)
    ident.finish()
    deviations = np.sqrt(np.diag(ident.covariance))
    assert np.abs((ident.parameters - true) / deviations).max() < 4.5


@pytest.mark.parametrize("inputs", [1, 2])
def test_one_by_one_is_equal_to_the_bit(inputs: int) -> None:
    u, y = measured(0)
    u[:3, 1], u[1], u[2, 0], y[40:44] = 1.0, np.nan, 1.0, UNUSABLE
    u, y = (u if inputs == 2 else u[:, 0].copy())[:600], y[:600]
    whole, single = made(inputs), made(inputs)
    whole.update_many(u, y)
    for each, output in zip(u.tolist(), y.tolist(), strict=True):
        single.update(each, output)
    np.testing.assert_array_equal(single.parameters, whole.parameters)
    assert (single.samples, single.rejected) == (whole.samples, whole.rejected)
    if inputs == 1:
        assert state(single) == state(whole)


@pytest.mark.parametrize("cut", [705, 761])
def test_a_checkpoint_within_a_hole_and_behind_it_goes_on_to_the_bit(cut: int) -> None:
    u, y = measured(1)
    u[700:760, 0] = np.nan
    whole, single = made(1), made(1)
    whole.update_many(u[:1000, 0].copy(), y[:1000])
    single.update_many(u[:cut, 0].copy(), y[:cut])
    again = rp.Identifier.from_bytes(single.to_bytes())
    again.update_many(u[cut:1000, 0].copy(), y[cut:1000])
    assert state(again) == state(whole)


def test_a_member_of_an_ensemble_gets_the_bits_that_it_would_get_alone() -> None:
    records = [measured(seed) for seed in range(5)]
    u, y = (np.column_stack(each) for each in zip(*((u[:600, 0], y[:600]) for u, y in records), strict=True))
    several = rp.Ensemble([made(1) for _ in records])
    several.update_many(u, y)
    for number, parameters in enumerate(several.parameters):
        alone = made(1)
        alone.update_many(u[:, number].copy(), y[:, number].copy())
        np.testing.assert_array_equal(parameters, alone.parameters)


@pytest.mark.parametrize("before", [30, 600])
def test_finish_within_a_hole_keeps_its_time(before: int) -> None:
    u, y = measured(2)
    ident = made(1)
    ident.update_many(u[:before, 0].copy(), y[:before])
    ident.update_many(np.full(50, np.nan), np.zeros(50))
    ident.finish()
    ident.update(0.0, 0.0)
    assert ident.recent[-1, 2] == pytest.approx(51 * DT)


def with_holes() -> tuple[np.ndarray, np.ndarray]:
    """Two inputs and the output, with three holes of 40 to 60 samples of one input, in which that input moves."""
    rng = np.random.default_rng(6)
    u = np.repeat(rng.standard_normal((SAMPLES // 15, 2)), 15, axis=0)
    y = PLANT.simulate(u[:, 0], DT) + OTHER.simulate(u[:, 1], DT) + 0.02 * rng.standard_normal(SAMPLES)
    for at, length, column in ((300, 40, 0), (640, 60, 1), (800, 50, 0)):
        u[at : at + length, column] = np.nan
    return u[:1000], y[:1000]


@pytest.mark.slow
def test_behind_holes_of_one_of_several_inputs_the_estimate_is_that_of_fit() -> None:
    u, y = with_holes()
    ident, found = made(2), rp.fit(u, y, dt=DT, poles=(2, 1))
    ident.update_many(u, y)
    ident.finish()
    assert (np.abs(ident.parameters - found.parameters) < 0.1 * np.sqrt(np.diag(found.covariance))).all()
    assert ident.assess().status == found.verdict.status == "trusted"
    # three samples of each hole are within a gap
    assert (ident.rejected["not finite"], ident.rejected["no output"], ident.taken) == (141, 9, 1000)
    assert np.unique(ident.recent_intervals / DT).tolist() == pytest.approx([1.0, 38.0, 48.0, 58.0])


@pytest.mark.parametrize("cut", [641, 645, 700, 701])
def test_rows_within_a_hole_and_behind_it_go_on_to_the_bit(cut: int) -> None:
    u, y = (each[:720] for each in with_holes())
    whole, parts = made(2), made(2)
    whole.update_many(u, y)
    parts.update_many(u[:cut], y[:cut])
    parts = rp.Identifier.from_bytes(parts.to_bytes())
    for each, output in zip(u[cut:].tolist(), y[cut:].tolist(), strict=True):
        parts.update(each, output)
    assert parts.to_bytes() == whole.to_bytes()


def test_a_checkpoint_of_rows_whose_times_do_not_advance_is_refused() -> None:
    u, y = with_holes()
    ident = made(2)
    ident.update_many(u[:20], y[:20])
    ident._now.kept.values[-1, -1] = 20.0  # that of the next sample
    with pytest.raises(DamagedCheckpointError, match="times are not valid"):
        rp.Identifier.from_bytes(ident.to_bytes())


def test_a_checkpoint_of_rows_whose_samples_are_not_numbered_goes_on_the_same() -> None:
    """As those of earlier commits."""
    u, y = with_holes()
    ident, other = made(2), made(2)
    for each in (ident, other):
        each.update_many(u[:20], y[:20])
    ident._now.kept.values[:, -1] = 0.0
    loaded = rp.Identifier.from_bytes(ident.to_bytes())
    assert loaded.to_bytes() == other.to_bytes()
