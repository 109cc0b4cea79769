"""A record of several inputs that is parted at each load: offset and initial states are other ones since."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

from replant.estimation.simulation.miso import RowRecord
from replant.estimation.solver.miso_breaks import PARTS, are_sure, find_break, find_plant_change
from replant.estimation.solver.miso_change import Judge
from replant.fitting.miso_solve import RowSolution, begun_at, solve_with
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.verdict.record_tests import changed_finding, load_finding
from replant.verdict.verdict import Finding


class Parted(NamedTuple):
    """A record that was parted, its estimate, and what there is to say."""

    ready: RowRecord
    solution: RowSolution | None
    findings: tuple[Finding, ...]
    loads: tuple[int, ...]  # samples of the record since which another load acts


def solve_parted(
    structures: tuple[Structure, ...], ready: RowRecord, references: FloatArray | None, names: tuple[str, ...]
) -> Parted:
    """Return the estimate of a record, see `solve_with`, and what has changed within it."""
    whole = found = Parted(*solve_with(structures, ready, references, names), ())
    without: set[tuple[int, int]] = set()
    while found.solution is not None:
        row, estimate, _ = found.solution
        change = find_break(row, estimate.point.theta, estimate.noise, without)
        if change is None:
            break
        if len(found.loads) == PARTS:
            return whole
        loads = tuple(sorted((*found.loads, change.begin)))
        record = replace(ready.record, begins=tuple(sorted({*ready.record.begins, *loads})))
        begins = partial(begun_at, estimate.point.theta)
        found = Parted(*solve_with(structures, replace(ready, record=record), references, names, begins), loads)
    if found.loads:
        found = Parted(*solve_with(structures, found.ready, references, names), found.loads)
    if not found.loads or found.solution is None or whole.solution is None:
        return whole
    kept = found if _are_sure(found.solution, whole.solution, found.loads) else whole
    after = [kept.ready.record.first(load + 1).span for load in kept.loads]
    return kept._replace(findings=(*kept.findings, *_of_plant(found.solution), *load_finding(after)))


def _are_sure(parted: RowSolution, whole: RowSolution, loads: tuple[int, ...]) -> bool:
    judges = (Judge(each.found.point.theta, each.found.noise) for each in (parted, whole))
    return are_sure(parted.row, next(judges), whole.row, next(judges), loads)


def _of_plant(solution: RowSolution) -> tuple[Finding, ...]:
    change = find_plant_change(solution.row, solution.found.point.theta)
    if change is None:
        return ()
    return (changed_finding(solution.row.record.last(solution.row.record.u.size - change.begin).span),)
