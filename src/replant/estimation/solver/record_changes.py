r"""All changes within a whole record, with one input or several.

The record is divided where something has changed and solved again, until one model explains each stretch, as several
changes hide each other.  When all are known, they are tested against a drift by what they explain together, with the
noise of either model, and against a change of the plant.

Loads of one input that begin in gaps are found first.  After a gap the initial state is unknown, the offset is that of
before.  Whitened, and with the initial states projected out, part i has the residual e_i, and the response c_i to a
unit offset.  Parts with a common offset leave the power

.. math:: \sum e_i^T e_i - (\sum c_i^T e_i)^2 / \sum c_i^T c_i .

At first each part has its own offset; gap by gap, the offsets on both sides are merged where that costs least, until
all remaining gaps surely have a load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, stability_margin
from replant.estimation.simulation.miso import Row, colour_of, evaluate, noise_of
from replant.estimation.solver.change_evidence import weighed
from replant.estimation.solver.change_search import PlantChange, change_within
from replant.estimation.solver.miso_change import (
    Change,
    Judge,
    dispersion,
    is_suspect,
    likeliest_change,
    plant_change,
    without_unknown,
    worth_of_lags,
)
from replant.estimation.solver.miso_steps import refine
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, ROUNDING
from replant.numerics.linear_algebra import inner, quiet, sum_of_squares
from replant.numerics.projections import LEFT, without

# with more loads than parts, no part may be free of a load; so many changes are a drift
PARTS = 4  # parts of a stretch whose models judge it [count]


Solved = TypeVar("Solved")


class Modelled(NamedTuple):
    """A row, and a model of it."""

    row: Row
    judge: Judge


class Parted(NamedTuple, Generic[Solved]):
    """The likeliest solution of a record: of the whole, or divided at the samples where loads begin."""

    solution: Solved
    suspected: tuple[int, ...] = ()  # all loads found, accepted or not; the surest one if they are too many
    loads: tuple[int, ...] = ()
    is_sure: bool = True  # also in view of the dispersion between stretches


@quiet
def may_have_loads(row: Row, theta: FloatArray, *, of_plant: bool = False) -> bool:
    """Return whether loads, or with ``of_plant`` another plant, seem to act in a row: a quick test before `parted`."""
    windows = (part for stretch in row.stretches for _, part in _windows(row.part(stretch.rows)))
    return any(is_suspect(part, theta, of_plant=of_plant) for part in windows if part.stretches)


@quiet
def parted(
    whole: Solved,
    model_of: Callable[[Solved], Modelled | None],
    solved: Callable[[tuple[int, ...]], Solved],
    judge: Judge | None = None,
    loads: tuple[int, ...] = (),
) -> Parted[Solved]:
    """Return the solution of a record divided at each load; ``whole`` if that is no likelier."""
    # the search begins with ``judge`` instead of the model of the whole, and with ``loads`` that may act
    first = model_of(whole)
    model = model_of(solved(loads)) if loads else first
    if model is not None and judge is not None:
        model = model._replace(judge=judge)
    surest, without = loads, set[tuple[int, int]]()
    while model is not None and (change := _find_break(*model, without)) is not None:
        if len(loads) >= PARTS:
            return Parted(whole, surest)
        loads = tuple(sorted((*loads, change.begin)))
        surest, model = surest or loads, _begun_at(model, loads)
    if not loads or first is None:
        return Parted(whole)
    found = solved(loads)
    kept, model = loads, model_of(found)
    while model is not None and kept and (needless := _needless(first.row, model.judge, kept)):
        kept = tuple(load for load in kept if load != needless)
        model = _begun_at(first._replace(judge=model.judge), kept)
    if kept and kept != loads:
        found = solved(kept)
        model = model_of(found)
    if kept and model is not None:
        more, least = _explained(model, first, kept)
        if more > least:
            return Parted(found, loads, kept, is_sure(*model, more, least))
    return Parted(whole, loads)


def is_sure(row: Row, judge: Judge, more: float, least: float) -> bool:
    """Return whether a divided row is also likelier in view of the dispersion of its model between stretches."""
    differently, numbers = dispersion(row, judge)
    return math.isfinite(numbers) and weighed(more, differently, numbers) > least


def _begun_at(model: Modelled, loads: tuple[int, ...]) -> Modelled:
    """Return a row with loads, and its model refined from another one."""
    row = _with_loads(model.row, loads)
    return Modelled(row, settled(row, *model.judge))


def settled(row: Row, theta: FloatArray, noise: Autoregression) -> Judge:
    """Return the model refined from another one, with its noise model."""
    for _ in range(2):
        point = refine(row, theta, noise)
        theta, noise = point.theta, noise_of(row, point)
    return Judge(theta, noise)


def _with_loads(row: Row, loads: tuple[int, ...]) -> Row:
    """Return a row with new offsets and initial states from some samples on."""
    record = replace(row.record, begins=tuple(sorted({*row.record.begins, *loads})))
    return row.over(record)


def _find_break(row: Row, judge: Judge, without: set[tuple[int, int]]) -> Change | None:
    """Return the surest change within a stretch; None without one, or with references; fills ``without``."""
    found = []
    for begin, end in ((each.rows.start, each.rows.stop) for each in row.stretches if row.outside is None):
        is_searched = (begin, end) not in without and end - begin >= 2 * PARTS  # each part of it has an interval
        change = _within(row.part(slice(begin, end)), begin, judge) if is_searched else None
        if change is None:
            without.add((begin, end))
        else:
            found.append(change)
    return max(found, key=lambda each: each.evidence, default=None)


def _needless(whole: Row, judge: Judge, loads: tuple[int, ...]) -> int:
    """Return the load that explains least under a model, if less than its price; else 0."""
    # a change found while another one was unknown may be none
    row = without_unknown(whole, set(loads))

    def cost(loads: tuple[int, ...]) -> float:
        return evaluate(_with_loads(row, loads), *judge).cost

    usual = cost(loads)
    if not 0.0 < usual < math.inf:
        return 0
    least, load = min((cost(tuple(each for each in loads if each != load)), load) for load in loads)
    return load if 0.5 * row.count * math.log(least / usual) < price(row.count, row.nuisances) else 0


def price(count: int, numbers: int = 1) -> float:
    """Return the least log-likelihood gain of a load in ``count`` samples: its numbers' price, and odds against it."""
    return 0.5 * numbers * math.log(count) - math.log(ALPHA)


def _explained(parted: Modelled, whole: Modelled, loads: tuple[int, ...]) -> tuple[float, float]:
    """Return the log-likelihood gain of a row divided at loads, and the least gain that is sure."""
    models = parted, whole._replace(row=without_unknown(whole.row, set(loads)))
    cost, usual = (evaluate(row, *judge).cost for row, judge in models)
    if not (0.0 < cost < math.inf and 0.0 < usual < math.inf):
        return 0.0, math.inf
    row, judge = parted
    cost *= worth_of_lags(row, judge.noise, whole.judge.noise)
    return 0.5 * row.count * math.log(usual / cost), len(loads) * price(row.count, row.nuisances)


@quiet
def is_another_in_parts(whole: Modelled, loads: tuple[int, ...]) -> bool:
    """Return whether a model of each part of a row explains surely more than one of all, with loads or without."""
    row = without_unknown(whole.row, set(loads))
    divided = _with_loads(row, loads)
    judge = settled(divided, *whole.judge)
    parts, noise = [divided.part(stretch.rows) for stretch in divided.stretches], judge.noise
    if len(parts) <= len(loads) or any(part.count <= 4 * (part.nuisances + judge.theta.size) for part in parts):
        return False
    for _ in range(2):
        points = [refine(part, judge.theta, noise) for part in parts]
        noise = colour_of(divided, [left for point in points for left in point.residual])
    cost = sum(evaluate(part, point.theta, noise).cost for part, point in zip(parts, points, strict=True))
    usual, loaded = evaluate(row, *whole.judge).cost, evaluate(divided, *judge).cost
    if not all(0.0 < each < math.inf for each in (cost, usual, loaded)):
        return False
    count, free = row.count, len(loads) * row.nuisances
    one = min(usual, loaded * count ** (free / count) * worth_of_lags(row, judge.noise, whole.judge.noise))
    cost *= count ** (free / count) * worth_of_lags(row, noise, whole.judge.noise)
    more, least = 0.5 * count * math.log(one / cost), (len(parts) - 1) * price(count, judge.theta.size)
    return more > least and is_sure(divided, Judge(judge.theta, noise), more, least)


@quiet
def find_plant_change(row: Row, theta: FloatArray) -> Change | None:
    """Return the surest change of the plant at the begin of a stretch; None without one."""
    found = (plant_change(row, stretch.rows.start, theta) for stretch in row.stretches[1:] if row.outside is None)
    return max((each for each in found if each is not None), key=lambda each: each.evidence, default=None)


@quiet
def plant_changed(
    structure: Structure, record: Record, parameters: FloatArray, *, loads: bool, most: int
) -> PlantChange | None:
    """Return the change of the plant in a solved record: at one of its ``loads``, else in ``most`` newest samples."""
    if not loads:
        return change_within(structure, record.last(most), parameters)
    found = find_plant_change(Row.of_one(structure, record), parameters[: structure.coefficients])
    return None if found is None else PlantChange(record.u.size - found.begin)


def _within(stretch: Row, first: int, judge: Judge) -> Change | None:
    """Return the surest change in a stretch, else in a half of it, as several changes may cancel."""
    if not stretch.stretches:
        return None
    judges = list(_judges(stretch, *judge))
    likeliest = partial(likeliest_change, theta=judge.theta, judges=judges, of_any_noise=False)
    whole, *halves = _windows(stretch)
    for windows in ([whole], halves):
        found = [
            replace(change, begin=first + begin + change.begin)
            for begin, part in windows
            if part.stretches and (change := likeliest(part)) is not None
        ]
        if found:
            return max(found, key=lambda each: each.evidence)
    return None


def _windows(stretch: Row) -> list[tuple[int, Row]]:
    """Return a stretch, and three halves of it, with the sample that each begins with."""
    samples = stretch.record.u.size
    halves = (slice(k * samples // 4, (k + 2) * samples // 4) for k in range(3))
    return [(rows.start, stretch.part(rows)) for rows in (slice(0, samples), *halves)]


def _judges(stretch: Row, theta: FloatArray, noise: Autoregression) -> Iterator[Judge]:
    """Yield the models of the parts of a stretch that are long enough, refined from the model of all of it."""
    samples = stretch.record.u.size
    for number in range(PARTS):
        part = stretch.part(slice(number * samples // PARTS, (number + 1) * samples // PARTS))
        if part.count > 4 * (part.nuisances + theta.size):
            yield settled(part, theta, noise)


class _Part(NamedTuple):
    """The information of samples on their common offset."""

    begin: int
    length: float  # c'c
    told: float  # c'e

    @property
    def explained(self) -> float:
        """The power that their offset explains."""
        return self.told**2 / self.length if self.length > 0.0 else 0.0

    def joined(self, later: _Part) -> _Part:
        """Return the information of these and later samples on a common offset."""
        return _Part(self.begin, self.length + later.length, self.told + later.told)


@quiet
def loads_at_gaps(structure: Structure, record: Record, theta: FloatArray, noise: Autoregression) -> tuple[int, ...]:
    """Return the gaps across which the offset has surely changed, given a model (T,), each as the sample after it."""
    parts, power = _parts_of(structure, record, theta, noise)
    least, rounding = price(record.count), ROUNDING * sum_of_squares(record.y)
    while gaps := [place for place, part in enumerate(parts) if place and part.begin not in record.begins]:
        usual = max(power - sum(part.explained for part in parts), rounding)
        if not 0.0 < usual < math.inf:
            return ()
        pairs = ((place, parts[place - 1], parts[place]) for place in gaps)
        # how much less each pair explains with one offset than with two
        losses = ((one.explained + two.explained - one.joined(two).explained, place) for place, one, two in pairs)
        loss, place = min((max(loss, 0.0), place) for loss, place in losses)
        if 0.5 * record.count * math.log1p(loss / usual) > least:
            break
        parts[place - 1 : place + 1] = [parts[place - 1].joined(parts[place])]
    return tuple(parts[place].begin for place in gaps)


@quiet
def cost_beside(
    structure: Structure, record: Record, theta: FloatArray, noise: Autoregression, loads: Sequence[int] = ()
) -> float:
    """Return the power of the whitened residual of a model (T,), with new offsets after some gaps of the record."""
    (first, *others), power = _parts_of(structure, record, theta, noise)
    sharing = [first]
    for part in others:
        if part.begin in record.begins or part.begin in loads:
            sharing.append(part)
        else:
            sharing[-1] = sharing[-1].joined(part)
    return max(power - sum(part.explained for part in sharing), ROUNDING * sum_of_squares(record.y))


def _parts_of(
    structure: Structure, record: Record, theta: FloatArray, noise: Autoregression
) -> tuple[list[_Part], float]:
    """Return the information of each part of a record on its offset, and the residual power without an offset."""
    model = AuxiliaryModel(structure, record.dt, record.input_hold, margin=stability_margin(record))
    nuisances, entries = structure.poles + 1, without_nuisances(structure, theta[: structure.coefficients])
    parts, power = [], 0.0
    for rows in record.parts:
        part = record.part(rows)
        done = model.run(entries, part)
        white = part.whitened(noise, np.column_stack([done.phi[:, -nuisances:], done.error]))
        offset, error = without(white[:, [0, -1]], white[:, 1:-1]).T
        length, told = sum_of_squares(offset), inner(offset, error)
        if length <= LEFT**2 * sum_of_squares(white[:, 0]):  # the initial state explains all of it
            length = told = 0.0
        parts.append(_Part(rows.start, length, told))
        power += sum_of_squares(error)
    return parts, power
