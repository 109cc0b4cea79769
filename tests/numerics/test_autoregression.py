"""Autoregressions of a residual: order, missing past, colouring."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from replant.kernels.schema import LAGS
from replant.numerics.autoregression import Autoregression, likelihood_ratio, one_step, sums_of
from support.cases import every

SMOOTH = np.convolve([1.0, -1.9, 0.95], [1.0, -0.95])  # as behind a disturbance of the plant's input


def coloured(model: list[float] | np.ndarray, samples: int, seed: int = 0) -> np.ndarray:
    return np.asarray(lfilter([1.0], model, np.random.default_rng(seed).standard_normal(samples + 500))[500:])


@every("model", [[1.0], [1.0, -0.9], [1.0, -1.6, 0.9], SMOOTH], ids=range(4))
def test_it_finds_the_model_that_made_the_residual(model: np.ndarray) -> None:
    """Coefficients within five of their standard deviations, sqrt(diag(G^-1)) for an innovation of variance one."""
    found = Autoregression.of(coloured(model, 20_000))
    assert found.order == len(model) - 1
    sums, count = sums_of(coloured(model, 20_000), np.minimum(np.arange(20_000), LAGS))
    p = found.order
    std = np.sqrt(np.diag(np.linalg.inv(sums[1 : p + 1, 1 : p + 1]))) if p else np.zeros(0)
    assert (np.abs(found.coefficients[1:] - np.asarray(model[1:])) < 5.0 * std).all()
    assert found.power / count == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / count))


def test_of_a_smooth_residual_it_finds_the_innovation_and_levinson_does_not() -> None:
    """The innovation is 1; the window of autocovariances leaks many times that from a spectrum over six decades."""
    model = np.poly([0.99, 0.98, 0.97, 0.96])
    error = coloured(model, 4000)
    covariances = np.array([error[lag:] @ error[: error.size - lag] for lag in range(LAGS + 1)])
    assert Autoregression.of(error).power / error.size == pytest.approx(1.0, abs=0.15)
    assert Autoregression.of_covariances(covariances).power / error.size > 5.0


def test_samples_with_a_missing_past_are_as_white_and_as_loud_as_the_others() -> None:
    """The past is broken every seventh sample: filtered and weighted, every sample has the variance of w."""
    error = coloured(SMOOTH, 70_000)
    known = np.minimum(np.arange(error.size) % 7, LAGS)
    model = Autoregression.of_sums(*sums_of(error, known))
    white = model.whiten_known(error, known)
    for since in range(7):
        part = white[since::7]
        assert np.mean(part**2) == pytest.approx(1.0, abs=6.0 * np.sqrt(2.0 / part.size))
    whole = known >= model.order
    np.testing.assert_allclose(white[whole], model.whiten(np.append(np.zeros(model.order), error))[whole], atol=1e-9)


def exact_model(a: float) -> Autoregression:
    """Of e_k = a e_{k-1} + w_k with variance one of w, whose order 0 has the variance of e."""
    models, powers = np.zeros((LAGS + 1, LAGS + 1)), np.ones(LAGS + 1)
    models[:, 0], models[1:, 1], powers[0] = 1.0, -a, 1.0 / (1.0 - a * a)
    return Autoregression(np.array([1.0, -a]), 1.0, models, powers, np.zeros_like(models), 1.0)


@pytest.mark.parametrize("missing", [[4], [0, 1], [3, 4, 5, 9], [2, 11], [11]])
def test_where_samples_are_missing_the_likelihood_is_that_of_the_known_ones(missing: list[int]) -> None:
    """The sum of squares is e' C^-1 e of the known samples with their covariance C, whatever stands for the others."""
    a, samples = 0.8, 12
    rng = np.random.default_rng(1)
    signals, is_known = rng.standard_normal((samples, 3)), ~np.isin(np.arange(samples), missing)
    past = np.minimum(np.arange(samples), LAGS)
    model = exact_model(a)
    white = model.without_unknown(model.whiten_known(signals, past), past, np.array(missing))
    covariance = a ** np.abs(np.subtract.outer(np.arange(samples), np.arange(samples))) / (1.0 - a * a)
    known = signals[is_known]
    expected = known.T @ np.linalg.solve(covariance[np.ix_(is_known, is_known)], known)
    np.testing.assert_allclose(white.T @ white, expected, rtol=1e-12)


def test_channels_are_whitened_one_by_one() -> None:
    """And nothing before the first row is read, whatever is said to be known."""
    signals = np.random.default_rng(1).standard_normal((400, 3))
    model = Autoregression.of(coloured(SMOOTH, 4000))
    known = np.minimum(np.arange(400) % 50 + 2, LAGS)
    together = model.whiten_known(signals, known)
    for channel in range(3):
        np.testing.assert_array_equal(together[:, channel], model.whiten_known(signals[:, channel], known))
    assert model.whiten_known(signals[:, :0], known).shape == (400, 0)
    begin = model.whiten_known(signals, np.arange(400))
    np.testing.assert_array_equal(model.whiten_known(signals, known)[:2], begin[:2])


def test_a_white_residual_is_left_as_it_is() -> None:
    error = coloured([1.0], 5000, seed=3)
    model = Autoregression.of(error)
    assert model.whiten_known(error, np.zeros(5000, np.int64)) is error
    np.testing.assert_array_equal(model.whiten(error), error)


def test_colouring_undoes_whitening_and_never_runs_away() -> None:
    model = Autoregression.of(coloured(SMOOTH, 5000))
    signal = np.random.default_rng(1).standard_normal((5000, 2))
    np.testing.assert_allclose(model.whiten(model.colour(signal)), signal[model.order :], atol=1e-8)
    growing = dataclasses.replace(model, coefficients=np.poly([1.02, 0.5]))
    made = growing.colour(signal)
    assert np.abs(made).max() < 100.0 * np.abs(signal).max()
    w = np.exp(1j * np.linspace(0.1, 3.0, 20))
    impulse = np.zeros(5000)
    impulse[0] = 1.0
    spectrum = np.abs(growing.colour(impulse) @ w[None, :] ** -np.arange(5000.0)[:, None])
    np.testing.assert_allclose(spectrum, 1.0 / np.abs(np.polyval(growing.coefficients, w)), rtol=1e-6)


def test_few_samples_count_as_white() -> None:
    assert Autoregression.of(np.arange(10.0)).order == 0
    np.testing.assert_array_equal(one_step(np.arange(10.0)), np.arange(10.0))


def test_models_of_every_order_are_kept() -> None:
    found = Autoregression.of(coloured([1.0, -1.6, 0.9], 5000))
    np.testing.assert_array_equal(found.models[:, 0], np.ones(LAGS + 1))
    assert not np.triu(found.models, 1).any()  # row j holds a model of order j
    assert (np.diff(found.powers) <= 0.0).all()
    np.testing.assert_array_equal(found.models[found.order, : found.order + 1], found.coefficients)
    assert found.variances[found.order] == pytest.approx(found.power / found.count)


@every(
    ("error", "other", "sign"),
    [
        (1e160, 1.0, -1),
        (1e150, 1e-20, -1),
        (0.0, 1e140, 1),
        (1e-170, 1e-160, 1),
        (0.0, 0.0, 0),
        (math.inf, 1.0, -1),
        (1.0, math.nan, 1),
    ],
)
def test_a_likelihood_ratio_is_one_of_any_residuals(error: float, other: float, sign: int) -> None:
    white = np.random.default_rng(0).standard_normal(500)
    found = likelihood_ratio(error * white, other * white)
    assert np.sign(found) == sign
    if math.isfinite(error) and math.isfinite(other) and max(error, other) < 1e100:
        assert likelihood_ratio(1e20 * error * white, 1e20 * other * white) == pytest.approx(found)
