"""What a rig does to an estimate in use: spikes, a sensor that dies, a plant that changes, a clock that is set."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import replant as rp
from replant.numerics.linear_algebra import compose
from support.builders import binary, is_finite, state
from support.cases import every, examples

DT = 0.05
PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
TRUE = np.array([4.0, 3.0, 2.0])
STRUCTURE = rp.Structure(2)
KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(0.999)},
    "tracking": {"optimizer": rp.KalmanTracking(1e-6)},
    "fixed filter": {
        "filter": rp.StateVariableFilter(3.0),
        "optimizer": rp.RecursiveLeastSquares(),
        "instruments": True,
    },
}


def made(kind: str = "default", **arguments: Any) -> rp.Identifier:
    return rp.Identifier(STRUCTURE, DT, **KINDS[kind], **arguments)


def measured(samples: int, noise: float = 0.03, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    u = binary(seed, samples, 8)
    return u, PLANT.simulate(u, DT) + noise * np.random.default_rng(seed + 100).standard_normal(samples)


def away(ident: rp.Identifier, true: np.ndarray = TRUE) -> float:
    return float(np.abs(ident.parameters / true - 1.0).max())


def assert_sound(ident: rp.Identifier) -> None:
    size = ident._state.entries
    memory = ident._state.memory[: size * size + size]
    assert is_finite(ident._state)
    assert (memory[size * size :] > 0.0).all()
    covariance = compose(memory[: size * size].reshape(size, size), memory[size * size :])
    std = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(std, std)).min() > -1e-12


# --- spikes


@every("kind", KINDS, quick=2)
@every("spike", [-10.0, 1e4, 1e6, -1e140], quick=1)
def test_a_spike_costs_one_sample(kind: str, spike: float) -> None:
    """Without it the estimate has learned one sample more, of N: it moves by a few standard deviations over N.

    A sample of a residual below 8 sigma moves the estimate by less than 8 std / sqrt(N), N = 500 or more: 0.4 std.
    """
    u, y = measured(3000)
    with_spike = y.copy()
    with_spike[600] = spike
    clean, ident = made(kind), made(kind)
    expected = clean.update_many(u, y)
    trace = ident.update_many(u, with_spike)
    assert ident.rejected["outlier"] == 1
    assert ident.samples == 3000
    assert abs(trace.errors[600] / spike) == pytest.approx(1.0, abs=0.1)  # what is reported is what was measured
    std = np.sqrt(np.diag(clean.covariance))
    moved = np.abs(trace.parameters - expected.parameters)[600:]
    assert (moved[0] <= 8.0 / math.sqrt(500.0) * std * math.sqrt(3000 / 500)).all()
    assert (moved < 0.02 * TRUE).all()
    assert ident.assess().status == clean.assess().status
    assert_sound(ident)


@settings(max_examples=examples(12, quick=6), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(list(KINDS)),
    st.lists(
        st.tuples(st.integers(600, 2999), st.floats(1.5, 140.0), st.sampled_from([-1.0, 1.0])), min_size=1, max_size=12
    ),
)
def test_any_spikes_leave_the_estimate_where_it_is(kind: str, spikes: list[tuple[int, float, float]]) -> None:
    u, y = measured(3000)
    for place, exponent, sign in spikes:
        y[place] = sign * 10.0**exponent
    ident = made(kind)
    trace = ident.update_many(u, y)
    assert np.isfinite(trace.parameters).all()
    assert np.isfinite(trace.errors[500:]).all()
    assert away(ident) < 0.05
    assert ident.rejected["outlier"] >= len({place for place, *_ in spikes})
    assert_sound(ident)


def test_a_spike_while_frozen_is_forgotten_at_once() -> None:
    u, y = measured(3000)
    y[1500] = 100.0
    ident = made()
    ident.update_many(u[:1400], y[:1400])
    ident.freeze()
    ident.update_many(u[1400:1502], y[1400:1502])
    ident.resume()
    trace = ident.update_many(u[1502:], y[1502:])
    assert np.abs(trace.parameters / TRUE - 1.0).max() < 0.03


@pytest.mark.slow
@every("places", [[100], [3, 250, 499], [0], [498]], quick=2)
def test_a_spike_in_start_up_does_not_spoil_the_first_model(places: list[int]) -> None:
    u, y = measured(3000)
    y[places] = 1e6
    ident = made()
    trace = ident.update_many(u, y)
    assert np.isfinite(trace.errors[500:]).all()
    assert np.abs(trace.parameters[520:] / TRUE - 1.0).max() < 0.1
    assert away(ident) < 0.03


def test_what_is_large_but_right_is_learned() -> None:
    """An input a hundred times as large: no error of a right model is an outlier."""
    u, _ = measured(4000)
    u[2000:] *= 100.0
    y = PLANT.simulate(u, DT) + 0.03 * np.random.default_rng(0).standard_normal(4000)
    ident = made()
    ident.update_many(u, y)
    assert ident.rejected["outlier"] == 0
    assert away(ident) < 0.01


@pytest.mark.slow
@every("kind", KINDS)
def test_chunks_do_not_matter_to_any_of_it(kind: str) -> None:
    """Spikes, a stuck sensor, a plant that jumps: one call, chunks and single updates come to the same bits."""
    u, y = measured(1200)
    y[540], y[600:700] = 1e6, y[600]
    y[800:] *= 1.5
    whole, chunks, single = made(kind), made(kind), made(kind)
    expected = whole.update_many(u, y).parameters
    parts = [chunks.update_many(u[k : k + 97], y[k : k + 97]).parameters for k in range(0, 1200, 97)]
    np.testing.assert_array_equal(np.vstack(parts), expected)
    for k in range(1200):
        single.update(u[k], y[k])
    assert state(single) == state(chunks) == state(whole)
    twin = whole.clone()
    for ident in (whole, twin):
        ident.update_many(u[:500], y[:500])
    assert state(whole) == state(twin)


def test_arrays_that_cannot_be_written_to_are_taken() -> None:
    u, y = measured(600)
    expected = made()
    expected.update_many(u, y)
    u.flags.writeable = y.flags.writeable = False
    ident = made()
    ident.update_many(u, y)
    assert state(ident) == state(expected)


# --- a sensor that fails


def failing(y: np.ndarray, fault: str) -> np.ndarray:
    if fault == "stuck":
        return np.full(y.size, y[0])
    if fault == "off":
        return np.zeros(y.size)
    if fault == "at its rail":
        return np.full(y.size, 5.0)
    return np.clip(y, -0.8 * y.std(), 0.8 * y.std())


@every("kind", ["default", "forgetting", "tracking"], quick=1)
@every("fault", ["stuck", "off", "at its rail", "saturated"], quick=1)
@every(("speed", "dt"), [(20.0, 1e-3), (2.0, 0.02)], ids=["1 kHz", "50 Hz"], quick=1)
def test_a_dead_sensor_is_said_and_not_learned(kind: str, fault: str, speed: float, dt: float) -> None:
    """Not trusted after two seconds of rig time; the parameters hold for as long as it lasts, and after it."""
    plant = rp.TransferFunction([2.0 * speed**2], [1.0, 4.0 * speed, 3.0 * speed**2])
    u = binary(1, 9000, 20)
    y = plant.simulate(u, dt) + 0.003 * np.random.default_rng(0).standard_normal(9000)
    y[4000:7000] = failing(y[4000:7000], fault)
    ident = rp.Identifier(STRUCTURE, dt, **KINDS[kind])
    ident.update_many(u[:4000], y[:4000])
    assert ident.assess().status == "trusted"
    before = ident.parameters
    soon = 4000 + min(round(2.0 / dt), 3000)
    trace = ident.update_many(u[4000:soon], y[4000:soon])
    assert ident.assess().status != "trusted"
    lasting = ident.update_many(u[soon:7000], y[soon:7000])
    assert ident.assess().status != "trusted"
    for parameters in (trace.parameters, lasting.parameters):
        if parameters.size:
            # forgetting and tracking scatter by more than that in health: two of their standard deviations are added
            slack = 0.0 if kind == "default" else 2.0 * float((ident.uncertainty.std / np.abs(before)).max())
            assert np.abs(parameters / before - 1.0).max() < 0.01 + slack
    ident.update_many(u[7000:], y[7000:])
    assert away(ident, plant_parameters(plant)) < 0.03
    assert ident.rejected["stuck"] > 500


def plant_parameters(plant: rp.TransferFunction) -> np.ndarray:
    return np.concatenate([plant.den[1:], plant.num])


def test_a_coarse_scale_is_no_stuck_sensor() -> None:
    """Equal neighbours are then usual: a right model, a slow output and ten bits of a scale."""
    u, y = measured(6000, noise=0.002)
    ident = made()
    ident.update_many(u, np.round(y * 100.0) / 100.0)
    assert ident.rejected["stuck"] < 60
    assert away(ident) < 0.03


# --- a plant that changes

JUMPING = {
    "two poles": (rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), 0.05, 8),
    "one pole": (rp.TransferFunction([1.25], [1.0, 0.5]), 0.2, 7),
    "a light mode": (rp.TransferFunction([25.0], [1.0, 0.2, 25.0]), 0.02, 9),
}
JUMPS = [(name, entry) for name, (plant, *_) in JUMPING.items() for entry in range(plant.den.size)]


def jumped(name: str, entry: int, factor: float, at_sample: int, samples: int, decibels: float) -> tuple[Any, ...]:
    """Input, output and new parameters of a plant whose parameter jumps; in the state of a phase variable form."""
    from scipy.linalg import expm

    before, dt, hold = JUMPING[name]
    parameters = plant_parameters(before)
    parameters[entry] *= factor
    u = binary(3, samples, hold)
    n = before.den.size - 1
    y, x = np.empty(samples), np.zeros(n)
    for k, values in enumerate((plant_parameters(before), parameters)):
        system = np.zeros((n + 1, n + 1))
        system[0, :n], system[0, n] = -values[:n], 1.0
        system[1:n, : n - 1] = np.eye(n - 1)
        power = expm(system * dt)
        for i in range(0 if k == 0 else at_sample, at_sample if k == 0 else samples):
            y[i] = values[n] * x[-1]
            x = power[:n, :n] @ x + power[:n, n] * u[i]
    noise = float(y[:at_sample].std()) * 10.0 ** (-decibels / 20.0)
    return u, y + noise * np.random.default_rng(5).standard_normal(samples), parameters, dt


@pytest.mark.slow
@every(("name", "entry"), JUMPS, quick=1)
@every("factor", [0.5, 1.5], quick=1)
@every("kind", ["default", "forgetting"], quick=1)
def test_a_jump_by_half_is_noticed_and_learned(name: str, entry: int, factor: float, kind: str) -> None:
    """At 25 dB within 300 samples; within four start-ups the estimate is right again.  Never trusted while wrong."""
    u, y, true, dt = jumped(name, entry, factor, 4000, 7000, 25.0)
    ident = rp.Identifier(rp.Structure(true.size - 1), dt, **KINDS[kind])
    ident.update_many(u[:4000], y[:4000])
    assert ident.assess().status == "trusted"
    for k in range(4000, 6000, 250):
        ident.update_many(u[k : k + 250], y[k : k + 250])
        if away(ident, true) > 0.1 and k >= 4250:
            assert ident.assess().status != "trusted"
    assert away(ident, true) < 0.05
    ident.update_many(u[6000:], y[6000:])
    assert away(ident, true) < 0.05
    assert_sound(ident)


def test_a_jump_soon_after_the_start_is_learned_with_forgetting() -> None:
    u, y, true, dt = jumped("two poles", 1, 1.5, 1500, 3500, 25.0)
    ident = rp.Identifier(rp.Structure(true.size - 1), dt, **KINDS["forgetting"])
    ident.update_many(u, y)
    assert away(ident, true) < 0.05


def test_a_mode_that_jumps_is_followed_by_tracking_too() -> None:
    u, y, true, dt = jumped("a light mode", 1, 0.5, 4000, 6000, 25.0)
    ident = rp.Identifier(STRUCTURE, dt, optimizer=rp.KalmanTracking(1e-7))
    ident.update_many(u, y)
    assert away(ident, true) < 0.05


def test_noise_that_grows_is_no_other_plant() -> None:
    """Four times as strong: the alarm is looked into and given up; the record stays one."""
    u, y = measured(8000)
    y[4000:] += 0.12 * np.random.default_rng(9).standard_normal(4000)
    ident = made()
    ident.update_many(u, y)
    assert ident._state.record_began == 0
    assert int(ident._state.alarm) == 0
    assert away(ident) < 0.03


def test_what_is_noticed_is_said() -> None:
    u, y = measured(4080)
    y[4000:] *= 1.5
    ident = made()
    ident.update_many(u, y)
    verdict = ident.assess()
    assert verdict.status == "inconsistent"
    assert "the residual began to grow" in " ".join(verdict.reasons)


# --- rest, gaps and clocks


@pytest.mark.parametrize("factor", [0.99, 0.999])
def test_forgetting_stops_before_it_has_forgotten(factor: float) -> None:
    """An input that stands still for longer than the memory teaches nothing more."""
    u, y = measured(3000)
    ident = rp.Identifier(STRUCTURE, DT, optimizer=rp.RecursiveLeastSquares(factor))
    ident.update_many(u, y)
    before, std = ident.parameters, ident.uncertainty.std
    rest = np.full(50_000, u[-1])
    whole = PLANT.simulate(np.concatenate([u, rest]), DT)[3000:]
    ident.update_many(rest, whole + 0.03 * np.random.default_rng(1).standard_normal(rest.size))
    assert (np.abs(ident.parameters - before) < 3.0 * std).all()


@every("plant", [PLANT, rp.TransferFunction([25.0], [1.0, 0.02, 25.0])], ids=["usual", "light"])
@every("kind", ["default", "forgetting"])
def test_after_a_gap_learning_goes_on_at_once(plant: rp.TransferFunction, kind: str) -> None:
    u = binary(1, 6000, 8)
    clean = plant.simulate(u, DT)
    y = clean + 0.03 * clean.std() * np.random.default_rng(0).standard_normal(6000)
    t = DT * np.arange(6000)
    ident = rp.Identifier(STRUCTURE, DT, **KINDS[kind])
    ident.update_many(u[:2000], y[:2000], t[:2000])
    true, std = plant_parameters(plant), ident.uncertainty.std
    for begin in range(2300, 6000, 800):
        before = ident.parameters
        trace = ident.update_many(u[begin : begin + 500], y[begin : begin + 500], t[begin : begin + 500])
        assert (trace.parameters[20] != before).any()
        assert (np.abs(trace.parameters - true) < 8.0 * std).all()
    assert ident._state.gaps == 5
    assert ident._state.rested == 0
    assert_sound(ident)


def test_the_last_entries_begin_anew_and_the_others_keep_their_covariance() -> None:
    from replant.kernels.optimizers.covariance import begin_last
    from replant.numerics.linear_algebra import factor_covariance

    root = np.random.default_rng(0).standard_normal((5, 9))
    covariance = root @ root.T
    U, D = factor_covariance(covariance)
    U = U.copy()
    begin_last(U, D, 3, np.array([7.0, 8.0]), np.empty(5))
    expected = np.diag([0.0, 0.0, 0.0, 7.0, 8.0])
    expected[:3, :3] = covariance[:3, :3]
    np.testing.assert_allclose(compose(U, D), expected, rtol=1e-12, atol=1e-12)


@every("jump", [86_400.0, -86_400.0, -30.0, 2.6])
def test_a_clock_that_is_set_is_followed(jump: float) -> None:
    """Forward it is a gap, and costs no sample; backward ten samples are lost."""
    u, y = measured(4000)
    t = DT * np.arange(4000.0)
    t[2000:] = t[1999] + jump + DT * np.arange(1, 2001)
    ident = made()
    ident.update_many(u, y, t)
    assert ident.rejected["not later"] == (0 if jump > 0.0 else 10)
    assert ident.samples == 4000 - ident.rejected["not later"]
    assert ident.rejected["time leap"] == 0
    assert ident._state.gaps == 1
    assert (ident._state.recent[: ident.samples, 2] > 0.0).all()
    assert away(ident) < 0.03
    assert_sound(ident)


def test_a_few_late_stamps_set_no_clock() -> None:
    u, y = measured(3000)
    t = DT * np.arange(3000.0)
    t[1000:1010] = t[500:510]  # a packet that came twice
    t[2000:2040:2] = t[100:120]
    ident = made()
    ident.update_many(u, y, t)
    assert ident.rejected["not later"] == 30
    assert ident._state.gaps == 0


def test_bursts_that_a_dead_time_cannot_see_through_are_refused() -> None:
    """The past inputs kept reach back a dead time at four times the nominal rate; what comes faster is counted."""
    structure = rp.Structure(1, delay=1.0)
    u, t = binary(1, 2000, 8), DT * np.arange(2000.0)
    y = rp.TransferFunction([2.0], [1.0, 1.0], 1.0).simulate(u, DT)
    ident = rp.Identifier(structure, DT)
    ident.update_many(u[:1000], y[:1000], t[:1000])
    before = state(ident)
    for burst in range(10):
        assert math.isnan(ident.update(u[1000], y[1000], t[999] + 1e-3 * DT * (burst + 1)))
    assert ident.rejected["too dense"] == 10
    after = state(ident)
    assert {key: after[key] for key in after if key != "ints"} == {key: before[key] for key in before if key != "ints"}
    ident.update_many(u[1000:], y[1000:], t[1000:])
    np.testing.assert_allclose(ident.parameters, [1.0, 2.0], rtol=1e-3)
