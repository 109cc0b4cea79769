"""The score test by the likelihood of the samples that are known, whatever those in between are."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.schema import LAGS
from replant.numerics.autoregression import Autoregression, in_a_row
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import chi2_quantile
from replant.numerics.score_test import Residual

SAMPLES, PHI = 120, 0.99


def test_of_a_record_with_holes_it_is_that_of_generalised_least_squares() -> None:
    """Noise that is slow beside the holes: by a shorter past the samples behind them would count as independent."""
    rng = np.random.default_rng(4)
    lags = np.arange(LAGS + 1)
    noise = Autoregression.of_sums(1e4 * PHI ** np.abs(lags[:, None] - lags), 1e4)
    assert noise.order == 1
    used = rng.random(SAMPLES) > 0.3
    covariance = PHI ** np.abs(np.subtract.outer(np.arange(SAMPLES), np.arange(SAMPLES)))
    error = np.linalg.cholesky(covariance) @ rng.standard_normal(SAMPLES)
    error -= error[used].mean()
    error[~used] = 7.0  # whatever it is
    t = np.linspace(-1.0, 1.0, SAMPLES)
    known, columns = np.column_stack([t]), np.column_stack([t**2, np.sin(20.0 * t)])
    past, unbroken = np.minimum(in_a_row(used), LAGS), np.minimum(np.arange(SAMPLES), LAGS)
    found = Residual.of(error, known, past, used, noise, unbroken).explained(columns)

    half = np.linalg.cholesky(covariance[np.ix_(used, used)])
    nuisances = np.linalg.solve(half, np.column_stack([known, np.ones(SAMPLES)])[used])
    signals = np.linalg.solve(half, np.column_stack([columns, error])[used])
    signals -= nuisances @ np.linalg.lstsq(nuisances, signals, rcond=None)[0]
    weights, left = np.linalg.lstsq(signals[:, :2], signals[:, 2], rcond=None)[:2]
    variance = left[0] / (used.sum() - 4)
    explained = np.sum(signals[:, 2] ** 2) - left[0]
    np.testing.assert_allclose(found.weights, weights, rtol=1e-6)
    assert found.statistic == pytest.approx(explained / variance / chi2_quantile(1.0 - ALPHA, 2), rel=1e-6)


def test_the_error_of_a_model_of_other_samples_is_counted_as_noise_is() -> None:
    """The statistic is that of generalised least squares, with the covariance of noise and model together."""
    rng = np.random.default_rng(5)
    own, half = np.array([[2.0, -0.5], [-0.5, 1.0]]), 0.1
    slopes = rng.standard_normal((SAMPLES, 2))
    columns = slopes + 0.5 * rng.standard_normal((SAMPLES, 2))
    error = half * rng.standard_normal(SAMPLES) + slopes @ [0.3, 0.7]
    white, past = Autoregression.white(half**2 * SAMPLES, SAMPLES), np.zeros(SAMPLES, np.int64)
    residual = Residual.of(error, np.zeros((SAMPLES, 0)), past, slice(None), white)
    found = residual.explained(columns, own=(slopes, own))

    columns, slopes, error = (each - each.mean(axis=0) for each in (columns, slopes, error))
    basis = np.linalg.qr(columns)[0]
    amounts = basis.T @ error
    variance = np.sum((error - basis @ amounts) ** 2) / (SAMPLES - 3)
    limit, along = chi2_quantile(1.0 - ALPHA, 2), basis.T @ slopes
    exactly, spread = amounts @ amounts / variance / limit, variance * np.eye(2) + along @ own @ along.T
    assert found.exactly == pytest.approx(exactly, rel=1e-6)
    assert found.statistic == pytest.approx(amounts @ np.linalg.solve(spread, amounts) / limit, rel=1e-6)
    assert found.exactly > 1.0 > found.statistic
    assert residual.explained(columns).statistic == pytest.approx(found.exactly)
