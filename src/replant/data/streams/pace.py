"""Pace: when the samples of a record or of a simulation are due."""

from __future__ import annotations

import math
import time

from replant.data.streams.address import Address
from replant.data.streams.alarm import Alarm

LONGEST_PAUSE = 3600.0
"""Longest pause at once: beyond it the system's timers may refuse [s]."""


class Pace:
    """A clock that runs ``speed`` times as fast as real time, from its first look.

    Parameters
    ----------
    speed : float
        1 for real time, infinite for as fast as possible.

    Examples
    --------
    >>> Pace(math.inf).gone()
    inf
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._begun: float | None = None

    def gone(self) -> float:
        """Return how much of the record has gone by, in its s."""
        now = time.monotonic()
        self._begun = now if self._begun is None else self._begun
        return math.inf if math.isinf(self._speed) else (now - self._begun) * self._speed

    def wait(self, alarm: Alarm, elapsed: float) -> None:
        """Wait until ``elapsed`` s of the record have gone by, or the alarm is rung."""
        alarm.wait(min(max(elapsed - self.gone(), 0.0) / self._speed, LONGEST_PAUSE))


def speed_of(address: Address, default: float) -> float:
    """Return the option ``speed`` of a URL: a positive number, or ``max``."""
    if address.options.get("speed") == "max":
        return math.inf
    return address.positive("speed") or default
