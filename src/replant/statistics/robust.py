"""Statistics that outliers do not move."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray

MEDIAN_TO_STD = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute values [ratio].
Derivation: 1 / 0.6745, the upper quartile of the standard normal distribution.
"""

GROSS = 2.0
"""Distance of an output from the median of its neighbours beyond which it is a spike [ranges of that median over the
record].
Derivation: nothing that a plant does.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SPIKE_NEIGHBOURS = 5
"""Neighbours whose median tells what an output is without its spikes [samples].
Derivation: two spikes in a row are outvoted.
Sensitivity: halved or doubled, cannot be: white 1 % ends with ValueError.
"""


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation of normal numbers (K,) about zero, whatever up to half of them are.

    Examples
    --------
    >>> robust_std(np.array([-1.0, 1.0, 0.5, -0.6745, 1e9, 0.1, -0.2]))
    1.0000...
    """
    return MEDIAN_TO_STD * float(np.median(np.abs(values)))


def without_spikes(y: FloatArray) -> FloatArray:
    """Return an output with gross outliers replaced by the median of five neighbours.

    An outlier is gross if it lies further from that median than twice the median's whole range, as no plant's output
    does.

    Examples
    --------
    >>> without_spikes(np.array([0.0, 1.0, 2.0, 3.0, 1e6, 4.0, 5.0, 6.0]))
    array([0., 1., 2., 3., 4., 4., 5., 6.])
    """
    if y.size < SPIKE_NEIGHBOURS or not np.isfinite(y).all():
        return y
    half = SPIKE_NEIGHBOURS // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(y, half, mode="reflect"), SPIKE_NEIGHBOURS)
    median = np.median(windows, axis=1)
    limit = GROSS * float(np.ptp(median))
    with np.errstate(over="ignore"):
        gross = (np.abs(y - median) > limit) & (limit > 0.0)
    return np.where(gross, median, y) if gross.any() else y


def normal_scores(values: FloatArray) -> FloatArray:
    """Return the normal quantiles of the ranks of values (K,): their order, without the size of the largest.

    Source: van der Waerden (1952), "Order tests for the two-sample problem and their power", Indagationes
    Mathematicae 14.

    Examples
    --------
    >>> normal_scores(np.array([3.0, -1.0, 1e9])).round(2)
    array([ 0.  , -0.67,  0.67])
    """
    from scipy import special, stats  # slow to import

    return np.asarray(special.ndtri(stats.rankdata(values) / (values.size + 1.0)))
