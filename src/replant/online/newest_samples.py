"""The newest samples of a running identification, as they are simulated for a model or a view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.online.estimate import Estimate

IRREGULAR = 1e-6
"""Deviation of an interval from the sampling time that is more than rounding [part of the sampling time].
Derivation: stamps of some 1e9 s have a resolution of 1e-7 s.
"""
LONGEST_IRREGULAR = 3000
"""Newest samples simulated on an irregular clock, where each interval needs a matrix exponential [samples]."""


@dataclass(frozen=True)
class NewestSamples:
    """Signals of the newest samples.

    Attributes
    ----------
    input, output : array (K,)
        In the units of the log, the input behind its map.
    intervals : array (K,)
        Seconds since the sample before.
    reference : array (K,)
        Empty where there is none.
    judged : array of bool (K,)
        Which samples the verdict uses.
    regular : bool
        Whether all of them are one sampling time apart.
    """

    input: FloatArray
    output: FloatArray
    intervals: FloatArray
    reference: FloatArray
    judged: BoolArray
    regular: bool

    @property
    def known_output(self) -> FloatArray:
        """The output (K,), NaN where the verdict does not use it."""
        return np.where(self.judged, self.output, np.nan)


def newest_samples(estimate: Estimate) -> NewestSamples:
    """Return the newest samples: all of `recent`, or the last 3,000 where the clock is irregular."""
    u, y, intervals = estimate.recent.T
    kept = estimate.recent_reference
    r, judged = np.zeros(0) if kept is None else kept, estimate.judged
    regular = bool((np.abs(intervals[1:] - estimate.dt) <= IRREGULAR * estimate.dt).all())
    last = slice(None) if regular else slice(-LONGEST_IRREGULAR, None)
    return NewestSamples(u[last], y[last], intervals[last], r[last], judged[last], regular)
