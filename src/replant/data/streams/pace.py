"""Pace: the time at which the samples of a record or a simulation are due."""

from __future__ import annotations

import math
import time

from replant.data.streams.address import Address
from replant.data.streams.stop_request import StopRequest

LONGEST_PAUSE = 3600.0  # the longest single pause: the system's timers may refuse a longer one [s]


class Pace:
    """A clock that runs ``speed`` times as fast as real time, and starts when it is first read.

    >>> Pace(math.inf).elapsed()
    inf
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start: float | None = None

    def elapsed(self) -> float:
        """Return the time of the record that has passed, in s."""
        now = time.monotonic()
        self._start = now if self._start is None else self._start
        return math.inf if math.isinf(self._speed) else (now - self._start) * self._speed

    def wait(self, stop: StopRequest, until: float) -> None:
        """Wait until ``until`` s of the record have passed, or a stop is requested."""
        stop.wait(min(max(until - self.elapsed(), 0.0) / self._speed, LONGEST_PAUSE))


def speed_of(address: Address, default: float) -> float:
    """Return the option ``speed`` of a URL: a positive number, or infinity for ``max``.

    >>> speed_of(Address("demo?speed=max", "", options={"speed": "max"}), 1.0)
    inf
    """
    if address.options.get("speed") == "max":
        return math.inf
    return address.positive("speed") or default
