"""Dead time as whole samples and a fraction of one."""

from __future__ import annotations


def split_delay(delay: float, dt: float) -> tuple[int, float]:
    """Return a dead time in s as whole samples and a fraction of one; a fraction below 1e-9 is rounded away.

    Examples
    --------
    >>> split_delay(0.3, 0.1), split_delay(0.025, 0.02)
    ((3, 0.0), (1, 0.25))
    """
    samples = delay / dt
    nearest = round(samples)
    if abs(samples - nearest) < 1e-9 * max(1.0, samples):
        return nearest, 0.0
    return int(samples), samples - int(samples)
