"""Statistics that outliers do not move, outputs that stand still, values that are missing, and stretches left out."""

from __future__ import annotations

import numpy as np

from replant.numerics.arguments import BoolArray, FloatArray, IntArray

MEDIAN_TO_STD = 1.4826  # standard deviation of a normal distribution over the median of its absolute values [ratio]
GROSS = 2.0  # distance from the neighbours' median that no plant makes: a spike [ranges of the median over the record]
SPIKE_NEIGHBOURS = 5  # whose median tells an output without spikes: two in a row are outvoted [samples]
# more than a twentieth at one end is what a signal does now and then
FAR_OUT = 0.05  # values at either end that may lie far from all others [part of them]
# as the digits of a log: levels that differ by less are one, computed from other numbers, such as two positions
ROUNDING = 1e-6  # distance of values that are one level of a scale [part of the range of nine tenths]
SECTIONS = 8  # of a record, one of which at least tells how often neighbours are equal by chance [count]


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation of normal numbers (K,) about zero, whatever up to half of them are."""
    return MEDIAN_TO_STD * float(np.median(np.abs(values)))


def without_spikes(y: FloatArray) -> FloatArray:
    """Return an output with gross outliers (`GROSS`) replaced by the median of five neighbours."""
    if y.size < SPIKE_NEIGHBOURS or not np.isfinite(y).all():
        return y
    half = SPIKE_NEIGHBOURS // 2
    windows = np.lib.stride_tricks.sliding_window_view(y, SPIKE_NEIGHBOURS)
    median = np.pad(np.median(windows, axis=1), half, mode="edge")  # a mirror would show an end that is bad twice
    limit = GROSS * float(np.ptp(median))
    with np.errstate(over="ignore"):
        gross = (np.abs(y - median) > limit) & (limit > 0.0)
    return np.where(gross, median, y) if gross.any() else y


def far_out(values: FloatArray) -> tuple[BoolArray, float, float]:
    """Return which values (K,) lie farther outside the range of nine tenths than that is wide, and this range."""
    known = values[np.isfinite(values)]
    with np.errstate(invalid="ignore", over="ignore"):
        low, high = np.quantile(known, [FAR_OUT, 1.0 - FAR_OUT]) if known.size else (0.0, 0.0)
        width = float(high - low)
        outside = (values < low - width) | (values > high + width)
    return outside & (width > 0.0), float(low), float(high)


def normal_scores(values: FloatArray) -> FloatArray:
    """Return the normal quantiles of the ranks of values (K,), van der Waerden's scores: their order without size."""
    from scipy.special import ndtri  # slow to import

    _, of_each, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1.0)  # equal values share the mean of theirs
    return np.asarray(ndtri(ranks[of_each] / (values.size + 1.0)))


def last_known(values: FloatArray, before: float = np.nan) -> FloatArray:
    """Return values (K,), the last finite one in the place of each that is not, ``before`` that the first one."""
    finite = np.isfinite(values)
    if finite.all():
        return values
    last = np.maximum.accumulate(np.where(finite, np.arange(values.size), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], before)


def still_runs(y: FloatArray) -> IntArray:
    """Return the runs of samples (K,) equal to the bit, (R, 2): where each begins and ends."""
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    return np.column_stack([begins, np.append(begins[1:], y.size)])


def usual_step(y: FloatArray) -> float:
    """Return the step of a sensor's scale, the median distance of the values (K,) that it gave; 0 of a single one."""
    known = y[np.isfinite(y)]
    apart = np.diff(np.unique(known))
    if not apart.size:
        return 0.0
    low, high = np.quantile(known, [FAR_OUT, 1.0 - FAR_OUT])  # without outliers
    levels = apart[apart > ROUNDING * ((high - low) or known.max() - known.min())]
    return float(np.median(levels if levels.size else apart))


def tie_share(equal: BoolArray) -> float:
    """Return the share of equal neighbours (K - 1,) in the part of the record with the fewest: the sensor may fail."""
    return min(float(part.mean()) for part in np.array_split(equal, SECTIONS))


def never_ties(y: FloatArray) -> bool:
    """Return whether noise keeps any two samples (K,) in a row from being equal, unless the sensor fails."""
    return y.size >= 2 * SECTIONS and tie_share(y[1:] == y[:-1]) * y.size < SECTIONS


#: No stretches of samples; others are rows [begin, end), (R, 2): bridged, rejected, or before an interruption.
NONE: IntArray = np.zeros((0, 2), np.int64)


def stretches_of(flags: BoolArray, first: int = 0) -> IntArray:
    """Return where flags (K,) are set, as rows [begin, end), (R, 2); ``first`` is the sample of the first flag."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return np.asarray(first + edges.reshape(-1, 2), np.int64)


def flags_of(stretches: IntArray, first: int, samples: int) -> BoolArray:
    """Return which samples (K,) of a range lie in stretches."""
    begin, end = np.searchsorted(stretches[:, 1], first, "right"), np.searchsorted(stretches[:, 0], first + samples)
    flags = np.zeros(samples, bool)
    for low, high in np.clip(stretches[begin:end] - first, 0, samples).tolist():
        flags[low:high] = True
    return flags


def joined(stretches: IntArray, apart: int) -> IntArray:
    """Return ascending stretches (R, 2) with those joined that are at most ``apart`` samples apart, for a plot."""
    if not len(stretches):
        return NONE
    new = np.flatnonzero(stretches[1:, 0] - np.maximum.accumulate(stretches[:-1, 1]) > apart)
    begins = stretches[np.concatenate([[0], new + 1]), 0]
    ends = np.maximum.accumulate(stretches[:, 1])[np.concatenate([new, [len(stretches) - 1]])]
    return np.column_stack([begins, ends])
