"""A record divided at each load, with new offset and initial states after it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

from replant.estimation.simulation.miso import Row, RowRecord
from replant.estimation.solver.change_contest import outputs_differ
from replant.estimation.solver.miso_change import Change, Judge, worth_of_lags
from replant.estimation.solver.record_changes import (
    Modelled,
    Parted,
    cost_beside,
    find_plant_change,
    is_another_in_parts,
    is_sure,
    loads_at_gaps,
    may_have_loads,
    parted,
    price,
    settled,
)
from replant.estimation.solver.solve import Solution, solve
from replant.estimation.solver.srivc_steps import Problem
from replant.fitting.miso_solve import RowSolution, solve_with
from replant.fitting.model_fields import has_rest
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import duration_of
from replant.verdict.sensor_and_excitation import CHANGED, LOADS_ACT, times_after
from replant.verdict.verdict import Finding, duration

# the residual due to a step of the sensor amid a record lasts for a fifth to two fifths of it
FEW = 10  # durations of the noise in a record up to which it may be due to a load [count]

#: Solves a record with loads that begin at these samples.
WithLoads = Callable[[tuple[int, ...]], Solution | None]


class PartedRow(NamedTuple):
    """A divided record of several inputs, its estimate, and the findings."""

    ready: RowRecord
    solution: RowSolution | None
    findings: tuple[Finding, ...]
    loads: tuple[int, ...] = ()  # samples at which another load begins
    plant: Change | None = None  # where the plant seems to change; the estimate is of both plants


def solve_parted_row(
    structures: tuple[Structure, ...],
    ready: RowRecord,
    references: FloatArray | None,
    names: tuple[str, ...],
    loads: tuple[int, ...] = (),
) -> PartedRow:
    """Return the estimate of a record, see `solve_with`, and the changes within it; ``loads`` may act."""

    @cache
    def solved(loads: tuple[int, ...]) -> PartedRow:
        record = replace(ready.record, begins=tuple(sorted({*ready.record.begins, *loads})))
        return PartedRow(*solve_with(structures, replace(ready, record=record), references, names))

    kept, suspected, loads, _ = parted(solved(()), _model_of_row, solved, loads=loads)
    findings, plant, tried = list(kept.findings), None, solved(suspected)
    if tried.solution is not None and tried.solution.row.record.begins != ready.record.begins:
        row, found, _ = tried.solution
        plant = find_plant_change(row, found.point.theta)
    if plant is not None:
        since = duration(ready.record.last(ready.record.u.size - plant.begin).span)
        findings.append(Finding("inconsistent", CHANGED.format(since)))
    if loads and kept.solution is not None:
        seconds = [kept.solution.row.record.first(load + 1).span for load in loads]
        findings.append(Finding("trusted", LOADS_ACT.format(times_after(seconds))))
    return kept._replace(findings=tuple(findings), loads=loads, plant=plant)


def _model_of_row(found: PartedRow) -> Modelled | None:
    if found.solution is None:
        return None
    row, estimate, _ = found.solution
    return Modelled(row, Judge(estimate.point.theta, estimate.noise))


def solve_parted(
    structure: Structure, whole: Solution, with_loads: WithLoads, others: Iterable[FloatArray] = ()
) -> Parted[Solution | None]:
    """Return the solution of a record of one input divided at its loads; ``whole`` is its solution without them."""
    others = list(others)
    at_gaps = _parted_at_gaps(structure, whole, with_loads, others)
    if at_gaps is None:
        return _parted_within(structure, whole, with_loads, others)
    found = _parted_within(
        structure, at_gaps.solution, lambda loads: with_loads(tuple(sorted({*at_gaps.loads, *loads}))), others
    )
    suspected, loads = (tuple(sorted({*at_gaps.loads, *more})) for more in (found.suspected, found.loads))
    return Parted(found.solution, suspected, loads, at_gaps.is_sure and found.is_sure)


def _parted_at_gaps(
    structure: Structure, whole: Solution, with_loads: WithLoads, others: Iterable[FloatArray]
) -> Parted[Solution] | None:
    """Return the solution divided at the gaps across which the level has changed; None if that is no likelier."""
    record, size = whole.record, structure.coefficients
    gaps = tuple(rows.start for rows in record.parts[1:] if rows.start not in record.begins)
    if not gaps or structure.bias:  # the offset is a parameter then
        return None
    row, loads = Row.of_one(structure, record), tuple[int, ...]()
    since_each = (with_loads(begins) for begins in (gaps,))  # another load after each gap
    for theta in _models(structure, whole, others, since_each):
        # refined as a row, whose parts have their own offsets, which removes the effect of a changed level on a model
        loads = loads_at_gaps(structure, record, *settled(row, *Judge.of(row, theta[:size])))
        if loads:
            break
    found = with_loads(loads) if loads else None
    if found is None:
        return None
    cost, usual = (
        cost_beside(structure, record, each.found.theta, each.found.noise_model, begins)
        for each, begins in ((found, loads), (whole, ()))
    )
    if not (0.0 < cost < math.inf and 0.0 < usual < math.inf):
        return None
    cost *= worth_of_lags(row, found.found.noise_model, whole.found.noise_model)
    more, least = 0.5 * record.count * math.log(usual / cost), len(loads) * price(record.count)
    model = _model_of(structure, found)
    if more <= least or model is None:
        return None
    return Parted(found, loads, loads, is_sure(*model, more, least))


def _parted_within(
    structure: Structure, whole: Solution, with_loads: WithLoads, others: Iterable[FloatArray]
) -> Parted[Solution | None]:
    """Return the solution divided at the loads that begin within stretches of the record."""
    row, samples = Row.of_one(structure, whole.record), whole.record.u.size
    halves = slice(0, samples // 2), slice(samples // 2, samples)
    of_halves = (solve(structure, whole.record.part(rows)) for rows in halves)
    # a slow pole may have followed a load completely: then other models (T,), or those of the halves, show it
    for theta in _models(structure, whole, others, of_halves):
        judge = Judge.of(row, theta[: structure.coefficients])
        if may_have_loads(row, judge.theta):
            return parted(whole, partial(_model_of, structure), with_loads, judge)
    return Parted[Solution | None](whole)


def _models(
    structure: Structure, whole: Solution, others: Iterable[FloatArray], of_parts: Iterable[Solution | None]
) -> Iterator[FloatArray]:
    """Yield the model (T,) of a record, others, and those of parts if a pole of model or noise is too slow for it."""
    yield whole.found.theta
    yield from others
    g, noise = structure.transfer_function(whole.found.theta[: structure.size]), whole.found.noise_model.coefficients
    if not (has_rest(g, whole.record.span) and whole.record.count > FEW * duration_of(noise)):
        yield from (part.found.theta for part in of_parts if part is not None)


def rival_of(
    structure: Structure, whole: Solution, found: Parted[Solution | None], with_loads: WithLoads
) -> Parted[Solution] | None:
    """Return the division that speaks against the model of all samples: by another G(s), or a change of the plant."""
    divided, differ = found.solution, partial(outputs_differ, Problem(structure, whole.record))
    if found.loads and divided is not None and differ(divided.found.theta, whole.found.theta):
        return Parted(divided, found.suspected, found.loads, is_sure=False)
    # a change of the plant looks like loads: the level changes with the gain.  One G(s) of parts of which none has it
    # is that of all samples, and hardly likelier
    model = _model_of(structure, whole) if found.suspected else None
    if model is None or not is_another_in_parts(model, found.suspected):
        return None
    tried = with_loads(found.suspected)
    return None if tried is None else Parted(tried, found.suspected, found.suspected, is_sure=False)


def _model_of(structure: Structure, solution: Solution | None) -> Modelled | None:
    if solution is None:
        return None
    row = Row.of_one(structure, solution.record)
    return Modelled(row, Judge.of(row, solution.found.theta[: structure.coefficients]))
