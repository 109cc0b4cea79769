"""Provisional model: what the samples held for start-up give, until they suffice for a model to go on from.

It is solved for with the first samples held, at half, a quarter, an eighth ... of the start-up, and each time that a
start-up which does not suffice has doubled.  Nothing that comes later depends on it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replant.offline.refined import Refined
from replant.online.startup import Held, modelled
from replant.settings import Request
from replant.statistics.robust import without_spikes

Solved = dict[int, tuple[Held, Refined | None]]
"""Estimates by the number of samples held that they are made from, each with the newest of these samples."""


def next_provisional(request: Request, held: int) -> int:
    """Return at how many samples held, more than ``held``, a provisional model is solved for next.

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


def provisional(request: Request, held: list[Held], solved: Solved, *, reference: bool) -> tuple[int, Refined] | None:
    """Return the newest provisional model, and the number of samples that it is made from; None where there is none.

    Parameters
    ----------
    request : Request
    held : list of (u, y, t, r)
        Samples held so far.
    solved : dict
        What was solved for before; changed in place.  A solution holds as long as its samples are held.
    reference : bool
        Whether the samples come with a reference.
    """
    if not request.wants_instruments:
        return None
    for size in _sizes(request, len(held)):
        newest = held[size - 1]
        if size not in solved or solved[size][0] is not newest:
            solved[size] = newest, _solve(request, held[:size], reference=reference)
        refined = solved[size][1]
        if refined is not None and refined.settled:
            return size, refined
    return None


def _sizes(request: Request, held: int) -> Iterator[int]:
    """Yield at how many samples, up to ``held``, a provisional model is solved for, the most first."""
    size = request.first_hold
    while 2 * size <= held:
        size *= 2
    while size >= request.least_startup:
        if size <= held:
            yield size
        size //= 2


def _solve(request: Request, held: list[Held], *, reference: bool) -> Refined | None:
    u, y, t, r = np.array(held, np.float64).T.copy()
    y = without_spikes(y)
    preprocess = request.preprocess.resolve(u, y)
    return modelled(request, preprocess, u, y, t, r if reference else None)[1]
