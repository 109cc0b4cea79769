"""What a sensor or a clock may do wrong, and what only looks like it."""

from __future__ import annotations

import numpy as np
import pytest

from replant import TransferFunction, fit
from replant.numerics.robust import usual_step
from replant.signals import random_steps
from replant.verdict.sensor_and_excitation import (
    clock_finding,
    is_resolved,
    level_finding,
    saturation_finding,
    stuck_finding,
)
from support.builders import G1, binary
from support.cases import every

DT = 0.1
U = binary(1, 3000, 20)
CLEAN = G1.simulate(U, DT)
NOISE = 0.1 * CLEAN.std() * np.random.default_rng(0).standard_normal(3000)
SECONDS = DT * np.arange(3000)


def found(y: np.ndarray, noise: float = float(NOISE.std())) -> list[str]:
    """Everything that speaks against the sensor, beside the true model."""
    resolved = is_resolved(y, noise)
    findings = saturation_finding(y, CLEAN) + stuck_finding(y, CLEAN, noise, resolved, SECONDS)
    assert all(finding.status == "inconsistent" for finding in findings)
    return [finding.reason for finding in findings]


@every(
    "y",
    [CLEAN + NOISE, CLEAN, np.round(20 * CLEAN) / 20, np.round(20 * (CLEAN + NOISE)) / 20],
    ids=["noisy", "clean", "coarse", "noisy and coarse"],
)
def test_a_sound_sensor_is_not_accused(y: np.ndarray) -> None:
    """Also where the plant comes to rest, at one value to the bit, again and again."""
    for noise in (float(NOISE.std()), 1e-12):
        assert found(y, noise) == []


def test_a_plant_at_rest_is_no_stuck_sensor() -> None:
    u = np.repeat([0.0, 1.0, 0.0, 1.0], 1000)  # fifty time constants each
    y = G1.simulate(u, DT)
    assert y[999] == y[998]
    resolved = is_resolved(y, 1e-13)
    assert saturation_finding(y, y) == []
    assert stuck_finding(y, y, 1e-13, resolved, DT * np.arange(4000)) == []


def test_a_motor_at_rest_is_no_sensor_at_its_limit() -> None:
    """No value lies between its rest and its speed, but a few of its start: nothing tells what a model is to be there.

    So it is where the model errs at the start only, as it does without the dead time.
    """
    turning = np.repeat([10.2, 10.9, 11.6, 16.7], [8, 63, 121, 1])
    y = np.concatenate([np.zeros(100), [7.3, 8.7, 9.5, 9.5, 9.5], turning])
    modelled = np.concatenate([np.full(100, -0.003), [8.0, 10.4, 11.8, 11.0, 11.2], np.full(turning.size, 11.3)])
    assert saturation_finding(y, modelled) == []
    rise = np.round(10.0 * G1.simulate(np.ones(300), 0.02), 1)
    late = np.concatenate([np.zeros(8), rise[:-8]])
    assert saturation_finding(late, 10.0 * G1.simulate(np.ones(300), 0.02)) == []


def test_the_tail_of_a_coarse_sensors_noise_is_no_limit() -> None:
    """Below its dead zone a plant stands still where the model goes on: numbers get rarer there, none piles up."""
    x = np.sin(np.linspace(0.0, 20.0, 4000))
    y = np.round((np.maximum(x, 0.0) + 0.1 * np.random.default_rng(2).standard_normal(x.size)) * 20.0) / 20.0
    counts = np.unique(y, return_counts=True)[1]
    assert counts[0] < counts[1] < counts[2]
    assert saturation_finding(y, 1.2 * x) == []
    assert saturation_finding(np.maximum(np.round(x * 20.0) / 20.0, -0.5), x), "cut off, they do"


@every("noisy", [True, False])
@every("failure", ["stuck", "saturated"])
def test_a_failed_sensor_is(failure: str, noisy: bool) -> None:
    y = CLEAN + NOISE if noisy else CLEAN.copy()
    if failure == "stuck":
        y[2900:] = y[2899]
    else:
        y = np.minimum(y, 0.5 * y.max())
    assert found(y, float(NOISE.std()) if noisy else 1e-9)


def test_it_need_not_last_where_noise_resolves_the_scale() -> None:
    """Nine samples in a row equal to the bit, in a record where no two are: no chance."""
    y = CLEAN + NOISE
    assert is_resolved(y, float(NOISE.std()))
    y[2990:2999] = y[2990]
    assert "was constant to the bit for 0.8 s" in found(y)[-1]
    y[2990:] = y[2990]
    assert "is constant" in found(y)[-1]


def test_swapped_columns_show_by_their_levels() -> None:
    y = CLEAN + NOISE
    assert level_finding(U, y) == []
    assert "swapped" in level_finding(y, U)[0].reason
    assert level_finding(U, U) == []
    assert level_finding(y, np.ones(3000)) == []


@every(("usual", "wrong"), [(0.1, False), (0.114, False), (0.086, False), (1.0, True), (0.01, True)])
def test_a_clock_that_contradicts_the_sampling_time(usual: float, wrong: bool) -> None:
    assert bool(clock_finding(usual, 0.1)) == wrong


def test_the_step_of_a_scale() -> None:
    assert usual_step(np.round(16 * NOISE) / 16) == 1 / 16
    assert usual_step(np.round(np.arange(30.0) / 7.0, 1)) == pytest.approx(1 / 7, abs=0.06)  # few digits
    assert usual_step(NOISE) < 0.01 * NOISE.std()
    assert usual_step(np.array([1.0, np.nan])) == 0.0
    # levels that differ in their last digits alone, as differences of positions do; an outlier is no step
    assert usual_step(np.diff(0.1 * np.round(np.cumsum(CLEAN + 5.0)))) == pytest.approx(0.1)
    assert usual_step(np.append(NOISE, 1e12)) < 0.01 * NOISE.std()


@every("seed", [1, 5, 0, 4], quick=1)
def test_pulses_of_a_coarse_encoder_are_no_outliers(seed: int) -> None:
    """The speed is the difference of its positions, mostly zero, over the sampling time."""
    dt, line = 0.001, 2.0 * np.pi / 200
    u = random_steps(6000, shortest=40, longest=120, low=-1.5, high=1.5, seed=seed)
    positions = line * np.round(TransferFunction([100.0], [1.0, 20.0, 0.0]).simulate(u, dt) / line)
    made = fit(u, np.diff(positions, prepend=0.0) / dt, dt, poles=1, delay=dt / 2)
    assert not made.outliers.size
    np.testing.assert_allclose(made.parameters[:2], [20.0, 100.0], rtol=0.05)
