"""Signals thinned for drawing: no peak is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.numerics.arguments import FloatArray


@dataclass(frozen=True, eq=False)
class Thinned:
    """A signal as it is drawn: evenly spaced points, counted in samples of the whole signal."""

    # (V,): NaN where the signal has nothing to show
    values: FloatArray
    first: float  # first, step: position of the first point and distance of the points, in samples
    step: float

    @property
    def places(self) -> FloatArray:
        """Which sample each point is, (V,); a fraction lies between two samples."""
        return np.asarray(self.first + self.step * np.arange(self.values.size))

    def among(self, t: FloatArray) -> FloatArray:
        """Return when each point is, (V,), in the signal whose samples came at the times ``t`` (K,), evenly or not."""
        if not t.size:
            return self.values
        last = float(t[-1] - t[-2]) if t.size > 1 else 0.0
        beyond = last * np.maximum(self.places - (t.size - 1), 0.0)
        return np.asarray(np.interp(self.places, np.arange(t.size), t) + beyond)

    def indices(self, length: int) -> npt.NDArray[np.intp]:
        """Return the index (V,) of the sample nearest below each point, in the signal of ``length`` samples."""
        return np.minimum(self.places.astype(np.intp), length - 1)


def thin(signal: FloatArray, points: int) -> Thinned:
    """Return at most ``points`` points that show every peak of ``signal`` (K,); all samples where they are few enough.

    The signal is cut into stretches of equal length, one for each column of a picture; of each the least and the
    greatest finite value are kept, in the order in which they came.
    """
    thinner = Thinner(signal.size, points)
    thinner.take(signal)
    return thinner.thinned


class Thinner:
    """Does what `thin` does, of a signal of ``length`` samples that comes batch by batch."""

    def __init__(self, length: int, points: int) -> None:
        self._width = 1 if length <= points else -(-length // max(1, points // 2))
        self._rest, self._parts = np.empty(0), [np.empty(0)]

    def take(self, signal: FloatArray) -> None:
        """Take the next samples (K,)."""
        if self._width == 1:
            self._parts.append(np.where(np.isfinite(signal), signal, np.nan))
            return
        known = np.concatenate([self._rest, signal])
        whole = known.size // self._width * self._width
        self._parts.append(_extremes(known[:whole].reshape(-1, self._width)))
        self._rest = known[whole:].copy()

    @property
    def thinned(self) -> Thinned:
        """The signal so far, as it is drawn."""
        if self._width == 1:
            return Thinned(np.concatenate(self._parts), 0.0, 1.0)
        last = np.full(self._width if self._rest.size else 0, np.nan)
        last[: self._rest.size] = self._rest
        values = np.concatenate([*self._parts, _extremes(last.reshape(-1, self._width))])
        return Thinned(values, 0.25 * self._width, 0.5 * self._width)


def _extremes(rows: FloatArray) -> FloatArray:
    """Return the least and the greatest finite value of each row, in the order in which they came, (2 R,)."""
    missing = ~np.isfinite(rows)
    least, greatest = np.where(missing, np.inf, rows), np.where(missing, -np.inf, rows)
    places = np.sort(np.stack([least.argmin(axis=1), greatest.argmax(axis=1)]), axis=0)
    values = np.take_along_axis(rows, places.T, axis=1).ravel()
    values[~np.isfinite(values)] = np.nan
    return np.asarray(values)


POINTS = 36_000  # points of a signal at most: nine-fold zoom on 2,000 columns loses nothing [count]
