"""TransferFunction against SciPy, python-control and analytic answers; how it prints, compares and refuses."""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

import replant as rp
from support.builders import G1, G2, Thing, binary, random_plant
from support.cases import every

DT = 0.1

PLANTS = {
    "first order": G1,
    "with a zero": G2,
    "integrator": rp.TransferFunction([2.0], [1.0, 0.0]),
    "double integrator": rp.TransferFunction([1.0, 3.0], [1.0, 0.0, 0.0]),
    "undamped": rp.TransferFunction([4.0], [1.0, 0.0, 4.0]),
    "unstable": rp.TransferFunction([1.0], [1.0, -0.2, 1.0]),
    "biproper": rp.TransferFunction([2.0, 1.0, 5.0], [1.0, 1.0, 3.0]),
    "a gain": rp.TransferFunction([3.0], [2.0]),
    "sixth order": random_plant(6, 6, 4),
    "tenth order": random_plant(10, 10, 7),
}
every_plant = every("plant", PLANTS.values(), ids=PLANTS)


def sorted_roots(roots: np.ndarray) -> np.ndarray:
    return np.sort_complex(np.round(roots, 9))


# --- poles, zeros, gain, response


@every_plant
def test_poles_zeros_gain_and_response_equal_control(plant: rp.TransferFunction) -> None:
    same = control.tf(plant.num, plant.den)
    np.testing.assert_allclose(sorted_roots(plant.poles), sorted_roots(same.poles()), rtol=1e-6)
    np.testing.assert_allclose(sorted_roots(plant.zeros), sorted_roots(same.zeros()), rtol=1e-6)
    assert plant.dc_gain == pytest.approx(same.dcgain(), rel=1e-12)
    frequency = np.geomspace(1e-3, 1e3, 50)
    np.testing.assert_allclose(plant.response(frequency), same(1j * frequency), rtol=1e-10)


@every_plant
def test_poles_and_zeros_are_roots(plant: rp.TransferFunction) -> None:
    """Each root, put into its polynomial, leaves nothing beside the polynomial's own terms."""
    for roots, polynomial in ((plant.poles, plant.den), (plant.zeros, plant.num)):
        for root in roots:
            assert abs(np.polyval(polynomial, root)) <= 1e-9 * np.polyval(abs(polynomial), abs(root))
        assert roots.size == polynomial.size - 1
        assert roots.dtype == np.complex128


def test_the_response_carries_the_dead_time_and_keeps_the_shape() -> None:
    late = rp.TransferFunction([1.0], [1.0, 1.0], delay=0.7)
    frequency = np.array([[0.0, 1.0], [2.0, 10.0]])
    expected = np.exp(-0.7j * frequency) / (1j * frequency + 1)
    np.testing.assert_allclose(late.response(frequency), expected, rtol=1e-14)
    assert late.response(2.0).shape == ()


def test_the_response_at_a_pole_is_not_finite() -> None:
    response = rp.TransferFunction([1.0], [1.0, 0.0]).response([0.0, 1.0])
    assert not np.isfinite(response[0])
    assert response[1] == pytest.approx(-1j)


def test_the_gain_of_integrators_and_differentiators() -> None:
    assert math.isinf(rp.TransferFunction([2.0], [1.0, 0.0]).dc_gain)
    assert rp.TransferFunction([2.0, 0.0], [1.0, 1.0]).dc_gain == 0.0
    assert math.isnan(rp.TransferFunction([2.0, 0.0], [1.0, 0.0]).dc_gain)


def test_stability_is_strict() -> None:
    assert G2.is_stable
    assert rp.TransferFunction([3.0], [1.0]).is_stable
    for den in ([1.0, 0.0], [1.0, 0.0, 4.0], [1.0, -0.1, 1.0]):
        assert not rp.TransferFunction([1.0], den).is_stable


def test_modes_read_as_an_engineer_reads_them() -> None:
    """A pair of 2 Hz and damping 0.1, a lag of 5 s and an integrator; slowest first, one entry for a pair."""
    natural = 2 * np.pi * 2.0
    den = np.polymul(np.polymul([1.0, 2 * 0.1 * natural, natural**2], [1.0, 0.2]), [1.0, 0.0])
    origin, lag, pair = rp.TransferFunction([1.0], den).modes
    assert (origin.frequency, origin.time_constant) == (0.0, math.inf)
    assert math.isnan(origin.damping)
    assert lag.time_constant == pytest.approx(5.0)
    assert lag.damping == pytest.approx(1.0)
    assert pair.frequency == pytest.approx(2.0)
    assert pair.damping == pytest.approx(0.1)
    assert pair.time_constant == pytest.approx(1 / (0.1 * natural))
    assert pair.pole.imag > 0


# --- simulation


@every_plant
def test_held_and_straight_inputs_equal_scipys_zero_order_hold_and_lsim(plant: rp.TransferFunction) -> None:
    u = np.random.default_rng(0).standard_normal(200)
    held = straight = plant.num[0] * u
    if plant.den.size > 1:
        matrices = signal.tf2ss(plant.num, plant.den)
        _, held, _ = signal.dlsim(signal.cont2discrete((*matrices,), DT, "zoh"), u)
        held = held[:, 0]
        _, straight, _ = signal.lsim(signal.StateSpace(*matrices), u, DT * np.arange(200))
    assert_close(plant.simulate(u, DT), held)
    assert_close(plant.simulate(u, DT, input_hold="foh"), straight)


def assert_close(computed: np.ndarray, expected: np.ndarray, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(computed, expected, rtol=0, atol=tolerance * abs(expected).max())


@every_plant
@every("hold", ["zoh", "foh"])
def test_a_whole_dead_time_shifts_the_output(plant: rp.TransferFunction, hold: str) -> None:
    u = np.random.default_rng(1).standard_normal(80)
    late = rp.TransferFunction(plant.num, plant.den, delay=7 * DT)
    expected = np.concatenate([np.zeros(7), plant.simulate(u, DT, input_hold=hold)[:-7]])
    assert_close(late.simulate(u, DT, input_hold=hold), expected, 1e-12)
    much_later = rp.TransferFunction(plant.num, plant.den, delay=100 * DT)
    assert not much_later.simulate(u, DT, input_hold=hold).any()


@every_plant
@every("quarters", [1, 2, 3, 9])
@every("hold", ["zoh", "foh"])
def test_a_fractional_dead_time_equals_an_oversampled_simulation(
    plant: rp.TransferFunction, quarters: int, hold: str
) -> None:
    """On a grid four times finer the delay is whole, and the input between samples is written out."""
    u = np.random.default_rng(2).standard_normal(60)
    fine_t = np.arange(4 * 59 + 1) / 4
    fine = np.repeat(u, 4)[: fine_t.size] if hold == "zoh" else np.interp(fine_t, np.arange(60), u)
    finely = rp.TransferFunction(plant.num, plant.den, delay=quarters * DT / 4)
    expected = finely.simulate(fine, DT / 4, input_hold=hold)[::4]
    late = rp.TransferFunction(plant.num, plant.den, delay=quarters * DT / 4)
    assert_close(late.simulate(u, DT, input_hold=hold), expected, 1e-10)


@every("delay", [0.0, math.sqrt(2) * DT, math.pi * DT, 1e-7])
def test_a_step_after_any_dead_time(delay: float) -> None:
    """1/(s+1): 1 - e^-(t - delay) from the step's arrival on, for either hold: the step is one for both."""
    t = DT * np.arange(100)
    plant = rp.TransferFunction([1.0], [1.0, 1.0], delay=delay)
    expected = 1 - np.exp(-np.maximum(t - delay, 0.0))
    for hold in ("zoh", "foh"):
        np.testing.assert_allclose(plant.simulate(np.ones(100), DT, input_hold=hold), expected, rtol=0, atol=1e-12)


def test_the_gain_of_a_biproper_plant_passes_at_once() -> None:
    plant = PLANTS["biproper"]
    u = np.zeros(10)
    u[3:] = 1.0
    y = plant.simulate(u, DT)
    assert not y[:3].any()
    assert y[3] == 2.0


@every_plant
def test_simulation_is_linear_and_does_not_touch_its_input(plant: rp.TransferFunction) -> None:
    u, v = np.random.default_rng(3).standard_normal((2, 50))
    before = u.copy()
    both = plant.simulate(2 * u - 3 * v, DT)
    assert_close(both, 2 * plant.simulate(u, DT) - 3 * plant.simulate(v, DT), 1e-12)
    np.testing.assert_array_equal(u, before)


def test_a_long_run_keeps_its_digits() -> None:
    """1/(s+1)^4 sampled at 1e-4 s, where a difference equation of the coefficients would lose 14 digits: its gain."""
    plant = rp.TransferFunction([1.0], np.poly([-1.0] * 4))
    y = plant.simulate(np.ones(400_000), 1e-4)
    t = 39.9999
    expected = 1 - np.exp(-t) * (1 + t + t**2 / 2 + t**3 / 6)
    assert y[-1] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_short_records(samples: int) -> None:
    for plant in PLANTS.values():
        for hold in ("zoh", "foh"):
            assert plant.simulate(np.ones(samples), DT, input_hold=hold).shape == (samples,)
        assert plant.free_responses(samples, DT).shape == (samples, plant.den.size - 1)


@every_plant
def test_free_responses_span_what_an_initial_state_adds(plant: rp.TransferFunction) -> None:
    """After an input has ended, the output goes on as a sum of free responses."""
    u = binary(1, 40, 3)
    padded = np.concatenate([u, np.zeros(60)])
    tail = plant.simulate(padded, DT)[40:]
    basis = plant.free_responses(60, DT)
    weights, *_ = np.linalg.lstsq(basis, tail, rcond=None)
    assert_close(basis @ weights, tail, 1e-9) if plant.den.size > 1 else np.testing.assert_array_equal(tail, 0.0)


# --- to and from other packages


@every_plant
def test_the_way_to_scipy_and_control_and_back(plant: rp.TransferFunction) -> None:
    there = plant.to_scipy()
    assert isinstance(there, signal.TransferFunction)
    assert rp.TransferFunction(np.atleast_1d(there.num), np.atleast_1d(there.den)) == plant
    beside = plant.to_control()
    assert isinstance(beside, control.TransferFunction)
    assert rp.TransferFunction(beside.num[0][0], beside.den[0][0]) == plant


def test_a_dead_time_does_not_get_lost_on_the_way() -> None:
    late = rp.TransferFunction([1.0], [1.0, 1.0], delay=0.5)
    for convert in (late.to_scipy, late.to_control):
        with pytest.raises(rp.InvalidArgumentError, match="dead time"):
            convert()


# --- printing, equality


@every(
    ("num", "den", "delay", "text"),
    [
        ([2.0], [1.0, 0.5], 0.0, "2 / (s + 0.5)"),
        ([7.5, -12.5], [1.0, 15.0, 100.0], 0.0, "(7.5 s - 12.5) / (s^2 + 15 s + 100)"),
        ([-1.0, 0.0], [1.0, 0.0, -4.0], 0.0, "-s / (s^2 - 4)"),
        ([1.0], [1.0, 0.0], 0.25, "1 / s exp(-0.25 s)"),
        ([0.0], [1.0, 1.0], 0.0, "0 / (s + 1)"),
        ([0.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], 0.0, "3 / s^3"),
        ([3.0], [2.0], 0.0, "1.5 / 1"),
        ([1e-12, -2e9], [1.0, 123456.0], 0.0, "(1e-12 s - 2e+09) / (s + 1.235e+05)"),
        ([-1.0, -1.0], [1.0, 1.00001], 0.0, "(-s - 1) / (s + 1)"),
        ([0.99999999], [1.00000001, 2.0], 0.0, "1 / (s + 2)"),
        ([0.99999999, 1.0], [1.0, 2.0], 1 / 3, "(s + 1) / (s + 2) exp(-0.3333 s)"),
    ],
)
def test_how_it_prints(num: list[float], den: list[float], delay: float, text: str) -> None:
    assert str(rp.TransferFunction(num, den, delay)) == text


def test_the_denominator_is_made_monic_and_leading_zeros_are_dropped() -> None:
    """One system, one way to write it: else SciPy would warn, and equals would differ."""
    plant = rp.TransferFunction([2.0, 4.0], [2.0, 6.0, 8.0])
    np.testing.assert_array_equal(plant.num, [1.0, 2.0])
    np.testing.assert_array_equal(plant.den, [1.0, 3.0, 4.0])
    assert plant == rp.TransferFunction([1.0, 2.0], [1.0, 3.0, 4.0])
    assert rp.TransferFunction([0, 0, 0, 2], [0, 1, 3, 4]) == rp.TransferFunction([2], [1, 3, 4])
    zero = rp.TransferFunction([0.0, 0.0], [1.0, 3.0])
    np.testing.assert_array_equal(zero.num, [0.0])
    assert not zero.simulate(np.ones(5), DT).any()


def test_equal_ones_hash_alike_and_others_differ() -> None:
    plant = rp.TransferFunction([1.0, 0.0], [1.0, 2.0, 0.0], 0.5)
    same = rp.TransferFunction([2.0, -0.0], [2.0, 4.0, -0.0], 0.5)
    assert plant == same
    assert hash(plant) == hash(same)
    assert hash(rp.TransferFunction([0.0], [-1.0, 1.0])) == hash(rp.TransferFunction([0.0], [1.0, -1.0]))
    others = [
        rp.TransferFunction([1.0, 0.0], [1.0, 2.0, 0.0]),
        rp.TransferFunction([1.0, 1.0], [1.0, 2.0, 0.0], 0.5),
        rp.TransferFunction([1.0, 0.0], [1.0, 2.0, 1.0], 0.5),
        rp.TransferFunction([1.0], [1.0, 2.0], 0.5),
    ]
    assert len({plant, same, *others}) == 5
    assert plant != "G(s)"


def test_it_cannot_be_changed_nor_does_it_follow_its_arguments() -> None:
    num, den = np.array([1.0]), np.array([1.0, 2.0])
    plant = rp.TransferFunction(num, den)
    num[0], den[1] = 9.0, 9.0
    assert plant == rp.TransferFunction([1.0], [1.0, 2.0])
    for array in (plant.num, plant.den):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    with pytest.raises(AttributeError):
        plant.delay = 1.0


# --- bad input


@every(
    ("arguments", "named"),
    [
        (([1.0], [0.0, 0.0]), "den"),
        (([1.0], []), "den"),
        (([], [1.0]), "num"),
        (([1.0, 2.0, 3.0], [1.0, 1.0]), "num"),
        (([math.nan], [1.0, 1.0]), "num"),
        (([1.0], [1.0, math.inf]), "den"),
        ((["a"], [1.0, 1.0]), "num"),
        (("a", [1.0, 1.0]), "num"),
        ((None, [1.0, 1.0]), "num"),
        (([1j], [1.0, 1.0]), "num"),
        (([1.0], np.array([1.0, 1.0j])), "den"),
        (([1.0], [Thing(), 1.0]), "den"),
        (([[1.0, 2.0]], [1.0, 1.0]), "num"),
        (([1.0], [[1.0], [1.0, 2.0]]), "den"),
        (([1.0], [1.0, 1.0], -0.1), "delay"),
        (([1.0], [1.0, 1.0], math.nan), "delay"),
        (([1.0], [1.0, 1.0], "a"), "delay"),
        (([1.0], [1.0, 1.0], None), "delay"),
    ],
    ids=repr,
)
def test_a_bad_transfer_function_is_refused_by_name(arguments: tuple[Any, ...], named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named) as caught:
        rp.TransferFunction(*arguments)
    assert "\n" not in str(caught.value)


WRONG = (rp.InvalidArgumentError, rp.ArgumentTypeError)


@every(
    ("call", "arguments", "options", "error", "words"),
    [
        *(
            (G1.simulate, arguments, options, WRONG, f"^{named} must")
            for arguments, options, named in (
                (("a", 0.1), {}, "u"),
                ((None, 0.1), {}, "u"),
                (([1j], 0.1), {}, "u"),
                ((1.0, 0.1), {}, "u"),
                (([[1.0]], 0.1), {}, "u"),
                (([1.0], 0.0), {}, "dt"),
                (([1.0], -1.0), {}, "dt"),
                (([1.0], math.nan), {}, "dt"),
                (([1.0], math.inf), {}, "dt"),
                (([1.0], "a"), {}, "dt"),
                (([1.0], 0.1), {"input_hold": "zero"}, "input_hold"),
                (([1.0], 0.1), {"input_hold": None}, "input_hold"),
            )
        ),
        *((G1.free_responses, (samples, DT), {}, WRONG, "samples") for samples in (-1, 1.0, None)),
        *((G1.response, (frequency,), {}, rp.ArgumentTypeError, "frequency") for frequency in ("ab", None, [1j])),
    ],
)
def test_what_a_simulation_or_a_response_is_asked_for_is_checked(
    call: Any, arguments: tuple[Any, ...], options: dict[str, Any], error: Any, words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
