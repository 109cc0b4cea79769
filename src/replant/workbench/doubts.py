"""Doubts: stretches of a log that may be left out, such as a stuck sensor, a gap in the clock, or missing outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.kernels.schema import Doubt as Suspect
from replant.offline.bad_samples import suspicious
from replant.simulation.stretches import stretches_of

SHOWN = 12  # stretches that are listed, the longest [count]
MOVES = 2  # moves of the input within it, without which the output may well rest [count]
GAP = 3.0  # distance of two time stamps from which on samples are missing between them [usual intervals]
MISSING = 10  # missing outputs in a row that are worth a line [count]


@dataclass(frozen=True)
class Doubt:
    """A stretch of time in s from the first sample, and what is the matter with it."""

    begin: float
    end: float
    what: str


def doubts(t: FloatArray, u: FloatArray | None, y: FloatArray | None) -> list[Doubt]:
    """Return what may be wrong, in the order of time; ``t`` (K,) in s from the first sample.

    >>> t = np.arange(400.0)
    >>> y = np.where((t >= 100) & (t < 160), 5.0, np.sin(t))
    >>> doubts(t, np.cos(t), y)
    [Doubt(begin=100.0, end=160.0, what='the output stays at 5 while the input moves')]
    """
    found = _gaps(t)
    if y is not None:
        found += _missing(t, y)
        if u is not None and u.size == y.size:
            found += _stuck(t, u, y)
    found = sorted(found, key=lambda each: each.begin - each.end)[:SHOWN]
    return sorted(found, key=lambda each: each.begin)


def _gaps(t: FloatArray) -> list[Doubt]:
    steps = np.diff(t)
    usual = float(np.median(steps)) if steps.size else 0.0
    places = np.flatnonzero(steps > GAP * usual) if usual > 0.0 else np.zeros(0, np.int64)
    return [Doubt(float(t[k]), float(t[k + 1]), f"no samples for {steps[k]:.4g} s") for k in places[: 10 * SHOWN]]


def _missing(t: FloatArray, y: FloatArray) -> list[Doubt]:
    rows = stretches_of(~np.isfinite(y)).tolist()
    return [Doubt(float(t[a]), _end(t, b), f"{b - a:,} outputs are missing") for a, b in rows if b - a >= MISSING]


def _stuck(t: FloatArray, u: FloatArray, y: FloatArray) -> list[Doubt]:
    """Return where a solution leaves the output out as that of a stuck sensor, and the input moves."""
    moved = np.concatenate([[0], np.cumsum(u[1:] != u[:-1])])
    return [
        Doubt(float(t[a]), _end(t, b), f"the output stays at {y[a]:.4g} while the input moves")
        for a, b in stretches_of(suspicious(u, y) == Suspect.STUCK).tolist()
        if moved[b - 1] - moved[a] >= MOVES
    ]


def _end(t: FloatArray, row: int) -> float:
    """Return when the sample behind a stretch was taken; of the last one, a step after it."""
    return float(t[row]) if row < t.size else float(2.0 * t[-1] - t[-2]) if t.size > 1 else float(t[-1])
