"""Curve: a signal over time, thinned for drawing; every point of it is one of the signal's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.online.trace import Trace

POINTS = 2000  # points of a curve: more than a panel has pixels, few enough for a small SVG [count]


@dataclass(frozen=True, eq=False)
class Curve:
    """Points of a signal.

    Attributes
    ----------
    t, values : (N,) arrays
        Time in s, and the signal there.
    """

    t: FloatArray
    values: FloatArray


def thin(values: FloatArray, points: int = POINTS) -> npt.NDArray[np.intp]:
    """Return the indices, in order, at which a signal (K,) is drawn: of each stretch the lowest and the highest.

    First and last are always among them; at most ``points`` + 2 are returned, all of them if there are no more.

    Examples
    --------
    >>> thin(np.array([0.0, 9.0, 1.0, 2.0, -5.0, 3.0, 4.0, 5.0]), points=4)
    array([0, 1, 4, 7])
    """
    if values.size <= points:
        return np.arange(values.size)
    stretch = -(-values.size // (points // 2))
    whole = values.size // stretch * stretch
    blocks = values[:whole].reshape(-1, stretch)
    starts = np.arange(0, whole, stretch)
    chosen = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1), [0, values.size - 1]]
    if whole < values.size:
        chosen.append([whole + int(values[whole:].argmin()), whole + int(values[whole:].argmax())])
    return np.unique(np.concatenate(chosen))


def curve(values: FloatArray, dt: float, points: int = POINTS) -> Curve:
    """Return a signal as a curve."""
    kept = thin(values, points)
    return Curve(np.asarray(kept * dt, np.float64), values[kept])


def transients(trace: Trace, dt: float, points: int = POINTS) -> dict[str, Curve]:
    """Return each parameter's estimate over time, by name; at t_k that of (21), before the update of sample k."""
    before = trace.before()
    return {name: curve(before[:, i], dt, points) for i, name in enumerate(trace.names)}
