"""Companion forms and their discretisations against SciPy, analytic answers and the twins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, signal

from replant.model import state_space
from support import references
from support.builders import random_plant
from support.cases import every

DENOMINATORS = {
    "integrator": [1.0, 0.0],
    "double integrator": [1.0, 0.0, 0.0],
    "pole at zero": [1.0, 3.0, 2.0, 0.0],
    "slow and fast": [1.0, 1000.1, 100.0],
    "hardly damped": [1.0, 3.292, 5891.0, 595.7],
    "tenfold": np.poly(np.full(10, -50.0)),
    "random": random_plant(1, 6).den,
}
every_denominator = every("denominator", DENOMINATORS.values(), ids=DENOMINATORS)


@every_denominator
def test_states_are_the_scaled_derivatives(denominator: np.ndarray) -> None:
    """w_i = c^(n-i) s^i/D x for every s: (s - matrix)^-1 column, scaled back, is [s^(n-1) .. 1] / D(s)."""
    model = state_space.companion(np.asarray(denominator))
    n = len(denominator) - 1
    for s in (0.3 + 0.4j, 2.0, -5.0 + 60.0j, 300.0j):
        states = linalg.solve(s * np.eye(n) - model.matrix, model.column.astype(complex))
        expected = model.scale * s ** np.arange(n - 1, -1, -1.0) / np.polyval(denominator, s)
        np.testing.assert_allclose(states, expected, rtol=0, atol=1e-9 * abs(expected).max())


@every_denominator
def test_the_companion_keeps_the_characteristic_polynomial(denominator: np.ndarray) -> None:
    """s^n/D x = x - characteristic' w, so the polynomial is rebuilt from characteristic and scale."""
    model = state_space.companion(np.asarray(denominator))
    np.testing.assert_allclose(model.characteristic * model.scale, denominator[1:], rtol=1e-14)


@every("cutoff", [1e-3, 1.0, 50.0, 1e4])
@every("order", [1, 2, 4, 10])
def test_scaled_states_are_as_well_conditioned_whatever_the_cutoff(order: int, cutoff: float) -> None:
    """For (s + cutoff)^n time runs cutoff times faster and nothing else changes: matrix and column scale with it.

    The states' covariance under white noise, whose condition number the article's unscaled states raise to
    cutoff^(2n-2), is therefore that of (s + 1)^n.
    """
    model = state_space.companion(np.poly(np.full(order, -cutoff)))
    unit = state_space.companion(np.poly(np.full(order, -1.0)))
    np.testing.assert_allclose(model.matrix, cutoff * unit.matrix, rtol=1e-12)
    np.testing.assert_allclose(model.column, cutoff * unit.column, rtol=1e-12)
    np.testing.assert_allclose(model.characteristic, unit.characteristic, rtol=1e-12)


def test_the_fourth_order_states_have_a_small_condition_number() -> None:
    """Four states of (s + 50)^4 under white noise: below 50 scaled, above 1e9 as the article writes them."""
    model = state_space.companion(np.poly(np.full(4, -50.0)))
    covariance = linalg.solve_continuous_lyapunov(model.matrix, -np.outer(model.column, model.column))
    unscaled = covariance / np.outer(model.scale, model.scale)
    assert np.linalg.cond(covariance) < 50
    assert np.linalg.cond(unscaled) > 1e9


@every_denominator
@every("dt", [1e-4, 0.01, 0.3])
@every("hold", ["zoh", "foh"])
def test_exact_equals_the_series_in_extended_precision(denominator: np.ndarray, dt: float, hold: str) -> None:
    model = state_space.companion(np.asarray(denominator))
    transition, before, after = state_space.exact(model.matrix, model.column, dt, hold)
    Ad, B0, B1 = references.straight_line(
        references.extended(model.matrix), references.extended(model.column), references.extended(dt)
    )
    expected = (Ad, B0 + B1, 0 * B1) if hold == "zoh" else (Ad, B0, B1)
    for computed, true in zip((transition, before, after), expected, strict=True):
        np.testing.assert_allclose(computed, true.astype(float), rtol=0, atol=1e-12 * max(1.0, float(abs(true).max())))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_exact_of_a_first_order_lag_is_the_textbook_formula(hold: str) -> None:
    """w' = -2 w + 2 x: e^(-2h); constant input 1 - e^(-2h); ramp 0 to 1 over h: 1 - (1 - e^(-2h)) / 2h."""
    h = 0.3
    transition, before, after = state_space.exact(np.array([[-2.0]]), np.array([2.0]), h, hold)
    step, ramp = 1 - np.exp(-2 * h), 1 - (1 - np.exp(-2 * h)) / (2 * h)
    expected = (step, 0.0) if hold == "zoh" else (step - ramp, ramp)
    np.testing.assert_allclose([transition[0, 0], before[0], after[0]], [np.exp(-2 * h), *expected], rtol=1e-14)


@every_denominator
@every("alpha", [0.0, 0.3, 0.5, 1.0])
def test_bilinear_equals_scipys_gbt(denominator: np.ndarray, alpha: float) -> None:
    model = state_space.companion(np.asarray(denominator))
    n, dt = model.column.size, 0.01
    Ad, Bd, *_ = signal.cont2discrete(
        (model.matrix, model.column[:, None], np.eye(n), np.zeros((n, 1))), dt, "gbt", alpha
    )
    transition, column = state_space.bilinear(model.matrix, model.column, dt, alpha)
    np.testing.assert_allclose(transition, Ad, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(column, Bd[:, 0], rtol=1e-10, atol=1e-13)


@every_denominator
@every("hold", ["zoh", "foh"])
@every("fraction", [0.0, 1e-6, 0.25, 0.5, 0.9])
def test_input_taps_move_a_constant_as_no_delay_does(denominator: np.ndarray, hold: str, fraction: float) -> None:
    """A constant input is the same however late it comes: the three taps add up to the step's."""
    model = state_space.companion(np.asarray(denominator))
    taps = state_space.input_taps(model.matrix, model.column, 0.1, hold, fraction)
    _, before, after = state_space.exact(model.matrix, model.column, 0.1, "zoh")
    np.testing.assert_allclose(taps.sum(axis=0), before + after, rtol=0, atol=1e-12 * max(1.0, abs(before).max()))


@every_denominator
def test_input_taps_move_a_ramp_late_by_the_fraction(denominator: np.ndarray) -> None:
    """The ramp x(t) = t through samples -2h, -h, 0 arrives as t - fraction h: a ramp less a constant."""
    model = state_space.companion(np.asarray(denominator))
    h, fraction = 0.1, 0.35
    taps = state_space.input_taps(model.matrix, model.column, h, "foh", fraction)
    _, before, after = state_space.exact(model.matrix, model.column, h, "foh")
    expected = before * (-h - fraction * h) + after * (-fraction * h)
    computed = np.array([-2 * h, -h, 0.0]) @ taps
    np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-12 * max(1.0, abs(before).max()))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_without_a_fraction_the_oldest_sample_does_not_count(hold: str) -> None:
    model = state_space.companion(np.array([1.0, 2.0, 2.0]))
    taps = state_space.input_taps(model.matrix, model.column, 0.1, hold, 0.0)
    _, before, after = state_space.exact(model.matrix, model.column, 0.1, hold)
    np.testing.assert_array_equal(taps, [np.zeros(2), before, after])
