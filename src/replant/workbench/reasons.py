"""Where in the plots a reason of a verdict can be seen: the stretch of time, the frequencies or the correlation."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBER = r"([-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?)"
_LAST = re.compile(rf"over the last {_NUMBER} s|of the last {_NUMBER} s|for the last {_NUMBER} s")
_AGO = re.compile(rf"{_NUMBER} s (?:ago|before the end)")
_POLE = re.compile(rf"(?:a pole at|near) {_NUMBER}(?: \+- {_NUMBER}j)? rad/s")
_INPUT = re.compile(r"the (?:input|reference) could explain|dead time of|the input seems to act|actuator seems")
_GAIN = re.compile(r"abs G|standard deviation|condition number|does not excite")
_OUTPUT = re.compile(r"constant to the bit|extreme of the output|no output has arrived|left out|sensor was stuck")
_COLOUR = re.compile(r"noise model|residual")


@dataclass(frozen=True)
class Place:
    """What to look at.

    Attributes
    ----------
    plot : {"output", "residual", "cross", "auto", "bode", "poles"}
    since : float or None
        How long before the end of the record the stretch begins, in s; None: the whole record.
    at : float or None
        Frequency in rad/s.
    """

    plot: str
    since: float | None = None
    at: float | None = None


def place_of(reason: str) -> Place:
    """Return where a reason can be seen.

    >>> place_of("the residual began to grow 12.5 s ago: the plant has changed")
    Place(plot='residual', since=12.5, at=None)
    >>> place_of("a zero may cancel the pole near -3.2 rad/s, so that the coefficients are not known")
    Place(plot='poles', since=None, at=3.2)
    >>> place_of("the input could explain another 12 % of the output's power over the last 40 s").plot
    'cross'
    """
    since = _first(_AGO, reason) or _first(_LAST, reason)
    found = _POLE.search(reason)
    if found:
        real, imag = (0.0 if each is None else _value(each) for each in found.groups())
        return Place("poles", since, round((real**2 + imag**2) ** 0.5, 12))
    for pattern, plot in ((_OUTPUT, "output"), (_INPUT, "cross"), (_AGO, "residual"), (_COLOUR, "auto")):
        if pattern.search(reason):
            return Place(plot, since)
    if _GAIN.search(reason) and "fits the output" not in reason:
        return Place("bode", since)
    return Place("output", since)


def _first(pattern: re.Pattern[str], reason: str) -> float | None:
    found = pattern.search(reason)
    return None if found is None else _value(next(group for group in found.groups() if group))


def _value(text: str) -> float:
    return float(text.replace(",", ""))
