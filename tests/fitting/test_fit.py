"""fit: exact recovery without noise, its order of convergence, its invariances, and what it refuses."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.signals import prbs
from support import references
from support.builders import G1, G2, random_plant, record, true_parameters
from support.cases import every

#: Plants with their zeros and a filter's cutoff near their poles: the article's two, and five random stable ones.
PLANTS = {"G1": (G1, 0, 1.0), "G2": (G2, 1, 10.0)} | {
    f"random {poles}/{zeros}": (random_plant(100 + seed, poles, zeros), zeros, 1.5)
    for seed, (poles, zeros) in enumerate([(1, 0), (2, 1), (3, 1), (3, 2), (4, 2)])
}
LS = "least_squares"
every_plant = every("name", PLANTS)


def held_record(name: str, bit: float, hold: int, bits: int) -> tuple[np.ndarray, np.ndarray, float]:
    """A PRBS whose bits last ``bit`` seconds, sampled ``hold`` times a bit, and the exact output; and dt."""
    u = prbs(bits * hold, bits=10, hold=hold)
    return u, PLANTS[name][0].simulate(u, bit / hold), bit / hold


def relative_errors(result: rp.FitResult, name: str) -> np.ndarray:
    plant, zeros, _ = PLANTS[name]
    return abs(result.parameters / true_parameters(plant, zeros) - 1)


def structure_of(name: str) -> rp.Structure:
    plant, zeros, _ = PLANTS[name]
    return rp.Structure(plant.den.size - 1, zeros)


# --- noise-free recovery


@every(
    ("name", "chosen"), [*((name, "given") for name in PLANTS), ("G1", "auto"), ("G2", "auto"), ("random 3/2", "auto")]
)
def test_without_noise_every_coefficient_comes_back_within_half_a_percent(name: str, chosen: str) -> None:
    """A held PRBS, sampled 65 times or more in the time constant of the fastest pole."""
    cutoff = PLANTS[name][2]
    u, y, dt = held_record(name, bit=2.0 / cutoff, hold=250, bits=80)
    state_filter = rp.StateVariableFilter(cutoff) if chosen == "given" else "auto"
    result = rp.fit(u, y, dt, structure_of(name), method="least_squares", filter=state_filter)
    assert (relative_errors(result, name) < 0.005).all()
    assert result.simulation.fit > 99.9
    assert result.one_step > 99.9
    assert result.samples == u.size


@every_plant
def test_the_error_falls_at_second_order_with_the_sampling_time(name: str) -> None:
    """The same held input in continuous time, sampled twice as often each time: the error is that of the straight
    lines between samples of y, in dt squared.
    """
    cutoff = PLANTS[name][2]
    errors = []
    for hold in (128, 256, 512):
        u, y, dt = held_record(name, bit=2.0 / cutoff, hold=hold, bits=60)
        errors.append(
            relative_errors(
                rp.fit(u, y, dt, structure_of(name), filter=rp.StateVariableFilter(cutoff), method=LS), name
            )
        )
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all()
    assert (orders < 2.3).all()


def test_where_the_holds_are_true_the_recovery_is_exact() -> None:
    """An integrator under a held input has straight lines for an output: nothing is left to err but rounding."""
    plant = rp.TransferFunction([3.0], [1.0, 0.0])
    u = prbs(400, bits=7, hold=3)
    result = rp.fit(u, plant.simulate(u, 0.1), 0.1, rp.Structure(1), filter=rp.StateVariableFilter(2.0), method=LS)
    np.testing.assert_allclose(result.parameters, [0.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("delay", [0.05, 0.1234567, 1.0])
def test_a_known_dead_time_is_taken_out(delay: float) -> None:
    plant = rp.TransferFunction([2.0], [1.0, 1.0], delay=delay)
    u = np.concatenate([np.zeros(200), prbs(8000, bits=10, hold=40)])
    y = plant.simulate(u, 0.01)
    known, ignored = (
        rp.fit(u, y, 0.01, rp.Structure(1, delay=d), filter=rp.StateVariableFilter(2.0), method=LS)
        for d in (delay, 0.0)
    )
    np.testing.assert_allclose(known.parameters, [1.0, 2.0], rtol=1e-4)
    assert known.transfer_function.delay == delay
    assert abs(ignored.parameters[0] - 1.0) > 0.01


# --- against other ways to compute the same


@every(
    "state_filter",
    [
        rp.StateVariableFilter(2.0),
        rp.StateVariableFilter(2.0, input_hold="foh"),
        rp.StateVariableFilter(2.0, method="gbt"),
        rp.StateVariableFilter(denominator=[1.0, 5.0, 7.0]),
    ],
    ids=["exact", "foh", "gbt", "denominator"],
)
@every("bias", [False, True])
def test_it_solves_the_articles_regression(state_filter: rp.StateVariableFilter, bias: bool) -> None:
    """y = phi_uy' theta_lambda, (4), solved by NumPy, and lambda added again: the same minimum."""
    structure = rp.Structure(2, 1, delay=0.13, bias=bias)
    u, y = record(random_plant(1, 2, 1), seed=1, samples=500, dt=0.1, noise=0.2)
    phi = references.regressor(u, y, structure=structure, state_filter=state_filter, dt=0.1).astype(float)
    theta_lambda, *_ = np.linalg.lstsq(phi, y, rcond=None)
    expected = theta_lambda.copy()
    expected[:2] += state_filter.polynomial(2)[1:]
    result = rp.fit(u, y, 0.1, structure, filter=state_filter, method=LS)
    np.testing.assert_allclose(result.parameters, expected, rtol=1e-9)
    residual = y - phi @ theta_lambda
    assert result.one_step == pytest.approx(100 * (1 - np.linalg.norm(residual) / np.linalg.norm(y - y.mean())))


#: How far rounding may move a result: directly solved, and searched for.
ROUNDING = {LS: 1e-9, "srivc": 1e-6}
both_methods = every("method", [LS, "srivc"])


@both_methods
def test_units_of_input_output_and_time_do_not_matter(method: str) -> None:
    """b scales with y and against u; with time c times slower a_i scales with c^-(n-i), b_i likewise."""
    structure, tolerance = rp.Structure(2, 1), ROUNDING[method]
    u, y = record(G2, seed=2, samples=1000, dt=0.02, noise=0.01)

    def fitted(u: np.ndarray, y: np.ndarray, dt: float) -> np.ndarray:
        return rp.fit(u, y, dt, structure, filter=rp.StateVariableFilter(0.2 / dt), method=method).parameters

    a1, a0, b1, b0 = fitted(u, y, 0.02)
    np.testing.assert_allclose(fitted(1e-6 * u, 1e9 * y, 0.02), [a1, a0, 1e15 * b1, 1e15 * b0], rtol=tolerance)
    np.testing.assert_allclose(fitted(u, y, 20.0), [a1 / 1e3, a0 / 1e6, b1 / 1e3, b0 / 1e6], rtol=tolerance)


@both_methods
def test_the_working_point_is_taken_off(method: str) -> None:
    u, y = record(G2, seed=3, samples=1000, dt=0.02, noise=0.01)
    plain = rp.fit(u, y, 0.02, rp.Structure(2, 1), method=method)
    known = rp.Preprocess("identity", 5.0, -3.0)
    first = rp.fit(u + 5, y - 3, 0.02, rp.Structure(2, 1), preprocess=known, method=method)
    assert first.filter == plain.filter
    np.testing.assert_allclose(first.parameters, plain.parameters, rtol=1e-9)
    assert (first.preprocess.input_offset, first.preprocess.output_offset) == (5.0, -3.0)


def test_a_bias_takes_up_an_offset_that_nobody_knows() -> None:
    """With y + 1 the filtered equation gains the constant a0/lambda0 once the filters have settled, (24)."""
    u, y = record(G1, seed=4, samples=20_000, dt=0.01, hold=100)
    without, with_bias = (
        rp.fit(u, y + 1.0, 0.01, rp.Structure(1, bias=bias), filter=rp.StateVariableFilter(5.0), method=LS)
        for bias in (False, True)
    )
    true = true_parameters(G1, 0)
    errors = [abs(result.parameters[:2] / true - 1).max() for result in (without, with_bias)]
    assert errors[1] < 0.01 < 0.1 < errors[0]
    assert with_bias.parameters[2] == pytest.approx(0.5 / 5.0, rel=0.02)


# --- samples that cannot be used


@every(("bad", "reason"), [(np.nan, "not finite"), (np.inf, "not finite"), (1e308, "too large")])
@every("where", ["u", "y"])
@both_methods
def test_unusable_samples_at_the_end_are_as_if_they_had_not_come(
    bad: float, reason: str, where: str, method: str
) -> None:
    u, y = record(G1, seed=5, samples=600, dt=0.05, noise=0.01)
    plain = rp.fit(u, y, 0.05, rp.Structure(1), preprocess=rp.Preprocess("identity", "mean", "mean"), method=method)
    tail_u, tail_y = (bad, 0.0) if where == "u" else (0.0, bad)
    longer = rp.fit(
        np.append(u, [tail_u] * 3),
        np.append(y, [tail_y] * 3),
        0.05,
        rp.Structure(1),
        filter=plain.filter,
        preprocess=rp.Preprocess("identity", "mean", "mean"),
        method=method,
    )
    np.testing.assert_array_equal(longer.parameters, plain.parameters)
    assert longer.samples == 600
    assert longer.rejected[reason] == 3
    assert longer.one_step == pytest.approx(plain.one_step, rel=1e-12)
    assert longer.simulation.fit == pytest.approx(plain.simulation.fit, abs=1e-6)


@every("bad", [np.nan, -1e308])
@every("preprocess", [rp.Preprocess(), rp.Preprocess("square"), rp.Preprocess("identity", "mean", "mean")])
@both_methods
def test_a_spike_in_the_middle_does_little_harm(bad: float, preprocess: rp.Preprocess, method: str) -> None:
    """One sample of 2000 is missing: the estimate moves by less than two percent."""
    fitted = functools.partial(
        rp.fit, dt=0.02, structure=rp.Structure(1), filter=rp.StateVariableFilter(2.0), preprocess=preprocess
    )
    u, y = record(G1, seed=6, samples=2000, dt=0.02, hold=50)
    u = u + 2.0 if preprocess.input_map == "square" else u
    y = G1.simulate(u**2, 0.02) if preprocess.input_map == "square" else y
    plain = fitted(u, y, method=method)
    for spiked in (u, y):
        kept, spiked[777] = spiked[777], bad
        result = fitted(u, y, method=method)
        spiked[777] = kept
        np.testing.assert_allclose(result.parameters, plain.parameters, rtol=0.02)
        assert result.simulation.fit > plain.simulation.fit - 2
        assert sum(result.rejected.values()) == 1


# --- no excitation


@every("level", [0.0, 1.0, -1e-300, 1e149])
@every("structure", [rp.Structure(1), rp.Structure(3, 2, delay=0.05, bias=True)])
@every("chosen", ["auto", "given"])
def test_a_constant_record_is_said_not_to_excite(level: float, structure: rp.Structure, chosen: str) -> None:
    """No crash and no warning (it would be an error here): the condition number is infinite."""
    state_filter = rp.StateVariableFilter(2.0) if chosen == "given" else "auto"
    result = rp.fit(np.full(200, level), np.full(200, 2 * level), 0.1, structure, filter=state_filter)
    assert result.condition == math.inf
    assert np.isfinite(result.parameters).all()
    assert math.isnan(result.one_step)


def test_an_input_at_rest_does_not_excite_though_the_output_moves() -> None:
    y = G1.free_responses(300, 0.1)[:, 0]
    result = rp.fit(np.zeros(300), y, 0.1, rp.Structure(1), filter=rp.StateVariableFilter(2.0), method=LS)
    assert result.condition == math.inf
    assert result.parameters[1] == 0.0


# --- bad input


@every(
    ("changes", "named", "kind"),
    [
        ({"dt": 0.0}, "dt", ValueError),
        ({"dt": -1.0}, "dt", ValueError),
        ({"dt": math.nan}, "dt", ValueError),
        ({"dt": math.inf}, "dt", ValueError),
        ({"dt": "a"}, "dt", TypeError),
        ({"dt": None}, "dt", TypeError),
        ({"u": [1.0, 2.0]}, "u and y must have the same length, got 2 and 50 samples", ValueError),
        ({"y": [1.0, 2.0]}, "u and y must have the same length, got 50 and 2 samples", ValueError),
        ({"u": ["a"] * 50}, "u", TypeError),
        ({"u": None}, "u", TypeError),
        ({"y": [None] * 50}, "y", TypeError),
        ({"y": [1j] * 50}, "y", TypeError),
        ({"y": np.ones((50, 1, 1))}, r"y must be .*shape \(50, 1, 1\)", ValueError),
        ({"structure": 2}, "structure", TypeError),
        ({"structure": None}, "structure", TypeError),
        ({"method": "subspace"}, "method", ValueError),
        ({"method": None}, "method", ValueError),
        ({"filter": 50.0}, "filter", TypeError),
        ({"filter": None}, "filter", TypeError),
        ({"filter": rp.StateVariableFilter(denominator=[1.0, 2.0, 1.0])}, "denominator", ValueError),
        ({"filter": rp.StateVariableFilter(100.0, method="gbt", alpha=0.0)}, "unstable", ValueError),
        ({"preprocess": "square"}, "preprocess", TypeError),
    ],
    ids=repr,
)
def test_a_bad_argument_is_refused_by_name(changes: dict[str, Any], named: str, kind: type[Exception]) -> None:
    u, y = record(G1, seed=1, samples=50, dt=0.1)
    with pytest.raises(kind, match=named) as caught:
        rp.fit(**{"u": u, "y": y, "dt": 0.1, "structure": rp.Structure(1), **changes})
    assert isinstance(caught.value, rp.ReplantError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("usable", [0, 1, 4])
def test_a_record_too_short_for_its_parameters_is_refused(usable: int) -> None:
    u, y = np.full(50, np.nan), np.ones(50)
    u[:usable] = 1.0
    too_few = rf"{usable} usable samples, fewer than the 5 that 4 parameters need \({50 - usable} not finite\)"
    with pytest.raises(rp.InvalidArgumentError, match=too_few):
        rp.fit(u, y, 0.1, rp.Structure(2, 1))
