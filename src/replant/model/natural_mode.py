"""Mode: a pole as an engineer reads it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Mode:
    """A pole with its frequency, damping and time constant.

    Attributes
    ----------
    pole : complex
        In rad/s.
    frequency : float
        Natural frequency abs(pole) / (2 pi), in Hz.
    damping : float
        -Re(pole) / abs(pole); 1 for a real stable pole, NaN at the origin.
    time_constant : float
        -1 / Re(pole) in s; infinite on the imaginary axis, negative for an unstable pole.
    """

    pole: complex
    frequency: float
    damping: float
    time_constant: float

    @classmethod
    def of(cls, pole: complex) -> Mode:
        """Return the mode of a pole.

        Parameters
        ----------
        pole : complex
            In rad/s.

        Examples
        --------
        >>> Mode.of(-3.0 + 4.0j).damping, Mode.of(-2.0 + 0.0j).time_constant
        (0.6, 0.5)
        """
        magnitude = abs(pole)
        damping = -pole.real / magnitude if magnitude else math.nan
        time_constant = -1.0 / pole.real if pole.real else math.inf
        return cls(pole, magnitude / (2 * math.pi), damping, time_constant)
