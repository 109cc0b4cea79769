"""Correlations of white residuals keep within their limits, and the excitation equals its definition."""

import numpy as np
import pytest
from scipy.signal import lfilter

from replant.numerics.residuals import BAND_95, correlation_lags, correlations
from replant.report.findings import excitation
from support.cases import every


def white(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def test_correlations_equal_their_definition() -> None:
    e, u = white(2, 50)
    found = correlations(e, u, lags=5)
    e, u = e - e.mean(), u - u.mean()
    for lag in range(6):
        auto = (e[: 50 - lag] * e[lag:]).sum() / (e**2).sum()
        later = (u[: 50 - lag] * e[lag:]).sum() / np.sqrt((e**2).sum() * (u**2).sum())
        earlier = (u[lag:] * e[: 50 - lag]).sum() / np.sqrt((e**2).sum() * (u**2).sum())
        assert (found.auto[lag], found.cross[5 + lag], found.cross[5 - lag]) == pytest.approx((auto, later, earlier))


def test_white_residuals_stay_within_the_limits() -> None:
    outside = np.array([correlations(*white(2, 2000, seed=seed), lags=40).outside for seed in range(60)])
    # 60 x 40 nearly independent lags, of which 5 % are outside: standard deviation 0.0044
    assert outside.mean(axis=0) == pytest.approx([0.05, 0.05], abs=0.018)


def test_limits_of_the_cross_correlation_allow_for_coloured_residuals() -> None:
    """Both coloured, and independent: limits of white noise would be broken by far more than 5 % of the lags."""
    beyond, naive = [], []
    for seed in range(60):
        e, u = lfilter([1.0], [1.0, -0.9], white(2, 4000, seed=seed))
        found = correlations(e, u, lags=60)
        beyond.append(found.outside[1])
        naive.append((np.abs(found.cross[60:]) > BAND_95 / np.sqrt(4000)).mean())
    assert np.mean(beyond) == pytest.approx(0.05, abs=0.04)
    assert np.mean(naive) > 0.3


def test_a_residual_that_follows_the_input_is_found_out() -> None:
    noise, u = white(2, 3000)
    late = np.concatenate([np.zeros(7), u[:-7]])
    found = correlations(noise + 0.3 * late, u, lags=20)
    assert found.cross.argmax() - 20 == 7
    assert found.cross.max() > 5 * BAND_95 * found.cross_std


@every(
    ("e", "u"),
    [
        (np.full(100, np.nan), white(100)),
        (white(5), white(5)),
        (np.zeros(100), white(100)),
        (white(100), np.ones(100)),
        (np.zeros(0), np.zeros(0)),
    ],
)
def test_a_constant_or_missing_signal_has_no_correlation(e: np.ndarray, u: np.ndarray) -> None:
    assert correlations(e, u, lags=10) is None


def test_correlations_do_not_overflow() -> None:
    e, u = white(2, 500)
    assert correlations(1e200 * e, 1e-200 * u, 10).cross == pytest.approx(correlations(e, u, 10).cross)


def test_lags_cover_five_time_constants_within_reason(plain) -> None:
    slowest = plain.result.transfer_function.modes[0].time_constant
    assert correlation_lags([slowest], 4000, 0.05) == int(np.ceil(5 * slowest / 0.05))
    assert correlation_lags([slowest], 40, 0.05) == 10


def test_excitation_is_that_of_the_scaled_information_matrix() -> None:
    phi = white(4000, 3) * [1.0, 1e6, 1e-6]
    found = excitation(phi)
    last = phi[found.samples[-1] - found.window : found.samples[-1]] / np.sqrt((phi**2).mean(axis=0))
    values = np.linalg.eigvalsh(last.T @ last / found.window)
    assert found.smallest[-1] == pytest.approx(values[0])
    assert found.condition[-1] == pytest.approx(np.linalg.cond(last))
    assert (found.smallest <= 1.2).all()


def test_excitation_tells_when_the_input_stood_still() -> None:
    phi = white(20_000, 2)
    phi[8000:12_000] = [1.0, 2.0]
    found = excitation(phi)
    still = (found.samples - found.window >= 8000) & (found.samples <= 12_000)
    moving = (found.samples <= 8000) | (found.samples - found.window >= 12_000)
    assert found.smallest[still].max() < 1e-12
    assert found.smallest[moving].min() > 0.3
    assert found.condition[still].min() > 1e6


def test_excitation_passes_over_rejected_rows() -> None:
    phi = white(4000, 2)
    holed = phi.copy()
    holed[::10] = np.nan
    assert excitation(holed).smallest == pytest.approx(excitation(phi).smallest, abs=0.4)
    assert excitation(np.full((100, 2), np.nan)) is None
    assert excitation(phi[:5]).samples.tolist() == [5]
