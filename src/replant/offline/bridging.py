"""Bridging: outputs that are missing, and outliers, replaced by what the model makes of the input.

The input is known where the output is not, and drives the plant all the same.  A sample left out would take its input
with it.  So the output is filled in, the model solved for, and the output filled in anew by the model, a few times
(expectation and maximisation in turn).  Outliers are found on the way: outputs that stand out of their
neighbours' residual alone.

Source: Dempster, Laird and Rubin (1977), "Maximum likelihood from incomplete data via the EM algorithm", Journal of the
Royal Statistical Society B 39; Pearson (2002), "Outliers in process modeling and identification", IEEE Transactions on
Control Systems Technology 10 (median filter and robust scale).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.engine.record import Record
from replant.offline.refined import Refined
from replant.statistics.robust import robust_std

ROUNDS = 5
"""Solutions at the most [count].
Origin: of 36 missing outputs in 1,500, and 50 in a row, the fourth moves no coefficient by a tenth of its deviation.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SIGMAS = 6.0
"""Distance of a residual from the median of its neighbours beyond which it is an outlier [robust standard deviations].
Level: 2e-9 for normal noise.
"""

LEAST = 0.25
"""The same beside the output, so that what rounding or a small fault of the model leaves is none [part of the output's
standard deviation].
Origin: an outlier that is smaller moves no coefficient by more than its deviation in a record of 500 samples.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STEPS = 3.0
"""The same beside the sensor's smallest step: rounded, right outputs lie up to two steps from their neighbours' median
[steps].
Derivation: one more than two.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST = 0.05
"""Share of outliers beyond which they are none: noise with heavy tails, or another plant [share of samples].
Origin: as MOST_DOUBTED of the recursion.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_MISSING = 0.2
"""Share of missing outputs beyond which their inputs are left out with them [share of samples].
Derivation: each round leaves about so large a part of the error, so that ROUNDS rounds leave less than a thousandth.
"""

NEIGHBOURS = 5
"""Neighbours, itself included, whose median tells what a residual is without outliers [samples].
Derivation: two outliers in a row are outvoted.
"""

JUMP = 0.1
"""Step of the input that a model without a direct path answers too late [part of the input's range].
Origin: not recorded.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BY_CHANCE = 0.01
"""Chance below which outliers are at steps of the input for a reason [probability].
Level: of a binomial test; a lone outlier is taken for an answer where steps are rarer than one sample in 100.
"""

Solve = Callable[[FloatArray], tuple[Record, Refined | None]]
Simulate = Callable[[Refined, FloatArray], FloatArray | None]


@dataclass(frozen=True, eq=False)
class Solution:
    """A model and the samples that it was made from.

    Attributes
    ----------
    ready : Record
    found : Refined or None
    outliers : (K,) array of bool
    missing : (K,) array of bool
        Samples whose input alone was used.
    """

    ready: Record
    found: Refined | None
    outliers: BoolArray
    missing: BoolArray

    @property
    def bridged(self) -> BoolArray:
        """Samples (K,) whose output is the model's."""
        return self.outliers | self.missing

    @property
    def widening(self) -> float:
        """By how much the covariance grows: a bridged sample has no information, and no residual either."""
        known = int((~self.bridged).sum())
        return ((known + int(self.bridged.sum())) / max(known, 1)) ** 2


def solved(
    u: FloatArray, y: FloatArray, missing: BoolArray, gross: FloatArray, solve: Solve, simulate: Simulate
) -> Solution:
    """Solve for a model, its outliers and missing outputs bridged.

    Parameters
    ----------
    u, y : (K,) arrays
        Input and output, NaN where they are not known.
    missing : (K,) array of bool
        Where the output alone is not known.
    gross : (K,) array
        The output with gross outliers replaced.
    solve : callable
        Returns the record of an output (K,), and its model.
    simulate : callable
        Returns a model's output (K,), offset and initial state fitted to the outputs that are not NaN; None where that
        says nothing, as for a model that runs away.
    """
    none = np.zeros(y.size, bool)
    if float(missing.mean()) > MOST_MISSING:
        return Solution(*solve(y), none, none)
    tried = [_iterated(u, y, missing, none, y, solve, simulate)]
    spikes = ~missing & np.isfinite(y) & (gross != y)
    if spikes.any():  # or what the plant does in answer to a pulse
        tried.append(_iterated(u, y, missing, spikes, gross, solve, simulate))
    usable = [each for each in tried if each[0] is not None]
    if not usable:  # as they came
        return Solution(*solve(y), none, none)
    return min(usable, key=lambda each: each[1])[0] or Solution(*solve(y), none, none)


def _iterated(
    u: FloatArray,
    y: FloatArray,
    missing: BoolArray,
    outliers: BoolArray,
    start: FloatArray,
    solve: Solve,
    simulate: Simulate,
) -> tuple[Solution | None, float]:
    """Return the solution that bridging in turn leads to from an output (K,), and its median absolute error.

    No solution where the model runs away, or none is found: what is bridged would then be taken for measured.
    """
    filled = _interpolated(start, missing) if missing.any() else start
    solution, output = None, np.full(y.size, np.nan)
    for _ in range(ROUNDS):
        ready, found = solve(filled)
        simulated = None if found is None else simulate(found, np.where(outliers, np.nan, y))
        if simulated is None:
            return None, math.inf
        output = simulated
        before, outliers = outliers, _outliers(u, y, y - output)
        solution = Solution(ready, found, before, missing)
        if (before == outliers).all() and not missing.any():
            break
        filled = np.where(outliers | missing, output, y)
    return solution, float(np.nanmedian(np.abs(y - output)))


def _interpolated(y: FloatArray, missing: BoolArray) -> FloatArray:
    """Return an output (K,) with those missing on the straight line between their neighbours."""
    known = np.isfinite(y)
    if not known.any():
        return y
    index = np.arange(y.size)
    return np.where(missing, np.interp(index, index[known], y[known]), y)


def _outliers(u: FloatArray, y: FloatArray, error: FloatArray) -> BoolArray:
    """Return which residuals (K,) stand out of their neighbours; none where they follow steps of the input."""
    known = np.isfinite(error)
    nothing = np.zeros(error.size, bool)
    if int(known.sum()) < NEIGHBOURS:
        return nothing
    half = NEIGHBOURS // 2
    padded = np.pad(np.where(known, error, np.nan)[known], half, mode="reflect")
    away = np.abs(error[known] - np.median(np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS), axis=1))
    steps_of_output = np.abs(np.diff(y[known]))
    step = float(steps_of_output[steps_of_output > 0.0].min(initial=math.inf))
    limit = max(SIGMAS * robust_std(away), LEAST * float(np.std(y[known] - error[known])))
    found = nothing.copy()
    found[known] = away > max(limit, STEPS * step if step < math.inf else 0.0)
    steps = np.abs(np.diff(u, prepend=u[:1])) > JUMP * float(np.ptp(u[np.isfinite(u)]))
    steps |= np.roll(steps, 1)
    follow = _more_than_chance(int((found & steps).sum()), int(found.sum()), float(steps.mean()))
    return nothing if follow or not 0 < int(found.sum()) <= MOST * error.size else found


def _more_than_chance(at_steps: int, outliers: int, share: float) -> bool:
    """Return whether more outliers are at steps than the share of steps among the samples makes by chance."""
    from scipy import special  # slow to import

    return 2 * at_steps > outliers and float(special.bdtrc(at_steps - 1, outliers, share)) < BY_CHANCE
