r"""The noise model in the recursion: regressor, instruments and target are filtered until their residual is white.

The residual e = target - phi' theta is modelled as an autoregression,

.. math:: D(q)\, e_k = e_k + d_1 e_{k-1} + \ldots + d_p e_{k-p} = w_k,

and the estimator learns from the row g D(q) [phi, zeta, target], whose residual is g w.  Its order p, at most LAGS, and
its coefficients come from sums of e_{k-i} e_{k-j} over all samples learned; they are renewed with the auxiliary model.
Where the residual is no noise but an error of the model, rows are not filtered, see
`replant.offline.specification_test`.

Where the past is broken (an interval that is irregular, a gap, an output that was bridged) only j < p predecessors are
known.  The best model of order j filters then, whose residual has the larger variance V_j.  The weight
g^2 = gain V_0 / V_j makes up for it: it is the likelihood of an autoregression with a missing past.  ``gain`` is
V_p / V_0 of the model that the optimizer's covariance was begun with, so that this stays in one unit: the variance
``gain`` V_0 of g w.

Sources: Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8; Ljung (1999), "System Identification:
Theory for the User", sections 7.3 and 10.3.
"""

import math

from replant.kernels import schema as at
from replant.kernels.filters.autoregression import nested_models
from replant.kernels.schema import FIXED, LAGS, Doubt, NoiseSlots

ORDER, FILTERS, GAIN, COUNT = (
    slot.index for slot in (NoiseSlots.order, NoiseSlots.filters, NoiseSlots.gain, NoiseSlots.count)
)
KNOWN, POSITION = NoiseSlots.known.index, NoiseSlots.position.index
_BEGINS = NoiseSlots.begins(FIXED | {"T": 0})  # what depends on T comes last
MODELS, VARIANCES, SUMS, ROWS = (_BEGINS[name] for name in ("models", "variances", "sums", "rows"))

IRREGULAR = 0.1
"""Difference from the sampling time beyond which an interval breaks the residual's past [sampling times].
Derivation: the autocorrelation of a residual that an autoregression can whiten changes little within a tenth of a step.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ENOUGH = 64.0
"""Residuals from which on the noise model is renewed [samples].
Derivation: a coefficient of an autoregression has a standard deviation of at most 1/sqrt(64), an eighth.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def before(row):
    """Return the row of the ring that was written before this one."""
    return row - 1 if row > 0 else LAGS


def filter_row(T, noise, phi, zeta, target):
    """Keep the newest row, and filter it in place; return the filtered target.

    Coefficients beyond the order are zero, so that all four earlier rows can be read at once.
    """
    width, size = 2 * T + 1, LAGS + 1
    newest = int(noise[POSITION]) + 1
    if newest == size:
        newest = 0
    lags = min(int(noise[ORDER]), int(noise[KNOWN]))
    noise[POSITION] = newest
    noise[KNOWN] = min(noise[KNOWN] + 1.0, float(size))
    row = noise[ROWS + newest * width :]
    for i in range(T):
        row[i] = phi[i]
    for i in range(T):
        row[T + i] = zeta[i]
    row[2 * T] = target
    if noise[ORDER] == 0.0 or noise[FILTERS] == 0.0:
        return target
    weight = math.sqrt(noise[GAIN] * noise[VARIANCES] / noise[VARIANCES + lags])
    model = MODELS + size * lags
    d_1, d_2, d_3, d_4 = noise[model + 1], noise[model + 2], noise[model + 3], noise[model + 4]
    first = before(newest)
    second = before(first)
    third = before(second)
    row_1, row_2 = noise[ROWS + first * width :], noise[ROWS + second * width :]
    row_3, row_4 = noise[ROWS + third * width :], noise[ROWS + before(third) * width :]
    for i in range(T):
        phi[i] = weight * (row[i] + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i])
    for i in range(T, 2 * T):
        zeta[i - T] = weight * (row[i] + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i])
    i = 2 * T
    return weight * (target + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i])


def gain(ints, reals):
    """Return the residual's variance in the unit of the optimizer's covariance, over that of the filtered residual."""
    return reals[ints[at.AT_NOISE] + GAIN] if ints[at.HAS_NOISE_MODEL] == 1 else 1.0


def whiten(ints, reals, target, interval):
    """Filter the regressor, the instruments and the target of the newest sample; return the target.

    Those of an output that was bridged stay as they are: they are not learned, and break the past of later ones.
    """
    noise = reals[ints[at.AT_NOISE] :]
    if abs(interval - reals[at.INTERVAL]) > IRREGULAR * reals[at.INTERVAL]:
        noise[KNOWN] = 0.0
    if ints[at.DOUBT] != Doubt.NONE:
        noise[KNOWN] = 0.0
        return target
    T = ints[at.ENTRIES]
    return filter_row(T, noise, reals[ints[at.AT_PHI] :], reals[ints[at.AT_ZETA] :], target)


def add_residuals(T, noise, theta, errors, forgetting):
    """Add the products of the newest residual and its LAGS predecessors to the sums, where these are known.

    All residuals are those of ``theta``: the estimate moves from sample to sample, by little beside the residual, but
    not beside what is left of a smooth one once it is filtered.  ``errors`` (LAGS + 1,) is work.
    """
    size, width, at_row = LAGS + 1, 2 * T + 1, int(noise[POSITION])
    if noise[KNOWN] < size:
        return
    for lag in range(size):
        row = noise[ROWS + at_row * width :]
        error = row[2 * T]
        for i in range(T):
            error -= theta[i] * row[i]
        errors[lag] = error
        at_row = before(at_row)
    noise[COUNT] = forgetting * noise[COUNT] + 1.0
    for i in range(size):
        sums = noise[SUMS + size * i :]
        for j in range(i + 1):
            sums[j] = forgetting * sums[j] + errors[i] * errors[j]


def record(ints, reals):
    """Take the newest sample's residual, before its update, into the sums that the noise model is made from."""
    noise, theta = reals[ints[at.AT_NOISE] :], reals[ints[at.AT_THETA] :]
    work = reals[ints[at.AT_WORK] :]
    add_residuals(ints[at.ENTRIES], noise, theta, work, reals[ints[at.AT_SETTINGS]])


def renew(ints, reals):
    """Renew the models of all orders, and the order in use, from the sums, where they are of enough residuals.

    The auxiliary model has just been renewed.
    """
    begin, size = ints[at.AT_NOISE], LAGS + 1
    noise = reals[begin:]
    noise[KNOWN] = 0.0  # the rows so far came from another filter
    if noise[COUNT] >= ENOUGH:
        noise[ORDER] = nested_models(
            noise[SUMS : SUMS + size * size],
            noise[COUNT],
            noise[MODELS : MODELS + size * size],
            noise[VARIANCES : VARIANCES + size],
            reals[ints[at.AT_WORK] :],
        )
