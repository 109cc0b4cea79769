"""Statistics that outliers do not move."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray

MEDIAN_TO_STD = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute values [ratio].
Derivation: 1 / 0.6745, the upper quartile of the standard normal distribution.
"""


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation of normal numbers (K,) about zero, whatever up to half of them are.

    Examples
    --------
    >>> robust_std(np.array([-1.0, 1.0, 0.5, -0.6745, 1e9, 0.1, -0.2]))
    1.0000...
    """
    return MEDIAN_TO_STD * float(np.median(np.abs(values)))
