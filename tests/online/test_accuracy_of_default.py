"""Accuracy of the default identifier, given structure and dt: exact without noise, within its std under noise."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import replant as rp
from replant.kernels.filters import bank as bk
from replant.numerics.linear_algebra import compose
from replant.signals import prbs
from support.builders import AWKWARD, DT, binary, random_plant, record, state, true_parameters, two_modes
from support.cases import every
from support.inside import factors_of, set_covariance, state_of

every_plant = every("name", AWKWARD)
SMOOTH = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))


def made(name: str, samples: int = 4000, noise: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A PRBS that begins at rest, and the plant's output with white noise of a part ``noise`` of its spread."""
    u = prbs(samples, bits=9, hold=6)
    u[:4] = 0.0
    y = AWKWARD[name][1].simulate(u, DT)
    return u, y + noise * y.std() * np.random.default_rng(seed).standard_normal(samples)


def truth(name: str) -> np.ndarray:
    structure, plant = AWKWARD[name]
    return true_parameters(plant, structure.zeros)


def relative(parameters: np.ndarray, name: str) -> np.ndarray:
    true = truth(name)
    return np.abs(parameters - true) / np.where(true == 0.0, np.abs(true).max(), np.abs(true))


def covariance_of(ident: rp.Identifier) -> np.ndarray:
    """U D U' of the second-order optimizers, in scaled parameters."""
    return compose(*factors_of(ident))


# --- without noise


@every("name", AWKWARD, quick=3)
def test_without_noise_every_coefficient_is_exact_from_the_first_estimate_on(name: str) -> None:
    """A thousandth was asked for; integrator, damping 0.001, zeros on the right and dead times included.

    The integrator's filter keeps a pole just left of the axis, and learns its offset from there.
    """
    u, y = made(name)
    ident = rp.Identifier(AWKWARD[name][0], DT)
    trace = ident.update_many(u, y)
    assert isinstance(ident.settings.filter, rp.RefinedFilter)
    assert ident.settings.optimizer == rp.RecursiveLeastSquares()
    assert (ident.settings.instruments, ident.settings.replay) == (True, None)
    first = ident.settings.startup - 1
    assert first == 499
    tolerance = 1e-5 if name == "integrator" else 1e-8
    assert max(relative(row, name).max() for row in trace.parameters[first::50]) < tolerance
    assert np.nanmax(np.abs(trace.errors[first:])) < 10 * tolerance * np.abs(y).max()
    assert ident.status == "running"


@every("name", AWKWARD, quick=3)
def test_the_recursion_alone_gets_there_too(name: str) -> None:
    """From a tenth beside the truth (a half-width of the resonance, where that is sharp), by samples alone.

    With forgetting: what was learned behind a wrong model is never quite undone without it, which is why the default
    solves its record again as it grows.
    """
    u, y = made(name, 60_000 if name == "damping 0.001" else 10_000)
    ident = rp.Identifier(AWKWARD[name][0], DT, optimizer=rp.RecursiveLeastSquares(time_constant=20.0))
    ident.update_many(u[:1000], y[:1000])
    inside = state_of(ident)
    wide, away = truth(name), 0.002 if name == "damping 0.001" else 0.1
    inside.theta[: wide.size] *= 1.0 + away * np.cos(np.arange(wide.size))
    sizes = np.append(wide, np.ones(inside.entries - wide.size))
    set_covariance(ident, away**2 * np.maximum(sizes**2, 1e-2))
    assert relative(ident.parameters, name).max() > 0.9 * away
    ident.update_many(u[1000:], y[1000:])
    assert relative(ident.parameters, name).max() < 1e-3


# --- with noise


@every("name", AWKWARD, quick=3)
def test_with_noise_the_truth_lies_where_the_covariance_says(name: str) -> None:
    """One run a plant at 20 dB: the chi-square of P degrees of freedom stays below its 1 - 1e-4 quantile."""
    u, y = made(name, noise=0.1)
    ident = rp.Identifier(AWKWARD[name][0], DT)
    ident.update_many(u, y)
    away, covariance = ident.parameters - truth(name), ident.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))).min() > 0
    assert away @ np.linalg.solve(covariance, away) < chi2.ppf(1 - 1e-4, away.size)
    known = ident.uncertainty.cancelled_pole is None
    np.testing.assert_array_equal(ident.uncertainty.std, np.sqrt(np.diag(covariance)) if known else np.inf)


def test_at_a_new_solution_online_is_offline() -> None:
    """The estimate is the one that `fit` finds in the record so far."""
    u, y = made("order 2", noise=0.2)
    ident = rp.Identifier(AWKWARD["order 2"][0], DT)
    solved = []
    for samples in range(500, 4001):
        ident.update_many(u[ident.samples : samples], y[ident.samples : samples])
        if ident._state.solved_at != samples:
            continue
        solved.append(samples)
        offline = rp.fit(u[:samples], y[:samples], DT, ident.structure, method="srivc")
        std = np.sqrt(np.diag(offline.covariance))
        assert (np.abs(ident.parameters - offline.parameters) < 0.02 * std).all()
        np.testing.assert_allclose(ident.uncertainty.std, std, rtol=0.02)
    assert len(solved) >= 4
    assert max(b / a for a, b in itertools.pairwise(solved)) < 1.6
    # and in between it is not far: what the recursion cannot undo is what the filter was before
    u, y = made("order 2", 9000, noise=0.2)
    ident.update_many(u[4000:7900], y[4000:7900])
    offline = rp.fit(u[:7900], y[:7900], DT, ident.structure, method="srivc")
    assert (np.abs(ident.parameters - offline.parameters) < 0.7 * np.sqrt(np.diag(offline.covariance))).all()


def test_units_do_not_matter() -> None:
    """To the bit for powers of two: b scales with y and against u, and so do their standard deviations."""
    u, y = made("non-minimum phase", noise=0.1)
    plain, scaled = (rp.Identifier(AWKWARD["non-minimum phase"][0], DT) for _ in range(2))
    plain.update_many(u, y)
    scaled.update_many(2.0**-20 * u, 2.0**30 * y)
    factor = np.array([1.0, 1.0, 2.0**50, 2.0**50])
    np.testing.assert_allclose(scaled.parameters, factor * plain.parameters, rtol=1e-6)
    np.testing.assert_allclose(scaled.uncertainty.std, factor * plain.uncertainty.std, rtol=1e-6)


# --- estimates that cannot serve as a model


@every("a", [[-0.5, 4.0], [2.0, -4.0], [-1.0, -1.0], [0.0, 4.0]], ids=repr)
def test_an_estimate_that_is_not_stable_is_learned_away_behind_the_last_stable_model(a: list[float]) -> None:
    """Throughout, the bank that serves has every pole on the left; the estimate comes back to the truth."""
    structure, plant = SMOOTH
    u = prbs(6000, bits=9, hold=6)
    y = plant.simulate(u, DT)
    ident = rp.Identifier(structure, DT, optimizer=rp.RecursiveLeastSquares(time_constant=20.0))
    ident.update_many(u[:600], y[:600])
    state_of(ident).theta[:2] = a
    set_covariance(ident, 10.0)
    for k in range(600, 6000, 50):
        ident.update_many(u[k : k + 50], y[k : k + 50])
        inside = state_of(ident)  # another one once an alarm was looked into
        for which in (1, 2) if inside.warming else (int(inside.serving_bank),):
            denominator = inside.banks[which, bk.DENOMINATOR : bk.DENOMINATOR + 2]
            assert np.roots([1.0, *denominator]).real.max() < 0
    np.testing.assert_allclose(ident.parameters, true_parameters(plant, 1), rtol=1e-3)
    assert ident.status == "running"


def test_an_unstable_plant_says_so_by_its_poles_or_not_at_all() -> None:
    """A plant with a pole on the right, for as long as its output is small: nothing breaks, every number finite."""
    plant = rp.TransferFunction([1.0], [1.0, 0.5, -0.05])
    u, y = record(plant, seed=1, samples=1200, dt=DT, hold=10, noise=0.001)
    ident = rp.Identifier(rp.Structure(2), DT)
    trace = ident.update_many(u, y)
    assert np.isfinite(trace.parameters).all()
    assert np.isfinite(state_of(ident).banks).all()


# --- start-up


def test_it_waits_for_an_input_that_moves() -> None:
    """A rig that idles for 30 000 samples and then moves: the idle part is let go of, half by half."""
    structure, plant = SMOOTH
    u = np.concatenate([np.zeros(30_000), prbs(6000, bits=9, hold=6)])
    y = plant.simulate(u, DT) + 0.01 * np.random.default_rng(0).standard_normal(u.size)
    ident = rp.Identifier(structure, DT)
    before = ident.update_many(u[:30_000], y[:30_000])
    assert ident.status == "starting"
    assert not before.parameters.any()
    assert ident.samples <= 20_000
    ident.update_many(u[30_000:], y[30_000:])
    assert ident.status == "running"
    np.testing.assert_allclose(ident.parameters, true_parameters(plant, 1), rtol=0.05)


@pytest.mark.parametrize("poles", [1, 3])
def test_however_few_samples_are_asked_for_it_takes_what_a_model_needs(poles: int) -> None:
    ident = rp.Identifier(rp.Structure(poles), DT, startup=1)
    u, y = record(random_plant(3, poles), seed=1, samples=400, dt=DT)
    trace = ident.update_many(u, y)
    started = int(np.flatnonzero(trace.parameters.any(axis=1))[0]) + 1
    assert started >= 4 * (2 * poles + 2)


def test_a_bad_start_up_waits_for_more() -> None:
    """At 0 dB 60 samples tell nothing: the identifier holds on until they do, doubling."""
    structure, plant = SMOOTH
    u, y = record(plant, seed=2, samples=4000, dt=DT, hold=10)
    y += y.std() * np.random.default_rng(3).standard_normal(4000)
    ident = rp.Identifier(structure, DT, startup=60)
    ident.update_many(u, y)
    assert ident.settings is not None
    assert ident.settings.startup in {120 * 2**k for k in range(5)}


# --- working point and bias


OFFSET_U, OFFSET_Y = 5.0, 8.0


@every(
    "preprocess",
    [
        rp.Preprocess(),
        rp.Preprocess(input_offset="first", output_offset="first"),
        rp.Preprocess(input_offset="mean", output_offset="mean"),
        rp.Preprocess(input_offset=OFFSET_U, output_offset=OFFSET_Y),
        rp.Preprocess(input_offset=-100.0, output_offset=77.0),
    ],
    ids=["none", "first", "mean", "known", "wrong"],
    quick=2,
)
def test_any_working_point_is_right_because_a_constant_is_estimated(preprocess: rp.Preprocess) -> None:
    structure, plant = SMOOTH
    u = prbs(3000, bits=9, hold=6)
    u[:4] = 0.0
    y = plant.simulate(u, DT) + OFFSET_Y
    ident = rp.Identifier(structure, DT, preprocess=preprocess)
    ident.update_many(u + OFFSET_U, y)
    np.testing.assert_allclose(ident.parameters, true_parameters(plant, 1), rtol=1e-8)


@pytest.mark.parametrize(
    ("input_map", "by_hand"), [("square", np.square), (np.cbrt, np.cbrt)], ids=["square", "callable"]
)
def test_a_mapped_input_is_as_one_mapped_by_hand(input_map: Any, by_hand: Any) -> None:
    """To the bit, through start-up and every new solution of the record."""
    structure, plant = SMOOTH
    u = 2.0 + prbs(3000, bits=9, hold=6)
    y = plant.simulate(by_hand(u), DT) + 0.1 * np.random.default_rng(0).standard_normal(3000)
    inside = rp.Identifier(structure, DT, preprocess=rp.Preprocess(input_map)).update_many(u, y)
    outside = rp.Identifier(structure, DT).update_many(by_hand(u), y)
    np.testing.assert_array_equal(inside.parameters, outside.parameters)
    np.testing.assert_array_equal(inside.errors, outside.errors)


def test_rejected_samples_shift_no_new_solution() -> None:
    """Wherever bad samples fall, also just before twice the start-up: the estimate is that of the others."""
    u, y = made("order 2", noise=0.1)
    clean, spoiled = (rp.Identifier(AWKWARD["order 2"][0], DT) for _ in range(2))
    t = DT * np.arange(u.size)
    expected = clean.update_many(u, y, t).parameters
    bad = [3, 499, 600, 998, 999, 999, 1000, 1500, 2001, 3998]
    trace = spoiled.update_many(np.insert(u, bad, np.nan), np.insert(y, bad, 0.0), np.insert(t, bad, t[bad]))
    np.testing.assert_array_equal(trace.parameters[np.isfinite(np.insert(u, bad, np.nan))], expected)
    assert spoiled.rejected["not finite"] == len(bad)


def test_the_bias_of_the_refined_filter_is_the_constant_of_the_equation() -> None:
    """A y = B u + bias: an offset of the output times a0."""
    _, plant = SMOOTH
    u = prbs(3000, bits=9, hold=6)
    u[:4] = 0.0
    for offset in (0.0, 3.0, -1e3):
        ident = rp.Identifier(rp.Structure(2, 1, bias=True), DT)
        ident.update_many(u, plant.simulate(u, DT) + offset)
        expected = np.append(true_parameters(plant, 1), offset * plant.den[-1])
        np.testing.assert_allclose(ident.parameters, expected, rtol=1e-8, atol=1e-9)
        assert ident.covariance.shape == (5, 5)


# --- what the user may do meanwhile


def test_while_frozen_samples_go_through_the_filters_and_nothing_is_learned() -> None:
    u, y = made("order 2", noise=0.1)
    ident = rp.Identifier(AWKWARD["order 2"][0], DT)
    ident.update_many(u[:700], y[:700])
    ident.freeze()
    parameters, covariance = ident.parameters, ident.covariance
    trace = ident.update_many(u[700:2500], y[700:2500])
    assert (trace.parameters == parameters).all()
    np.testing.assert_array_equal(ident.covariance, covariance)
    assert ident.samples == 2500
    # the errors are those of a model that runs: no larger than noise and a first model make them
    assert trace.errors.std() < 0.2 * y.std()
    ident.resume()
    ident.update_many(u[2500:2501], y[2500:2501])
    assert (ident.parameters != parameters).any()


def test_what_came_in_while_frozen_is_never_learned_afterwards() -> None:
    """Not even by a new solution of the whole record: for two hundred samples the sensor showed something else."""
    u, y = made("order 1", noise=0.01)
    y[600:800] *= -1.0
    ident = rp.Identifier(AWKWARD["order 1"][0], DT)
    ident.update_many(u[:600], y[:600])
    ident.freeze()
    ident.update_many(u[600:800], y[600:800])
    ident.resume()
    ident.update_many(u[800:], y[800:])
    assert relative(ident.parameters, "order 1").max() < 0.01
    learned = rp.fit(u, y, DT, AWKWARD["order 1"][0], method="srivc")
    assert relative(learned.parameters, "order 1").max() > 0.03


def test_freezing_before_there_is_an_estimate_is_refused() -> None:
    ident = rp.Identifier(rp.Structure(1), DT)
    for call in (ident.freeze, ident.resume):
        with pytest.raises(rp.InvalidArgumentError, match="freezing needs a model"):
            call()


def test_a_clone_and_a_reset_carry_instruments_and_banks() -> None:
    u, y = made("order 3", noise=0.1)
    ident = rp.Identifier(AWKWARD["order 3"][0], DT)
    ident.update_many(u[:1500], y[:1500])
    twin = ident.clone()
    ident.update_many(u[1500:], y[1500:])
    twin.update_many(u[1500:], y[1500:])
    assert state(ident) == state(twin)
    after = state(ident)
    ident.reset()
    assert math.isnan(ident.covariance[0, 0])
    ident.update_many(u[:1500], y[:1500])
    ident.update_many(u[1500:], y[1500:])
    assert state(ident) == after


# --- tracking


@pytest.mark.slow
def test_a_plant_that_jumps_is_followed() -> None:
    before, after = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([2.0], [1.0, 2.0])
    u = binary(1, 4400, 8)
    y = np.concatenate([before.simulate(u, DT)[:2200], after.simulate(u, DT)[2200:]])
    y += 0.01 * np.random.default_rng(0).standard_normal(4400)
    errors = {}
    for name, optimizer in {
        "default": "auto",
        "forgetting": rp.RecursiveLeastSquares(time_constant=20.0),
        "tracking": rp.KalmanTracking([0.05, 0.05]),
    }.items():
        ident = rp.Identifier(rp.Structure(1), DT, optimizer=optimizer)
        ident.update_many(u, y)
        errors[name] = np.abs(ident.parameters / [2.0, 2.0] - 1).max()
    assert max(errors.values()) < 0.02


def test_process_noise_needs_one_number_or_one_a_parameter() -> None:
    for entries in ([0.1], [0.1] * 3, [0.1] * 5):
        with pytest.raises(rp.InvalidArgumentError, match=f"process_noise must have 4 entries.*got {len(entries)}"):
            rp.Identifier(rp.Structure(2, 1), DT, optimizer=rp.KalmanTracking(entries))
    for enough in (0.1, [0.1] * 4):
        assert rp.Identifier(rp.Structure(2, 1), DT, optimizer=rp.KalmanTracking(enough)).status == "starting"
