"""Power and colour of the residual, and instruments filtered by it, kept for standard deviations under coloured noise.

Noise that is not white makes the plain covariance sigma^2 P too small.  With the residual modelled as an
autoregression, e = w / D(q), the covariance of the instrumental-variable estimate is

    sigma_w^2 P Q P,   Q = sum zeta_f zeta_f',  zeta_f = zeta / D(q).

Source: Soderstrom and Stoica, "Instrumental Variable Methods for System Identification", 1983, chapter 4.
"""

from replant.kernels.native import Reals, kernel
from replant.kernels.schema import FIXED, LAGS, ColourSlots

COUNT, POWER, POSITION = ColourSlots.count.index, ColourSlots.power.index, ColourSlots.position.index
BEGINS = ColourSlots.begins(FIXED | {"T": 0})  # what depends on T comes last
MODEL, COVARIANCES, ERRORS, FILTERED = (BEGINS[name] for name in ("model", "covariances", "errors", "filtered"))


@kernel("covariances.size > LAGS and model.size > LAGS and previous.size > LAGS")
def autoregression(covariances: Reals, model: Reals, previous: Reals):
    """Fill ``model`` (LAGS + 1,) with the autoregression of these autocovariances; return its innovation's power.

    Levinson and Durbin's recursion; ``previous`` (LAGS + 1,) is work.
    """
    model[0] = 1.0
    for i in range(1, LAGS + 1):
        model[i] = 0.0
    power = covariances[0]
    for order in range(1, LAGS + 1):
        if not power > 0.0:
            break
        total = covariances[order]
        for i in range(1, order):
            total += model[i] * covariances[order - i]
        reflection = -total / power
        for i in range(order):
            previous[i] = model[i]
        for i in range(1, order):
            model[i] = previous[i] + reflection * previous[order - i]
        model[order] = reflection
        power *= 1.0 - reflection * reflection
    return max(power, 0.0)


def record(colour, error, alpha, forgetting, zeta):
    """Take one residual (before its update; alpha as in `optimizers.covariance.measurement_update`) and its regressor.

    ``zeta`` is overwritten by its filtered value.
    """
    T = zeta.size
    colour[COUNT] = forgetting * colour[COUNT] + 1.0
    colour[POWER] = forgetting * colour[POWER] + error * error * forgetting / alpha
    for lag in range(LAGS + 1):
        other = error if lag == 0 else colour[ERRORS + lag - 1]
        colour[COVARIANCES + lag] = forgetting * colour[COVARIANCES + lag] + error * other
    for lag in range(LAGS - 1, 0, -1):
        colour[ERRORS + lag] = colour[ERRORS + lag - 1]
    colour[ERRORS] = error
    newest = (int(colour[POSITION]) + 1) % LAGS
    row = FILTERED + newest * T  # holds what is LAGS samples old, which the newest takes the place of
    filtered = colour[row : row + T]
    for i in range(T):
        zeta[i] -= colour[MODEL + LAGS] * filtered[i]
    for lag in range(1, LAGS):
        row = FILTERED + (newest + LAGS - lag) % LAGS * T
        weight, earlier = colour[MODEL + lag], colour[row : row + T]
        for i in range(T):
            zeta[i] -= weight * earlier[i]
    for i in range(T):
        filtered[i] = zeta[i]
    squares = FILTERED + LAGS * T
    keep = forgetting * forgetting
    for i in range(T):
        one, sums = zeta[i], colour[squares + i * T : squares + i * T + T]
        for j in range(T):
            sums[j] = keep * sums[j] + one * zeta[j]
    colour[POSITION] = newest


def begin_last(colour, first, entries):
    """Forget what the regressor's entries from ``first`` on have been, as `optimizers.covariance.begin_last` does."""
    for lag in range(LAGS):
        for i in range(first, entries):
            colour[FILTERED + lag * entries + i] = 0.0
    squares = FILTERED + LAGS * entries
    for i in range(entries):
        for j in range(entries):
            if i >= first or j >= first:
                colour[squares + i * entries + j] = 0.0
