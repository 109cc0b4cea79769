"""Provisional model: what the samples of the start-up give, until they suffice for a model to go on from.

It is solved for with the first outputs measured: at half, a quarter, an eighth ... of the start-up, and each time that
a start-up which does not suffice has doubled, from the usual starts; from half of the start-up on at three sizes in
between, from the model before.  Nothing that comes later depends on it.
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
    [31, 62, 125, 625]
    """
    later = request.first_hold
    while later <= held:
        later *= 2
    return min((size for size, _ in _sizes(request, later) if size > held), default=later)


def provisional(request: Request, kept: RecentSamples, solved: Solved) -> tuple[int, Refined] | None:
    """Return the newest provisional model, and how many outputs it is made from; None where there is none."""
    if not request.wants_instruments:
        return None
    there = np.flatnonzero(kept.is_measured)
    for size, begun in _sizes(request, there.size):
        for number in (begun, size):
            if number not in solved:
                given = solved[begun] if number > begun else None
                solved[number] = _solved(request, kept[: there[number - 1] + 1], given)
        refined = solved[size]
        if refined is not None and refined.settled:
            return size, refined
    return None


def _solved(request: Request, kept: RecentSamples, given: Refined | None) -> Refined | None:
    """Return the estimate of some samples, from a given one or from the usual starts."""
    mapped, clean = cleaned(request, kept)
    preprocess = mapped.preprocess.resolve(clean.input.copy(), clean.output.copy())
    solution = modelled(request, preprocess, kept, [] if given is None else [given.theta])
    return None if solution is None else solution.found


def _sizes(request: Request, held: int) -> Iterator[tuple[int, int]]:
    """Yield at how many measured outputs, up to ``held``, a provisional model is solved for, the most first.

    Beside each comes the number whose model it starts from; the same number where it starts from none.
    """
    size = request.first_hold
    while 2 * size <= held:
        size *= 2
    while size >= request.least_startup:
        for quarters in (7, 6, 5, 4) if 2 * size >= request.startup else (4,):
            if size * quarters // 4 <= held:
                yield size * quarters // 4, size
        size //= 2
