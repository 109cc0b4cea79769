r"""Autoregressions of a residual: their fit, of every order, and their filters, of series and sample by sample.

G[i, j] is the sum of e_{k-i} e_{k-j} over the samples whose predecessors are all known.  The model of order j minimises
the sum of (e_k + d_1 e_{k-1} + .. + d_j e_{k-j})^2: G[1:j+1, 1:j+1] d = -G[1:j+1, 0].  One factorisation L D L' of
G[1:, 1:] gives all orders, as its leading parts are the factors of the smaller ones.

Autocovariances need fewer numbers, but the ends of their window leak: for a smooth residual, such as that of a
disturbance at the plant's input, the variance of their innovation is 40 to 400 times too large.

A sample with j < p known predecessors is whitened by the model of order j, whose residual has the larger variance V_j,
and weighted by the root of V_p / V_j: the likelihood of an autoregression with a missing past.

The all-pole filter turns white noise into an autoregression; the play operator models a part with backlash.

In the recursion the residual e = target - phi' theta is modelled as D(q) e = w, and the estimator learns from the row
g D(q) [phi, zeta, target], whose residual is g w.  Order p, at most LAGS, and coefficients come from sums over all
samples learned; they are renewed with the auxiliary model.  If the residual is an error of the model, not noise, rows
are not filtered, see `replant.estimation.solver.specification_test`.  After a break (a lost sample, a gap, a bridged
output) the weight is g^2 = gain V_0 / V_j: ``gain`` is V_p / V_0 of the model that the optimizer's covariance was begun
with, so that the covariance keeps its unit, the variance ``gain`` V_0 of g w.

Sources: Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8; Ljung (1999), "System Identification:
Theory for the User", sections 7.3, 10.1, 10.3 and 16.4; Brokate and Sprekels (1996), "Hysteresis and Phase
Transitions", chapter 2.
"""

import math

import numpy as np

from replant.kernels.native import Ints, Matrix, Reals, inlined, kernel
from replant.kernels.schema import LAGS, Doubt

# some hundred times the precision of float64
ROUNDING = 1e-13  # remainder of a sum after elimination below which it is rounding [part of the sum]

LEAST = 1e-300  # least power, so that variances stay positive and have a logarithm [output's unit squared]


@kernel(
    "variances.size >= 1 and sums.shape[0] >= variances.size and sums.shape[1] >= variances.size",
    "models.shape[0] >= variances.size and models.shape[1] >= variances.size",
    "work.size >= variances.size * variances.size + variances.size",
)
def nested_models(sums: Matrix, count: float, models: Matrix, variances: Reals, work: Reals):
    """Fill models of orders 0 .. P - 1 and the variances (P,) of their residuals; return the order of least BIC.

    ``sums`` (P, P): the lower triangle of G, over ``count`` samples; ``models`` (P, P): row j is 1, d_1 .. d_j, 0 ..;
    ``work`` holds P P + P numbers.
    """
    P = variances.size
    top = P - 1
    at_scaled = P * P  # forward solution, scaled by the pivots
    least = max(ROUNDING * sums[0, 0], LEAST)
    power = max(sums[0, 0], least)
    for i in range(P):
        for j in range(P):
            models[i, j] = 0.0
    usable = True
    best, lowest = 0, math.inf
    for order in range(P):
        if order > 0:
            i = order - 1  # its row in the factors
            for j in range(i + 1):
                total = sums[order, j + 1]
                for k in range(j):
                    total -= work[i * top + k] * work[j * top + k] * work[k * top + k]
                if j < i:
                    work[i * top + j] = total / work[j * top + j]
                else:
                    work[i * top + i] = total
            pivot = work[i * top + i]
            usable = usable and pivot > ROUNDING * sums[order, order] and pivot > 0.0
            if usable:
                total = -sums[order, 0]
                for k in range(i):
                    total -= work[i * top + k] * work[k * top + k] * work[at_scaled + k]
                work[at_scaled + i] = total / pivot
                power = max(power - total / pivot * total, least)  # total^2 may overflow
                for j in range(i, -1, -1):
                    solution = work[at_scaled + j]
                    for k in range(j + 1, order):
                        solution -= work[k * top + j] * models[order, k + 1]
                    models[order, j + 1] = solution
            else:  # the remainder is rounding: keep the smaller order
                for j in range(P):
                    models[order, j] = models[order - 1, j]
                work[i * top + i] = 1.0
        models[order, 0] = 1.0
        variances[order] = power / max(count, 1.0)
        criterion = count * math.log(power) + order * math.log(max(count, 1.0))
        if criterion < lowest:
            best, lowest = order, criterion
    return best


@kernel(
    "models.shape[0] >= weights.size and models.shape[1] >= weights.size and weights.size >= 1",
    "channels >= 0 and channels <= signals.size and signals.size >= known.size * channels",
    "result.size >= known.size * channels",
)
def whiten_known(models: Matrix, weights: Reals, signals: Reals, channels: int, known: Ints, result: Reals):
    """Write ``signals`` (K, channels), each row filtered by the model of order ``known`` (K,), its known predecessors.

    ``models``: row j is 1, d_1 .. d_j, up to order p; ``weights`` (p + 1,): factors of the rows filtered by each order.
    """
    order = weights.size - 1
    for i in range(known.size * channels):
        result[i] = signals[i]
    for lag in range(1, order + 1):
        coefficient, back = models[order, lag], lag * channels
        for i in range(back, known.size * channels):
            result[i] += coefficient * signals[i - back]
    for k in range(known.size):
        lags = max(min(known[k], k), 0)
        if lags < order:
            for i in range(k * channels, (k + 1) * channels):
                white = signals[i]
                for lag in range(1, lags + 1):
                    white += models[lags, lag] * signals[i - lag * channels]
                result[i] = white * weights[lags]


@kernel(
    "coefficients.size >= 1 and state.size >= coefficients.size",
    "result.shape[0] >= signals.shape[0] and result.shape[1] == signals.shape[1]",
)
def fill_all_pole(coefficients: Reals, signals: Matrix, result: Matrix, state: Reals):
    """Write the result of `all_pole` into ``result``; ``state`` (p + 1,) is work."""
    order = coefficients.size - 1
    for channel in range(signals.shape[0]):
        for i in range(order + 1):
            state[i] = 0.0
        for k in range(signals.shape[1]):
            output = signals[channel, k] + state[0]
            for i in range(order):
                state[i] = state[i + 1] - coefficients[i + 1] * output
            result[channel, k] = output


def all_pole(coefficients: Reals, signals: Matrix) -> Matrix:
    """Return x / D(q) of ``signals`` (channels, K), from rest: y(k) = x(k) - d_1 y(k-1) - ... - d_p y(k-p).

    ``coefficients`` (p + 1,) are 1, d_1 .. d_p.  The filter is in transposed direct form II.
    """
    signals = np.ascontiguousarray(signals, float)
    result = np.empty(signals.shape)
    fill_all_pole(np.ascontiguousarray(coefficients, float), signals, result, np.empty(coefficients.size))
    return result


@kernel("output.size >= v.size")
def fill_play(v: Reals, width: float, output: Reals):
    """Write the result of `play` into ``output`` (K,)."""
    held = 0.0
    for k in range(v.size):
        held = min(max(held, v[k] - width), v[k] + width)
        output[k] = held


def play(v: Reals, width: float) -> Reals:
    """Return the output (K,) of a play operator of half ``width``: it moves only when the signal (K,) pushes it.

    y(k) = min(max(y(k-1), v(k) - width), v(k) + width), from y = 0 before the record; in the unit of v.
    """
    v = np.ascontiguousarray(v, float)
    output = np.empty(v.size)
    fill_play(v, width, output)
    return output


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
