"""Simulated rigs: rest, nonlinear input, noise; the true plant can be identified."""

from __future__ import annotations

import math

import numpy as np
import pytest

import replant as rp
from replant.rigs import (
    DEAP,
    G1,
    G2,
    Rig,
    deap_rig,
    deap_voltage,
)
from support.builders import true_parameters


def test_the_plants_are_the_articles() -> None:
    assert rp.TransferFunction([1.25], [1.0, 0.5]) == G1
    assert rp.TransferFunction([7.5, -12.5], [1.0, 15.0, 100.0]) == G2
    a0, a1, a2, b0, b1 = 595.7, 5891.0, 3.292, 7.722, 51.47  # Table 6
    assert rp.TransferFunction([b1, b0], [1.0, a2, a1, a0]) == DEAP


def test_the_actuator_has_a_slow_and_a_fast_lightly_damped_mode() -> None:
    slow, fast = DEAP.modes
    assert slow.pole == pytest.approx(-0.1011, rel=1e-3)
    assert fast.frequency == pytest.approx(12.2, rel=2e-3)
    assert fast.damping == pytest.approx(0.021, rel=0.02)
    np.testing.assert_allclose(DEAP.zeros, [-0.150], rtol=1e-3)


@pytest.mark.parametrize("rig", [deap_rig(noise=0.0), Rig(G1, 0.1, input_rest=-2.0, output_rest=7.0)])
def test_at_rest_nothing_moves(rig: Rig) -> None:
    np.testing.assert_allclose(rig.measure(np.full(50, rig.input_rest)), rig.output_rest, rtol=1e-14)


def test_the_output_is_the_plants_answer_to_the_mapped_input_around_rest() -> None:
    rig = Rig(G2, 0.01, input_map="square", input_rest=3.0, output_rest=-1.0)
    u = np.random.default_rng(0).uniform(2.0, 4.0, 200)
    np.testing.assert_allclose(rig.measure(u), -1.0 + G2.simulate(u**2 - 9.0, 0.01), rtol=1e-12)


def test_the_sensor_adds_its_noise_by_the_seed() -> None:
    """The standard deviation of K samples has a relative error of 1/sqrt(2K); the bound is five times that."""
    K, rig = 20_000, deap_rig(noise=1e-3)
    u = np.full(K, rig.input_rest)
    noise = rig.measure(u, seed=1) - rig.output_rest
    assert noise.std() == pytest.approx(1e-3, rel=5 / math.sqrt(2 * K))
    np.testing.assert_array_equal(rig.measure(u, seed=1), rig.measure(u, seed=1))
    assert (rig.measure(u, seed=1) != rig.measure(u, seed=2)).any()


def test_with_the_rigs_preprocess_the_plant_is_found() -> None:
    rig = Rig(G2, 0.002, input_map="square", input_rest=3.0, output_rest=-1.0)
    u = np.repeat(np.random.default_rng(1).uniform(2.0, 4.0, 200), 50)
    u[:50] = rig.input_rest
    result = rp.fit(
        u, rig.measure(u), 0.002, rp.Structure(2, 1), filter=rp.StateVariableFilter(10.0), preprocess=rig.preprocess
    )
    np.testing.assert_allclose(result.parameters, true_parameters(G2, 1), rtol=0.001)


def test_the_actuators_voltage_stays_within_its_limits() -> None:
    u = deap_voltage(60_000, seed=3)
    assert 2.0 <= u.min() < 2.5 < 5.0 < u.max() <= 5.5
    np.testing.assert_array_equal(u, deap_voltage(60_000, seed=3))
