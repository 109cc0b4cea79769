"""The clock of a place: jumps that daylight saving time or midnight makes in time stamps without a zone or a date."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.errors import LogError, shown

_HOUR = 3600.0  # by how much daylight saving time turns a clock [s]
_DAY = 86400.0  # by how much a clock without a date goes back at midnight [s]
_NEAR = 0.5  # difference of a jump from an hour or a day up to which it is one [usual intervals]

_REMEDY = "write the stamps with their offset from UTC (+01:00), or give the sampling time (dt, --dt)"


class LocalClock:
    """Looks for such jumps in time stamps that are given block by block.

    >>> clock = LocalClock(Path("log.csv"), "time", "row {}".format, has_date=True)
    >>> clock.check(np.array([0.0, 60.0, 120.0]))
    >>> clock.check(np.array([-3420.0]))
    Traceback (most recent call last):
    replant.errors.LogError: log.csv: row 3, column 'time': the clock goes back by 3540 s, ...
    """

    def __init__(self, path: Path, name: str, describe_row: Callable[[int], str], *, has_date: bool) -> None:
        self._path, self._name, self._describe_row, self._has_date = path, name, describe_row, has_date
        self._rows, self._last, self._usual = 0, np.empty(0), math.nan

    def check(self, stamps: NDArray[np.float64]) -> None:
        """Look at the next stamps, in s."""
        row = self._rows - self._last.size
        known = np.concatenate([self._last, stamps])
        steps = np.diff(known)
        forward = steps[steps > 0.0]
        if math.isnan(self._usual) and forward.size:
            self._usual = float(np.median(forward))
        for jump, said in self._jumps():
            found = np.abs(steps - self._usual - jump) <= _NEAR * self._usual
            if found.any() and self._usual < 0.25 * _HOUR:
                at = int(np.argmax(found))
                raise LogError(
                    f"{self._path}: {self._describe_row(row + at + 1)}, column {shown(self._name)}: the clock goes "
                    f"{'back' if jump < 0.0 else 'on'} by {abs(steps[at]):.6g} s, {said}"
                )
        self._rows += stamps.size
        self._last = known[-1:]

    def _jumps(self) -> list[tuple[float, str]]:
        back = (-_HOUR, f"as at the end of daylight saving time; {_REMEDY}")
        forth = (_HOUR, f"as at the beginning of daylight saving time, or after a pause of an hour; {_REMEDY}")
        midnight = "as at midnight; write the date into the column, too, or give the sampling time (dt, --dt)"
        return [back, forth] if self._has_date else [(-_DAY, midnight)]
