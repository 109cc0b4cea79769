"""Rig clock: the device's time stamps converted to rig time, which continues after the device was reset."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.state import GAP
from replant.kernels.schema import FARTHEST, LEAP

BACK = 1.0  # step back of the stamps below which they are late samples, which the identifier rejects one by one [s]


class RigClock:
    """Converts time stamps to rig time.

    Rig time is the stamp plus an offset.  Two consecutive stamps that lie close together and more than a second back
    show that the clock was set back or the device was reset: the offset is then changed so that rig time continues
    after a gap, at which the filters restart.  A clock that jumps ahead makes such a gap by itself.  A stamp that leaps
    by more than `LEAP` sampling times, and the very first stamp, advance rig time only once the next stamp confirms
    them.  Every stamp is returned: the identifier applies the same rule, rejects samples and counts them.

    >>> clock = RigClock(dt=0.1)
    >>> clock.follow(np.array([500.0, 500.1])), clock.offset
    (array([500. , 500.1]), 0.0)
    >>> clock.follow(np.array([0.0, 0.1, 0.2])).round(6)  # the device was reset, which its second stamp confirms
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
        is_first = self.last == -np.inf
        if not self.alone and (not is_first or (t.size > 1 and np.abs(shifted).max() <= self._farthest)):
            steps = np.diff(shifted) if is_first else np.diff(shifted, prepend=self.last)
            if (steps > 0.0).all() and (steps <= self._leap).all():
                self._advance(float(shifted[-1]))
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
            self._advance(shifted)
        elif shifted > self.last or self.alone:
            return self._follow_leap(stamp, shifted)
        elif shifted < self.last - BACK:
            return self._follow_step_back(stamp, shifted)
        return shifted

    def _advance(self, shifted: float) -> None:
        self.last, self.candidate, self.alone = shifted, None, False

    def _follow_leap(self, stamp: float, shifted: float) -> float:
        """Handle a stamp that leaps ahead, or does not follow the very first one; it counts once it is confirmed."""
        candidate, self.candidate = self.candidate, stamp
        if candidate is not None:
            leapt = candidate + self.offset - self.last
            if leapt > 0.0 or self.alone:
                ahead = stamp - candidate > 0.0
                if ahead and stamp - candidate <= self._leap:
                    self._advance(shifted)
                elif ahead and stamp - candidate <= 2.0 * leapt:  # a slow rig, each of whose stamps leaps
                    self.last, self.alone = candidate + self.offset, False
        return shifted

    def _follow_step_back(self, stamp: float, shifted: float) -> float:
        """Handle a stamp that lies far back; if the stamp before confirms it, set a new offset."""
        candidate, self.candidate = self.candidate, stamp
        if candidate is None or not 0.0 < stamp - candidate <= self._leap or candidate + self.offset > self.last:
            return shifted
        self.offset = self.last + self._gap - stamp
        self._advance(stamp + self.offset)
        return self.last
