"""Uncertainty: analytic slopes against differences of the figures themselves, and against a Monte Carlo."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.model.uncertainty import Uncertainty
from support.builders import random_plant, true_parameters
from support.cases import every

#: Structure and plant: real and conjugate poles, zeros on both sides, a bias, as many zeros as poles.
PLANTS = {
    "first order": (rp.Structure(1), rp.TransferFunction([2.0], [1.0, 0.5])),
    "two real poles": (rp.Structure(2), rp.TransferFunction([2.0], [1.0, 4.0, 3.0])),
    "lightly damped": (rp.Structure(2, 1), rp.TransferFunction([1.0, 3.0], [1.0, 0.04, 4.0])),
    "non-minimum phase": (rp.Structure(3, 1, delay=0.2), rp.TransferFunction([-1.0, 3.0], [1.0, 3.0, 7.0, 10.0], 0.2)),
    "unstable": (rp.Structure(2), rp.TransferFunction([1.0], [1.0, 0.5, -3.0])),
    "feedthrough": (rp.Structure(2, 2, feedthrough=True), rp.TransferFunction([1.0, 2.0, 9.0], [1.0, 1.0, 4.0])),
    "with bias": (rp.Structure(2, 1, bias=True), rp.TransferFunction([1.0, 3.0], [1.0, 2.0, 5.0])),
    "random": (rp.Structure(4, 2), random_plant(5, 4, 2)),
}
every_plant = every("name", PLANTS)
OMEGA = np.array([0.1, 0.7, 2.3, 11.0])


def parameters_of(name: str) -> np.ndarray:
    structure, plant = PLANTS[name]
    parameters = true_parameters(plant, structure.zeros)
    return np.append(parameters, 0.7) if structure.bias else parameters


def known(name: str, covariance: np.ndarray) -> Uncertainty:
    return Uncertainty(PLANTS[name][0], parameters_of(name), covariance)


def random_covariance(name: str, size: float) -> np.ndarray:
    """Standard deviations of about ``size`` times each parameter, correlated at random."""
    parameters = parameters_of(name)
    factor = np.random.default_rng(1).standard_normal((parameters.size, parameters.size)) / math.sqrt(parameters.size)
    scale = size * np.abs(parameters)
    return (factor @ factor.T) * np.outer(scale, scale)


def slopes(figure: Callable[[rp.TransferFunction], np.ndarray], name: str) -> np.ndarray:
    """Central differences of the model's figure in each parameter, (figures, P)."""
    structure, parameters = PLANTS[name][0], parameters_of(name)
    columns = []
    for i in range(parameters.size):
        step = 1e-6 * max(abs(parameters[i]), 1e-3)
        ends = []
        for sign in (1.0, -1.0):
            moved = parameters.copy()
            moved[i] += sign * step
            ends.append(np.asarray(figure(structure.transfer_function(moved))))
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=-1)


def spread(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("fi,ij,fj->f", jacobian, covariance, jacobian))


@every_plant
def test_standard_deviations_are_the_roots_of_the_diagonal(name: str) -> None:
    covariance = random_covariance(name, 0.01)
    np.testing.assert_allclose(known(name, covariance).std, np.sqrt(np.diag(covariance)), rtol=1e-14)


@every_plant
def test_gain_and_response_by_differences(name: str) -> None:
    covariance = random_covariance(name, 0.01)
    uncertainty = known(name, covariance)
    gain = spread(slopes(lambda model: np.array([model.dc_gain]), name), covariance)
    assert uncertainty.dc_gain_std == pytest.approx(gain[0], rel=1e-6)
    relative, phase = uncertainty.response(OMEGA)
    np.testing.assert_allclose(
        relative, spread(slopes(lambda model: np.log(np.abs(model.response(OMEGA))), name), covariance), rtol=1e-5
    )
    reference = PLANTS[name][1].response(OMEGA)
    turned = slopes(lambda model: np.angle(model.response(OMEGA) / reference), name)
    np.testing.assert_allclose(phase, spread(turned, covariance), rtol=1e-5)


@every_plant
def test_modes_by_differences(name: str) -> None:
    covariance = random_covariance(name, 0.001)
    modes = PLANTS[name][1].modes

    def figures(model: rp.TransferFunction) -> np.ndarray:
        nearest = [min(model.modes, key=lambda mode, one=one: abs(mode.pole - one.pole)) for one in modes]
        return np.array([[m.pole.real, m.pole.imag, m.frequency, m.damping, m.time_constant] for m in nearest]).ravel()

    jacobian = slopes(figures, name).reshape(len(modes), 5, -1)
    for found, mode, slope in zip(known(name, covariance).modes, modes, jacobian, strict=True):
        assert found.mode.pole == pytest.approx(mode.pole)
        expected = slope[:2] @ covariance @ slope[:2].T
        np.testing.assert_allclose(found.covariance, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
        np.testing.assert_allclose(found.covariance, found.covariance.T)
        std = spread(slope[2:], covariance)
        computed = [found.frequency_std, found.damping_std, found.time_constant_std]
        np.testing.assert_allclose(computed, std, rtol=1e-4, atol=1e-9 * abs(mode.pole))


@every("name", ["first order", "lightly damped", "non-minimum phase", "random"])
def test_figures_of_drawn_models_scatter_as_they_say(name: str) -> None:
    """2000 models drawn from the covariance: a standard deviation out of N draws is good to 1/sqrt(2 N) = 1.6 %.

    With parameters within 0.1 % the figures are linear; the bound is five of these.
    """
    covariance = random_covariance(name, 0.001)
    uncertainty, structure = known(name, covariance), PLANTS[name][0]
    drawn = np.random.default_rng(2).multivariate_normal(parameters_of(name), covariance, 2000)
    models = [structure.transfer_function(parameters) for parameters in drawn]
    gains = np.array([model.dc_gain for model in models])
    assert uncertainty.dc_gain_std == pytest.approx(gains.std(), rel=0.08)
    responses = np.array([model.response(OMEGA) for model in models])
    relative, phase = uncertainty.response(OMEGA)
    np.testing.assert_allclose(relative, np.log(np.abs(responses)).std(axis=0), rtol=0.08)
    np.testing.assert_allclose(phase, np.angle(responses / PLANTS[name][1].response(OMEGA)).std(axis=0), rtol=0.08)
    for found in uncertainty.modes:
        nearest = [min(model.modes, key=lambda mode: abs(mode.pole - found.mode.pole)) for model in models]
        assert found.frequency_std == pytest.approx(np.std([mode.frequency for mode in nearest]), rel=0.08)
        assert found.damping_std == pytest.approx(np.std([mode.damping for mode in nearest]), rel=0.08, abs=1e-12)
        assert found.time_constant_std == pytest.approx(np.std([mode.time_constant for mode in nearest]), rel=0.08)


def test_what_is_not_known_is_not_made_up() -> None:
    unknown = Uncertainty(rp.Structure(2), np.array([3.0, 2.0, 1.0]), np.full((3, 3), np.nan))
    assert np.isnan(unknown.std).all()
    assert math.isnan(unknown.dc_gain_std)
    assert all(math.isnan(mode.frequency_std) and math.isnan(mode.damping_std) for mode in unknown.modes)
    assert np.isnan(unknown.response([1.0])).all()


def test_an_integrator_has_no_static_gain_and_a_double_pole_no_bound() -> None:
    covariance = np.diag([1e-4, 1e-4, 1e-4])
    integrator = Uncertainty(rp.Structure(2), np.array([1.0, 0.0, 1.0]), covariance)
    assert integrator.dc_gain_std == math.inf
    slow = integrator.modes[0]
    assert slow.mode.pole == 0.0
    assert slow.time_constant_std == math.inf
    assert slow.frequency_std == pytest.approx(0.01 / math.tau)
    double = Uncertainty(rp.Structure(2), np.array([2.0, 1.0, 1.0]), covariance)
    for mode in double.modes:
        assert mode.frequency_std == mode.damping_std == mode.time_constant_std == math.inf
        assert np.isinf(mode.covariance).all()


def test_before_the_first_sample_nothing_is_known_and_nothing_fails() -> None:
    """Every parameter is zero then: a double pole at the origin, and no covariance."""
    modes = rp.Identifier(rp.Structure(3), 0.1).uncertainty.modes
    assert len(modes) == 3
    assert all(math.isnan(mode.frequency_std) for mode in modes)


@every("shape", [(2, 2), (4, 4), (3,), (3, 2)])
def test_a_covariance_of_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=r"covariance must have shape \(3, 3\)"):
        Uncertainty(rp.Structure(2), np.ones(3), np.zeros(shape))
