"""Dead time as whole samples and a fraction of one."""

from __future__ import annotations

WHOLE = 1e-9
"""Distance of a dead time from a whole number of samples up to which it counts as whole [part of it].
Derivation: some million times the precision of float64: a decimal fraction of a decimal sampling time is hit.
"""

NEVER = 2.0**53
"""Dead time that is longer than any record [samples].
Derivation: beyond, float64 does not hold every whole number.
"""


def unknown_outputs(delay: float, dt: float) -> int:
    """Return how many outputs of a record answer to inputs from before it, with a dead time in s.

    Examples
    --------
    >>> unknown_outputs(0.3, 0.1), unknown_outputs(0.32, 0.1)
    (3, 4)
    """
    samples, fraction = split_delay(delay, dt)
    return samples + (fraction > 0.0)


def split_delay(delay: float, dt: float) -> tuple[int, float]:
    """Return a dead time in s as whole samples and a fraction of one; a fraction below 1e-9 is rounded away.

    Examples
    --------
    >>> split_delay(0.3, 0.1), split_delay(0.025, 0.02)
    ((3, 0.0), (1, 0.25))
    """
    samples = min(delay / dt, NEVER)
    nearest = round(samples)
    if abs(samples - nearest) < WHOLE * max(1.0, samples):
        return nearest, 0.0
    return int(samples), samples - int(samples)
