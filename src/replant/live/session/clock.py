"""Clock: the device's time stamps as rig time, which goes on where a device that was switched off begins at zero."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.state import GAP
from replant.kernels.schema import FARTHEST, LEAP

BACK = 1.0
"""Step back of the stamps below which they are late samples, which the identifier rejects one by one [s]."""


class Clock:
    """Follow time stamps.

    Two stamps in a row, soon one after the other, that lie more than a second back are a clock that was set back, or a
    device that started anew: from then on rig time is the stamp plus an offset, so that the filters begin anew after a
    gap.  A clock that jumps ahead is such a gap by itself.  A stamp that leaps by more than `LEAP` sampling times, and
    the very first one, count once the next one confirms them; until then rig time stays.  Every stamp is handed on:
    the identifier, which has the same rule, rejects and counts.

    Parameters
    ----------
    dt : float
        Sampling time in s.
    last : float
        Rig time of the newest sample before, in s; minus infinity if there is none.
    offset : float
        What is added to stamps, in s.
    candidate : float or None
        The stamp before, where it leapt or lay far back.
    alone : bool
        Whether rig time is the very first stamp, which none has confirmed.

    Examples
    --------
    >>> clock = Clock(dt=0.1)
    >>> clock.follow(np.array([500.0, 500.1])), clock.offset
    (array([500. , 500.1]), 0.0)
    >>> clock.follow(np.array([0.0, 0.1, 0.2])).round(6)  # it was switched off and on: a sample later it is believed
    array([  0. , 504.1, 504.2])
    >>> clock.follow(np.array([1e4, 0.3])).round(6), round(clock.last, 6)  # misread, rejected by the identifier
    (array([10504. ,   504.3]), 504.3)
    """

    def __init__(
        self,
        dt: float,
        last: float = -np.inf,
        offset: float = 0.0,
        candidate: float | None = None,
        *,
        alone: bool = False,
    ) -> None:
        self._gap, self._leap, self._farthest = 2.0 * GAP * dt, LEAP * dt, FARTHEST * dt
        self.last, self.offset, self.candidate, self.alone = last, offset, candidate, alone

    def follow(self, t: FloatArray) -> FloatArray:
        """Return rig time (K,) of the stamps of K samples."""
        shifted = t + self.offset if self.offset else t
        begins = self.last == -np.inf
        if not self.alone and (not begins or (t.size > 1 and np.abs(shifted).max() <= self._farthest)):
            steps = np.diff(shifted) if begins else np.diff(shifted, prepend=self.last)
            if (steps > 0.0).all() and (steps <= self._leap).all():
                self._go_on(float(shifted[-1]))
                return shifted
        one_by_one = np.array([self._one(stamp) for stamp in t.tolist()])
        return one_by_one if self.offset else t

    def _one(self, stamp: float) -> float:
        shifted = stamp + self.offset if self.offset else stamp
        if not abs(shifted) <= self._farthest:
            return shifted
        if self.last == -np.inf:
            self.last, self.alone = shifted, True
        elif 0.0 < shifted - self.last <= self._leap:
            self._go_on(shifted)
        elif shifted > self.last or self.alone:
            return self._leaps(stamp, shifted)
        elif shifted < self.last - BACK:
            return self._goes_back(stamp, shifted)
        return shifted

    def _go_on(self, shifted: float) -> None:
        self.last, self.candidate, self.alone = shifted, None, False

    def _leaps(self, stamp: float, shifted: float) -> float:
        """Take a stamp that leaps ahead, or one that does not go on from the very first, as rig time once confirmed."""
        candidate, self.candidate = self.candidate, stamp
        if candidate is not None:
            leapt = candidate + self.offset - self.last
            if leapt > 0.0 or self.alone:
                ahead = stamp - candidate > 0.0
                if ahead and stamp - candidate <= self._leap:
                    self._go_on(shifted)
                elif ahead and stamp - candidate <= 2.0 * leapt:  # a slow rig: each stamp leaps
                    self.last, self.alone = candidate + self.offset, False
        return shifted

    def _goes_back(self, stamp: float, shifted: float) -> float:
        """Begin a new offset with a stamp that lies far back, as the one before it did."""
        candidate, self.candidate = self.candidate, stamp
        if candidate is None or not 0.0 < stamp - candidate <= self._leap or candidate + self.offset > self.last:
            return shifted
        self.offset = self.last + self._gap - stamp
        self._go_on(stamp + self.offset)
        return self.last
