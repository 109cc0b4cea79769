"""Scenario K of the accuracy benchmark, and the Cramer-Rao bound: the equations, the statistics, the promises."""

from __future__ import annotations

import doctest
import importlib
import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import toeplitz

import replant as rp
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy import controlled, linear, records, results
from accuracy.feedback import TRUSTED, Feedback, Outcome, Promised, compared, outcome, sizes
from accuracy.information import cramer_rao
from accuracy.loops import Controller, Disturbance, KnowsTheController, Loop, discretised, whitening_filter
from accuracy.summary import summarise
from replant.signals import prbs

EXPERIMENTS = {each.key: each for each in controlled.scenario_k()}
PLANT = rp.TransferFunction([1.0, 2.0], [1.0, 0.3, 1.0], 0.2)
LOOP = Loop(PLANT, 0.1, Controller(0.4, 0.1, 0.05, 0.1), 20, (), (3,), 60)


# --- the records


@pytest.mark.parametrize("at_input", [False, True])
def test_a_record_is_the_loops_difference_equations(at_input: bool) -> None:
    loop, generator = replace(LOOP, at_input=at_input), np.random.default_rng(0)
    r, d, v = generator.standard_normal((3, 60))
    u, y = loop.respond(r, d, v)
    (b, a), (top, bottom) = discretised(PLANT, 0.1), loop.controller.discretised(0.1)

    def behind(polynomial: np.ndarray, signal: np.ndarray) -> np.ndarray:
        return np.convolve(polynomial, signal)[:60]

    np.testing.assert_allclose(behind(a, y - v), behind(b, u + d), atol=1e-11)
    answer = behind(bottom, u - r) + behind(top, y) if at_input else behind(bottom, u) - behind(top, r - y)
    np.testing.assert_allclose(answer, 0.0, atol=1e-11)


def test_the_discretised_plant_is_the_packages_simulation() -> None:
    u = np.random.default_rng(1).standard_normal(60)
    silent = np.zeros(60)
    _, y = replace(LOOP, controller=Controller(0.0), at_input=True).respond(u, silent, silent)
    np.testing.assert_allclose(y, PLANT.simulate(u, 0.1), atol=1e-11)


def test_the_controller_is_its_differences() -> None:
    kp, ki, kd, tf, dt = 2.0, 0.5, 0.3, 0.2, 0.1
    top, bottom = Controller(kp, ki, kd, tf).discretised(dt)
    e = np.random.default_rng(2).standard_normal(50)
    u, integral, rate, last = np.zeros(50), 0.0, 0.0, 0.0
    for k in range(50):
        rate = (tf * rate + kd * (e[k] - last)) / (tf + dt)  # backward
        u[k] = kp * e[k] + integral + rate
        integral += ki * dt * e[k]  # forward
        last = e[k]
    np.testing.assert_allclose(np.convolve(bottom, u)[:50], np.convolve(top, e)[:50], atol=1e-12)


def test_a_controller_in_continuous_time_is_the_limit_of_fast_sampling() -> None:
    base = replace(LOOP, plant=rp.TransferFunction([1.0, 2.0], [1.0, 0.3, 1.0]), controller=Controller(2.0, 1.0))
    analogue = replace(base, analogue=True, at_input=True)
    signals = np.random.default_rng(3).standard_normal((3, 60))
    exact = np.concatenate(analogue.between_samples(*signals))
    errors = []
    for times in (50, 100):
        finer = replace(analogue, dt=0.1 / times)
        found = [each[::times] for each in finer.respond(*np.repeat(signals, times, axis=1))]
        errors.append(np.abs(np.concatenate(found) - exact).max())
    assert errors[0] < 0.2
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.1)  # of first order


@pytest.mark.parametrize("at_input", [False, True])
def test_a_disturbance_is_as_strong_as_it_says(at_input: bool) -> None:
    quiet = replace(LOOP, samples=4000, disturbances=(Disturbance((1.0,), (1.0,), math.inf),))
    noisy = replace(quiet, disturbances=(Disturbance((1.0,), (1.0, -0.9), 10.0, at_input),))
    clean, record = quiet(5), noisy(5)
    assert record.r is not None
    np.testing.assert_array_equal(record.r, clean.r)
    without = clean.y if at_input else PLANT.simulate(record.u, 0.1)  # of the noise, not of what answers it
    made = record.y - without
    assert made.std() / clean.y.std() == pytest.approx(10.0**-0.5, rel=1e-6)


def test_a_load_is_held_and_its_first_step_cut() -> None:
    load = Disturbance((1.0,), (1.0,), 10.0, at_input=True, held=100)
    drawn = [load.drawn(np.random.default_rng(seed), 1000) for seed in range(5)]
    steps = [np.flatnonzero(np.diff(each)) for each in drawn]
    assert all((np.diff(each) == 100).all() for each in steps)
    assert len({int(each[0]) for each in steps}) > 1


# --- the anchor and the bound


def test_the_anchor_finds_the_plant_and_says_how_well() -> None:
    experiment = EXPERIMENTS["K unstable white-10"]
    assert isinstance(experiment.record, Loop)
    loop = replace(experiment.record, samples=1000)
    anchor = KnowsTheController(loop)
    found = [anchor(experiment.structure, experiment.dt, loop(run)) for run in range(4)]
    for name, true in experiment.truth.items():
        missed = np.array([(figures[name][0] - true) / figures[name][1] for figures in found])
        assert np.abs(missed).max() < 4.5
        assert max(figures[name][1] for figures in found) < 0.1


def test_the_whitening_filter_is_the_autoregression() -> None:
    e = np.zeros(20_000)
    w = np.random.default_rng(4).standard_normal(e.size)
    for k in range(2, e.size):
        e[k] = 1.2 * e[k - 1] - 0.5 * e[k - 2] + w[k]
    found = whitening_filter(e, 3)
    np.testing.assert_allclose(found, [1.0, -1.2, 0.5, 0.0], atol=4.0 / math.sqrt(e.size) * 1.5)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_the_bound_is_that_of_the_whole_covariance_matrix(colour: float) -> None:
    u, size, step = prbs(300, bits=6, hold=8), 300, 1e-6
    clean = records.PLANT_A.simulate(u, 0.05)
    truth = np.array([4.0, 3.0, 2.0])

    def output(theta: np.ndarray) -> Any:
        return rp.TransferFunction(theta[2:], [1.0, *theta[:2]]).simulate(u, 0.05)

    slopes = [(output(truth + step * row) - output(truth - step * row)) / (2 * step) for row in np.eye(3)]
    sensitivities = np.column_stack([*slopes, np.ones(size)])
    covariance = 0.1 * clean.var() * toeplitz(colour ** np.arange(size))
    information = sensitivities.T @ np.linalg.solve(covariance, sensitivities)
    expected = np.sqrt(np.diag(np.linalg.inv(information)))[:3]
    np.testing.assert_allclose(cramer_rao(records.PLANT_A, u, 0.05, 10.0, colour), expected, rtol=1e-6)


def test_scenario_a_is_as_sharp_as_its_bound() -> None:
    u = prbs(2001, bits=8, hold=8)
    least = cramer_rao(records.PLANT_A, u, 0.05, 10.0, 0.0)
    np.testing.assert_allclose(least, list(linear.STD_A.values()), rtol=0.1)


# --- the statistics and the promises


def figures(a0: float, b0: float, trusted: bool) -> dict[str, tuple[float, float]]:
    return {"a0": (a0, 0.1), "b0": (b0, 0.1), TRUSTED: (float(trusted), math.nan)}


def test_an_outcome_counts_what_is_right_and_what_is_trusted() -> None:
    size, truth = {"a0": 2.0, "b0": 1.0}, {"a0": 0.0, "b0": 1.0}
    runs = [
        figures(0.1, 1.0, trusted=True),
        figures(-0.1, 1.05, trusted=False),
        figures(0.1, 1.2, trusted=True),
        figures(5.0, 1.0, trusted=False),
        figures(math.nan, math.nan, trusted=False),
    ]
    seen = outcome(size, truth, runs)
    assert (seen.runs, seen.failed, seen.diverged) == (5, 1, 2)
    assert (seen.right, seen.right_and_trusted, seen.wrong_and_trusted) == (2, 1, 1)
    assert seen.bias["a0"] == pytest.approx((5 - 5 + 5 + 250) / 4)
    assert seen.rms["b0"] == pytest.approx(math.sqrt((5**2 + 20**2) / 4))
    assert seen.coverage == pytest.approx(60.0)  # 3 of a0, 3 of b0, of 10; 0.1 off by 0.1 is inside


def seen_as(**changed: Any) -> Outcome:
    usual = Outcome(100, 0, 0, {"a0": 1.0}, {"a0": 0.2}, {"a0": 2.0}, 95.0, True, 50, 46, 0)
    return replace(usual, **changed)


@every(
    ("promised", "kept", "broken"),
    [
        (Promised(bias=2.0), {"bias": {"a0": 2.9}, "standard_error": {"a0": 1.5}}, {"bias": {"a0": -2.9}}),
        (Promised(bias=0.5, standard_errors=0.0), {"bias": {"a0": 0.5}}, {"bias": {"a0": 0.51}}),
        (Promised(bias=2.0), {}, {"failed": 1}),
        (Promised(rms=1.4), {"rms": {"a0": 2.79}}, {"rms": {"a0": 2.81}}),
        (Promised(online="online"), {"rms": {"a0": 2.0}}, {"rms": {"a0": 2.2}}),
        (Promised(is_covered=True), {"coverage": 88.0}, {"coverage": 99.5}),
        (Promised(is_trusted=True), {"right_and_trusted": 45}, {"right_and_trusted": 44}),
        (Promised(is_trusted=True), {}, {"right": 0, "right_and_trusted": 0}),
        (Promised(never_wrong=True), {}, {"wrong_and_trusted": 1}),
        (Promised(stays=True), {}, {"diverged": 1}),
    ],
)
def test_a_promise_is_kept_up_to_its_limit(promised: Promised, kept: dict[str, Any], broken: dict[str, Any]) -> None:
    feedback = Feedback({"a0": 1.0}, {"m": promised}, {}, "anchor")
    for changed, expected in ((kept, True), (broken, False)):
        outcomes = {"m": seen_as(**changed), "anchor": seen_as(), "online": seen_as()}
        (line,) = compared(feedback, outcomes, "m")
        assert line[2] is expected, line


def test_nothing_is_said_of_trust_where_the_anchor_is_coarse() -> None:
    feedback = Feedback({"a0": 1.0}, {"m": Promised(is_trusted=True)}, {}, "anchor")
    (line,) = compared(feedback, {"m": seen_as(right_and_trusted=0), "anchor": seen_as(rms={"a0": 4.1})}, "m")
    assert line[2] is None


@every("key", EXPERIMENTS)
def test_a_loop_has_what_its_promises_name(key: str) -> None:
    experiment = EXPERIMENTS[key]
    feedback = experiment.feedback
    assert feedback is not None
    assert set(feedback.sizes) == set(experiment.truth) == set(experiment.structure.names)
    assert min(feedback.sizes.values()) > 0
    for method, promised in feedback.promised.items():
        assert method in experiment.methods
        assert promised.online in ("", *experiment.methods)
        if not math.isnan(promised.rms) or promised.is_trusted:
            assert feedback.anchor in experiment.methods
    assert set(feedback.families) <= set(experiment.methods)


def test_every_loop_is_stable() -> None:
    for experiment in EXPERIMENTS.values():
        loop = experiment.record
        assert isinstance(loop, Loop)
        pulse = np.zeros(20 * loop.hold)
        pulse[0] = 1.0
        u, y = loop.respond(pulse, 0 * pulse, 0 * pulse)
        assert np.abs([u[-loop.hold :], y[-loop.hold :]]).max() < 1e-2 * np.abs(u).max()


def test_sizes_take_poles_at_zero_for_slow_ones() -> None:
    assert sizes(rp.TransferFunction([7.0], [1.0, 0.0, 0.0])).tolist() == [2.0, 1.0, 7.0]
    assert sizes(rp.TransferFunction([1.0], [1.0, -1.0])).tolist() == [1.0, 1.0]


# --- a run, and its place in the report


def test_a_run_with_the_reference_beside_the_anchor() -> None:
    experiment = EXPERIMENTS["K lag white-10"]
    record = experiment.record(0)
    asked = {name: experiment.methods[name] for name in (controlled.ONLINE_R, controlled.OFFLINE_R, controlled.ANCHOR)}
    found = {name: method(experiment.structure, experiment.dt, record) for name, method in asked.items()}
    assert set(found[controlled.ONLINE_R]) > {TRUSTED}
    for name, true in experiment.truth.items():
        std = found[controlled.ANCHOR][name][1]
        for figures_ in found.values():
            assert abs(figures_[name][0] - true) < 6 * std
    assert experiment.feedback is not None
    families = {controlled.ONLINE_R: controlled.ALL_WITH_R}
    feedback = replace(experiment.feedback, promised=controlled.WITH_R, families=families)
    some = replace(experiment, methods=asked, feedback=feedback)
    tables = results.tabulated([summarise(some, [found])], {})
    promised = {(row["experiment"], row["method"], row["promise"]) for row in tables["promises"]}
    assert ("K lag white-10", controlled.ONLINE_R, "bias within 2 % or 2 standard errors") in promised
    assert any(experiment == "K all with r" for experiment, _, _ in promised)
    assert [row["method"] for row in tables["loops"]] == list(some.methods)


@pytest.mark.parametrize("name", ["feedback", "information", "loops"])
def test_examples_in_docstrings(name: str) -> None:
    assert doctest.testmod(importlib.import_module(f"accuracy.{name}")).failed == 0
