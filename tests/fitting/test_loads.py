"""A record of one input in which loads act: parted where they begin, `fit` finds the plant as if there were none."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.miso import Row
from replant.estimation.solver.miso_change import Judge
from replant.estimation.solver.record_changes import Modelled, is_another_in_parts
from replant.estimation.solver.solve import solve
from replant.fitting.fit_result import FitResult
from replant.numerics.linear_algebra import chi2_quantile
from support.cases import every

PLANT, DT, SAMPLES = rp.TransferFunction([0.1], [1.0, 0.1], delay=0.3), 0.05, 5000
TRUE = np.array([0.1, 0.1])
KNOWN = 4500  # samples, behind the last load
LOADS = (1500, 2600, 3700)
Array = np.ndarray


def record(seed: int, loads: tuple[int, ...] = LOADS, pole: float = 0.0, size: float = 0.7) -> tuple[Array, Array]:
    """An input that moves each 5 s, and the output with steps of alternate sign at 10 dB of noise of one pole."""
    rng = np.random.default_rng([seed, 41])
    u = rng.choice([-1.0, 1.0], SAMPLES // 100).repeat(100)
    clean = PLANT.simulate(u, DT)
    acts = sum(((-1.0) ** k * (np.arange(SAMPLES) >= begin) for k, begin in enumerate(loads)), np.zeros(SAMPLES))
    noise = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(SAMPLES))
    return u, clean + clean.std() * (size * acts + 0.32 * noise)


def fitted(u: Array, y: Array, **options: Any) -> FitResult:
    return rp.fit(u, y, DT, poles=1, delay=0.3, **options)


@cache
def parted(seed: int) -> FitResult:
    """The fit of the first samples of a record with loads."""
    u, y = record(seed)
    return fitted(u[:KNOWN], y[:KNOWN])


def distance(found: FitResult) -> float:
    """The squared distance of an estimate from the plant in its standard deviations: chi-square of two."""
    off = found.parameters - TRUE
    return float(off @ np.linalg.solve(found.covariance, off))


@pytest.mark.slow
@every("seed", range(6), quick=1)
def test_a_record_is_parted_at_its_loads(seed: int) -> None:
    found = parted(seed)
    assert all(np.abs(found.loads - load).min() <= 20 for load in LOADS)
    assert found.loads.size <= len(LOADS) + 1  # what a load that is begun a little early leaves
    assert distance(found) < chi2_quantile(0.9999, 2)
    assert found.parameters == pytest.approx(TRUE, rel=0.1)
    assert found.verdict.status == "trusted"
    assert any(reason.startswith("another load acts since 7") for reason in found.verdict.reasons)


@pytest.mark.slow
@every("seed", range(6), quick=1)
def test_what_is_left_is_the_noise(seed: int) -> None:
    u, y = record(seed)
    found = parted(seed)
    y = y[:KNOWN]
    error = y - found.simulation.output
    assert np.nanstd(error) == pytest.approx(0.32 * PLANT.simulate(u, DT).std(), rel=0.05)
    assert found.simulation.fit == pytest.approx(100.0 * (1.0 - np.nanstd(error) / y.std()), abs=0.2)


@pytest.mark.slow
@every("seed", range(6), quick=1)
def test_the_end_of_a_run_finds_them_too_and_goes_on_from_there(seed: int) -> None:
    u, y = record(seed)
    found, ident = parted(seed), rp.Identifier(rp.Structure(1, delay=0.3), DT)
    ident.update_many(u[:KNOWN], y[:KNOWN])
    ident.finish()
    deviations = np.sqrt(np.diag(found.covariance))  # either has a noise model of its own
    assert np.all(np.abs(ident.parameters - found.parameters) < deviations)
    assert ident.assess().status == "trusted"
    ident.update_many(u[KNOWN:], y[KNOWN:])
    assert ident.parameters == pytest.approx(TRUE, rel=0.1)
    assert ident.assess().status == "trusted"


@pytest.mark.parametrize("pole", [0.0, 0.9])
@every("seed", range(3), quick=1)
def test_a_record_without_a_load_is_not_parted(seed: int, pole: float) -> None:
    found = fitted(*record(seed, (), pole))
    assert not found.loads.size
    assert found.rival is None
    assert found.verdict.status == "trusted"


@pytest.mark.slow
@every("seed", [2, 0, 1], quick=1)
def test_a_drift_is_no_load(seed: int) -> None:
    u, y = record(seed, ())
    drift = np.cumsum(np.random.default_rng([seed, 43]).standard_normal(SAMPLES))
    found = fitted(u, y + 0.3 * y.std() / drift.std() * drift)
    assert not found.loads.size


def test_loads_that_are_likely_but_not_sure_take_trust_away() -> None:
    """Noise of a slow pole goes on as a load does: without the load the plant is many deviations off."""
    found = fitted(*record(4, (4300,), 0.9))
    assert not found.loads.size
    assert distance(found) > chi2_quantile(0.99, 2)
    assert found.verdict.status == "converging"
    assert found.verdict.reasons[0].startswith("another load may act since 216 s")
    assert found.rival is not None
    assert distance(found.rival) < chi2_quantile(0.99, 2)


@pytest.mark.slow
@every("seed", [6, 3, 4], quick=1)
def test_a_load_is_found_that_a_slow_pole_has_followed(seed: int) -> None:
    """The model of the whole record takes the load for its own answer: its halves tell of it, or the recursion."""
    rng, plant = np.random.default_rng(seed), rp.TransferFunction([3.0], [1.0, 1.5, 2.0])
    u = rng.choice([-1.0, 1.0], 500).repeat(8)
    clean, noise = plant.simulate(u, 0.1), lfilter([1.0], [1.0, -0.9], rng.standard_normal(4000))
    y = clean + clean.std() * (0.3 / noise.std() * noise + 3.0 * (np.arange(4000) >= 2600))
    found, ident = rp.fit(u, y, 0.1, poles=2), rp.Identifier(poles=2, dt=0.1)
    ident.update_many(u, y)
    ident.finish()
    for parameters in (found.parameters, ident.parameters):
        assert parameters == pytest.approx([1.5, 2.0, 3.0], rel=0.15)
    assert found.verdict.status == "trusted"
    assert ident.assess().status in {"trusted", "converging"}


@pytest.mark.slow
def test_the_model_keeps_what_the_verdict_says_of_loads() -> None:
    model = parted(0).model
    assert any("another load acts since" in reason for reason in model.verdict.reasons)


@every("seed", range(4), quick=1)
def test_a_step_of_the_sensor_in_the_middle_is_found(seed: int) -> None:
    """Each half has an offset of its own, which is no colour of its noise; in all of it a pole near nought follows."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1.0, 1.0, 100).repeat(20)
    y = rp.TransferFunction([2.0 / 3.0], [1.0, 1.0 / 3.0]).simulate(u, 0.1) + 0.05 * rng.standard_normal(2000)
    y[1000:] += 1.5
    fitted = rp.fit(u, y, 0.1, poles=1)
    assert np.abs(fitted.loads - 1000).max(initial=0) <= 20
    assert fitted.loads.size == 1
    assert fitted.transfer_function.dc_gain == pytest.approx(2.0, rel=0.03)
    assert fitted.verdict.status == "trusted"


def there_and_back(seed: int, gain: float, drift: float = 0.0) -> tuple[Array, Array]:
    """A record about a level far from nought, with another gain of the sensor in its middle third."""
    rng, count = np.random.default_rng([seed, 47]), 900
    u = rng.uniform(1.0, 3.0, count // 20).repeat(20)
    clean = rp.TransferFunction([2.0 / 3.0], [1.0, 1.0 / 3.0]).simulate(u, 0.1) + 4.0 * np.exp(-np.arange(count) / 30.0)
    clean[count // 3 : 2 * count // 3] *= gain
    noise = 0.03 * rng.standard_normal(count)
    return u, clean + noise + drift * np.cumsum(rng.standard_normal(count)) / np.sqrt(count)


@every("seed", [1, 0], quick=1)
def test_a_gain_of_the_sensor_that_changes_there_and_back_takes_trust_away(seed: int) -> None:
    """Its steps of the level are slow noise to one model, beside which no test of that model sees the gain."""
    assert rp.fit(*there_and_back(seed, 1.4), 0.1, poles=1).verdict.status != "trusted"


@pytest.mark.slow
@every("seed", [1, 0], quick=1)
def test_the_end_of_a_run_sees_it_too(seed: int) -> None:
    ident = rp.Identifier(poles=1, dt=0.1)
    ident.update_many(*there_and_back(seed, 1.4))
    ident.finish()
    assert ident.assess().status != "trusted"


@pytest.mark.parametrize(("gain", "drift"), [(1.4, 0.0), (1.0, 0.0), (1.0, 1.0)])
@every("seed", range(10), quick=3)
def test_parts_with_models_of_their_own_are_told_from_one_model(gain: float, drift: float, seed: int) -> None:
    """In a drift the parts have other offsets, whether or not a load begins there, and one G(s)."""
    structure, (u, y) = rp.Structure(1), there_and_back(seed, gain, drift)
    whole = solve(structure, Record(u - u.mean(), y - y.mean(), np.array([0.1])), nested=True)
    assert whole is not None
    row = Row.of_one(structure, whole.record)
    model = Modelled(row, Judge.of(row, whole.found.theta[:2]))
    assert is_another_in_parts(model, (300, 600)) == (gain != 1.0)
