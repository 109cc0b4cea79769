"""An output that is held from report to report is named, as no stuck sensor; a coarse scale is none."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.signals import random_steps
from replant.verdict import Verdict
from support.cases import every

SWINGING = rp.TransferFunction([2.0], [1.0, 2.0, 4.0])
SAMPLES, PLANT = 3000, rp.TransferFunction([2.0], [30.0, 1.0])
HELD = "the output is held from report to report"


def record(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    u = random_steps(SAMPLES, shortest=50, longest=150, low=-2.0, high=2.0, seed=seed)
    return u, PLANT.simulate(u, 1.0) + noise * np.random.default_rng(seed).standard_normal(SAMPLES)


def by_exception(y: np.ndarray, deadband: float) -> np.ndarray:
    """What a historian keeps: a value is written once it has moved by a deadband."""
    kept = y.copy()
    for k in range(1, y.size):
        kept[k] = y[k] if abs(y[k] - kept[k - 1]) > deadband else kept[k - 1]
    return kept


def online(u: np.ndarray, y: np.ndarray) -> Verdict:
    ident = rp.Identifier(poles=1, dt=1.0)
    ident.update_many(u, y)
    ident.finish()
    return ident.assess()


def reports(y: np.ndarray) -> np.ndarray:
    """An output with the cells empty that repeat the one before."""
    return np.where(np.diff(y, prepend=np.nan) == 0.0, np.nan, y)


def checked(u: np.ndarray, y: np.ndarray) -> None:
    for found in (rp.fit(u, y, 1.0, poles=1).verdict, online(u, y)):
        assert (found.status, found.reasons[0][: len(HELD)]) == ("inconsistent", HELD), found.reasons
        assert not any("stuck" in reason for reason in found.reasons), found.reasons
    advised = rp.fit(u, reports(y), 1.0, poles=1)
    assert advised.verdict.status == "trusted"
    np.testing.assert_allclose(advised.parameters[:2], [1.0 / 30.0, 2.0 / 30.0], rtol=0.02)


@pytest.mark.slow
@every("seed", range(6), quick=2)
def test_an_output_written_once_it_has_moved_is_named_and_its_reports_give_the_plant(seed: int) -> None:
    u, y = record(seed, 0.01)
    checked(u, by_exception(y, 0.2))


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_an_output_of_a_slow_sensor_is_named_and_its_reports_give_the_plant(seed: int) -> None:
    u, y = record(seed, 0.03)
    checked(u, np.repeat(y[::15], 15)[:SAMPLES])


@every("seed", range(4), quick=1)
def test_an_output_that_is_held_for_less_than_matters_is_said_and_trusted(seed: int) -> None:
    u, y = record(seed, 0.01)
    found = rp.fit(u, np.repeat(y[::2], 2), 1.0, poles=1).verdict
    assert found.status == "trusted"
    assert any(reason.startswith(HELD) for reason in found.reasons), found.reasons


@every("step, noise", [(0.05, 0.0), (0.2, 0.0), (0.4, 0.05), (1.0, 0.05)], quick=2)
def test_equal_outputs_of_a_coarse_scale_are_not_held(step: float, noise: float) -> None:
    for seed in range(3):
        u, y = record(seed, noise)
        found = rp.fit(u, step * np.round(y / step), 1.0, poles=1).verdict
        assert not any(HELD in reason for reason in found.reasons), found.reasons


def swinging(seed: int, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """A plant that crosses a step of a coarse scale within a sample or two, and then rests within one."""
    u = random_steps(2000, shortest=10, longest=60, low=-1.0, high=1.0, seed=seed)
    return u, SWINGING.simulate(u, 0.1) + noise * np.random.default_rng(seed).standard_normal(u.size)


@every("seed, step", [(4, 0.1), (1, 0.2), (5, 0.1), (4, 0.2)], quick=2)
def test_a_coarse_scale_that_the_plant_crosses_fast_is_not_held(seed: int, step: float) -> None:
    """A new value lies half a step ahead of the plant: a model of these alone is early, and the one of all is right."""
    u, y = swinging(seed)
    found = rp.fit(u, step * np.round(y / step), 0.1, poles=2).verdict
    assert found.status == "trusted", found.reasons


@every("seed, step", [(0, 0.4), (1, 0.2)], quick=1)
def test_nor_is_it_behind_two_inputs(seed: int, step: float) -> None:
    (u, y), other = swinging(seed), random_steps(2000, shortest=10, longest=60, low=-1.0, high=1.0, seed=100 + seed)
    y = y + rp.TransferFunction([0.5], [1.0, 0.5]).simulate(other, 0.1)
    found = rp.fit(np.column_stack([other, u]), step * np.round(y / step), 0.1, poles=(1, 2)).verdict
    assert found.status == "trusted", found.reasons


@every("step, noise", [(0.0, 0.1), (0.1, 0.01)], quick=1)
def test_one_that_is_held_for_five_rows_is_with_much_noise_and_on_a_coarse_scale(step: float, noise: float) -> None:
    for seed in range(2):
        u, y = swinging(seed, noise)
        y = np.repeat(y[::5], 5)
        found = rp.fit(u, step * np.round(y / step) if step else y, 0.1, poles=2).verdict
        assert (found.status, found.reasons[0][: len(HELD)]) == ("inconsistent", HELD), (seed, found.reasons)
