"""Thin a signal for drawing: minimum and maximum of each stretch stand for it, so that no peak is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Thinned:
    """A signal as it is drawn: evenly spaced points, counted in samples of the whole signal.

    Attributes
    ----------
    values : (V,) array
        NaN where the signal has nothing to show.
    first, step : float
        Position of the first point and distance of the points, in samples.
    """

    values: FloatArray
    first: float
    step: float

    def times(self, dt: float) -> FloatArray:
        """Return when each point is, (V,), in s."""
        return np.asarray(dt * (self.first + self.step * np.arange(self.values.size)))


def thin(signal: FloatArray, points: int) -> Thinned:
    """Return at most ``points`` points that show every peak of ``signal`` (K,); all samples where they are few enough.

    The signal is cut into stretches of equal length, one for each column of a picture; of each the least and the
    greatest finite value are kept, in the order in which they came.

    Examples
    --------
    >>> thin(np.array([0.0, 0.0, 9.0, 0.0, 0.0, -7.0, 0.0, 0.0]), points=4).values
    array([ 0.,  9.,  0., -7.])
    """
    if signal.size <= points:
        return Thinned(np.where(np.isfinite(signal), signal, np.nan), 0.0, 1.0)
    columns = max(1, points // 2)
    width = -(-signal.size // columns)
    columns = -(-signal.size // width)
    padded = np.full(columns * width, np.nan)
    padded[: signal.size] = signal
    rows = padded.reshape(columns, width)
    missing = ~np.isfinite(rows)
    least, greatest = np.where(missing, np.inf, rows), np.where(missing, -np.inf, rows)
    places = np.sort(np.stack([least.argmin(axis=1), greatest.argmax(axis=1)]), axis=0)
    values = np.take_along_axis(rows, places.T, axis=1).ravel()
    values[~np.isfinite(values)] = np.nan
    return Thinned(values, 0.25 * width, 0.5 * width)
