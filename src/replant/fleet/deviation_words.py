"""Deviation in words: a quantity of a rig beside what is usual, or beside what it was."""

from __future__ import annotations

import math

from replant.fleet.quantities import Quantity

MEDIAN, BEFORE = "the fleet's median", "what it was"


def compared(
    quantity: Quantity,
    log_ratio: float,
    std: float,
    *,
    is_reversed: bool = False,
    sure: float = 0.0,
    beside: str = MEDIAN,
) -> str:
    """Return a quantity beside another value of it in words.

    >>> compared(Quantity("time constant", ()), math.log(2.1), math.log(2.1) / 14)
    "time constant 2.1 times the fleet's median, 14 standard deviations"
    """
    times = _ratio(math.exp(min(max(log_ratio, -700.0), 700.0)))
    if is_reversed:
        return f"{quantity.name} of the opposite sign, {times} times {beside}, {sure:,.0f} standard deviations"
    return f"{quantity.name} {times} times {beside}, {abs(log_ratio) / std:,.0f} standard deviations"


def _ratio(value: float) -> str:
    """Return a ratio with two digits, near one with three.

    Examples
    --------
    >>> _ratio(2.143), _ratio(1.052), _ratio(1234.0)
    ('2.1', '1.05', '1,234')
    """
    if 0.9 < value < 1.1:
        return f"{value:.3g}"
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}" if value < 1e6 else f"{value:.1e}"
