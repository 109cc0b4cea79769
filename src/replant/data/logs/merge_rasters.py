"""Signals on rasters of their own, merged exactly: the input is held, the output is taken where it was measured.

Nothing is resampled.  At a time t the input is the value of its newest stamp, u(t) = u_k for t_k <= t < t_(k+1), as an
actuator holds it; the reference likewise.  The output is known at its own stamps alone.

The rows are the stamps of the output, if the input changes at none but them: then nothing is lost.  Otherwise a change
between two outputs would come too late, by up to an interval, which looks like dead time.  The rows then are the stamps
of output and input together, and the output is NaN, a missing one, where it was not measured.  Of rasters that nest, as
10 ms and 100 ms, the finer one results, with a regular clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ROUNDING = 4.0
"""Difference up to which two stamps are the same: rounding of computed stamps, as 3 * 0.1 and 0.3 [spacings of float64
at the latest stamp].
"""


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal with its own time stamps."""

    t: FloatArray
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Merged:
    """Signals at common stamps."""

    t: FloatArray
    output: FloatArray
    held: tuple[FloatArray, ...]


def merge(output: Signal, held: Sequence[Signal]) -> Merged:
    """Merge an output with inputs and references, all of which have at least one sample.

    The rows begin with the first output for which each held signal is known.  They end with the last output up to which
    each is held: its last value for no longer than its longest interval, after which the logger may have lost it.  The
    only value of a signal that was logged once is held for ever.

    The input steps at 0.2 s, where an output is measured, then at 0.3 s, where none is.  At 0.4 s the next one may have
    come to the former:

    >>> output = Signal(np.array([0.0, 0.2, 0.4]), np.array([0.0, 0.1, 0.9]))
    >>> merge(output, [Signal(np.array([0.0, 0.2]), np.array([0.0, 1.0]))]).held
    (array([0., 1.]),)
    >>> both = merge(output, [Signal(np.array([0.0, 0.2, 0.3]), np.array([0.0, 1.0, 0.0]))])
    >>> both.t, both.output, both.held
    (array([0. , 0.2, 0.3, 0.4]), array([0. , 0.1, nan, 0.9]), (array([0., 1., 0., 0.]),))
    """
    for signal in (output, *held):
        if not np.all(np.isfinite(signal.t)) or np.any(np.diff(signal.t) < 0.0):
            raise ValueError("the time stamps of a signal must be finite and never decrease")
    tolerance = ROUNDING * float(np.spacing(max(np.abs(signal.t).max() for signal in (output, *held))))
    held = [Signal(_snapped(signal.t, output.t, tolerance), signal.values) for signal in held]
    inside = np.ones(output.t.size, np.bool_)
    for signal in held:
        inside &= (output.t >= signal.t[0]) & (output.t < _held_until(signal.t) - tolerance)
    t, y = output.t[inside], output.values[inside]
    for signal in held:
        if not np.isin(signal.t[_changes(signal.values)], output.t).all():
            within = signal.t[(signal.t > t[0]) & (signal.t < t[-1])] if t.size else signal.t[:0]
            added = np.setdiff1d(within, t)
            t, y = np.concatenate([t, added]), np.concatenate([y, np.full(added.size, np.nan)])
            order = np.argsort(t, kind="stable")
            t, y = t[order], y[order]
    newest = [np.searchsorted(signal.t, t, side="right") - 1 for signal in held]
    return Merged(t, y, tuple(signal.values[at] for signal, at in zip(held, newest, strict=True)))


def _snapped(t: FloatArray, grid: FloatArray, tolerance: float) -> FloatArray:
    """Return stamps, each replaced by that of the grid which it equals but for rounding."""
    right = np.clip(np.searchsorted(grid, t), 0, grid.size - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(grid[left] - t) < np.abs(grid[right] - t), grid[left], grid[right])
    return np.where(np.abs(nearest - t) <= tolerance, nearest, t)


def _held_until(t: FloatArray) -> float:
    return float(t[-1] + np.diff(t).max()) if t.size > 1 else np.inf


def _changes(values: FloatArray) -> NDArray[np.bool_]:
    """Return which values differ from the one before; a missing one does not differ from another missing one."""
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return np.concatenate([np.zeros(min(values.size, 1), np.bool_), ~same])
