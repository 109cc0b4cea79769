"""What came of one record, apart from the package: whoever reads it need not import that."""

from __future__ import annotations

from dataclasses import dataclass

RIGHT = 0.1
"""Largest error of an estimate that counts as right [root mean square, part of the true coefficients]."""


@dataclass(frozen=True)
class Outcome:
    """What came of one record.

    ``error``: root mean square of the coefficients' relative errors at the end; NaN where the order is wrong.
    ``late``: samples from the event until the verdict was no longer "trusted"; infinite where it stayed so.
    ``alarms``: samples taken for outliers or for those of a stuck sensor, and alarms, where there was nothing.
    ``figures``: those behind the verdict, to the last bit.
    """

    error: float
    status: str
    late: float
    alarms: int
    faulty: bool
    figures: str

    @property
    def trusted(self) -> bool:
        return self.status == "trusted"

    @property
    def is_right(self) -> bool:
        """Whether it may be trusted."""
        return not self.faulty and self.error <= RIGHT
