r"""A row of transfer functions, sample by sample: the outputs of its branches, and the joint update with fixed filters.

The output of a model alone or of one branch, and its derivatives with respect to the parameters, come from the input.
With x = B/A u + the response to an initial state, the derivatives are

.. math::
    -\frac{s^k}{A} x, \qquad \frac{s^k}{A} u, \qquad \text{and the responses to each state.}

`stages.regressors` gives the same to the bit, in twice the time: it filters a measured output, too.

The filters are made of a model theta_0.  Near it the error of a row is linear in delta = theta - theta_0,
e = e_0 - phi' delta + noise.  With D(q) (noise) = w white,

.. math:: \delta \leftarrow \delta + \frac{P\,\psi}{1 + \psi' P\,\psi} (D e_0 - \psi' \delta), \quad \psi = D \varphi,

which is recursive least squares; offset and initial states are entries of delta.  An innovation is clipped at
`OUTLYING` standard deviations, which bounds the effect of a wild output.  After a break only j < p predecessors are
known: the best model of order j filters, weighted by the root of V_p / V_j.

Page's test detects a larger variance of the innovations: the sum of log-likelihood ratios of twice the variance, less
its least value so far.  By chance it exceeds h at most n exp(-h) times within n samples.

In feedback P and the gain are made of instruments zeta, whitened in the same way, in place of phi.  zeta is the part of
phi that comes from outside the loop, and the rest of phi is independent of it: zeta phi' and zeta zeta' have the same
mean.

Sources: Ljung (1999), "System Identification: Theory for the User", sections 7.3 and 11.2; Page (1954), "Continuous
inspection schemes", Biometrika 41.
"""

import math

import numpy as np

from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.native import LAID_OUT, Ints, Matrix, Reals, kernel
from replant.kernels.optimizers.covariance import measurement_update, variance_along
from replant.kernels.schema import LAGS, OUTLYING, StateSlots
from replant.kernels.step.stages import acceptable


def respond(s, u, interval, constant, row):
    """Pass an input through dead time and model; fill the row (T,), with a constant if asked; return the output."""
    n, T, bank, work = s.order, s.entries, s.banks[s.serving_bank], s.work
    first = chain.filters_begin(s, u, 0.0, interval)
    slot = 0
    if not first:
        slot = bk.discretization(bank, n, T, interval, work)
        s.input_now = chain.advance_input(s, bank, interval, slot, work, bk.INPUT)
        # again: the discretisations of the pieces may have replaced that of the whole interval
        slot = bk.discretization(bank, n, T, interval, work)
        bk.advance_channel(bank, n, T, bk.IMPULSE, slot, 0.0, 0.0, work)
        if constant:
            bk.advance_channel(bank, n, T, bk.CONSTANT, slot, 1.0, 1.0, work)
    output = bk.fill_known_entries(s, bank, bk.INPUT, s.input_now, constant, False, row)
    if not first:
        bk.advance_channel(bank, n, T, bk.MODEL, slot, bank[bk.INSTRUMENT], output, work)
    bank[bk.INSTRUMENT] = bank[bk.MODEL_OUTPUT] = output
    bk.fill_output_entries(bank, n, T, bk.MODEL, output, row)
    if s.unknown_input > 0.0:  # the delayed input is unknown: the sample carries no information
        for i in range(T):
            row[i] = 0.0
    return output


@kernel(
    LAID_OUT, "s.refined and s.instruments and not s.has_reference and not s.bilinear",
    "intervals.size == 1 or intervals.size >= u.size",
    "output.size >= u.size and rows.shape[0] >= u.size and rows.shape[1] >= s.entries",
)  # fmt: skip
def branch(s: StateSlots, u: Reals, intervals: Reals, constant: bool, rows: Matrix, output: Reals):
    """Run a model over inputs (K,), from where its last run ended.

    ``intervals`` are (K,) or (1,) in s.  Writes ``rows`` (K, T or more), in the order of the model's entries, and
    ``output`` (K,).  The entry of the constant is zero unless asked for.  Both are NaN where an input is not finite or
    too large.
    """
    T, bank = s.entries, s.banks[s.serving_bank]
    for k in range(u.size):
        interval = intervals[0] if intervals.size == 1 else intervals[k]
        if not acceptable(s, u[k], 0.0):
            output[k] = np.nan
            for i in range(T):
                rows[k, i] = np.nan
        elif bank[bk.REFLECTED] == 1.0:  # an unstable model predicts from the measured output, here zero
            chain.observe(s, u[k], 0.0, interval)
            output[k] = bank[bk.MODEL_OUTPUT]
            for i in range(T):
                rows[k, i] = s.zeta[i]
        else:
            rows[k, s.order + s.input_entries] = 0.0
            output[k] = respond(s, u[k], interval, constant, rows[k])


# places in ``counts``: known predecessors of the next sample; samples learned; updates refused; samples since Page's
# sum was last zero
KNOWN, LEARNED, REFUSED, RISING = range(4)
# places in ``squares``: sum of the squares of the normalised innovations; Page's sum; usual variance of the
# innovations, used if it exceeds their mean
POWER, PAGE, USUAL = range(3)

# so that a few wild outputs raise no alarm
WILD = 9.0  # largest square of a normalised innovation in Page's sum [variances]
# 50 ordinary samples reduce the sum by this much on average
BEYOND = 5.0  # largest excess of Page's sum over its limit [nats]


@kernel(
    "rows.shape[0] >= LAGS + errors.size and rows.shape[1] >= delta.size + 1",
    "instruments.shape[0] == 0 or (instruments.shape[0] >= LAGS + errors.size and instruments.shape[1] >= delta.size)",
    "measured.size >= errors.size and usual.size >= errors.size and 0 <= order <= LAGS",
    "models.shape[0] > LAGS and models.shape[1] > LAGS and powers.size > LAGS",
    "factor.shape[0] >= delta.size and factor.shape[1] >= delta.size and diagonal.size == delta.size",
    "counts.size >= 4 and 0 <= counts[KNOWN] <= LAGS and squares.size >= 3 and work.size >= 4 * delta.size + 1",
    "estimates.shape[0] >= errors.size and estimates.shape[1] <= delta.size",
)
def learn(
    rows: Matrix, instruments: Matrix, measured: Ints, usual: Ints, learns: bool, order: int, models: Matrix,
    powers: Reals, delta: Reals, factor: Matrix, diagonal: Reals, counts: Ints, squares: Reals, least: float,
    limit: float, errors: Reals, estimates: Matrix, work: Reals,
):  # fmt: skip
    """Take K samples; return the first one at which Page's sum exceeds its limit, K if there is none.

    Parameters
    ----------
    rows : (LAGS + K, T + 1) array
        phi and e_0 of each sample, after those of the LAGS samples before.
    instruments : (LAGS + K, T) array
        zeta in the same order; an array without rows stands for phi.
    measured, usual : (K,) arrays
        Flags: whether there is an output; whether the sample comes one sampling time after the previous one.
    learns : bool
        Whether delta is updated.
    order : int
        Order p of the noise model.
    models, powers : (LAGS + 1, LAGS + 1) and (LAGS + 1,) arrays
        The noise models of each order, and V of each.
    delta, factor, diagonal : (T,), (T, T) and (T,) arrays
        theta - theta_0, and P = U D U'.
    counts, squares : (4,) and (3,) arrays
        See `KNOWN` and `POWER`.
    least : float
        Least variance that innovations are compared with.
    limit : float
        Of Page's sum, in nats.
    errors : (K,) array
        Written: y less the output predicted a priori, in the unit of y; NaN without an output.
    estimates : (K, P) array
        Written: the first entries of delta after each sample.
    work : (4 T + 1,) array
    """
    T = delta.size
    alarm = errors.size
    white, projected, gain, zeta = work, work[T + 1 :], work[2 * T + 1 :], work[3 * T + 1 :]
    for k in range(errors.size):
        row, known = rows[LAGS + k], counts[KNOWN] if usual[k] else 0
        error = row[T]
        for i in range(T):
            error -= row[i] * delta[i]
        errors[k] = error if measured[k] else np.nan
        if measured[k] and learns:
            lags = min(order, known)
            weight = math.sqrt(powers[order] / powers[lags]) if lags < order else 1.0
            for i in range(T + 1):
                total = row[i]
                for lag in range(1, lags + 1):
                    total += models[lags, lag] * rows[LAGS + k - lag, i]
                white[i] = weight * total
            innovation = white[T]
            for i in range(T):
                innovation -= white[i] * delta[i]
                zeta[i] = white[i]
            if instruments.shape[0] > 0:
                for i in range(T):
                    total = instruments[LAGS + k, i]
                    for lag in range(1, lags + 1):
                        total += models[lags, lag] * instruments[LAGS + k - lag, i]
                    zeta[i] = weight * total
            spread = 1.0 + variance_along(factor, diagonal, zeta)
            if math.isfinite(innovation * innovation * spread):
                variance = squares[POWER] / max(counts[LEARNED] - T, 1)
                power = max(max(variance, squares[USUAL]) * spread, least)
                if power > 0.0:
                    before = squares[PAGE]
                    ratio = min(innovation * innovation / power, WILD)
                    after = min(max(before + 0.25 * ratio - 0.5 * math.log(2.0), 0.0), limit + BEYOND)
                    counts[RISING] = counts[RISING] + 1 if after > 0.0 else 0
                    squares[PAGE] = after
                    if after > limit and before <= limit and alarm == errors.size:
                        alarm = k
                most = OUTLYING * math.sqrt(variance * spread)
                if most > 0.0:
                    innovation = min(max(innovation, -most), most)
                alpha = measurement_update(T, factor, diagonal, zeta, 1.0, projected, gain)
                for i in range(T):
                    delta[i] += gain[i] * innovation / alpha
                squares[POWER] += innovation * innovation / alpha
                counts[LEARNED] += 1
            else:
                counts[REFUSED] += 1
        counts[KNOWN] = min(known + 1, LAGS) if measured[k] else 0
        for i in range(estimates.shape[1]):
            estimates[k, i] = delta[i]
    return float(alarm)
