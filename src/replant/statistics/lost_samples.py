"""Lost samples: where the samples of an irregular clock lie on a regular grid, for models that count in samples."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray, IntArray
from replant.kernels.schema import LAGS
from replant.statistics.autoregression import one_step


def places_on_grid(intervals: FloatArray, dt: float) -> IntArray:
    """Return the place (K,) of each sample on a grid of step ``dt``, the first one's the places that it follows.

    Each sample takes the next place, after one empty place for each sample that was lost.  More than LAGS in a row are
    counted as LAGS: what comes after has no known past either way.

    >>> places_on_grid(np.array([1.0, 1.2, 2.9, 0.1, 70.0]), dt=1.0)
    array([ 0,  1,  4,  5, 10])
    """
    lost = np.clip(np.rint(np.minimum(intervals / dt, LAGS + 1.0)) - 1.0, 0.0, LAGS).astype(np.int64)
    return np.asarray(np.arange(intervals.size) + np.cumsum(lost))


def one_step_with_lost(residual: FloatArray, t: FloatArray, dt: float) -> FloatArray:
    """Return what `one_step` does of a residual (K,) on an irregular clock: lost samples are part of no known past.

    >>> slow, kept = np.sin(np.arange(400) / 10), np.arange(400) % 50 > 3
    >>> error = one_step_with_lost(slow[kept], np.flatnonzero(kept) * 0.1, 0.1)
    >>> bool(np.median(abs(error)) < 1e-6), bool(abs(error[46]) == abs(slow[54]))  # 46: the first after a gap
    (True, True)
    """
    places = places_on_grid(np.diff(t, prepend=t[:1] - dt), dt)
    spread = np.full(places[-1] + 1 if places.size else 0, np.nan)
    spread[places] = residual
    return one_step(spread)[places]
