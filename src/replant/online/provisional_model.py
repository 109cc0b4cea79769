"""Provisional model: what the samples of the start-up give, until they suffice for a model to go on from.

It is solved for with the first outputs measured, at half, a quarter, an eighth ... of the start-up, and each time
that a start-up which does not suffice has doubled.  Nothing that comes later depends on it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replant.engine.recent_samples import RecentSamples
from replant.offline.refined import Refined
from replant.online.startup import cleaned, modelled
from replant.settings import Request

Solved = dict[int, Refined | None]
"""Estimates by the number of measured outputs that they are made from."""


def next_provisional(request: Request, held: int) -> int:
    """Return at how many measured outputs, more than ``held``, a provisional model is solved for next.

    Examples
    --------
    >>> from replant.model.structure import Structure
    >>> [next_provisional(Request(Structure(1), 0.1), held) for held in (0, 31, 100, 500)]
    [31, 62, 125, 1000]
    """
    later = request.first_hold
    while later <= held:
        later *= 2
    return min((size for size in _sizes(request, later) if size > held), default=later)


def provisional(request: Request, kept: RecentSamples, solved: Solved) -> tuple[int, Refined] | None:
    """Return the newest provisional model, and how many outputs it is made from; None where there is none.

    Parameters
    ----------
    request : Request
    kept : RecentSamples
        Collected so far.
    solved : dict
        What was solved for before; changed in place.  It holds as long as none of the samples is dropped.
    """
    if not request.wants_instruments:
        return None
    there = np.flatnonzero(kept.is_measured)
    for size in _sizes(request, there.size):
        if size not in solved:
            some = kept[: there[size - 1] + 1]
            mapped, clean = cleaned(request, some)
            solution = modelled(request, mapped.preprocess.resolve(clean.input.copy(), clean.output.copy()), some)
            solved[size] = None if solution is None else solution.found
        refined = solved[size]
        if refined is not None and refined.settled:
            return size, refined
    return None


def _sizes(request: Request, held: int) -> Iterator[int]:
    """Yield at how many measured outputs, up to ``held``, a provisional model is solved for, the most first."""
    size = request.first_hold
    while 2 * size <= held:
        size *= 2
    while size >= request.least_startup:
        if size <= held:
            yield size
        size //= 2
