"""Autoregressions of every order from sums of products, beside plain least squares on the record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from replant.kernels.filters.autoregressions import nested_models
from replant.kernels.schema import LAGS
from replant.numerics import autoregression as numerics
from replant.numerics.autoregression import Autoregression
from support.cases import every

ORDERS = 5


def sums_of(errors: np.ndarray) -> np.ndarray:
    """G over the samples whose predecessors are all known, its upper triangle left empty."""
    rows = np.column_stack([errors[ORDERS - 1 - lag : errors.size - lag] for lag in range(ORDERS)])
    return np.tril(rows.T @ rows)


def models_of(errors: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    models, variances = np.full((ORDERS, ORDERS), np.nan), np.full(ORDERS, np.nan)
    count = float(errors.size - ORDERS + 1)
    order = nested_models(sums_of(errors), count, models, variances, np.empty(ORDERS**2 + ORDERS))
    return order, models, variances


COLOURS = {0: [1.0], 1: [1.0, -0.9], 2: [1.0, -1.6, 0.9], 3: [1.0, -2.7, 2.43, -0.729]}


@every("order", COLOURS)
def test_each_order_is_the_least_squares_model_of_the_record(order: int) -> None:
    errors = lfilter([1.0], COLOURS[order], np.random.default_rng(order).standard_normal(4000))
    _, models, variances = models_of(errors)
    for j in range(ORDERS):
        past = np.column_stack([errors[ORDERS - 1 - lag : errors.size - lag] for lag in range(1, j + 1)] or [[]])
        now = errors[ORDERS - 1 :]
        d = np.linalg.lstsq(past, -now, rcond=None)[0] if j else np.zeros(0)
        np.testing.assert_allclose(models[j], np.concatenate([[1.0], d, np.zeros(ORDERS - 1 - j)]), atol=1e-6)
        left = now + (past @ d if j else 0.0)
        assert variances[j] == pytest.approx(left @ left / now.size, rel=1e-6)


@every("order", COLOURS)
def test_the_order_is_found(order: int) -> None:
    """BIC takes too large an order with a chance of about P(chi2_1 > ln 4000) = 0.4 % each: of 50 records few do."""
    found = []
    for seed in range(50):
        errors = lfilter([1.0], COLOURS[order], np.random.default_rng([order, seed]).standard_normal(4000))
        found.append(models_of(errors)[0])
    assert min(found) == order
    assert sum(one > order for one in found) <= 4


@every("errors", [np.zeros(100), np.ones(100), np.arange(100.0), 0.5 ** np.arange(100.0)], ids=range(4))
def test_a_record_that_is_predicted_exactly(errors: np.ndarray) -> None:
    """Larger orders than the one that leaves nothing are no better, and every number stays finite."""
    order, models, variances = models_of(errors)
    assert np.isfinite(models).all()
    assert (variances > 0.0).all()
    assert (np.diff(variances) <= 0.0).all()
    past = np.column_stack([errors[ORDERS - 1 - lag : errors.size - lag] for lag in range(ORDERS)])
    assert np.abs(past @ models[order]).max() <= 1e-6 * max(np.abs(errors).max(), 1e-300)


@every("power", [-1000, -520, -300, 300, 500])
def test_the_model_does_not_depend_on_the_unit(power: int) -> None:
    """Of squares that float64 has, and of those that it has not a fourth power of."""
    error = lfilter([1.0], [1.0, -0.9], np.random.default_rng(0).standard_normal(3000))
    known = np.minimum(np.arange(error.size), LAGS)
    sums, count = numerics.sums_of(error, known)
    found, scaled = (Autoregression.of_sums(each, count) for each in (sums, sums * 2.0**power))
    assert found.order == 1
    assert (scaled.coefficients == found.coefficients).all()
