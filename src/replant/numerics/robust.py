"""Statistics robust to outliers, constant outputs, missing values, and stretches of samples left out."""

from __future__ import annotations

import numpy as np

from replant.numerics.arguments import BoolArray, FloatArray, IntArray

MEDIAN_TO_STD = 1.4826  # standard deviation of a normal distribution over the median of its absolute values [ratio]
GROSS = 2.0  # distance from the neighbours' median beyond which an output is a spike [ranges of that median]
SPIKE_NEIGHBOURS = 5  # samples of the running median, which removes up to two spikes in a row [samples]
# more than a twentieth at one end is part of the signal
FAR_OUT = 0.05  # share of values at either end that may lie far from all others [part of all values]
# the digits of a log: closer levels are the same one, computed for instance from two positions
ROUNDING = 1e-6  # distance of values that are one level of a scale [part of the range of nine tenths]
SECTIONS = 8  # sections of a record: at least one shows how often neighbours are equal by chance [count]


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation of normal numbers (K,) about zero; up to half of them may be outliers."""
    return MEDIAN_TO_STD * float(np.median(np.abs(values)))


def without_spikes(y: FloatArray) -> FloatArray:
    """Return an output with spikes (`GROSS`) replaced by the median of five neighbours."""
    if y.size < SPIKE_NEIGHBOURS or not np.isfinite(y).all():
        return y
    half = SPIKE_NEIGHBOURS // 2
    windows = np.lib.stride_tricks.sliding_window_view(y, SPIKE_NEIGHBOURS)
    median = np.pad(np.median(windows, axis=1), half, mode="edge")  # mirroring would count a bad end sample twice
    limit = GROSS * float(np.ptp(median))
    with np.errstate(over="ignore"):
        gross = (np.abs(y - median) > limit) & (limit > 0.0)
    return np.where(gross, median, y) if gross.any() else y


def far_out(values: FloatArray) -> tuple[BoolArray, float, float]:
    """Return which values (K,) lie outside the range of nine tenths by more than its width, and this range."""
    known = values[np.isfinite(values)]
    with np.errstate(invalid="ignore", over="ignore"):
        low, high = np.quantile(known, [FAR_OUT, 1.0 - FAR_OUT]) if known.size else (0.0, 0.0)
        width = float(high - low)
        outside = (values < low - width) | (values > high + width)
    return outside & (width > 0.0), float(low), float(high)


def normal_scores(values: FloatArray) -> FloatArray:
    """Return van der Waerden's scores: the normal quantiles of the ranks of values (K,)."""
    from scipy.special import ndtri  # slow to import

    _, of_each, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1.0)  # equal values share the mean of theirs
    return np.asarray(ndtri(ranks[of_each] / (values.size + 1.0)))


def last_known(values: FloatArray, before: float = np.nan) -> FloatArray:
    """Return values (K,) with each non-finite one replaced by the last finite one, or ``before`` if there is none."""
    finite = np.isfinite(values)
    if finite.all():
        return values
    last = np.maximum.accumulate(np.where(finite, np.arange(values.size), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], before)


def still_runs(y: FloatArray) -> IntArray:
    """Return the runs of equal samples (K,) as rows [begin, end), (R, 2)."""
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    return np.column_stack([begins, np.append(begins[1:], y.size)])


def usual_step(y: FloatArray) -> float:
    """Return the step of a sensor's scale: the median distance of its distinct values (K,); 0 for a single one."""
    known = y[np.isfinite(y)]
    apart = np.diff(np.unique(known))
    if not apart.size:
        return 0.0
    low, high = np.quantile(known, [FAR_OUT, 1.0 - FAR_OUT])  # without outliers
    levels = apart[apart > ROUNDING * ((high - low) or known.max() - known.min())]
    return float(np.median(levels if levels.size else apart))


def tie_share(equal: BoolArray) -> float:
    """Return the share of equal neighbours (K - 1,) in the section with the fewest: elsewhere the sensor may fail."""
    return min(float(part.mean()) for part in np.array_split(equal, SECTIONS))


def never_ties(y: FloatArray) -> bool:
    """Return whether two successive samples (K,) are never equal, because of noise, unless the sensor fails."""
    return y.size >= 2 * SECTIONS and tie_share(y[1:] == y[:-1]) * y.size < SECTIONS


#: No stretches of samples.  Stretches are rows [begin, end), (R, 2): bridged, rejected, or before an interruption.
NONE: IntArray = np.zeros((0, 2), np.int64)


def stretches_of(flags: BoolArray, first: int = 0) -> IntArray:
    """Return the stretches of set flags (K,) as rows [begin, end), (R, 2); ``first`` is the first flag's sample."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return np.asarray(first + edges.reshape(-1, 2), np.int64)


def flags_of(stretches: IntArray, first: int, samples: int) -> BoolArray:
    """Return a mask (K,) of the samples of a range that lie in stretches."""
    begin, end = np.searchsorted(stretches[:, 1], first, "right"), np.searchsorted(stretches[:, 0], first + samples)
    flags = np.zeros(samples, bool)
    for low, high in np.clip(stretches[begin:end] - first, 0, samples).tolist():
        flags[low:high] = True
    return flags


def joined(stretches: IntArray, apart: int) -> IntArray:
    """Join ascending stretches (R, 2) that are at most ``apart`` samples apart, for a plot."""
    if not len(stretches):
        return NONE
    new = np.flatnonzero(stretches[1:, 0] - np.maximum.accumulate(stretches[:-1, 1]) > apart)
    begins = stretches[np.concatenate([[0], new + 1]), 0]
    ends = np.maximum.accumulate(stretches[:, 1])[np.concatenate([new, [len(stretches) - 1]])]
    return np.column_stack([begins, ends])
