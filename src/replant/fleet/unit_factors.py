"""Wrong units: a gain that differs from the fleet's by a factor between usual units, and nothing else does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from replant.fleet.quantities import Figures, Quantity
from replant.fleet.robust import Location

FACTORS = {
    "a power of ten": (10.0, 100.0, 1e3, 1e4, 1e6, 1e9),
    "degrees beside radians": (180.0 / math.pi,),
    "revolutions a minute beside rad/s": (30.0 / math.pi,),
    "revolutions a second beside rad/s": (math.tau,),
    "a minute beside a second": (60.0,),
    "inches beside mm": (25.4,),
    "km/h beside m/s": (3.6,),
    "pounds beside kg": (2.2046,),
    "bar beside psi": (14.504,),
}
NEAR = 3.0
"""Distance of a ratio from a factor up to which it may be that one [standard deviations].
Level: a normal variable is farther off in one of 370 cases.
"""
FARTHEST = 0.15
"""The same, however uncertain the ratio is [natural logarithm].
Derivation: a third of the distance between 2.2 and 3.6; a gain that is halved is no 1/2.2.
"""
WIDEST = 0.15
"""Uncertainty of a ratio beyond which too many factors are near [natural logarithm].
Derivation: half of the distance between neighbours in the list.
"""


def unit_factor(usual: Sequence[tuple[Quantity, float, float]], figures: Figures, place: Location, row: int) -> str:
    """Return which factor between units lies between the gain of a rig and the fleet's, in words; empty if none."""
    off, total = figures.x[row] - place.centre, (place.spread + figures.covariances[row]) * place.scale
    words = ""
    for quantity, _, _ in usual:
        w = figures.weights(quantity)
        if w is None:
            continue
        log_ratio, std = float(w @ off), math.sqrt(float(w @ total @ w))
        if quantity.name == "gain":
            words = _nearest(log_ratio, std, bool(figures.reversed[row][np.flatnonzero(w)].any()))
            if not words:
                return ""
        elif abs(log_ratio) > NEAR * std * 1.5:  # a wrong unit changes the gain alone
            return ""
    return words


def _nearest(log_ratio: float, std: float, is_reversed: bool) -> str:
    """Return the factor nearest to a ratio, in words.

    Examples
    --------
    >>> _nearest(math.log(0.001003), 0.01, False)
    "the gain is 1/1000 of the fleet's, nearly: a power of ten"
    >>> _nearest(math.log(57.4), 0.01, False)
    "the gain is 57.3 times the fleet's, nearly: degrees beside radians"
    >>> _nearest(math.log(0.53), 0.1, False)
    ''
    """
    if std > WIDEST or is_reversed:
        return ""
    tried = [(abs(abs(log_ratio) - math.log(each)), each, what) for what, of in FACTORS.items() for each in of]
    off, factor, what = min(tried)
    if off > min(NEAR * std, FARTHEST):
        return ""
    times = f"{factor:.4g}" if factor == round(factor) else f"{factor:.3g}"
    times = f"{times} times" if log_ratio > 0.0 else f"1/{times} of"
    return f"the gain is {times} the fleet's, nearly: {what}"
