"""Power and colour of the residual: Levinson against the normal equations, sums against whole records."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from replant.kernels.monitoring.scatter import LAGS, autoregression, record
from replant.kernels.schema import FIXED, ColourSlots
from support.cases import every


def covariances_of(errors: np.ndarray) -> np.ndarray:
    return np.array([errors[lag:] @ errors[: errors.size - lag] for lag in range(LAGS + 1)])


@every("colour", [[1.0], [1.0, -0.9], [1.0, 0.5, 0.3], [1.0, -1.6, 0.9]], ids=repr)
def test_the_autoregression_solves_yule_and_walkers_equations(colour: list[float]) -> None:
    """For any record: Toeplitz c d = -c, and the innovation's power is c' [1, d], below that of the signal."""
    errors = lfilter([1.0], colour, np.random.default_rng(0).standard_normal(5000))
    covariances, model = covariances_of(errors), np.empty(LAGS + 1)
    power = autoregression(covariances, model, np.empty(LAGS + 1))
    expected = solve_toeplitz(covariances[:LAGS], -covariances[1:])
    np.testing.assert_allclose(model, [1.0, *expected], rtol=1e-9, atol=1e-12)
    assert power == pytest.approx(covariances @ model, rel=1e-9)
    assert 0 < power <= covariances[0]
    assert np.abs(np.roots(model)).max() < 1.0
    # and recovers the colour: standard errors of an AR estimate of N samples are below 1/sqrt(N) = 0.014
    np.testing.assert_allclose(model[: len(colour)], colour, atol=0.07)
    assert power / errors.size == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("covariances", [np.zeros(LAGS + 1), np.array([1.0, 1.0, 1.0, 1.0, 1.0])], ids=["none", "one"])
def test_a_residual_without_innovation(covariances: np.ndarray) -> None:
    model = np.empty(LAGS + 1)
    assert autoregression(covariances, model, np.empty(LAGS + 1)) == 0.0
    assert np.isfinite(model).all()


@pytest.mark.parametrize("forgetting", [1.0, 0.99])
def test_the_sums_are_those_of_the_record(forgetting: float) -> None:
    """Sample by sample equals all at once: autocovariances, power, and the filtered regressors' products."""
    T, samples = 3, 400
    generator = np.random.default_rng(1)
    errors, zeta, alphas = generator.standard_normal(samples), generator.standard_normal((samples, T)), 1.5
    colour = ColourSlots.zeros(FIXED | {"T": T})
    colour.model[:] = model = np.array([1.0, -0.7, 0.2, 0.1, -0.05])
    for k in range(samples):
        record(colour.fields, errors[k], alphas, forgetting, zeta[k].copy())
    weight = forgetting ** np.arange(samples)[::-1]
    assert colour.count == pytest.approx(weight.sum(), rel=1e-12)
    assert colour.power == pytest.approx((weight * errors**2).sum() * forgetting / alphas, rel=1e-12)
    lagged = [weight[lag:] * errors[lag:] @ errors[: samples - lag] for lag in range(LAGS + 1)]
    np.testing.assert_allclose(colour.covariances, lagged, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(colour.errors, errors[-LAGS:][::-1])
    filtered = lfilter([1.0], model, zeta, axis=0)
    squares = (weight**2 * filtered.T) @ filtered
    np.testing.assert_allclose(colour.squares, squares, rtol=1e-10)
