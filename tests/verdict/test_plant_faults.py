"""A plant whose coefficients depend on the operating point, or with dry friction, is named, and no linear one is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.signals import random_steps
from replant.verdict import assess_record
from replant.verdict.evidence import Evidence
from replant.verdict.plant_faults import Path
from support.bending import damped, lagging, rubbing, turning
from support.builders import binary
from support.cases import every
from support.loops import closed_loop

DT, SAMPLES = 0.1, 2000
LEVELS, FRICTION = "the plant acts otherwise at other levels", "dry friction"
WAYS, TIMES = "the plant acts otherwise on its way up than on its way down", "the plant changes as the record goes on"
Plant = Callable[[np.ndarray], np.ndarray]
BENT: dict[str, tuple[Plant, int]] = {
    "a time constant that grows": (lambda u: lagging(u, DT, lambda y: 0.3 * y), 1),
    "one that is longer far from the middle": (lambda u: lagging(u, DT, lambda y: 0.6 * abs(y) - 0.3), 1),
    "damping that grows": (lambda u: damped(u, DT, lambda y: 0.3 * y), 2),
}
SLIGHTLY: dict[str, tuple[Plant, int]] = {
    "a time constant that grows": (lambda u: lagging(u, DT, lambda y: 0.06 * y), 1),
    "damping that grows": (lambda u: damped(u, DT, lambda y: 0.06 * y), 2),
}


def moves(seed: int) -> np.ndarray:
    """Steps of a few tenths about levels that hold for ten time constants."""
    levels = random_steps(SAMPLES, shortest=80, longest=160, low=-0.7, high=0.7, seed=seed)
    return levels + 0.3 * binary(seed + 1, SAMPLES, 12)


def noisy(y: np.ndarray, part: float = 0.01) -> np.ndarray:
    return y + part * y.std() * np.random.default_rng(7).standard_normal(y.size)


def offline(u: np.ndarray, y: np.ndarray, poles: int) -> rp.Assessment:
    return rp.fit(u, y, DT, poles=poles).verdict


def online(u: np.ndarray, y: np.ndarray, poles: int) -> rp.Assessment:
    ident = rp.Identifier(rp.Structure(poles), DT)
    ident.update_many(u, y)
    return ident.assess()


def finished(u: np.ndarray, y: np.ndarray, poles: int) -> rp.Assessment:
    ident = rp.Identifier(rp.Structure(poles), DT)
    ident.update_many(u, y)
    ident.finish()
    return ident.assess()


def said(verdict: rp.Assessment, words: str) -> bool:
    return any(words in reason for reason in verdict.reasons)


@pytest.mark.slow
@pytest.mark.parametrize("judged", [offline, pytest.param(finished, marks=pytest.mark.slow), online])
@every("bent", BENT, quick=2)
def test_coefficients_that_depend_on_the_operating_point_are_named(
    bent: str, judged: Callable[[np.ndarray, np.ndarray, int], rp.Assessment]
) -> None:
    """Its output differs by a few per cent from a linear plant's, its steps at the ends of the range by a tenth."""
    plant, poles = BENT[bent]
    u = moves(3)
    verdict = judged(u, noisy(plant(u)), poles)
    assert verdict.status == "inconsistent", verdict.reasons
    assert said(verdict, LEVELS), verdict.reasons


@pytest.mark.slow
@every("bent", SLIGHTLY)
def test_a_plant_that_is_slightly_nonlinear_stays_trusted(bent: str) -> None:
    """It is named, as far as it is sure, in a remark."""
    plant, poles = SLIGHTLY[bent]
    u = moves(3)
    verdict = offline(u, noisy(plant(u), 0.002), poles)
    assert verdict.status == "trusted"
    assert said(verdict, LEVELS), verdict.reasons


@every("seed", range(6), quick=2)
def test_a_linear_plant_is_not(seed: int) -> None:
    u = 0.5 * seed + moves(seed)
    for plant in (rp.TransferFunction([1.0], [1.0, 1.0]), rp.TransferFunction([1.0, 3.0], [1.0, 1.2, 4.0])):
        y = noisy(plant.simulate(u, DT), 0.03)
        verdict = rp.fit(u, y, DT, poles=plant.den.size - 1, zeros=plant.num.size - 1).verdict
        assert verdict.status == "trusted", verdict.reasons
        assert not said(verdict, LEVELS), verdict.reasons
        assert not any(said(verdict, words) for words in (FRICTION, WAYS, TIMES)), verdict.reasons


def figure_of(verdict: rp.Assessment, words: str) -> float:
    """By how much G is said to differ; 0 where nothing is."""
    said = [reason for reason in verdict.reasons if reason.startswith(words)]
    return float(said[0].split(" by ")[1].split(" %")[0]) if said else 0.0


@pytest.mark.parametrize("judged", [offline, finished, online])
@every("up, down", [(1.25, 0.75), (0.8, 1.3)], quick=1)
def test_a_plant_that_rises_faster_than_it_falls_is_named(
    up: float, down: float, judged: Callable[[np.ndarray, np.ndarray, int], rp.Assessment]
) -> None:
    """As a heater that cools more slowly than it heats: its mean had been trusted."""
    u = random_steps(SAMPLES, shortest=10, longest=50, low=-1.0, high=1.0, seed=5)
    verdict = judged(u, noisy(turning(u, DT, up, down), 0.03), 1)
    assert verdict.status == "inconsistent", verdict.reasons
    # 25 % either way, of which the mean has none; beyond chance it is less
    assert 15.0 < figure_of(verdict, WAYS) < 30.0, verdict.reasons


@pytest.mark.slow
@pytest.mark.parametrize("judged", [offline, pytest.param(finished, marks=pytest.mark.slow), online])
@every("periods, size", [(1.0, 0.3), (3.3, 0.3)], quick=1)
def test_a_plant_whose_gain_goes_up_and_down_is_named(
    periods: float, size: float, judged: Callable[[np.ndarray, np.ndarray, int], rp.Assessment]
) -> None:
    """The mean of its gain had been trusted, with a fit of 75 % where the noise allows 97 %."""
    u = random_steps(SAMPLES, shortest=5, longest=30, low=-1.0, high=1.0, seed=6)
    swing = 1.0 + size * np.sin(2.0 * np.pi * periods * np.arange(SAMPLES) / SAMPLES)
    y = rp.TransferFunction([1.5], [1.0, 0.7, 1.2]).simulate(u * swing, DT)
    verdict = judged(u, noisy(y, 0.03), 2)
    assert verdict.status == "inconsistent", verdict.reasons
    assert figure_of(verdict, TIMES) < 100.0 * size
    assert said(verdict, TIMES) or any("the plant" in reason and "change" in reason for reason in verdict.reasons)


@every("seed", range(5), quick=1)
def test_a_slow_swing_is_named_in_strong_noise_by_its_mean(seed: int) -> None:
    """Few waves are needed for it: the columns of eight hide it in their own uncertainty."""
    u = random_steps(SAMPLES, shortest=5, longest=30, low=-1.0, high=1.0, seed=seed)
    swing = 1.0 + 0.3 * np.sin(3.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    y = rp.TransferFunction([1.5], [1.0, 0.7, 1.2]).simulate(u * swing, DT)
    verdict = offline(u, noisy(y, 0.4), 2)
    assert verdict.status == "inconsistent", verdict.reasons
    assert 0.5 * swing.std() < 0.01 * figure_of(verdict, TIMES) < 1.2 * swing.std()


@every("seed", [9, 10, 11, 59], quick=2)
def test_a_random_walk_round_an_integrator_is_no_fault(seed: int) -> None:
    """An autoregression of order four leaves colour at the lowest frequencies: the columns of a drift take it."""
    rng = np.random.default_rng(seed)
    walk, r = np.cumsum(rng.standard_normal(SAMPLES)), np.repeat(rng.uniform(-1.0, 1.0, SAMPLES // 25), 25)
    noise = 0.01 * walk + 0.05 * rng.standard_normal(SAMPLES)
    u, y = closed_loop([1.0], [1.0, 0.0], (0.8, 0.0), DT, r, np.zeros(SAMPLES), noise)
    verdict = rp.fit(u, y, DT, poles=1, reference=r).verdict
    assert verdict.status != "inconsistent", verdict.reasons


def test_small_differences_are_a_remark() -> None:
    u = random_steps(SAMPLES, shortest=10, longest=50, low=-1.0, high=1.0, seed=5)
    verdict = offline(u, noisy(turning(u, DT, 1.04, 0.96), 0.005), 1)
    assert verdict.status == "trusted", verdict.reasons
    assert 1.0 < figure_of(verdict, WAYS) < 5.0, verdict.reasons


@every("seed", [6, 11, 12, 18], quick=2)
def test_a_controller_that_answers_noise_at_once_makes_no_other_way_down(seed: int) -> None:
    """Of one pole the slope jumps with the input, which answers the noise of the same sample."""
    noise = 0.03 * np.random.default_rng(seed).standard_normal(1000)
    u, y = closed_loop([1.0], [1.0, 1.0], (3.0, 1.0), DT, np.ones(1000), np.zeros(1000), noise)
    verdict = assess_record(rp.Structure(1), np.ones(2), Record(u, y - y.mean(), np.array([DT])), DT)
    assert not said(verdict, WAYS), verdict.reasons


@every("poles", [1, 2])
def test_a_column_holds_no_input_of_its_own_sample(poles: int) -> None:
    """In feedback that answers the noise: what a model of a direct path alone may hold."""
    u = np.random.default_rng(1).standard_normal(50)
    structure, theta = rp.Structure(poles), np.array([*[1.0] * poles, 1.0])

    def columns(u: np.ndarray) -> np.ndarray:
        record = Record(u, np.zeros(u.size), np.array([DT]))
        path = Path.of(Evidence(structure, DT, record, theta, None, theta, 0, u.size))
        assert path is not None
        return path.changes(*(np.sign(each[:, 1]) for each in (path.states, path.reached)))

    other = np.append(u[:-1], -30.0 * np.sign(u[-1]))
    np.testing.assert_array_equal(columns(u)[-1], columns(other)[-1])


@pytest.mark.slow
@every("spring", [0.0, 1.0])
def test_dry_friction_is_named(spring: float) -> None:
    """A positioning plant with and without a spring; without friction it is trusted."""
    u = random_steps(SAMPLES, shortest=5, longest=30, low=-1.0, high=1.0, seed=4)
    u -= u.mean()
    verdict = offline(u, noisy(rubbing(u, DT, spring, 0.15), 0.003), 2)
    assert verdict.status == "inconsistent", verdict.reasons
    assert said(verdict, FRICTION), verdict.reasons
    assert not said(offline(u, noisy(rubbing(u, DT, spring, 0.0), 0.003), 2), FRICTION)


def test_the_columns_are_the_changes_of_the_output_to_first_order() -> None:
    """Half of the bend leaves a quarter of what the columns do not explain: of (1 + c y) y' = u - y it is c y y'."""
    u = random_steps(600, shortest=3, longest=20, low=-1.0, high=1.0, seed=2)
    u -= u[0]
    structure, theta, dt = rp.Structure(1), np.array([1.0, 1.0]), 0.02
    record = Record(u, np.zeros(u.size), np.array([dt]))
    path = Path.of(Evidence(structure, dt, record, theta, None, theta, 0, u.size))
    assert path is not None
    x = rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, dt)
    # a change of the coefficient of x', by x itself
    column = path.changes(x, x)[:, 1]

    def left(bend: float) -> float:
        bent = lagging(u, dt, lambda y: bend * y) - x
        return float(np.abs(bent - bend * column).max())

    assert 3.0 < left(0.1) / left(0.05) < 5.0
    assert left(0.05) < 0.1 * float(np.abs(0.05 * column).max())


def test_the_changes_of_the_response_are_those_of_g() -> None:
    structure, theta = rp.Structure(2, 1), np.array([1.2, 4.0, 1.0, 3.0])
    record = Record(np.arange(10.0), np.zeros(10), np.array([DT]))
    path = Path.of(Evidence(structure, DT, record, theta, None, theta, 0, 10))
    assert path is not None
    omega, small = np.array([0.3, 2.0, 7.0]), 1e-6
    changes = path.changes_of_response(omega)
    a, b = np.array([4.0, 1.2, 1.0]), np.array([3.0, 1.0])  # a_0 .. a_n, b_0 .. b_m

    def response(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.polyval(b[::-1], 1j * omega) / np.polyval(a[::-1], 1j * omega)

    for i in range(5):
        step = small * np.eye(5)[i]
        moved = response(a + step[:3], b + step[3:]) / response(a, b) - 1.0
        np.testing.assert_allclose(moved / small, changes[:, i], rtol=1e-5)


def test_the_rounding_of_a_step_response_is_no_other_plant() -> None:
    """A coarse scale without noise: what the model leaves follows from the path, and is smaller than a step of it."""
    u = np.repeat([0.0, 1.0], [300, 2700])
    y = rp.TransferFunction([1.0], np.poly([-1.0, -2.5, -6.0])).simulate(u, 0.04)
    step = 0.008 / 1.5
    verdict = rp.fit(u, step * np.round(y / step), 0.04, poles=3).verdict
    assert verdict.status == "trusted", verdict.reasons
    assert not said(verdict, LEVELS), verdict.reasons


def test_no_figure_is_given_beyond_first_order() -> None:
    """Behind a parabola the gain has another sign at the ends."""
    u = moves(3)
    x = rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, DT)
    verdict = offline(u, noisy(x + 1.5 * x**2), 1)
    assert said(verdict, "G differs by 100 % at least")


@pytest.mark.slow
@every("seed", [0, 2])
def test_a_line_that_is_left_of_the_output_is_no_other_plant(seed: int) -> None:
    """Taken off both signals, lines leave a part of the plant's answer; `fit` takes it for loads, or for a drift."""
    u = binary(seed, SAMPLES, 5)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.05) + np.linspace(0.0, 20.0, SAMPLES)
    log = rp.Log(u, y + 0.05 * np.random.default_rng(seed + 1).standard_normal(SAMPLES), 0.05)
    verdict = rp.fit(rp.detrend(log), poles=1).verdict
    assert not said(verdict, LEVELS)
    assert not said(verdict, FRICTION)


def test_a_slight_bend_under_few_moves_is_no_change_in_time() -> None:
    """Nearly free of noise, many columns find a frequency where G seems to differ; in its mean it does not."""
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], 20).repeat(100)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT)
    y = 6.0 * np.tanh(y / 6.0) + 0.002 * rng.standard_normal(u.size)
    for judged in (offline, finished):
        verdict = judged(u, y, 1)
        assert verdict.status == "trusted", verdict.reasons
        assert not said(verdict, TIMES), verdict.reasons
