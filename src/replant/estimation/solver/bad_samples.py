"""Bad samples of a record: outputs that are missing, outliers, and those of a sensor that is stuck or at its limit.

An outlier is an output whose residual stands out of its neighbours'.  A sensor is stuck where the output was the same
number to the bit so often in a row that it is no chance, while the model says that it moved; at its limit where it is
so at the same number again.  Both need a model, so that a record is solved, its outputs are judged, and it is solved
again without those that are bad (`estimation.solver.solve`).  What may be bad by the outputs alone is left out first.

Sources: Pearson (2002), "Outliers in process modeling and identification", IEEE Transactions on Control Systems
Technology 10 (median filter and robust scale); Chang, Tiao and Chen (1988), "Estimation of time series parameters in
the presence of outliers", Technometrics 30 (additive outliers in coloured noise).
"""

from __future__ import annotations

import math

import numpy as np

from replant.estimation.engine.recent_samples import IN_A_ROW
from replant.kernels.schema import OUTLYING, Doubt
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.levels import MATTERS
from replant.numerics.robust import SECTIONS, never_ties, robust_std, still_runs, tie_share, usual_step, without_spikes

LEAST = 0.25
"""The same beside the output, so that what rounding or a small fault of the model leaves is none [part of the output's
standard deviation].
Origin: an outlier that is smaller moves no coefficient by more than its deviation in a record of 500 samples.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# rounded, right outputs lie up to two steps from their neighbours' median, and one between two steps stands still
STEPS = 3.0  # the same beside the sensor's usual step, and what a model must move while the sensor is stuck [steps]

# half-way between an output that the model gives whole, and one of which it gives nothing
UNEXPLAINED = 0.5  # residual of a gross output that the model does not explain [part of its distance from the median]
MOST = 0.05  # share of outliers beyond which they are none: heavy tails, or another plant; as MOST_DOUBTED [share]
FEWEST = 5  # residuals that tell how large one usually is, at the least [samples]
JUMP = math.sqrt(MATTERS)  # step of the input that a model without a direct path answers too late [part of its range]

# of a binomial test; a lone outlier is taken for an answer where steps are rarer than one sample in 100
BY_CHANCE = 0.01  # chance below which outliers are at steps of the input for a reason [probability]

# the run's length follows from the share of equal neighbours elsewhere
TIED_BY_CHANCE = 1e-3  # chance of a run of equal outputs in a record below which the sensor is stuck [probability]

HARM = 0.02  # what a model must move for a stuck sensor to do harm: the root of the recursion's [part of y's deviation]


def suspicious(u: FloatArray, y: FloatArray) -> IntArray:
    """Return the `Doubt` in each output (K,) without a model: missing (NaN), gross, or equal too often to be chance."""
    doubt = np.where(np.isfinite(y), Doubt.NONE, Doubt.MISSING)
    known = np.isfinite(y)
    if not known.any():
        return doubt
    gross = _gross(y)
    if not _follow(u, gross):
        doubt[gross] = Doubt.OUTLIER
    still = doubt.copy()
    for rows in _runs(y):
        still[rows] = Doubt.STUCK
    return still if 2 * int((still == Doubt.NONE).sum()) > int(known.sum()) else doubt


def doubts(u: FloatArray, y: FloatArray, modelled: FloatArray, noise: FloatArray) -> IntArray:
    """Return the `Doubt` in each output (K,), by a model's; inputs are (K,) or (K, q)."""
    error = y - modelled
    doubt = np.where(np.isfinite(y), Doubt.NONE, Doubt.MISSING)
    stuck = _stuck(u, y, modelled, robust_std(error[np.isfinite(error)]) if np.isfinite(error).any() else 0.0)
    doubt[_outliers(u, np.where(stuck, np.nan, y), np.where(stuck, np.nan, error), noise)] = Doubt.OUTLIER
    doubt[stuck] = Doubt.STUCK
    return doubt


def filled(y: FloatArray, measured: BoolArray) -> FloatArray:
    """Return an output (K,) with those not measured on the straight line between their neighbours."""
    if measured.all() or not measured.any():
        return y
    index = np.arange(y.size)
    return np.interp(index, index[measured], y[measured])


def _runs(y: FloatArray) -> list[slice]:
    """Return where outputs (K,) are equal to the bit so often in a row that it is no chance."""
    if y.size < 2 * SECTIONS:
        return []
    equal = y[1:] == y[:-1]
    low, high = np.nanmin(y), np.nanmax(y)
    inside = equal & (y[1:] != low) & (y[1:] != high)  # at its limit a sensor repeats itself everywhere
    share = max(tie_share(inside), SECTIONS / y.size)  # fewer were not looked at
    if not share < 1.0:
        return []
    fewest = math.log(TIED_BY_CHANCE / y.size) / math.log(share)
    runs = still_runs(y)
    return [slice(begin, end) for begin, end in runs[np.diff(runs)[:, 0] - 1 > fewest].tolist()]


def _stuck(u: FloatArray, y: FloatArray, modelled: FloatArray, noise: float) -> BoolArray:
    """Return which outputs (K,) are those of a sensor that is stuck, or at its limit."""
    found = np.zeros(y.size, bool)
    known = y[np.isfinite(y)]
    if y.size < 2 * SECTIONS or known.size < 2:
        return found
    step, is_resolved = STEPS * usual_step(known), never_ties(y)
    least, low, high = max(noise, step, HARM * float(known.std())), known.min(), known.max()
    # the model moves meanwhile by more than the noise, some steps of the scale, and what does no harm
    moved = [rows for rows in _runs(y) if float(np.ptp(modelled[rows])) > least]
    # under an input that rests a plant may rest as often at the same number; before its first move no output proves
    # that it did not: the model follows the outputs that were left out with its initial state
    steps = np.flatnonzero(np.diff(u, axis=0).reshape(y.size - 1, -1).any(axis=1)) + 1
    first = int(steps[0]) if steps.size else y.size
    driven = [np.searchsorted(steps, rows.start) < np.searchsorted(steps, rows.stop) for rows in moved]
    levels = [float(y[rows.start]) if is_driven else math.nan for rows, is_driven in zip(moved, driven, strict=True)]
    limits = set()
    for rows in moved:
        level = float(y[rows.start])
        away = float(modelled[rows].mean()) - level
        again = levels.count(level) > 1 and abs(away) > least
        is_limit = again or (level == high and away > 0.0) or (level == low and away < 0.0)
        if is_limit and rows.start >= first:
            limits.add(level)
        # a plant that rests leaves its rest without a jump, however late; where noise tells any two outputs in a row
        # apart, it does so while a plant rests
        elif rows.stop == y.size or is_resolved or not abs(float(y[rows.stop]) - level) <= max(noise, step):
            found[rows] = True
    for level in limits:  # shorter runs too
        found[:-1] |= (y[:-1] == level) & (y[1:] == level)
        found[1:] |= (y[:-1] == level) & (y[1:] == level)
    return found


def _outliers(u: FloatArray, y: FloatArray, error: FloatArray, noise: FloatArray) -> BoolArray:
    """Return which residuals (K,) stand out of their neighbours, by D'D e / d'd, and follow no steps of the input."""
    known = np.isfinite(error)
    nothing = np.zeros(error.size, bool)
    if int(known.sum()) < max(FEWEST, noise.size):
        return nothing
    left, found = np.where(known, error, 0.0), nothing.copy()
    least = max(LEAST * float(np.std(y[known] - error[known])), STEPS * usual_step(y[known]))
    for _ in range(IN_A_ROW):  # each time the largest of neighbours is found
        white = np.convolve(left, noise)[: left.size]
        away = np.convolve(white[::-1], noise)[: left.size][::-1] / float(noise @ noise)
        size = np.abs(away)
        # of neighbours it is the one that stands out most: the others do so because of it
        largest = np.max(
            np.lib.stride_tricks.sliding_window_view(np.pad(size, noise.size - 1), 2 * noise.size - 1), axis=1
        )
        new = known & (size > max(OUTLYING * robust_std(away[known]), least)) & (size == largest)
        if not new.any():
            break
        found |= new
        left[new] -= away[new]
    if _follow(u, found):  # but for what no plant does and the model does not explain
        found &= _gross(y) & (np.abs(error) > UNEXPLAINED * np.abs(y - np.median(y[known])))
    return nothing if not 0 < int(found.sum()) <= MOST * error.size else found


def _gross(y: FloatArray) -> BoolArray:
    """Return which outputs (K,) lie further from their neighbours than any plant's."""
    known = np.flatnonzero(np.isfinite(y))
    gross = np.zeros(y.size, bool)
    gross[known[without_spikes(y[known]) != y[known]]] = True
    return gross


def _follow(u: FloatArray, found: BoolArray) -> bool:
    """Return whether samples (K,) are at steps of an input more often than the share of steps makes by chance."""
    from scipy import special  # slow to import

    steps = np.abs(np.diff(u, axis=0, prepend=u[:1])) > JUMP * np.ptp(u, axis=0)
    steps = steps.reshape(found.size, -1).any(axis=1)
    steps |= np.roll(steps, 1)
    at_steps, every, share = int((found & steps).sum()), int(found.sum()), float(steps.mean())
    return 2 * at_steps > every and float(special.bdtrc(at_steps - 1, every, share)) < BY_CHANCE
