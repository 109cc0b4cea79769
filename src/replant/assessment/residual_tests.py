r"""Residual analysis: what a model leaves, and whether the input could still explain some of it.

The residual of a right model may have any colour, as that is the noise's, but it is independent of the input.  The
test regresses it on what an input does to an output that the model misses: the input at several delays, also before
its time; the states s^i/A u at several delays; powers of the simulated output.  Both sides are first filtered by the
autoregression that makes the residual white, so that the explained part, over the residual's variance, is
:math:`\chi^2` with as many degrees of freedom as there are independent columns.

Sources: Ljung (1999), "System Identification: Theory for the User", sections 16.5 and 16.6; Soderstrom and Stoica
(1989), "System Identification", chapter 11.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.assessment.model_run import ModelRun
from replant.assessment.sums import lengths_of, orthogonal, products, without
from replant.factors import larger
from replant.validation import FloatArray

FALSE_ALARM = 1e-4  # chance that a test finds something where there is nothing
INPUT_DELAYS = (0, 1, 2, 3, 5, 8, 13, -1, -2, -4)  # samples; below zero the input is yet to come
SLOW_DELAYS = (0.5, 1.0, 2.0)  # of the slowest time constant
STATE_DELAYS = (0, 1, 2, 4, 8, -2)  # in steps of FAST_STEP times the fastest time constant
FAST_STEP = 0.5
FARTHEST = 0.02  # of the record: longest step of a delay of the states
PER_COLUMN = 8  # samples that each column of the regression needs at the least
WHITENESS_LAGS = 25


def autoregression(error: FloatArray) -> FloatArray:
    """Return D(q), 1 first, of the autoregression D(q) e = w that makes the error white."""
    from replant.kernels import residuals

    lags = residuals.LAGS
    covariances = np.array([error[lag:] @ error[: error.size - lag] for lag in range(lags + 1)])
    model = np.empty(lags + 1)
    residuals.autoregression(covariances, model, np.empty(lags + 1))
    return model


def filtered(model: FloatArray, signals: FloatArray) -> FloatArray:
    """Return D(q) x along the first axis, without the samples where the filter still fills."""
    lags = model.size - 1
    result = model[0] * signals[lags:]
    for lag in range(1, lags + 1):
        result = result + model[lag] * signals[lags - lag : signals.shape[0] - lag]
    return np.asarray(result)


def whiteness(error: FloatArray) -> float:
    r"""Return the portmanteau statistic :math:`N \sum_\tau \hat r_e^2(\tau)` over its 99 % limit.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(2000)
    >>> whiteness(noise) < 1.0 < whiteness(noise[1:] + noise[:-1])
    True
    """
    from scipy.stats import chi2

    lags = min(WHITENESS_LAGS, error.size // 4)
    power = float(error @ error)
    if lags < 1 or not power > 0.0:
        return 0.0
    correlations = np.array([error[lag:] @ error[: error.size - lag] for lag in range(1, lags + 1)]) / power
    return float(error.size * (correlations @ correlations) / chi2.ppf(0.99, lags))


@dataclass(frozen=True)
class Unexplained:
    """What of a residual the input could still explain.

    Attributes
    ----------
    power : float
        Mean square of that part, what chance adds taken off; in the output's unit squared.
    share : float
        That part of the whitened residual.
    statistic : float
        The test's, over its limit: above 1 it is no chance.
    """

    power: float
    share: float
    statistic: float


def unexplained(run: ModelRun, rows: slice, dt: float, surplus: float = 0.0) -> Unexplained:
    """Return what of a run's residual over ``rows`` the input could still explain.

    ``surplus`` is how much larger the statistic is by the estimate's own error: rows over samples learned.
    """
    from scipy.stats import chi2

    columns = _columns(run, rows, dt)
    error, columns = run.error[rows] - run.error[rows].mean(), columns - columns.mean(axis=0)
    model = autoregression(error)
    e, z = filtered(model, error), filtered(model, columns)
    lengths = lengths_of(z)
    seen = lengths > 1e-9 * lengths_of(columns)
    # what the filter has not seen whole must not count afterwards either
    columns, z = columns[model.size - 1 :, seen] / lengths[seen], z[:, seen] / lengths[seen]
    total = float(e @ e)
    if not seen.any() or not total > 0.0:
        return Unexplained(0.0, 0.0, 0.0)
    basis = orthogonal(products(z, z))
    amounts = basis.T @ products(z, e[:, None])[:, 0]
    count, freedom = len(amounts), e.size - len(amounts)
    part = float(amounts @ amounts)
    variance = max(total - part, 0.0) / max(freedom, 1)
    # in the output: what the columns so weighted make, less what noise alone would give them
    gram = basis.T @ products(columns, columns) @ basis
    power = (float(amounts @ gram @ amounts) - variance * float(np.trace(gram))) / error.size
    limit = float(chi2.ppf(1.0 - FALSE_ALARM, count)) * (1.0 + surplus * run.zeta.shape[1] / count)
    statistic = part / variance / limit if variance > 0.0 else math.inf
    return Unexplained(max(power, 0.0), part / total, statistic)


def _columns(run: ModelRun, rows: slice, dt: float) -> FloatArray:
    """Return what the residual is regressed on, for ``rows``; fewer delays where the samples are few."""
    samples, n = len(run.error), run.structure.poles
    begin, end, _ = rows.indices(samples)
    index = np.arange(begin, end)
    u = run.u
    poles = np.roots(np.concatenate([[1.0], run.parameters[:n]]))
    slowest = 1.0 / max(float(np.abs(poles.real).min()), 1.0 / (samples * dt))
    fastest = max(float(np.abs(poles).max()), 1.0 / (samples * dt))
    step = min(max(1, round(FAST_STEP / fastest / dt)), max(1, int(FARTHEST * samples)))
    delays = [*INPUT_DELAYS, *(min(round(part * slowest / dt), samples // 4) for part in SLOW_DELAYS)]
    room = (end - begin) // PER_COLUMN - len(delays) - n - 2
    state_delays = STATE_DELAYS[: max(1, room // run.states.shape[1])]

    def delayed(signal: FloatArray, delay: int) -> FloatArray:
        return np.asarray(signal[np.clip(index - delay, 0, samples - 1)])

    output = run.forced[rows] - run.forced[rows].mean()
    parts = [
        np.column_stack([delayed(u, delay) for delay in dict.fromkeys(delays)]),
        *(delayed(run.states, delay * step) for delay in state_delays),
        run.zeta[rows, :n],
        np.column_stack([output**2, output**3]),
    ]
    return np.hstack(parts)


@dataclass(frozen=True)
class Distance:
    """How far an estimate lies from where a record would put it.

    Attributes
    ----------
    step : (n + m + 1,) array
        From the estimate to there, to first order.
    statistic : float
        Of the test whether that is chance, over its limit.
    covariance : (n + m + 1, n + m + 1) array
        Of an estimate from this record alone, the residual's colour taken into account.
    """

    step: FloatArray
    statistic: float
    covariance: FloatArray


def distance(run: ModelRun, rows: slice, false_alarm: float = FALSE_ALARM) -> Distance:
    """Return the Gauss-Newton step that a record asks of an estimate, and whether it is more than chance."""
    from scipy.signal import lfilter
    from scipy.stats import chi2

    nuisances = np.hstack([run.nuisances[rows], np.ones((len(run.error[rows]), 1))])
    zeta = without(run.zeta[rows], nuisances)
    error = without(run.error[rows, None], nuisances)[:, 0]
    lengths = lengths_of(zeta)
    zeta = zeta / lengths
    basis = orthogonal(products(zeta, zeta))
    inverse = basis @ basis.T
    step = inverse @ products(zeta, error[:, None])[:, 0]
    left = error - np.einsum("ij,j->i", zeta, step)
    model = autoregression(left)
    innovation = filtered(model, left)
    coloured = lfilter([1.0], model, zeta, axis=0)
    variance = float(innovation @ innovation) / max(innovation.size - len(step), 1)
    covariance = variance * inverse @ products(coloured, coloured) @ inverse
    covariance = larger(covariance, float(np.mean(left**2)) * inverse)
    known = np.linalg.pinv(covariance, rcond=1e-14, hermitian=True)
    statistic = float(step @ known @ step) / float(chi2.ppf(1.0 - false_alarm, len(step)))
    return Distance(step / lengths, statistic, covariance / np.outer(lengths, lengths))
