"""The noise model of a fit's residual: what the fit has explained of the noise is given back."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from replant.numerics.autoregression import Autoregression, in_a_row
from replant.numerics.projections import Fitted, noise_of_fit

SAMPLES, POLE, RECORDS = 150, 0.9, 120
KNOWN = in_a_row(np.ones(SAMPLES, bool))
PHASE = np.arange(SAMPLES) / SAMPLES
#: An offset, a line and slow waves, as a slow plant's slopes are.
SLOPES = np.column_stack([np.ones(SAMPLES), PHASE, np.sin(2.0 * np.pi * PHASE), np.cos(2.0 * np.pi * PHASE)])


def residual(seed: int) -> np.ndarray:
    """Noise of unit variance without what the generalised least squares with the true noise model explain of it."""
    white = np.random.default_rng([51, seed]).normal(size=SAMPLES)
    noise = lfilter([np.sqrt(1.0 - POLE**2)], [1.0, -POLE], white, zi=[POLE * np.random.default_rng(seed).normal()])[0]
    columns = np.column_stack([noise, SLOPES])
    ahead = columns[1:] - POLE * columns[:-1]
    ahead = np.vstack([columns[:1] * np.sqrt(1.0 - POLE**2), ahead])
    return noise - SLOPES @ np.linalg.lstsq(ahead[:, 1:], ahead[:, 0], rcond=None)[0]


def found_by(error: np.ndarray, slopes: np.ndarray = SLOPES, own: int = 0) -> Autoregression:
    """The noise model if the first slopes are of the stretch alone."""
    return noise_of_fit([Fitted(error, slopes[:, own:], slopes[:, :own], KNOWN)], SAMPLES)


def test_noise_that_a_fit_has_explained_is_given_back() -> None:
    """At least half of the power that is missing, a third of slow noise, in the mean of 120 records."""
    powers = np.empty((RECORDS, 2))
    for seed in range(RECORDS):
        error = residual(seed)
        models = Autoregression.of_residual(error, KNOWN, SAMPLES), found_by(error)
        powers[seed] = [each.sums[0, 0] / each.count for each in models]
    (before, after), scatter = powers.mean(axis=0), powers.std(axis=0) / np.sqrt(RECORDS)
    assert before < 1.0 - 4.0 * scatter[0]
    assert 1.0 - after < 0.5 * (1.0 - before)


def test_of_white_noise_little_is_given_back() -> None:
    """Each of four columns explains as much as one of 150 samples."""
    error = np.random.default_rng(10).normal(size=SAMPLES)
    error -= SLOPES @ np.linalg.lstsq(SLOPES, error, rcond=None)[0]
    raw, found = Autoregression.of_residual(error, KNOWN, SAMPLES), found_by(error)
    assert found.order == 0
    np.testing.assert_allclose(found.power / raw.power, 1.0 + 4.0 / SAMPLES, rtol=0.01)


def test_the_units_of_the_columns_do_not_matter() -> None:
    error, units = residual(3), np.array([1e-9, 1.0, 1e9, 1e3])
    found, same = (found_by(error, columns) for columns in (SLOPES, SLOPES * units))
    np.testing.assert_allclose(found.coefficients, same.coefficients, rtol=1e-9)


def test_columns_of_the_only_stretch_are_those_of_the_model() -> None:
    error = residual(4)
    np.testing.assert_allclose(found_by(error).coefficients, found_by(error, own=2).coefficients, rtol=1e-9)


def test_the_model_of_two_stretches_is_fitted_to_both() -> None:
    """Twice the same stretch, with twice the samples: the common slopes explain half as much of each."""
    error = residual(5)
    one = Fitted(error, SLOPES[:, 2:], SLOPES[:, :2], KNOWN)
    both, alone = noise_of_fit([one, one], 2 * SAMPLES), noise_of_fit([one], SAMPLES)
    raw = Autoregression.of_residual(error, KNOWN, SAMPLES).sums[0, 0]
    assert raw < 0.5 * both.sums[0, 0] < alone.sums[0, 0]
