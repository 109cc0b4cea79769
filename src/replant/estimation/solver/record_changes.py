"""Every change within a whole record, of one input or several.

It is parted where something has changed, and solved again, until one model explains each stretch: of several changes
each hides the others.  Whether they are changes, and no drift, is asked when all are known: what they explain together
beside the noise that either model leaves.  So is where the plant has changed, and not only a load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Generic, NamedTuple, TypeVar

from replant.estimation.engine.record import Record
from replant.estimation.simulation.miso import Row, evaluate, noise_of
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
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import quiet

# with more loads than parts no model may be without one, and what changes so often is a drift
PARTS = 4  # parts of a stretch whose models judge it [count]


Solved = TypeVar("Solved")


class Modelled(NamedTuple):
    """A row, and a model of it."""

    row: Row
    judge: Judge


class Parted(NamedTuple, Generic[Solved]):
    """The likeliest solution of a record: of the whole, or parted at loads, since these samples of it."""

    solution: Solved
    suspected: tuple[int, ...] = ()  # all loads that may have acted, likelier or not; of too many the surest
    loads: tuple[int, ...] = ()
    is_sure: bool = True  # also beside how differently the model fits each stretch


@quiet
def may_have_loads(row: Row, theta: FloatArray, *, of_plant: bool = False) -> bool:
    """Return whether loads seem to act in a row, or ``of_plant`` another plant: a quick question before `parted`."""
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
    """Return the solution of a record that is parted at each load; ``whole`` where that is no likelier."""
    # the first load is looked for by ``judge``, in the place of the model of the whole, and beside ``loads``: may act
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
    """Return whether a parted row is also likelier beside how differently its model fits each stretch."""
    differently, numbers = dispersion(row, judge)
    return math.isfinite(numbers) and weighed(more, differently, numbers) > least


def _begun_at(model: Modelled, loads: tuple[int, ...]) -> Modelled:
    """Return the model that steps from another one lead to with loads, and the noise that it leaves."""
    row = _with_loads(model.row, loads)
    return Modelled(row, settled(row, *model.judge))


def settled(row: Row, theta: FloatArray, noise: Autoregression) -> Judge:
    """Return the model that steps from another one lead to, with the noise that it leaves."""
    for _ in range(2):
        point = refine(row, theta, noise)
        theta, noise = point.theta, noise_of(row, point)
    return Judge(theta, noise)


def _with_loads(row: Row, loads: tuple[int, ...]) -> Row:
    """Return a row with other offsets and initial states since some samples."""
    record = replace(row.record, begins=tuple(sorted({*row.record.begins, *loads})))
    return row.over(record)


def _find_break(row: Row, judge: Judge, without: set[tuple[int, int]]) -> Change | None:
    """Return what is surest to have changed within a stretch; None without, or with references; fills ``without``."""
    found = []
    for begin, end in ((each.rows.start, each.rows.stop) for each in row.stretches if row.outside is None):
        is_told = (begin, end) not in without and end - begin >= 2 * PARTS  # each part of it has an interval
        change = _within(row.part(slice(begin, end)), begin, judge) if is_told else None
        if change is None:
            without.add((begin, end))
        else:
            found.append(change)
    return max(found, key=lambda each: each.evidence, default=None)


def _needless(whole: Row, judge: Judge, loads: tuple[int, ...]) -> int:
    """Return the load that explains least beside a model, where that is no more than it costs; else 0."""
    # what seemed to be a change while another one was not known yet may be none
    row = without_unknown(whole, set(loads))

    def cost(loads: tuple[int, ...]) -> float:
        return evaluate(_with_loads(row, loads), *judge).cost

    usual = cost(loads)
    if not 0.0 < usual < math.inf:
        return 0
    least, load = min((cost(tuple(each for each in loads if each != load)), load) for load in loads)
    return load if 0.5 * row.count * math.log(least / usual) < _price(row) else 0


def _price(row: Row) -> float:
    """Return by how much likelier a load must make a row: by its numbers, and the odds against it."""
    return 0.5 * row.nuisances * math.log(row.count) - math.log(ALPHA)


def _explained(parted: Modelled, whole: Modelled, loads: tuple[int, ...]) -> tuple[float, float]:
    """Return how much likelier a row is that is parted at loads, and how much it has to be to be surely likelier."""
    models = parted, whole._replace(row=without_unknown(whole.row, set(loads)))
    cost, usual = (evaluate(row, *judge).cost for row, judge in models)
    if not (0.0 < cost < math.inf and 0.0 < usual < math.inf):
        return 0.0, math.inf
    row, judge = parted
    cost *= worth_of_lags(row, judge.noise, whole.judge.noise)
    return 0.5 * row.count * math.log(usual / cost), len(loads) * _price(row)


@quiet
def find_plant_change(row: Row, theta: FloatArray) -> Change | None:
    """Return where the plant is surest to have changed, of the samples where a stretch begins; None where nowhere."""
    found = (plant_change(row, stretch.rows.start, theta) for stretch in row.stretches[1:] if row.outside is None)
    return max((each for each in found if each is not None), key=lambda each: each.evidence, default=None)


@quiet
def plant_changed(
    structure: Structure, record: Record, parameters: FloatArray, *, loads: bool, most: int
) -> PlantChange | None:
    """Return that the plant has changed in a record that was solved: since a load, or else in its newest samples."""
    if not loads:
        return change_within(structure, record.last(most), parameters)
    found = find_plant_change(Row.of_one(structure, record), parameters[: structure.coefficients])
    return None if found is None else PlantChange(record.u.size - found.begin)


def _within(stretch: Row, first: int, judge: Judge) -> Change | None:
    """Return what is surest to have changed in a stretch, or in a half of it, where several changes cancel."""
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
    """Yield the models of parts of a stretch that are long enough for one, from the model of all of it."""
    samples = stretch.record.u.size
    for number in range(PARTS):
        part = stretch.part(slice(number * samples // PARTS, (number + 1) * samples // PARTS))
        if part.count > 4 * (part.nuisances + theta.size):
            yield settled(part, theta, noise)
