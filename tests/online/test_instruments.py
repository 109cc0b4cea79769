"""Instruments beside a fixed filter, with every optimizer: unbiased where the plain update is not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.signals import prbs
from support.builders import DT, binary, true_parameters, two_modes
from support.cases import every
from support.references import TWINS

PLANT, STRUCTURE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2)
TRUE = true_parameters(PLANT, 0)


def noisy(seed: int, samples: int, decibel: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """A random binary input and the output at this signal-to-noise ratio, white."""
    u = binary(seed, samples, 4)
    y = PLANT.simulate(u, DT)
    noise = y.std() * 10 ** (-decibel / 20)
    return u, y + noise * np.random.default_rng([seed, 5]).standard_normal(samples)


def ends(samples: int, runs: int, **arguments: Any) -> np.ndarray:
    """Final estimates (runs, P) behind the filter (s + 4)^2."""
    found = []
    for seed in range(runs):
        ident = rp.Identifier(STRUCTURE, DT, filter=rp.StateVariableFilter(4.0), **arguments)
        ident.update_many(*noisy(seed, samples))
        found.append(ident.parameters)
    return np.array(found)


def assert_unbiased(found: np.ndarray, tolerance: float = 0.01) -> None:
    """The mean within four of its own standard errors and ``tolerance`` for filters that join y by straight lines."""
    error = found.std(axis=0, ddof=1) / math.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - TRUE) < 4 * error + tolerance * TRUE).all()


def test_buffered_amsgrad_is_unbiased_with_instruments_and_not_without() -> None:
    """Twelve runs at 10 dB.  Without instruments the buffer settles on least squares: a1 a fifth too low.

    The standard error of the mean is std / sqrt(12), a1's below 0.05: without instruments it is ten of these off.
    """
    arguments = {"optimizer": rp.AMSGrad(step_size=3e-4), "replay": rp.Replay(capacity=12_000, batch_size=10)}
    plain = ends(12_000, 12, instruments=False, **arguments)
    instrumental = ends(12_000, 12, instruments=True, **arguments)
    assert_unbiased(instrumental)
    error = plain.std(axis=0, ddof=1) / math.sqrt(12)
    assert (np.abs(plain.mean(axis=0) - TRUE)[[0, 2]] > 8 * error[[0, 2]]).all()
    assert plain[:, 0].mean() < 0.85 * TRUE[0]


@pytest.mark.parametrize(
    "optimizer", [rp.RecursiveLeastSquares(), rp.KalmanTracking(1e-5)], ids=lambda v: type(v).__name__
)
def test_the_second_order_is_unbiased_with_instruments_and_not_without(optimizer: Any) -> None:
    plain = ends(8000, 8, optimizer=optimizer, instruments=False)
    instrumental = ends(8000, 8, optimizer=optimizer, instruments=True)
    assert_unbiased(instrumental)
    error = plain.std(axis=0, ddof=1) / math.sqrt(8)
    assert (np.abs(plain.mean(axis=0) - TRUE)[0] > 8 * error[0]).all()


@every("name", OPTIMIZERS)
def test_every_optimizer_runs_with_instruments_and_stays_at_the_truth(name: str) -> None:
    """Noise-free, from the start-up's estimate on: within the error of the straight lines between samples of y."""
    settings = dict(TWINS[name].settings)
    if "step_size" in settings:
        settings["step_size"] *= 0.01
    ident = rp.Identifier(
        STRUCTURE, DT, filter=rp.StateVariableFilter(4.0), optimizer=OPTIMIZERS[name](**settings), instruments=True
    )
    u = binary(1, 4000, 4)
    ident.update_many(u, PLANT.simulate(u, DT))
    assert ident.status == "running"
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.02)


@every("name", OPTIMIZERS, quick=2)
def test_zeta_is_free_of_the_outputs_noise(name: str) -> None:
    """The same input with other noise: phi differs by the noise, zeta by what the estimates differ alone."""
    gains = []
    for decibel in (300.0, 10.0):
        ident = rp.Identifier(
            STRUCTURE, DT, filter=rp.StateVariableFilter(4.0), scaling=None, instruments=True,
            optimizer=OPTIMIZERS[name](**TWINS[name].settings),
        )  # fmt: skip
        ident.update_many(*noisy(3, 600, decibel))
        ident.freeze()
        model = ident._state.banks.copy()
        u, y = noisy(3, 900, decibel)
        phis, zetas = [], []
        for k in range(600, 900):
            ident.update(float(u[k]), float(y[k]))
            phis.append(ident._state.phi.copy())
            zetas.append(ident._state.zeta.copy())
        gains.append((np.array(phis), np.array(zetas), model))
    (clean_phi, clean_zeta, _), (noisy_phi, noisy_zeta, _) = gains
    np.testing.assert_allclose(clean_phi, clean_zeta, atol=0.02 * np.abs(clean_phi).max())
    of_phi = np.linalg.norm((noisy_phi - clean_phi)[:, 0])
    of_zeta = np.linalg.norm((noisy_zeta - clean_zeta)[:, 0])
    assert of_zeta < 0.3 * of_phi
    np.testing.assert_array_equal(noisy_zeta[:, 2], noisy_phi[:, 2])  # of the input: the same


# --- the bias of a fixed filter


SMOOTH = rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))


@every("optimizer", [rp.RecursiveLeastSquares(), rp.KalmanTracking(1e-6)], ids=lambda v: type(v).__name__)
@every("offset", [0.0, 3.0, -50.0])
@every("cutoff", [2.0, 5.0])
def test_a_bias_takes_up_the_outputs_offset(optimizer: Any, offset: float, cutoff: float) -> None:
    """(24): with y + c the filtered equation gains c a0 / lambda0, once the filters have settled.

    The rest is the error of straight lines between samples of y, (dt times the plant's frequency)^2 / 12 about.
    """
    u = prbs(6000, bits=9, hold=6)
    ident = rp.Identifier(
        rp.Structure(2, 1, bias=True), DT, filter=rp.StateVariableFilter(cutoff), optimizer=optimizer, instruments=True
    )
    ident.update_many(u, SMOOTH.simulate(u, DT) + offset)
    np.testing.assert_allclose(ident.parameters[:4], true_parameters(SMOOTH, 1), rtol=0.01)
    assert ident.parameters[4] == pytest.approx(offset * 4.0 / cutoff**2, rel=0.01, abs=1e-3)


def test_with_noise_the_bias_is_unbiased_too() -> None:
    u = prbs(6000, bits=9, hold=6)
    found = []
    for seed in range(10):
        y = SMOOTH.simulate(u, DT) + 3.0
        y += 0.3 * y.std() * np.random.default_rng(seed).standard_normal(6000)
        ident = rp.Identifier(
            rp.Structure(2, 1, bias=True), DT, filter=rp.StateVariableFilter(5.0), instruments=True,
            optimizer=rp.RecursiveLeastSquares(),
        )  # fmt: skip
        ident.update_many(u, y)
        found.append(ident.parameters)
    found = np.array(found)
    error = found.std(axis=0, ddof=1) / math.sqrt(10)
    expected = np.append(true_parameters(SMOOTH, 1), 3.0 * 4.0 / 25.0)
    assert (np.abs(found.mean(axis=0) - expected) < 4 * error + 0.01 * expected).all()


# --- the working point of a fixed filter


@pytest.mark.parametrize(
    ("preprocess", "tolerance"),
    [
        (rp.Preprocess(input_offset="first", output_offset="first"), 0.01),
        (rp.Preprocess(input_offset=5.0, output_offset=8.0), 0.01),
        # the mean of the start-up is the working point but for what the input's own mean is then: a sixth root of 500
        (rp.Preprocess(input_offset="mean", output_offset="mean"), 0.05),
    ],
    ids=["first", "known", "mean"],
)
def test_without_a_constant_the_working_point_is_taken_off(preprocess: rp.Preprocess, tolerance: float) -> None:
    u = prbs(6000, bits=9, hold=6)
    u[:4] = 0.0
    y = SMOOTH.simulate(u, DT) + 8.0
    for instruments in (True, False):
        ident = rp.Identifier(
            rp.Structure(2, 1), DT, filter=rp.StateVariableFilter(5.0), optimizer=rp.RecursiveLeastSquares(),
            instruments=instruments, preprocess=preprocess,
        )  # fmt: skip
        ident.update_many(u + 5.0, y)
        np.testing.assert_allclose(ident.parameters, true_parameters(SMOOTH, 1), rtol=tolerance)


# --- what is not honest


def test_without_instruments_no_covariance_is_told() -> None:
    ident = rp.Identifier(STRUCTURE, DT, optimizer=rp.RecursiveLeastSquares(), instruments=False)
    ident.update_many(*noisy(1, 3000))
    assert np.isnan(ident.covariance).all()
    assert np.isnan(ident.uncertainty.std).all()


def test_a_refined_filter_without_instruments_is_refused() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="the refined filter needs instruments"):
        rp.Identifier(STRUCTURE, DT, filter=rp.RefinedFilter(), instruments=False)
