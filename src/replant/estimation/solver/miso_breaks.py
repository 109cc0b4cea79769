"""Every change within a whole record of several inputs.

It is parted where something has changed, and solved again, until one model explains each stretch: of several changes
each hides the others.  Whether they are changes, and no drift, is asked when all are known: what they explain together
beside the noise that either model leaves.  So is where the plant has changed, and not only a load.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from replant.estimation.simulation.miso import Row, evaluate, noise_of
from replant.estimation.solver.miso_change import (
    Change,
    Judge,
    likeliest_change,
    plant_change,
    without_unknown,
    worth_of_lags,
)
from replant.estimation.solver.miso_steps import refine
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import quiet

# with more loads than parts no model may be without one, and what changes so often is a drift
PARTS = 4  # parts of a stretch whose models judge it [count]


@quiet
def find_break(row: Row, theta: FloatArray, noise: Autoregression, whole: set[tuple[int, int]]) -> Change | None:
    """Return what is surest to have changed within a stretch of a row; None where one model explains each of them.

    Nor does one say what has changed where references move inputs.  Stretches in which nothing has are added to
    ``whole``, and not looked into again.
    """
    found = []
    for begin, end in ((each.rows.start, each.rows.stop) for each in row.stretches if row.outside is None):
        change = None if (begin, end) in whole else _within(_cut(row, slice(begin, end)), begin, theta, noise)
        if change is None:
            whole.add((begin, end))
        else:
            found.append(change)
    return max(found, key=lambda each: each.evidence, default=None)


@quiet
def are_sure(parted: Row, judge: Judge, whole: Row, other: Judge, loads: tuple[int, ...]) -> bool:
    """Return whether a row that is parted at loads is surely likelier than the whole, each with a model of its own."""
    whole = without_unknown(whole, set(loads))
    cost, usual = (evaluate(row, *each).cost for row, each in ((parted, judge), (whole, other)))
    if not (0.0 < cost < math.inf and 0.0 < usual < math.inf):
        return False
    cost *= worth_of_lags(parted, judge.noise, other.noise)
    price = 0.5 * parted.nuisances * math.log(parted.count) - math.log(ALPHA)
    return 0.5 * parted.count * math.log(usual / cost) > len(loads) * price


@quiet
def find_plant_change(row: Row, theta: FloatArray) -> Change | None:
    """Return where the plant is surest to have changed, of the samples where a stretch begins; None where nowhere."""
    found = (plant_change(row, stretch.rows.start, theta) for stretch in row.stretches[1:] if row.outside is None)
    return max((each for each in found if each is not None), key=lambda each: each.evidence, default=None)


def _within(stretch: Row, first: int, theta: FloatArray, noise: Autoregression) -> Change | None:
    """Return what is surest to have changed in a stretch, or in a half of it, where several changes cancel."""
    if not stretch.stretches:
        return None
    samples, judges = stretch.record.u.size, list(_judges(stretch, theta, noise))
    halves = (slice(k * samples // 4, (k + 2) * samples // 4) for k in range(3))
    for windows in ([slice(0, samples)], halves):
        parts = [(window.start, _cut(stretch, window)) for window in windows]
        found = [
            replace(change, begin=first + begin + change.begin)
            for begin, part in parts
            if part.stretches and (change := likeliest_change(part, theta, judges, of_any_noise=False)) is not None
        ]
        if found:
            return max(found, key=lambda each: each.evidence)
    return None


def _judges(stretch: Row, theta: FloatArray, noise: Autoregression) -> Iterator[Judge]:
    """Yield the models of parts of a stretch that are long enough for one, from the model of all of it."""
    samples = stretch.record.u.size
    for number in range(PARTS):
        part = _cut(stretch, slice(number * samples // PARTS, (number + 1) * samples // PARTS))
        if part.count > 4 * (part.nuisances + theta.size):
            point = refine(part, theta, noise)
            point = refine(part, point.theta, noise_of(part, point))
            yield Judge(point.theta, noise_of(part, point))


def _cut(row: Row, rows: slice) -> Row:
    return Row(row.structures, row.record.part(rows), row.inputs[rows], row.names)
