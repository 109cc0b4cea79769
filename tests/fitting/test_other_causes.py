"""Values of the input that the plant has not seen, and a drift of the output, are named, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.fitting.other_causes import SWAPPED
from replant.logs.column_roles import seem_swapped
from replant.numerics.robust import far_out
from replant.online.runs.result import Result
from replant.online.runs.run_log import judged_by_log
from support.builders import DT, binary, record
from support.cases import every

PLANT = rp.TransferFunction([2.0], [1.0, 0.5])


def run(log: rp.Log, poles: int) -> Result:
    return judged_by_log(rp.run(log, poles=poles), log)


@pytest.mark.slow
@every("identified, glitches", [(rp.fit, 20), (rp.fit, 1), (run, 20), (run, 1)], quick=1)
@every("level", [300.0, 0.0], quick=1)
def test_values_that_the_plant_has_not_seen_are_named(identified, glitches: int, level: float) -> None:
    u, y = record(PLANT, 3, 2000, DT, noise=0.05)
    rows = np.random.default_rng(3).choice(u.size, glitches, replace=False)
    seen = u + level
    seen[rows] = level + 60.0
    log = rp.Log(seen, y, DT)
    verdict = identified(log, poles=1).verdict
    if identified is rp.fit:
        assert rp.fit(seen, y, DT, poles=1).verdict.reasons == verdict.reasons  # of arrays, too
    values = "a value of the input lies" if glitches == 1 else "20 values of the input lie"
    assert verdict.status == "inconsistent"
    assert verdict.reasons[0].startswith(f"{values} far from its others, {level - 1.0:.3g} to {level + 1.0:.3g}, and")
    assert len(verdict.reasons) == 1
    seen[rows] = np.nan
    assert identified(rp.Log(seen, y, DT), poles=1).verdict.status == "trusted"


@every("poles", [1, 2])
def test_pulses_that_the_plant_answers_are_none(poles: int) -> None:
    u = binary(3, 2000, 8)
    u[np.random.default_rng(3).choice(u.size, 8, replace=False)] = 60.0
    plant = rp.TransferFunction([4.0], [1.0, 1.0, 4.0])
    y = plant.simulate(u, DT) + 0.05 * np.random.default_rng(4).standard_normal(u.size)
    verdict = rp.fit(u, y, DT, poles=poles).verdict
    assert (verdict.status == "trusted") is (poles == 2)
    assert not any("far from" in reason for reason in verdict.reasons)


@pytest.mark.slow
@every("identified", [rp.fit, run], quick=1)
@every("seed", [0, 2, 3], quick=1)
def test_a_straight_line_on_the_output_is_named(identified, seed: int) -> None:
    u, y = record(PLANT, seed, 2000, DT, noise=0.05)
    log = rp.Log(u + 2.0, y + 8.0 + np.linspace(0.0, 20.0, u.size), DT)
    verdict = identified(log, poles=1).verdict
    assert verdict.status == "inconsistent"
    assert verdict.reasons[0].startswith("the output drifts along a straight line, ")
    assert identified(rp.detrend(log), poles=1).verdict.status == "trusted"


@pytest.mark.slow
@every("seed", range(3), quick=1)
def test_what_a_slow_plant_does_is_no_drift(seed: int) -> None:
    """It rises all along, but the model of too few poles is wrong beside a line, too."""
    u = np.abs(binary(seed, 2000, 40))
    u[:100] = 0.0
    y = rp.TransferFunction([0.05], [1.0, 1.0, 0.02]).simulate(u, DT)
    y = y + 0.002 * np.random.default_rng(seed).standard_normal(u.size)
    verdict = rp.fit(u, y, DT, poles=1).verdict
    assert not any("drifts along" in reason for reason in verdict.reasons), verdict.reasons


@every("seed", [1, 0, 2], quick=1)
def test_a_slow_mode_that_the_structure_lacks_is_no_drift(seed: int) -> None:
    """A heat sink that warms up: without the line its model would have a gain of a thirtieth."""
    u = 0.5 + 0.5 * binary(seed, 3000, 30)
    plant = rp.TransferFunction([1.03, 0.031], [1.0, 1.001, 0.001])
    y = plant.simulate(u, 0.1) + 0.05 * np.random.default_rng(seed).standard_normal(u.size)
    verdict = rp.fit(rp.Log(u, y, 0.1), poles=1).verdict
    assert verdict.status == "inconsistent"
    assert not any("drifts along" in reason for reason in verdict.reasons), verdict.reasons


def test_a_line_that_the_input_makes_is_no_drift() -> None:
    """The plant is not linear, and beside a line its part of it matters less."""
    u = binary(3, 2000, 40) * 0.5 + np.linspace(-1.0, 1.0, 2000)
    y = PLANT.simulate(np.tanh(1.5 * u), DT) + 0.05 * np.random.default_rng(3).standard_normal(u.size)
    verdict = rp.fit(u, y, DT, poles=1).verdict
    assert verdict.status == "inconsistent"
    assert not any("drifts along" in reason for reason in verdict.reasons), verdict.reasons


def test_what_is_far_out_lies_beyond_the_range_by_its_width() -> None:
    values = np.array([*np.linspace(-1.0, 1.0, 41), 2.7, 3.3, -5.0, np.nan])
    found, low, high = far_out(values)
    assert np.flatnonzero(found).tolist() == [42, 43]
    assert (low, high) == pytest.approx((-1.0, 1.0), abs=0.2)
    assert not far_out(np.where(np.arange(100) == 50, 1.0, 0.0))[0].any()  # a single pulse has no others


def in_loop(seed: int, controller: str, load: str, filtered: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output of a loop without a set-point that a random walk at its ``load`` moves."""
    rng = np.random.default_rng(seed)
    walk, noise = np.cumsum(0.1 * rng.standard_normal(600)), 0.02 * rng.standard_normal(600)
    proportional, integral = {"integral": (0.0, 0.03), "PI": (0.5, 0.03)}[controller]
    u, y = np.zeros(600), np.zeros(600)
    x = total = seen = 0.0
    for k in range(600):
        x = 0.95 * x + 0.15 * (u[k - 1] + (walk[k] if load == "input" else 0.0))
        y[k] = x + noise[k] + (walk[k] if load == "output" else 0.0)
        seen = 0.7 * seen + 0.3 * y[k] if filtered else y[k]
        total += integral * seen
        u[k] = -proportional * seen - total
    return u, y


@every("digits", [None, 2])
@every("load", ["input", "output"])
@every("filtered", [True, False])
@every("controller", ["integral", "PI"])
def test_a_controllers_input_does_not_seem_swapped(controller: str, filtered: bool, load: str, digits) -> None:
    for seed in range(10):
        u, y = in_loop(seed, controller, load, filtered)
        assert not seem_swapped(u if digits is None else np.round(u, digits), y), seed


@every("noise", [0.02, 0.1])
@every("held", [25, 5, 1])
def test_exchanged_columns_of_an_open_loop_seem_swapped(held: int, noise: float) -> None:
    found = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1.0, 1.0, 600 // held), held)
        u = u if held > 1 else np.convolve(u, np.ones(10), "same")
        y = PLANT.simulate(u, 0.1)
        y += noise * y.std() * rng.standard_normal(u.size)
        found += seem_swapped(y, u)
        assert not seem_swapped(u, y), seed
    assert found >= 9


@every("seed", range(4), quick=1)
def test_a_verdict_asks_whether_columns_are_swapped(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 25)
    y = rp.TransferFunction([1.5], [1.0, 0.5]).simulate(u, 0.1) + 0.05 * rng.standard_normal(1500)
    swapped = rp.fit(y, u, 0.1, poles=1).verdict
    assert (swapped.status != "trusted", swapped.reasons[0]) == (True, SWAPPED)
    assert SWAPPED not in rp.fit(u, y, 0.1, poles=1).verdict.reasons


@every("controller, filtered", [("PI", True), ("integral", True), ("integral", False)], quick=1)
def test_a_verdict_does_not_ask_it_in_a_loop_and_explains_the_loop_once(controller: str, filtered: bool) -> None:
    found = rp.fit(*in_loop(0, controller, "output", filtered), 0.1, poles=1).verdict
    assert SWAPPED not in found.reasons
    assert sum("more colour than the noise model" in reason for reason in found.reasons) == 1


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_a_loop_whose_input_copies_the_output_is_said_to_be_closed_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, moved, load = 0.0, np.zeros(1500), np.cumsum(0.1 * rng.standard_normal(1500))
    measured = np.zeros(1500)
    for k in range(1500):
        x = 0.95 * x + 0.15 * (moved[k - 1] if k else 0.0)
        measured[k] = x + load[k]
        moved[k] = -0.8 * measured[k]
    found = rp.fit(moved, measured, 0.1, poles=1).verdict
    assert SWAPPED not in found.reasons
    assert sum("the loop is closed" in reason for reason in found.reasons) <= 1
