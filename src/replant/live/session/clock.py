"""Clock: the device's time stamps as rig time, which goes on where a device that was switched off begins at zero."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.state import GAP

BACK = 1.0  # s; stamps that go back less are late samples, which the identifier rejects one by one


class Clock:
    """Follow time stamps.

    Two stamps in a row that lie more than a second back are a clock that was set back, or a device that started anew:
    from then on rig time is the stamp plus an offset, so that the filters begin anew after a gap.  A clock that jumps
    ahead is such a gap by itself.

    Parameters
    ----------
    dt : float
        Sampling time in s.
    last : float
        Rig time of the newest sample before, in s; minus infinity if there is none.
    offset : float
        What is added to stamps, in s.

    Examples
    --------
    >>> clock = Clock(dt=0.1)
    >>> clock.follow(np.array([500.0, 500.1])), clock.offset
    (array([500. , 500.1]), 0.0)
    >>> clock.follow(np.array([0.0, 0.1, 0.2])).round(6)  # it was switched off and on: a sample later it is believed
    array([  0. , 504.1, 504.2])
    """

    def __init__(self, dt: float, last: float = -np.inf, offset: float = 0.0) -> None:
        self._gap = 2.0 * GAP * dt
        self.last, self.offset = last, offset
        self._behind: float | None = None  # the stamp before, if it lay far back

    def follow(self, t: FloatArray) -> FloatArray:
        """Return rig time (K,) of the stamps of K samples."""
        shifted = t + self.offset if self.offset else t
        if shifted[0] > self.last and (np.diff(shifted) > 0.0).all():
            self.last, self._behind = float(shifted[-1]), None
            return shifted
        return np.array([self._one(stamp) for stamp in t.tolist()])

    def _one(self, stamp: float) -> float:
        shifted = stamp + self.offset if self.offset else stamp
        if shifted > self.last:
            self.last, self._behind = shifted, None
        elif shifted < self.last - BACK:
            if self._behind is not None and stamp > self._behind:
                self.offset = self.last + self._gap - stamp
                self.last, self._behind = stamp + self.offset, None
                return self.last
            self._behind = stamp
        return shifted
