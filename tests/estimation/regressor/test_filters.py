"""State-variable filters: exactness, dead time of any size, the article's transform, and what is refused."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from scipy import signal

import replant as rp
from replant.estimation.solver.least_squares import regressors
from replant.model.preprocess import Preprocess
from replant.model.state_space import split_delay
from support.builders import binary, random_plant
from support.cases import every

DT = 0.1


def filtered(
    state_filter: rp.StateVariableFilter, u: np.ndarray, y: np.ndarray, poles: int, delay: float = 0.0, dt: float = DT
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What replant computes: s^i/Lambda y and s^i/Lambda u, i = n-1 .. 0, and s^n/Lambda y."""
    structure = rp.Structure(poles, poles - 1, delay=delay)
    phi, target = regressors(structure, dt, state_filter, Preprocess(), u, y)
    return -phi[:, :poles], phi[:, poles:], target


def by_lsim(x: np.ndarray, denominator: np.ndarray, dt: float = DT, *, straight: bool) -> np.ndarray:
    """SciPy's simulation of every s^i/Lambda x, i = n-1 .. 0, exact for the hold, in unscaled states."""
    t = dt * np.arange(x.size)
    n = denominator.size - 1
    return np.stack(
        [signal.lsim(([1.0] + [0.0] * i, denominator), x, t, interp=straight)[1] for i in reversed(range(n))], axis=1
    )


def assert_close(computed: np.ndarray, expected: np.ndarray, tolerance: float = 1e-9) -> None:
    """Column by column, relative to the column's largest value."""
    np.testing.assert_allclose(computed / abs(expected).max(axis=0), expected / abs(expected).max(axis=0), 0, tolerance)


@every("poles", [1, 2, 3, 6])
@every("hold", ["zoh", "foh"])
def test_exact_filters_equal_the_solution_of_their_differential_equation(poles: int, hold: str) -> None:
    state_filter = rp.StateVariableFilter(cutoff=2.0, input_hold=hold)
    u, y = binary(poles, 300, 7), np.random.default_rng(poles).standard_normal(300)
    wy, wu, target = filtered(state_filter, u, y, poles)
    denominator = np.poly(np.full(poles, -2.0))
    expected_y = by_lsim(y, denominator, straight=True)
    assert_close(wy, expected_y)
    assert_close(wu, by_lsim(u, denominator, straight=hold == "foh"))
    # s^n/Lambda y by polynomial division: y less the lower derivatives
    np.testing.assert_allclose(target, y - expected_y @ denominator[1:], rtol=0, atol=1e-9 * abs(y).max())


def test_a_given_denominator_filters_as_it_says() -> None:
    denominator = random_plant(4, 3).den
    u, y = binary(0, 200, 5), np.random.default_rng(0).standard_normal(200)
    wy, wu, _ = filtered(rp.StateVariableFilter(denominator=denominator), u, y, 3)
    assert_close(wy, by_lsim(y, denominator, straight=True))
    assert_close(wu, by_lsim(u, denominator, straight=False))


def test_the_filters_of_a_sine_converge_to_its_steady_state_at_second_order() -> None:
    """y = sin t through 1/(s+2): (2 sin t - cos t)/5 once settled; straight lines err by dt^2/12 of the curvature."""
    errors = []
    for dt in (0.1, 0.05, 0.025):
        t = dt * np.arange(round(20 / dt))
        wy, _, _ = filtered(rp.StateVariableFilter(cutoff=2.0), np.zeros(t.size), np.sin(t), 1, dt=dt)
        late = t > 15
        errors.append(abs(wy[late, 0] - (2 * np.sin(t) - np.cos(t))[late] / 5).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (abs(orders - 2) < 0.1).all()


# --- dead time


@every("numerator", [0, 1, 3, 4, 7, 10, 13])
@every("hold", ["zoh", "foh"])
def test_a_dead_time_equals_an_oversampled_simulation(numerator: int, hold: str) -> None:
    """A delay of numerator/4 samples is whole on a grid four times finer, where the same input is simulated."""
    finer = 4
    u = binary(1, 200, 3)
    zero = np.zeros(200)
    state_filter = rp.StateVariableFilter(cutoff=2.0, input_hold=hold)
    _, wu, _ = filtered(state_filter, u, zero, 2, delay=numerator * DT / finer)
    fine_t = np.arange(200 * finer) / finer - numerator / finer
    held, joined = u[np.maximum(np.floor(fine_t).astype(int), 0)], np.interp(fine_t, np.arange(200), u)
    fine = held if hold == "zoh" else joined
    expected = by_lsim(fine, np.poly([-2.0, -2.0]), DT / finer, straight=hold == "foh")[::finer]
    assert_close(wu, expected)


@every("delay", [0.0, 1e-7, math.sqrt(2) * DT, math.pi * DT, 0.9999999 * DT, 5 * DT, 123.456 * DT])
def test_a_step_arrives_exactly_as_late_as_the_dead_time(delay: float) -> None:
    """The step at t0 = 1 through 1/(s+3): (1 - e^(-3 (t - t0 - delay)))/3 after it has arrived, for any real delay."""
    t = DT * np.arange(400)
    u = np.where(t >= 1.0 - 1e-9, 1.0, 0.0)
    _, wu, _ = filtered(rp.StateVariableFilter(cutoff=3.0), u, np.zeros(400), 1, delay=delay)
    expected = (1 - np.exp(-3 * np.maximum(t - 1.0 - delay, 0.0))) / 3
    np.testing.assert_allclose(wu[:, 0], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.37 * DT, math.e * DT])
def test_a_ramp_arrives_exactly_as_late_as_the_dead_time(delay: float) -> None:
    """The ramp from t0 = 1 through 1/(s+3): (3 (t - t0 - delay) - 1 + e^(-3 (...)))/9."""
    t = DT * np.arange(300)
    _, wu, _ = filtered(
        rp.StateVariableFilter(cutoff=3.0, input_hold="foh"), np.maximum(t - 1, 0), np.zeros(300), 1, delay=delay
    )
    late = np.maximum(t - 1 - delay, 0)
    np.testing.assert_allclose(wu[:, 0], (3 * late - 1 + np.exp(-3 * late)) / 9, rtol=0, atol=1e-12)


def test_the_input_stood_at_its_first_value_before_the_record() -> None:
    """With a constant input the dead time does not show."""
    u, zero = np.full(50, 3.0), np.zeros(50)
    for hold in ("zoh", "foh"):
        state_filter = rp.StateVariableFilter(cutoff=2.0, input_hold=hold)
        _, early, _ = filtered(state_filter, u, zero, 2)
        _, late, _ = filtered(state_filter, u, zero, 2, delay=7.3 * DT)
        np.testing.assert_allclose(late, early, rtol=0, atol=1e-13)


@every(("delay", "expected"), [(0.0, (0, 0.0)), (0.3, (3, 0.0)), (0.7, (7, 0.0)), (12.3, (123, 0.0))])
def test_rounding_does_not_make_a_fraction_of_a_whole_delay(delay: float, expected: tuple[int, float]) -> None:
    assert split_delay(delay, 0.1) == expected


def test_a_split_delay_adds_up() -> None:
    for delay in np.random.default_rng(0).uniform(0, 50, 200):
        lag, fraction = split_delay(delay, 0.1)
        assert 0 <= fraction < 1
        assert lag + fraction == pytest.approx(delay / 0.1, rel=1e-8)


# --- the article's transform


@every("poles", [1, 2, 3, 6])
@every("alpha", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_gbt_is_scipys_transform_of_appendix_a(poles: int, alpha: float) -> None:
    """(7) with F and l of (29), cut out of SciPy: after the change of states the very same difference equations."""
    cutoff = 4.0
    polynomial = np.poly(np.full(poles, -cutoff))
    F = np.vstack([-polynomial[1:], np.eye(poles - 1, poles)])
    l_column = np.eye(poles)[:, :1]
    Fd, ld, *_ = signal.cont2discrete((F, l_column, np.eye(poles), np.zeros((poles, 1))), DT, "gbt", alpha)
    discrete = rp.StateVariableFilter(cutoff=cutoff, method="gbt", alpha=alpha).discretize(poles, DT)
    T = np.diag(discrete.scale)  # scaled states are T times the article's
    np.testing.assert_allclose(discrete.transition, T @ Fd @ np.linalg.inv(T), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(discrete.output_taps, [(T @ ld)[:, 0], np.zeros(poles)], rtol=1e-11)
    np.testing.assert_allclose(discrete.input_taps, [np.zeros(poles), (T @ ld)[:, 0], np.zeros(poles)], rtol=1e-11)


def test_gbt_is_strictly_causal() -> None:
    """The regressor at t_k is built from samples before k alone."""
    u, y = np.random.default_rng(0).standard_normal((2, 40))
    state_filter = rp.StateVariableFilter(cutoff=4.0, method="gbt")
    changed_u, changed_y = u.copy(), y.copy()
    changed_u[-1], changed_y[-1] = 9.0, 9.0
    for before, after in zip(
        filtered(state_filter, u, y, 2)[:2], filtered(state_filter, changed_u, changed_y, 2)[:2], strict=True
    ):
        np.testing.assert_array_equal(before, after)


@every("alpha", [0.0, 0.25, 0.4])
@every("poles", [1, 3, 10])
def test_gbt_is_refused_exactly_beyond_its_limit_of_stability(alpha: float, poles: int) -> None:
    limit = 2 / (1 - 2 * alpha)
    beyond = rp.StateVariableFilter(cutoff=1.0, method="gbt", alpha=alpha)
    with pytest.raises(rp.InvalidArgumentError, match="unstable") as caught:
        beyond.discretize(poles, 1.001 * limit)
    assert "2/(1 - 2 alpha)" in str(caught.value)
    with pytest.warns(UserWarning, match="rings"):
        discrete = beyond.discretize(poles, 0.999 * limit)
    if poles == 1:  # a single pole is not scattered by its multiplicity
        assert 0.99 < abs(np.linalg.eigvals(discrete.transition)).max() < 1


@pytest.mark.parametrize("poles", [1, 3, 10])
def test_tustin_warns_exactly_where_it_rings(poles: int) -> None:
    tustin = rp.StateVariableFilter(cutoff=1.0, method="gbt", alpha=0.5)
    with pytest.warns(UserWarning, match="rings"):
        tustin.discretize(poles, 2.001)
    tustin.discretize(poles, 1.999)  # a warning would be an error


@every("poles", [1, 3, 10])
@every("dt", [1e-8, 1e-3, 1.0, 1e3])
def test_backward_euler_and_exact_never_ring(poles: int, dt: float) -> None:
    for state_filter in (
        rp.StateVariableFilter(cutoff=1.0, method="gbt", alpha=1.0),
        rp.StateVariableFilter(cutoff=1.0),
    ):
        assert np.isfinite(state_filter.discretize(poles, dt).transition).all()


def test_an_unstable_filter_is_refused_when_the_identifier_is_made() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="unstable"):
        rp.Identifier(rp.Structure(2), 1.0, filter=rp.StateVariableFilter(3.0, method="gbt", alpha=0.0))


# --- bad input


@every(
    ("settings", "named"),
    [
        ({}, "cutoff"),
        ({"cutoff": 1.0, "denominator": [1.0, 1.0]}, "cutoff"),
        ({"cutoff": 0.0}, "cutoff"),
        ({"cutoff": -1.0}, "cutoff"),
        ({"cutoff": math.nan}, "cutoff"),
        ({"cutoff": math.inf}, "cutoff"),
        ({"cutoff": "a"}, "cutoff"),
        ({"cutoff": 1j}, "cutoff"),
        ({"cutoff": [5.0]}, "cutoff"),
        ({"denominator": [2.0, 1.0]}, "denominator"),
        ({"denominator": [1.0]}, "denominator"),
        ({"denominator": []}, "denominator"),
        ({"denominator": "ab"}, "denominator"),
        ({"denominator": [1.0, -1.0]}, "denominator"),
        ({"denominator": [1.0, 0.0, 1.0]}, "denominator"),
        ({"denominator": [1.0, math.nan]}, "denominator"),
        ({"denominator": [1.0, 1j]}, "denominator"),
        ({"denominator": [[1.0, 1.0], [1.0, 1.0]]}, "denominator"),
        ({"cutoff": 1.0, "method": "Exact"}, "method"),
        ({"cutoff": 1.0, "method": None}, "method"),
        ({"cutoff": 1.0, "input_hold": "none"}, "input_hold"),
        ({"cutoff": 1.0, "alpha": 1.1}, "alpha"),
        ({"cutoff": 1.0, "alpha": -0.1}, "alpha"),
        ({"cutoff": 1.0, "alpha": "a"}, "alpha"),
    ],
    ids=repr,
)
def test_a_bad_filter_is_refused_by_name(settings: dict[str, Any], named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named) as caught:
        rp.StateVariableFilter(**settings)
    assert "\n" not in str(caught.value)


@every(
    ("settings", "arguments", "named"),
    [
        ({"cutoff": 1.0}, (0, 0.1), "poles"),
        ({"cutoff": 1.0}, (1, 0.0), "dt"),
        ({"cutoff": 1.0}, (1, -1.0), "dt"),
        ({"cutoff": 1.0}, (1, math.nan), "dt"),
        ({"cutoff": 1.0}, (1, 0.1, -1.0), "delay"),
        ({"denominator": [1.0, 3.0, 2.0]}, (3, 0.1), "denominator must have 4 coefficients"),
    ],
)
def test_bad_arguments_of_discretize_are_refused_by_name(
    settings: dict[str, Any], arguments: tuple[Any, ...], named: str
) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=named):
        rp.StateVariableFilter(**settings).discretize(*arguments)


def test_any_kind_of_number_will_do() -> None:
    expected = rp.StateVariableFilter(cutoff=4.0).discretize(2, 0.25, 0.5)
    for cutoff, dt, delay in ((4, Decimal("0.25"), Decimal("0.5")), (np.float32(4), np.float32(0.25), np.array(0.5))):
        computed = rp.StateVariableFilter(cutoff=cutoff).discretize(2, dt, delay)
        np.testing.assert_array_equal(computed.transition, expected.transition)
        assert computed.lag == expected.lag
