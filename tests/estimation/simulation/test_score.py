"""The fits of a record that comes in batches: those of the record as a whole."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from replant.estimation.simulation.model_run import Score
from replant.model.transfer_function import TransferFunction
from replant.numerics.autoregression import one_step
from replant.verdict import fit_percent, simulate

DT = 0.05
UNKNOWN = 3  # outputs at the beginning that answer to inputs from before the record
MODEL = TransferFunction([3.0, 6.0], [1.0, 1.6, 4.0], 0.12)


def record(samples: int = 3000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A plant near the model, away from rest, with an offset, coloured noise, and samples missing."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 20 + 1), 20)[:samples]
    plant = TransferFunction([3.1, 6.0], [1.0, 1.5, 4.0], 0.12)
    noise = np.convolve(rng.standard_normal(samples + 9), np.ones(10) / 10, "valid")
    y = plant.simulate(u, DT) + 40.0 + 2.0 * plant.free_responses(samples, DT)[:, 0] + 0.1 * noise
    y[rng.random(samples) < 0.01] = np.nan
    y[2] = np.nan  # one of the first, which have no past of full length
    u[rng.random(samples) < 0.01] = np.nan
    y[1000:1100] = np.nan
    return u, y


def answering(y: np.ndarray) -> np.ndarray:
    """The outputs that answer to inputs of the record."""
    return np.concatenate([np.full(UNKNOWN, np.nan), y[UNKNOWN:]])


def scored(model: TransferFunction, u: np.ndarray, y: np.ndarray, cuts: list[int]) -> tuple[Score, np.ndarray]:
    score, ends = Score(model, DT), [0, *cuts, u.size]
    parts = [score.take(u[a:b], y[a:b]) for a, b in pairwise(ends)]
    return score, np.concatenate(parts) + score.shift


def test_one_batch_is_the_simulation_of_the_whole() -> None:
    u, y = record()
    score, output = scored(MODEL, u, y, [])
    expected = simulate(MODEL, u, y, DT)
    np.testing.assert_allclose(output, expected.output, rtol=1e-12, atol=1e-12)
    assert score.simulated == pytest.approx(expected.fit, abs=1e-9)
    assert score.offset == pytest.approx(expected.offset, abs=1e-10)
    y = answering(y)
    assert score.one_step == pytest.approx(fit_percent(y, y - one_step(y - expected.output)), abs=1e-9)


@pytest.mark.parametrize("cuts", [[1500], [1500, 1501, 1503, 2999], list(range(1500, 3000, 7))])
def test_batches_give_the_fits_of_their_own_output(cuts: list[int]) -> None:
    """With the initial state of the first batch and the offset of all: every sum agrees with the whole's."""
    u, y = record()
    score, output = scored(MODEL, u, y, cuts)
    y = answering(y)
    assert np.nanmean(y - output) == pytest.approx(0.0, abs=1e-11)
    assert score.simulated == pytest.approx(fit_percent(y, output), abs=1e-9)
    assert score.one_step == pytest.approx(fit_percent(y, y - one_step(y - output)), abs=1e-9)
    assert score.simulated == pytest.approx(simulate(MODEL, u, y, DT).fit, abs=0.02)


def test_an_offset_far_from_zero_costs_no_digits() -> None:
    u, y = record()
    near, _ = scored(MODEL, u, y, [1500])
    far, _ = scored(MODEL, u, y + 1e6, [1500])
    assert far.simulated == pytest.approx(near.simulated, abs=1e-6)
    assert far.one_step == pytest.approx(near.one_step, abs=1e-6)


def test_a_perfect_model_fits_to_one_hundred() -> None:
    u = np.repeat([1.0, -1.0, 1.0, 0.0], 200)
    score, _ = scored(MODEL, u, MODEL.simulate(u, DT) + 3.0, [400])
    assert score.simulated == pytest.approx(100.0, abs=1e-7)
    assert score.offset == pytest.approx(3.0, abs=1e-8)


@pytest.mark.parametrize("cuts", [[], [300]])
def test_what_cannot_be_compared_has_no_figure(cuts: list[int]) -> None:
    u = np.ones(600)
    runaway, output = scored(TransferFunction([1.0], [1.0, -1e3]), u, np.sin(np.arange(600.0)), cuts)
    assert runaway.simulated == -math.inf
    assert math.isnan(runaway.one_step)
    assert np.isnan(output).all()
    nothing, output = scored(MODEL, u, np.full(600, np.nan), cuts)
    assert nothing.simulated == -math.inf
    assert nothing.offset == 0.0
    assert np.isnan(output).all()
    still, _ = scored(MODEL, u, np.full(600, 5.0), cuts)
    assert math.isnan(still.simulated)


def test_a_first_batch_without_output_leaves_the_offset_to_the_others() -> None:
    u, y = record()
    y[:1500] = np.nan
    score, output = scored(MODEL, u, y, [1500])
    assert np.nanmean(y - output) == pytest.approx(0.0, abs=1e-11)
    assert score.simulated == pytest.approx(simulate(MODEL, u, y, DT).fit, abs=1.0)
