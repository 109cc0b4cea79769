r"""The weights of a bank of structures: the predictive likelihood of each member.

An autoregression of its own whitens the a-priori error e of each member, w = D(q) e.  Its coefficients and variances
V_j are estimated from earlier samples.  With L the logarithm of a weight and P that of its prior,

.. math:: L \leftarrow \lambda\,(L - P) + P - \tfrac12 \left(\ln V + \min(w^2 / V, g)\right),

which is dynamic model averaging: the factor lambda forgets evidence, towards the prior.  A sample is an outlier if it
lies beyond the gate g of the member that predicts best.  Outliers change no weight, until several come in a row: then
each counts, at most as much as the gate.

Source: Raftery, Karny and Ettler (2010), "Online prediction under model uncertainty via dynamic model averaging",
Technometrics 52.
"""

import math

from replant.kernels.filters.autoregressions import nested_models
from replant.kernels.native import Cube, Ints, Matrix, Reals, kernel
from replant.kernels.schema import LAGS

# places in ``counts``: known errors before the next sample; outliers in a row that were skipped; samples until the
# autoregressions are renewed
KNOWN, SKIPPED, DUE = range(3)

GATE = 64.0  # w^2 / V beyond which an output may be an outlier: eight standard deviations, as in the recursion [V]
IN_A_ROW = 5  # outliers in a row that are skipped: if more follow, the plant may have changed [samples]
RENEWED = 64  # a coefficient of so many samples has a standard deviation of at most an eighth [samples]


@kernel(
    "joined.size >= weights.size and prices.size >= weights.size and orders.size >= weights.size",
    "errors.shape[1] >= weights.size and logs.shape[0] >= errors.shape[0] and logs.shape[1] >= weights.size",
    "past.shape[0] >= weights.size and past.shape[1] >= LAGS + 1 and work.size >= 36 + 2 * weights.size",
    "sums.shape[0] >= weights.size and sums.shape[1] > LAGS and sums.shape[2] > LAGS",
    "models.shape[0] >= weights.size and models.shape[1] > LAGS and models.shape[2] > LAGS",
    "variances.shape[0] >= weights.size and variances.shape[1] == LAGS + 1",
    "numbers.size >= 1 and counts.size >= 3 and 0 <= counts[KNOWN] <= LAGS",
)
def weigh(
    errors: Matrix, joined: Ints, forgetting: float, least: float, prices: Reals, weights: Reals, past: Matrix,
    sums: Cube, models: Cube, variances: Matrix, orders: Ints, numbers: Reals, counts: Ints, logs: Matrix, work: Reals,
):  # fmt: skip
    """Take K samples.

    Parameters
    ----------
    errors : (K, M) array
        A-priori errors of M members; a sample is used if the errors of all joined members are finite.
    joined : (M,) array
        Flags: whether a member takes part.
    forgetting, least : float
        lambda; variance below which a residual is no evidence.
    prices, weights : (M,) arrays
        P and L.
    past : (M, LAGS + 1) array
        Earlier errors from the second column on, the newest first.
    sums, models, variances, orders : (M, LAGS + 1, LAGS + 1), the same, (M, LAGS + 1) and (M,) arrays
        The autoregressions, see `nested_models`, and the order in use.
    numbers : (1,) array
        Effective number of samples in the sums, after forgetting.
    counts : (3,) array
        See `KNOWN`.
    logs : (K, M) array
        Written: L after each sample.
    work : (36 + 2 M,) array
    """
    M = weights.size
    levels, spreads = work[36 : 36 + M], work[36 + M : 36 + 2 * M]
    for k in range(errors.shape[0]):
        is_usable = True
        for i in range(M):
            if joined[i] and not math.isfinite(errors[k, i] * errors[k, i]):
                is_usable = False
        sharpest, at_best = math.inf, 0.0
        if is_usable:
            for i in range(M):
                if joined[i]:
                    lags = min(max(orders[i], 0), counts[KNOWN])
                    white = errors[k, i]
                    for lag in range(1, lags + 1):
                        white += models[i, lags, lag] * past[i, lag]
                    spreads[i] = max(variances[i, lags], least)
                    levels[i] = white * white / spreads[i]
                    if spreads[i] < sharpest:
                        sharpest, at_best = spreads[i], levels[i]
        is_outlier = at_best > GATE
        if is_usable and (not is_outlier or counts[SKIPPED] >= IN_A_ROW):
            counts[SKIPPED] = counts[SKIPPED] if is_outlier else 0
            counts[DUE] -= 1
            is_whole = counts[KNOWN] >= LAGS
            numbers[0] = forgetting * numbers[0] + 1.0 if is_whole else numbers[0]
            for i in range(M):
                if joined[i]:
                    told = -0.5 * (math.log(spreads[i]) + min(levels[i], GATE))
                    weights[i] = forgetting * (weights[i] - prices[i]) + prices[i] + told
                    past[i, 0] = errors[k, i]
                    if is_whole:
                        for row in range(LAGS + 1):
                            for column in range(row + 1):
                                product = past[i, row] * past[i, column]
                                sums[i, row, column] = forgetting * sums[i, row, column] + product
                    for lag in range(LAGS, 0, -1):
                        past[i, lag] = past[i, lag - 1]
            counts[KNOWN] = min(counts[KNOWN] + 1, LAGS)
            if counts[DUE] <= 0 and numbers[0] >= RENEWED:
                counts[DUE] = RENEWED
                for i in range(M):
                    if joined[i]:
                        orders[i] = nested_models(sums[i], numbers[0], models[i], variances[i], work)
        else:  # the next samples have no complete past
            counts[SKIPPED] += 1 if is_usable else 0
            counts[KNOWN] = 0
        for i in range(M):
            logs[k, i] = weights[i]
