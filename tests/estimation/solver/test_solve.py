"""A fit uses the input of a sample whose output is bad: missing, an outlier, or that of a stuck sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.estimation.solver.bad_samples import suspicious
from replant.kernels.schema import Doubt
from replant.online.runs.result import result_of_fit
from support.builders import DT, binary, true_parameters
from support.cases import every

PLANT, STRUCTURE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2)
TRUE, SAMPLES = true_parameters(PLANT, 0), 1500


def noisy(seed: int) -> tuple[np.ndarray, np.ndarray]:
    u = binary(seed, SAMPLES, 8)
    y = PLANT.simulate(u, DT)
    return u, y + 0.05 * y.std() * np.random.default_rng(seed).standard_normal(SAMPLES)


def away(result: rp.FitResult, other: rp.FitResult) -> float:
    """The largest distance of two fits' parameters in standard deviations."""
    assert other.covariance is not None
    return float(np.abs((result.parameters - other.parameters) / np.sqrt(np.diag(other.covariance))).max())


@pytest.mark.parametrize("first", [[0.0], [-9999.0, 0.0]])
def test_first_outputs_that_are_bad_are_named_and_change_nothing(first: list[float]) -> None:
    """A sensor is read before it is ready; a fast pole with an initial state would explain it, and did."""
    u, y = noisy(1)
    y += 5.0
    clean = rp.fit(u, y, DT, STRUCTURE)
    y[: len(first)] = first
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.outliers.tolist() == list(range(len(first)))
    assert away(found, clean) < 0.2


def test_a_fast_pole_that_is_in_motion_at_first_is_none() -> None:
    """The first jump is the largest: the input was far away before the record."""
    plant = rp.TransferFunction([40.0, 60.0], [1.0, 31.0, 30.0])
    u, before = binary(1, SAMPLES, 8), np.full(200, -20.0)
    y = plant.simulate(np.concatenate([before, u]), DT)[200:] + 0.02 * np.random.default_rng(2).standard_normal(SAMPLES)
    assert np.abs(np.diff(y)).argmax() == 0
    found = rp.fit(u, y, DT, rp.Structure(2, 1))
    assert not found.outliers.size
    np.testing.assert_allclose(found.parameters, [31.0, 30.0, 40.0, 60.0], rtol=0.1)


@pytest.mark.parametrize("size", [5.0, 1e6, -1e12])
def test_one_outlier_is_named_and_changes_nothing(size: float) -> None:
    u, y = noisy(1)
    clean = rp.fit(u, y, DT, STRUCTURE)
    y[700] = size
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.outliers.tolist() == [700]
    assert (found.rejected["outlier"], found.samples) == (1, SAMPLES - 1)
    assert away(found, clean) < 0.2
    assert found.simulation.fit > clean.simulation.fit - 0.5


@pytest.mark.parametrize("number", [30, 60, 85])
def test_an_outlier_at_a_step_of_the_input_is_one_all_the_same(number: int) -> None:
    u, y = noisy(1)
    at = np.flatnonzero(np.diff(u))[[number]] + 1
    clean = rp.fit(u, y, DT, STRUCTURE)
    y[at] = 1e4
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.outliers.tolist() == at.tolist()
    assert away(found, clean) < 0.3


def test_many_outliers_are_found() -> None:
    u, y = noisy(2)
    clean = rp.fit(u, y, DT, STRUCTURE)
    hit = np.sort(np.random.default_rng(3).choice(SAMPLES // 3, 20, replace=False)) * 3
    y[hit] += np.random.default_rng(4).choice([-1.0, 1.0], 20) * np.geomspace(1.0, 100.0, 20) * y.std()
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.outliers.tolist() == hit.tolist()
    assert away(found, clean) < 0.5


@pytest.mark.parametrize("where", ["scattered", "in a row"])
def test_where_the_output_is_missing_the_input_is_used(where: str) -> None:
    """36 of 1500 missing outputs made errors three times as large when their inputs were left out as well."""
    u, y = noisy(5)
    clean = rp.fit(u, y, DT, STRUCTURE)
    rows = np.random.default_rng(6).choice(SAMPLES, 36, replace=False) if where == "scattered" else np.r_[600:650]
    y[rows] = np.nan
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.rejected["not finite"] == rows.size
    assert away(found, clean) < 0.5
    assert found.simulation.fit == pytest.approx(clean.simulation.fit, abs=0.5)
    assert found.covariance is not None
    assert clean.covariance is not None
    assert (np.diag(found.covariance) > 0.9 * np.diag(clean.covariance)).all()


def test_a_record_without_any_is_solved_once_and_as_it_is() -> None:
    """Noise-free, and with heavy noise: no sample is held against it."""
    u = binary(7, SAMPLES, 8)
    for noise in (0.0, 0.01, 1.0):
        y = PLANT.simulate(u, DT)
        y += noise * y.std() * np.random.default_rng(8).standard_normal(SAMPLES)
        found = rp.fit(u, y, DT, STRUCTURE)
        assert found.outliers.size == 0


@every("seed", range(4))
def test_on_a_coarse_scale_a_rounded_output_is_no_outlier(seed: int) -> None:
    """A tenth of the output's range is a step: right outputs jump by two of them."""
    u, y = noisy(seed)
    y += 0.1 * y.std() * np.random.default_rng(seed + 20).standard_normal(SAMPLES)
    step = 0.4 * float(y.std())
    assert rp.fit(u, step * np.round(y / step), DT, STRUCTURE).outliers.size == 0


def test_what_a_missing_direct_path_leaves_is_no_outlier() -> None:
    """Its residual stands out for a sample wherever the input steps: that is the model's fault, not the sensor's."""
    u = binary(9, SAMPLES, 25)
    y = PLANT.simulate(u, DT) + 0.5 * u
    y[1:] = y[1:] - 0.5 * u[:-1]  # gone after a sample
    y += 0.005 * np.random.default_rng(10).standard_normal(SAMPLES)
    assert rp.fit(u, y, DT, STRUCTURE).outliers.size == 0


def test_on_an_irregular_clock() -> None:
    u, y = noisy(11)
    t = DT * np.arange(SAMPLES) + 0.1 * DT * np.random.default_rng(12).uniform(-1.0, 1.0, SAMPLES)
    y[[300, 301, 900]] = np.nan, np.nan, 1e3
    found = rp.fit(u, y, DT, STRUCTURE, t=t)
    assert found.outliers.tolist() == [900]
    assert (np.abs(found.parameters / TRUE - 1.0) < 0.1).all()


def test_the_verdict_is_that_of_the_samples_used() -> None:
    """An outlier of a million is left out of fit, verdict and residual, and shown as left out."""
    u, y = noisy(13)
    y[700], y[900:910] = 1e6, np.nan
    fitted = rp.fit(u, y, DT, STRUCTURE)
    result = result_of_fit(fitted, u, y, begun=0.0)
    assert result.verdict.status == "trusted", result.verdict.reasons
    assert result.left_out.tolist() == [[700, 701], [900, 910]]
    assert np.isnan(result.residual(y)[[700, 905]]).all()
    known = fitted.bridged(y)
    assert np.isfinite(known).all()
    assert (known != y).sum() == 11


def test_an_answer_to_a_pulse_is_no_outlier() -> None:
    """It is over after two samples and stands out of its neighbours, each time alike."""
    u = np.zeros(SAMPLES)
    u[30::50] = 1.0
    fast = rp.TransferFunction([900.0], [1.0, 6.0, 900.0])
    y = fast.simulate(u, 0.1) + 0.002 * np.random.default_rng(14).standard_normal(SAMPLES)
    found = rp.fit(u, y, 0.1, STRUCTURE)
    assert found.outliers.size == 0
    assert found.simulation.fit > 95.0


def test_an_input_that_always_moves_does_not_hide_outliers() -> None:
    u = np.random.default_rng(15).standard_normal(SAMPLES)
    y = PLANT.simulate(u, DT)
    y += 0.02 * y.std() * np.random.default_rng(16).standard_normal(SAMPLES)
    y[[100, 700, 1300]] += 5.0 * y.std()
    assert rp.fit(u, y, DT, STRUCTURE).outliers.tolist() == [100, 700, 1300]


def test_missing_outputs_of_an_unstable_plant_keep_their_inputs() -> None:
    """Their place is taken by predictions, as a simulation would run away."""
    u, plant = binary(17, 400, 8), rp.TransferFunction([2.0], [1.0, -0.05])
    y = plant.simulate(u, 0.1) + 0.05 * np.random.default_rng(18).standard_normal(400)
    clean = rp.fit(u, y, 0.1, rp.Structure(1))
    y[100:150] = np.nan
    found = rp.fit(u, y, 0.1, rp.Structure(1))
    assert found.missing.tolist() == list(range(100, 150))
    assert found.samples == 350
    assert away(found, clean) < 1.0


def test_where_most_is_missing_the_rest_tells_the_model() -> None:
    """The standard deviations grow by the root of the ratio of samples, as what is left is spread evenly."""
    u, y = noisy(19)
    clean = rp.fit(u, y, DT, STRUCTURE)
    y[np.random.default_rng(20).choice(SAMPLES, 4 * SAMPLES // 5, replace=False)] = np.nan
    found = rp.fit(u, y, DT, STRUCTURE)
    assert found.missing.size > 0.79 * SAMPLES
    assert (np.abs(found.parameters - TRUE) < 4.0 * found.uncertainty.std).all()
    assert (found.uncertainty.std < 1.3 * np.sqrt(5.0) * clean.uncertainty.std).all()


def stuck(y: np.ndarray, *places: tuple[int, int]) -> np.ndarray:
    held = y.copy()
    for begin, end in places:
        held[begin:end] = held[begin]
    return held


@every("seed", range(12), quick=4)
def test_a_coarse_sensor_that_toggles_while_the_plant_rests_is_not_stuck(seed: int) -> None:
    """A heater from rest, its sensor of half a degree: the same number comes in several runs before the step."""
    u = np.where(np.arange(481) < 30, 0.0, 178.5)
    clean = rp.TransferFunction([0.55], np.polymul([250.0, 1.0], [8.0, 1.0])).simulate(u, 1.0)
    y = np.round((29.33 + clean + np.random.default_rng(seed).normal(0.0, 0.12, u.size)) / 0.489) * 0.489
    found = rp.fit(u, y, 1.0, rp.Structure(2))
    assert not found.stuck.size
    assert abs(found.transfer_function.dc_gain / 0.55 - 1.0) < 4.0 * found.uncertainty.dc_gain_std / 0.55


def test_a_stuck_sensor_is_left_out_and_its_inputs_are_used() -> None:
    u, y = noisy(21)
    clean = rp.fit(u, y, DT, STRUCTURE)
    found = rp.fit(u, stuck(y, (300, 500), (900, 950)), DT, STRUCTURE)
    assert found.stuck.tolist() == [*range(300, 500), *range(900, 950)]
    assert found.rejected["stuck"] == 250
    assert away(found, clean) < 1.0
    assert found.verdict.status == "trusted", found.verdict.reasons


def test_a_sensor_at_its_limit_is_left_out() -> None:
    u, y = noisy(22)
    clean = rp.fit(u, y, DT, STRUCTURE)
    limit = float(np.quantile(y, 0.85))
    found = rp.fit(u, np.minimum(y, limit), DT, STRUCTURE)
    assert found.stuck.size > 0.9 * (y > limit).sum()
    assert (np.minimum(y, limit)[found.stuck] == limit).all()
    assert away(found, clean) < 1.0


def test_an_output_at_rest_is_not_stuck() -> None:
    """A step test on a scale of 8 bits: before the step and on the plateau the output stands still by right."""
    u = np.repeat([0.0, 1.0], [100, 500])
    y = rp.TransferFunction([1.0], [3.0, 1.0]).simulate(u, DT)
    found = rp.fit(u, np.round(256.0 * y) / 256.0, DT, poles=1)
    assert found.stuck.size == 0
    assert found.parameters == pytest.approx([1.0 / 3.0, 1.0 / 3.0], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_noise_of_any_colour_has_no_outliers(pole: float) -> None:
    """The level is 2e-9 a sample: of 30,000 samples none."""
    for seed in range(20):
        u, _ = noisy(seed)
        y = PLANT.simulate(u, DT)
        noise = lfilter([1.0], [1.0, -pole], np.random.default_rng(seed).standard_normal(SAMPLES))
        assert rp.fit(u, y + 0.3 * y.std() / noise.std() * noise, DT, STRUCTURE).outliers.size == 0, seed


def test_by_the_outputs_alone_missing_gross_and_equal_ones_are_suspicious() -> None:
    y = np.sin(np.arange(200.0))
    y[20], y[50], y[100:160] = np.nan, 1e9, 0.3
    doubt = suspicious(np.cos(np.arange(200.0)), y)
    assert doubt[20] == Doubt.MISSING
    assert doubt[50] == Doubt.OUTLIER
    assert (doubt[100:160] == Doubt.STUCK).all()
    assert int((doubt != Doubt.NONE).sum()) == 62
