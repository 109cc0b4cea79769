r"""The noise model in the recursion: it filters regressor, instruments and target so that their residual is white.

The residual e = target - phi' theta is modelled as an autoregression,

.. math:: D(q)\, e_k = e_k + d_1 e_{k-1} + \ldots + d_p e_{k-p} = w_k,

and the estimator learns from the row g D(q) [phi, zeta, target], whose residual is g w.  Order p, at most LAGS, and
coefficients come from sums of e_{k-i} e_{k-j} over all samples learned; they are renewed with the auxiliary model.
If the residual is an error of the model, not noise, rows are not filtered, see
`replant.estimation.solver.specification_test`.

After a break (a lost sample, a gap, a bridged output) only j < p predecessors are known.  Then the best model of order
j filters, whose residual has the larger variance V_j.  The weight g^2 = gain V_0 / V_j compensates for it: the
likelihood of an autoregression with a missing past.  ``gain`` is V_p / V_0 of the model that the optimizer's covariance
was begun with, so that the covariance keeps its unit: the variance ``gain`` V_0 of g w.

Sources: Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8; Ljung (1999), "System Identification:
Theory for the User", sections 7.3 and 10.3.
"""

import math

from replant.kernels.filters.autoregressions import nested_models
from replant.kernels.native import inlined
from replant.kernels.schema import LAGS, Doubt

# beyond half an interval another sample is nearest in time
JITTER = 0.5  # difference from the sampling time beyond which an interval breaks the residual's past [sampling times]
# a coefficient of an autoregression then has a standard deviation of at most 1/sqrt(64), an eighth
ENOUGH = 64.0  # residuals needed to renew the noise model [samples]


def before(row):
    """Return the row of the ring written before this one."""
    return row - 1 if row > 0 else LAGS


@inlined
def earlier_rows(noise, row):
    """Return the four rows of the ring before this one, the newest first."""
    first = before(row)
    second = before(first)
    third = before(second)
    return noise.rows[first], noise.rows[second], noise.rows[third], noise.rows[before(third)]


@inlined
def white(row, earlier, d, i):
    """Return entry ``i`` of a row filtered by D(q); of ``d``, d_1 .. d_4, those beyond the order are zero."""
    return row[i] + d[0] * earlier[0][i] + d[1] * earlier[1][i] + d[2] * earlier[2][i] + d[3] * earlier[3][i]


def filter_row(T, noise, phi, zeta, target):
    """Store the newest row, and filter it in place; return the filtered target."""
    newest = int(noise.position) + 1
    if newest == LAGS + 1:
        newest = 0
    lags = min(int(noise.order), int(noise.known))
    noise.position = newest
    noise.known = min(noise.known + 1.0, float(LAGS + 1))
    row = noise.rows[newest]
    for i in range(T):
        row[i] = phi[i]
    for i in range(T):
        row[T + i] = zeta[i]
    row[2 * T] = target
    if noise.order == 0.0 or noise.filters == 0.0:
        return target
    weight = math.sqrt(noise.gain * noise.variances[0] / noise.variances[lags])
    model, earlier = noise.models[lags], earlier_rows(noise, newest)
    d = model[1], model[2], model[3], model[4]
    for i in range(T):
        phi[i] = weight * white(row, earlier, d, i)
    for i in range(T):
        zeta[i] = weight * white(row, earlier, d, T + i)
    return weight * white(row, earlier, d, 2 * T)


def gain(s):
    """Return the variance of the filtered residual over that of the residual; 1 without a noise model."""
    return s.noise.gain if s.has_noise_model else 1.0


def whiten(s, target, interval):
    """Filter regressor, instruments and target, unless the output was bridged; return the target."""
    noise = s.noise
    if abs(interval - s.interval) > JITTER * s.interval:
        noise.known = 0.0
    if s.doubt != Doubt.NONE:
        noise.known = 0.0
        return target
    return filter_row(s.entries, noise, s.phi, s.zeta, target)


def add_residuals(noise, newest, theta, errors, forgetting):
    """Add the products of the residuals of row ``newest`` and its LAGS predecessors; the numbers may be vectors."""
    T, size, at_row = theta.size, LAGS + 1, newest
    # all residuals with the same theta: its small moves would not be small beside the innovation of a smooth residual
    for lag in range(size):
        row = noise.rows[at_row]
        error = row[2 * T]
        for i in range(T):
            error -= theta[i] * row[i]
        errors[lag] = error
        at_row = before(at_row)
    noise.count = forgetting * noise.count + 1.0
    for i in range(size):
        for j in range(i + 1):
            noise.sums[i, j] = forgetting * noise.sums[i, j] + errors[i] * errors[j]


def record(s):
    """Add the newest residual, before its update, to the sums of the noise model, if its past is complete."""
    if s.noise.known > LAGS:
        add_residuals(s.noise, int(s.noise.position), s.theta, s.work, s.settings[0])


def renew(s):
    """Renew the models of all orders, and the order in use, if there are enough residuals."""
    noise = s.noise
    noise.known = 0.0  # earlier rows came from another filter
    if noise.count >= ENOUGH:
        noise.order = nested_models(noise.sums, noise.count, noise.models, noise.variances, s.work)
