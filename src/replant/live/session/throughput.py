"""Throughput: how many samples a second are learned, and how long they take from arrival to the estimate."""

from __future__ import annotations

import time


class Throughput:
    """Measures rate and lag of the samples that a session learns.

    Examples
    --------
    >>> throughput = Throughput()
    >>> throughput.count(10, arrived=time.monotonic() - 0.5)
    >>> rate, lag = throughput.read()
    >>> rate, round(lag, 1)
    (0.0, 0.5)
    """

    def __init__(self) -> None:
        self._since: float | None = None  # beginning of the current second; None before the first sample
        self._samples, self._rate, self._lag = 0, 0.0, 0.0

    def count(self, samples: int, arrived: float) -> None:
        """Count samples that were learned just now; ``arrived`` is the time at which the newest arrived."""
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        self._samples += samples
        self._lag = max(self._lag, now - arrived)

    def read(self) -> tuple[float, float]:
        """Return samples a second, over about one second, and the longest lag in s since `reset_lag`."""
        now = time.monotonic()
        if self._since is not None and now - self._since >= 1.0:
            self._rate, self._samples, self._since = self._samples / (now - self._since), 0, now
        return self._rate, self._lag

    def reset_lag(self) -> None:
        """Forget the longest lag."""
        self._lag = 0.0
