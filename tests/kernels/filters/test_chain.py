"""The chain on any clock: filters, dead time and feedthrough against the twin, piece by piece."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import State
from replant.kernels.filters import bank as bk
from replant.kernels.filters.chain import install_model
from replant.kernels.step.stages import regressors
from support.builders import random_plant
from support.cases import every
from support.references import filtered_at

DT, SAMPLES = 0.1, 80
NONE = np.empty((0, 2))  # what is explained without a reference


def stamps(seed: int, spread: float) -> np.ndarray:
    """A clock whose intervals lie within a part ``spread`` of DT."""
    return np.cumsum(DT * np.random.default_rng([seed, 7]).uniform(1 - spread, 1 + spread, SAMPLES))


def run(
    state: State, u: np.ndarray, y: np.ndarray, t: np.ndarray, by_reference: np.ndarray = NONE
) -> tuple[np.ndarray, ...]:
    """phi, zeta, target and auxiliary output of a record."""
    T = state.entries
    phi, zeta, target, output = np.empty((u.size, T)), np.empty((u.size, T)), np.empty(u.size), np.empty(u.size)
    intervals = np.diff(t, prepend=t[0] - DT)
    regressors(*state.arrays, u, y, intervals, by_reference, phi, zeta, target, output)
    return phi, zeta, target, output


def signals(seed: int) -> tuple[np.ndarray, np.ndarray]:
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))


def close(computed: np.ndarray, expected: np.ndarray, tolerance: float = 1e-11) -> None:
    np.testing.assert_allclose(computed, expected.astype(float), atol=tolerance * float(np.abs(expected).max()), rtol=0)


@every("hold", ["zoh", "foh"])
@every("delay", [0.0, 0.3 * DT, DT, 2.41 * DT, 7.0 * DT], quick=3)
@every("spread", [0.0, 0.2, 0.45], quick=2)
@every("feedthrough", [False, True])
def test_filters_are_exact_on_any_clock(hold: str, delay: float, spread: float, feedthrough: bool) -> None:
    n, poles = 3, np.poly([-3.0, -2.0, -2.0])
    structure = rp.Structure(n, n if feedthrough else n - 1, delay=delay, feedthrough=feedthrough)
    state_filter = rp.StateVariableFilter(denominator=poles, input_hold=hold)
    state = State.build(structure, DT, state_filter)
    (u, y), t = signals(1), stamps(1, spread)
    phi, _, target, _ = run(state, u, y, t)
    of_y, of_u = filtered_at(y, t, poles, 0.0, "foh"), filtered_at(u, t, poles, delay, hold)
    close(phi[:, :n], -of_y)
    close(target, y - of_y @ poles[1:])
    if feedthrough:
        close(phi[:, n + 1 :], of_u)
        # s^n/Lambda u: the delayed input itself, less the lower derivatives
        now = phi[:, n] + of_u @ poles[1:]
        close(now, delayed(u, t, delay, hold))
    else:
        close(phi[:, n:], of_u)


def delayed(u: np.ndarray, t: np.ndarray, delay: float, hold: str) -> np.ndarray:
    """u(t - delay), just after a jump."""
    if hold == "foh":
        return np.interp(t - delay, t, u)
    return u[np.maximum(np.searchsorted(t, t - delay + 1e-9, side="right") - 1, 0)]


@every("order", [1, 2, 4])
@every("hold", ["zoh", "foh"])
@every("delay", [0.0, 1.3 * DT])
def test_the_auxiliary_model_is_the_plant(order: int, hold: str, delay: float) -> None:
    """With the plant's own coefficients its output is the plant's, at every stamp of an irregular clock.

    And the refined filter's equation error is then the output error: y given as noise, target - phi' theta = y - x.
    """
    plant = random_plant(order, order, order - 1)
    structure = rp.Structure(order, order - 1, delay=delay)
    state = State.build(structure, DT, rp.RefinedFilter(hold))
    (u, y), t = signals(2), stamps(2, 0.3)
    u[:4] = 0.0  # at rest until the input that acts is one of the record
    theta = np.zeros(state.entries)
    theta[: 2 * order] = np.concatenate([plant.den[1:], plant.num])
    state.install(theta)
    phi, zeta, target, output = run(state, u, y, t)
    expected = filtered_at(u, t, plant.den, delay, hold) @ plant.num
    close(output, expected)
    known = t - t[0] >= delay
    np.testing.assert_allclose((target - phi @ theta)[known], (y - output)[known], atol=1e-11 * np.abs(y).max())
    assert not phi[~known].any()
    assert not zeta[~known].any()
    assert not target[~known].any()
    # instruments: the regressor of the model's output, joined by straight lines, all else being the same
    close(zeta[:, :order], -filtered_at(output, t, plant.den, 0.0, "foh"))
    np.testing.assert_array_equal(zeta[:, order:], phi[:, order:])


@pytest.mark.parametrize("order", [1, 3])
def test_nuisances_are_an_offset_and_an_initial_state(order: int) -> None:
    """The regressor's last entries: 1/A of one, and s^i/A of an impulse at the start."""
    plant = random_plant(order, order)
    state = State.build(rp.Structure(order), DT, rp.RefinedFilter())
    (u, y), t = signals(3), stamps(3, 0.3)
    theta = np.zeros(state.entries)
    theta[:order] = plant.den[1:]
    state.install(theta)
    phi, *_ = run(state, u, y, t)
    close(phi[:, order + 1], filtered_at(np.ones(SAMPLES), t, plant.den, 0.0, "foh")[:, -1])
    # an impulse is what the step's derivative is: the response to a step from rest, differentiated by the equation
    impulse = np.zeros((SAMPLES, order))
    impulse[0, 0] = 1.0
    F = np.vstack([-plant.den[1:], np.eye(order - 1, order)])
    from scipy.linalg import expm

    for k in range(1, SAMPLES):
        impulse[k] = expm(F * (t[k] - t[k - 1])) @ impulse[k - 1]
    close(phi[:, order + 2 :], impulse)


def test_a_missing_held_input_counts_with_what_is_known_of_it() -> None:
    """Over three sampling times the input stood for the first, and is taken to be half of the way for the others."""
    state = State.build(rp.Structure(1), DT, rp.StateVariableFilter(1.0))
    u, y = np.array([0.0, 1.0, 4.0]), np.zeros(3)
    phi, *_ = run(state, u, y, np.array([0.0, DT, 4 * DT]))
    level = (1.0 + 2 * 2.5) / 3
    expected = (1 - np.exp(-3 * DT)) * level  # the first value was zero
    assert phi[2, 1] == pytest.approx(expected, rel=1e-12)


def test_a_missing_sample_of_an_input_that_stood_costs_nothing() -> None:
    structure, state_filter = rp.Structure(2, 1, delay=0.13), rp.StateVariableFilter(2.0)
    generator = np.random.default_rng(4)
    u, t = np.repeat(generator.standard_normal(20), 8), DT * np.arange(160)
    y = filtered_at(u, t, [1.0, 3.0, 2.0], 0.0, "zoh").astype(float)[:, 1]
    kept = np.arange(160) % 8 != 4
    phi, *_ = run(State.build(structure, DT, state_filter), u[kept], y[kept], t[kept])
    of_u = filtered_at(u, t, state_filter.polynomial(2), 0.13, "zoh")[kept]
    close(phi[:, 2:], of_u)


def test_a_device_that_samples_more_slowly_misses_nothing_wherever_the_ring_begins() -> None:
    """No input is taken to have moved between its samples, at none of the places of the ring of inputs."""
    poles, delay, t = np.poly([-3.0, -2.0]), 1.0 * DT, 2 * DT * np.arange(SAMPLES)
    state_filter = rp.StateVariableFilter(denominator=poles)
    state = State.build(rp.Structure(2, 1, delay=delay), DT, state_filter)
    assert 3 < state.ring_size < SAMPLES / 2
    u, y = -0.01 - 0.1 * np.abs(signals(5))
    u[:4] = u[0]  # until two intervals are known
    phi, *_ = run(state, u, y, t)
    close(phi[:, 2:], filtered_at(u, t, poles, delay, "zoh"))


@every("unstable", [[-1.0, 2.0], [3.0, -2.0], [0.0, 1.0], [0.0, 0.0]], ids=repr)
def test_an_unstable_estimate_serves_with_its_poles_reflected(unstable: list[float]) -> None:
    """The filter's poles are mirrored, and lie left of the margin; the model's own coefficients are the estimate's."""
    from replant.kernels.filters.chain import renew_model

    state = State.build(rp.Structure(2), DT, rp.RefinedFilter())
    state.install(np.array([3.0, 2.0, 1.0, 0.0, 0.0, 0.0]))
    state.stability_margin, state.largest_bandwidth = 1e-3, 100.0
    state.theta[:2], state.ready_at, state.elapsed = unstable, 0.0, 10.0
    renew_model(state.fields)
    bank, poles = state.banks[2], np.roots([1.0, *unstable])
    expected = np.minimum(-np.abs(poles.real), -1e-3) + 1j * poles.imag
    np.testing.assert_allclose(bank[bk.DENOMINATOR : bk.DENOMINATOR + 2], np.poly(expected)[1:].real, atol=1e-7)
    assert bank[bk.REFLECTED] == 1.0
    np.testing.assert_array_equal(bank[bk.at_weights(2, 6) :][:2], unstable)


def test_a_wild_estimate_never_serves_as_a_model() -> None:
    """`renew_model` is the only way from the estimate to a filter: it looks at the bandwidth."""
    from replant.kernels.filters.chain import renew_model

    state = State.build(rp.Structure(2), DT, rp.RefinedFilter())
    good = np.zeros(state.entries)
    good[:3] = 3.0, 2.0, 1.0
    state.install(good)
    state.stability_margin, state.largest_bandwidth = 1e-3, 100.0
    for bad in ([1e9, 2.0], [1.0, 1e9], [np.nan, 1.0], [1.0, np.inf]):
        state.elapsed, state.ready_at = 10.0, 0.0
        state.theta[:2] = bad
        assert not renew_model(state.fields)
        assert (state.warming, state.serving_bank) == (0, 1)
        np.testing.assert_array_equal(state.banks[1, bk.DENOMINATOR : bk.DENOMINATOR + 2], [3.0, 2.0])
        assert state.ready_at > 10.0  # looked at again later
    state.ready_at = 0.0
    state.theta[:3] = 5.0, 6.0, 1.0
    assert not renew_model(state.fields)
    assert (state.warming, state.serving_bank) == (1, 1)
    np.testing.assert_array_equal(state.banks[2, bk.DENOMINATOR : bk.DENOMINATOR + 2], [5.0, 6.0])
    state.elapsed = state.ready_at
    assert renew_model(state.fields)
    assert state.serving_bank == 2


def test_installing_a_model_leaves_the_other_banks_alone() -> None:
    state = State.build(rp.Structure(2), DT, rp.RefinedFilter())
    before = state.banks.copy()
    install_model(*state.arrays, 2, np.ones(state.entries))
    np.testing.assert_array_equal(state.banks[:2], before[:2])
    assert (state.banks[2] != before[2]).any()


def loop(poles: list[float], samples: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Held input and output, without noise, of 1/prod(s - p) under a state feedback; and the largest curvature."""
    n = len(poles)
    a = np.poly(poles)[1:]
    F, column = np.vstack([-a, np.eye(n - 1, n)]), np.eye(n)[0]
    gains = np.poly(np.full(n, -2.0))[1:] - a
    system = np.zeros((n + 1, n + 1))
    system[:n, :n], system[:n, n] = F, column
    from scipy.linalg import expm

    transition = expm(system * DT)
    r = np.repeat(np.random.default_rng(8).standard_normal(samples // 10), 10)
    x, u, y, curvature = np.zeros(n), np.zeros(samples), np.zeros(samples), 0.0
    for k in range(samples):
        y[k], u[k] = x[-1], r[k] - gains @ x
        after = transition[:n, :n] @ x + transition[:n, n] * u[k]
        for state in (x, after):  # it is largest at one end of the interval, or nearly
            curvature = max(curvature, abs(float((F @ (F @ state + column * u[k]))[-1])))
        x = after
    return u, y, curvature


@every("poles", [[1.0], [0.0], [0.0, 0.0], [0.5, -1.0], [-1.0, -2.0]])
def test_the_error_of_an_unstable_plant_is_defined_and_vanishes(poles: list[float]) -> None:
    """e = A/D y - B/D u is zero for the right model, but for the straight line that joins the output.

    Between samples that is off by dt^2/8 times the curvature at the most.  (D - A)/D is 2 p / (s + p) for a reflected
    pole p, whose response has the area 2, and about m / (s + m) for a pole at zero that is moved to the margin m, whose
    response has the area m times the duration.
    """
    u, y, curvature = loop(poles, 400)
    n, slowest = len(poles), 1e-3 / (400 * DT)
    state = State.build(rp.Structure(n), DT, rp.RefinedFilter())
    state.stability_margin = slowest
    theta = np.zeros(state.entries)
    theta[:n], theta[n] = np.poly(poles)[1:], 1.0
    state.install(theta)
    phi, _, target, output = run(state, u, y, DT * np.arange(400.0))
    error = target - phi @ theta
    area = 2.0 if max(poles) > 0.0 else 2.0 * n * slowest * 400 * DT if max(poles) == 0.0 else 0.0
    size = float(np.abs(y).max())
    assert np.abs(error).max() < 1.1 * area * DT**2 / 8 * curvature + 1e-11 * size
    if max(poles) < 0.0:
        np.testing.assert_allclose(y - output, error, atol=1e-11 * size)
    assert np.isfinite(phi).all()
    assert bool(state.banks[1, bk.REFLECTED]) == (max(poles) >= 0.0)


@every("delay", [0.0, 1.3 * DT])
@every("hold", ["zoh", "foh"])
@every("zeros", [0, 2])
def test_instruments_are_the_regressor_of_what_a_reference_explains(delay: float, hold: str, zeros: int) -> None:
    """With (u_r, y_r) given for (u, y), zeta is phi of the record (u_r, y_r); all else does not change."""
    structure = rp.Structure(2, zeros, delay=delay, feedthrough=zeros == 2)
    (u, y), (u_r, y_r), t = signals(5), signals(6), stamps(5, 0.3)
    theta = np.zeros(State.build(structure, DT, rp.RefinedFilter()).entries)
    theta[:3] = -1.0, 2.0, 1.0
    passes = []
    for reference in (False, True):
        state = State.build(structure, DT, rp.RefinedFilter(hold), reference=reference)
        state.stability_margin = 1e-3
        state.install(theta)
        passes.append(run(state, u, y, t, np.column_stack([u_r, y_r]) if reference else NONE))
    for one, other in zip(passes[0][::2], passes[1][::2], strict=True):
        np.testing.assert_array_equal(one, other)  # phi and target
    state = State.build(structure, DT, rp.RefinedFilter(hold))
    state.stability_margin = 1e-3
    state.install(theta)
    phi, *_ = run(state, u_r, y_r, t)
    np.testing.assert_allclose(passes[1][1], phi, atol=1e-12 * np.abs(phi).max())


def test_the_predicted_output_is_the_one_that_makes_the_residual_zero() -> None:
    """Put in the place of the newest output, at every sample of an irregular clock."""
    (u, y), t = signals(9), stamps(9, 0.3)
    structure = rp.Structure(2, 1)
    theta = np.array([-1.0, 2.0, 1.0, 3.0, 0.5, 0.2, -0.1])

    def residual_and_output(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = State.build(structure, DT, rp.RefinedFilter())
        state.stability_margin = 1e-3
        state.install(theta)
        phi, _, target, output = run(state, u, y, t)
        return target - phi @ theta, output

    residual, output = residual_and_output(y)
    assert np.abs(residual).max() > 0.1
    for k in (1, 2, 40, 79):
        changed = y.copy()
        changed[k] = output[k]
        assert residual_and_output(changed)[0][k] == pytest.approx(0.0, abs=1e-11)


def test_with_a_negative_margin_an_unstable_model_is_simulated_from_the_input_alone() -> None:
    (u, y), t = signals(10), stamps(10, 0.3)
    state = State.build(rp.Structure(2), DT, rp.RefinedFilter())
    state.stability_margin = -1.0
    theta = np.zeros(state.entries)
    theta[:3] = -0.5, 1.0, 2.0
    u[0] = 0.0
    state.install(theta)
    _, _, _, output = run(state, u, y, t)
    close(output, filtered_at(u, t, [1.0, -0.5, 1.0], 0.0, "zoh")[:, 1] * 2.0)
