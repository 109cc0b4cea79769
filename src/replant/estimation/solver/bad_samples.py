"""Bad samples of a record: missing outputs, outliers, and outputs of a sensor that is stuck or at its limit.

An outlier is an output whose residual is much larger than its neighbours'.  A sensor is stuck if successive outputs are
bitwise equal for longer than by chance, while the model moves; it is at its limit if this recurs at the same value.
Both need a model: a record is solved, its outputs are judged, and it is solved again without the bad ones
(`estimation.solver.solve`).  Outputs that seem bad without a model are left out first.

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
"""Least residual of an outlier, so that rounding or a small error of the model is none [part of the output's standard
deviation].
Origin: a smaller outlier moves no coefficient by more than its standard deviation in a record of 500 samples.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# rounded, right outputs lie up to two steps from their neighbours' median, and an output between two steps is constant
STEPS = 3.0  # least residual of an outlier, and least movement of the model with a stuck sensor [usual steps]

# half-way between an output that the model explains fully, and one that it does not explain
UNEXPLAINED = 0.5  # residual of a gross output that the model does not explain [part of its distance from the median]
MOST = 0.05  # largest share of outliers: more are heavy tails, or another plant; as MOST_DOUBTED [share]
FEWEST = 5  # fewest residuals that give their usual size [samples]
JUMP = math.sqrt(MATTERS)  # step of the input to which a model without a direct path is too late [part of its range]

# of a binomial test; a single outlier counts as a response if steps are rarer than one sample in 100
BY_CHANCE = 0.01  # chance below which outliers at steps of the input are responses [probability]

# the run's length follows from the share of equal neighbours elsewhere
TIED_BY_CHANCE = 1e-3  # chance of a run of equal outputs in a record below which the sensor is stuck [probability]

HARM = 0.02  # least movement of the model with a harmful stuck sensor: root of the recursion's [part of y's deviation]


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
    """Return the `Doubt` in each output (K,) by a modelled one; inputs are (K,) or (K, q)."""
    error = y - modelled
    doubt = np.where(np.isfinite(y), Doubt.NONE, Doubt.MISSING)
    stuck = _stuck(u, y, modelled, robust_std(error[np.isfinite(error)]) if np.isfinite(error).any() else 0.0)
    doubt[_outliers(u, np.where(stuck, np.nan, y), np.where(stuck, np.nan, error), noise)] = Doubt.OUTLIER
    doubt[stuck] = Doubt.STUCK
    return doubt


def filled(y: FloatArray, measured: BoolArray) -> FloatArray:
    """Return an output (K,) with the values that were not measured interpolated linearly."""
    if measured.all() or not measured.any():
        return y
    index = np.arange(y.size)
    return np.interp(index, index[measured], y[measured])


def _runs(y: FloatArray) -> list[slice]:
    """Return the runs of bitwise equal outputs (K,) that are too long for chance."""
    if y.size < 2 * SECTIONS:
        return []
    equal = y[1:] == y[:-1]
    low, high = np.nanmin(y), np.nanmax(y)
    inside = equal & (y[1:] != low) & (y[1:] != high)  # at its limit a sensor repeats itself everywhere
    share = max(tie_share(inside), SECTIONS / y.size)  # the resolution of the share
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
    # the model moves meanwhile by more than the noise, some steps of the scale, and a harmless amount
    moved = [rows for rows in _runs(y) if float(np.ptp(modelled[rows])) > least]
    # with a constant input a plant may rest repeatedly at one value; before the input's first move nothing proves that
    # it did not: there the model may move by its fitted initial state alone
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
        # a plant leaves its rest without a jump, however late; noise that makes all successive outputs differ does so
        # at rest as well
        elif rows.stop == y.size or is_resolved or not abs(float(y[rows.stop]) - level) <= max(noise, step):
            found[rows] = True
    for level in limits:  # also in shorter runs
        found[:-1] |= (y[:-1] == level) & (y[1:] == level)
        found[1:] |= (y[:-1] == level) & (y[1:] == level)
    return found


def _outliers(u: FloatArray, y: FloatArray, error: FloatArray, noise: FloatArray) -> BoolArray:
    """Return which residuals (K,) are outliers among their neighbours, by D'D e / d'd, and not at input steps."""
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
        # only the largest among neighbours: it makes the others large
        largest = np.max(
            np.lib.stride_tricks.sliding_window_view(np.pad(size, noise.size - 1), 2 * noise.size - 1), axis=1
        )
        new = known & (size > max(OUTLYING * robust_std(away[known]), least)) & (size == largest)
        if not new.any():
            break
        found |= new
        left[new] -= away[new]
    if _follow(u, found):  # except those that no plant produces and the model does not explain
        found &= _gross(y) & (np.abs(error) > UNEXPLAINED * np.abs(y - np.median(y[known])))
    return nothing if not 0 < int(found.sum()) <= MOST * error.size else found


def _gross(y: FloatArray) -> BoolArray:
    """Return which outputs (K,) lie further from their neighbours than those of any plant."""
    known = np.flatnonzero(np.isfinite(y))
    gross = np.zeros(y.size, bool)
    gross[known[without_spikes(y[known]) != y[known]]] = True
    return gross


def _follow(u: FloatArray, found: BoolArray) -> bool:
    """Return whether samples (K,) are at steps of an input more often than by chance."""
    from scipy import special  # slow to import

    steps = np.abs(np.diff(u, axis=0, prepend=u[:1])) > JUMP * np.ptp(u, axis=0)
    steps = steps.reshape(found.size, -1).any(axis=1)
    steps |= np.roll(steps, 1)
    at_steps, every, share = int((found & steps).sum()), int(found.sum()), float(steps.mean())
    return 2 * at_steps > every and float(special.bdtrc(at_steps - 1, every, share)) < BY_CHANCE
