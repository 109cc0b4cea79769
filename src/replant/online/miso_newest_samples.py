"""The estimate and the verdict of an identification of several inputs over its newest samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.simulation.miso import Point, Row, RowRecord, evaluate
from replant.estimation.solver.solve import leaving_out
from replant.fitting.miso_solve import RowEstimate, RowSolution, doubts_of, with_outside
from replant.kernels.schema import Doubt
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import quiet
from replant.online.miso_recursion import RowRecursion
from replant.online.miso_state import RowState
from replant.verdict.miso_inputs import controlled, timing
from replant.verdict.miso_tests import judged, left_out
from replant.verdict.sensor_and_excitation import FOLLOWED, guard_findings, left_out_finding
from replant.verdict.verdict import Finding, Verdict, duration

NO_COLUMNS: Mapping[str, FloatArray] = {}


class Newest(NamedTuple):
    """The newest samples, the estimate evaluated over them, and the verdict."""

    ready: RowRecord
    solution: RowSolution
    verdict: Verdict


@quiet
def newest_of(state: RowState, others: Mapping[str, FloatArray] = NO_COLUMNS) -> Newest | None:
    """Return the newest samples with the estimate over them and the verdict; None if they are too few."""
    known = state.recursion
    if known is None:
        return None
    if np.isfinite(state.newest_rows[:, -2]).sum() <= known.delta.size:
        return None
    ready, row, references = state.record(RECENT)
    if row.count <= row.nuisances:
        return None
    is_moved = np.zeros(len(row.structures), bool) if known.instruments is None else known.instruments.is_moved
    ready, _ = with_outside(ready, references, row.names, is_moved)
    doubt = doubts_of(row, ready, _over(row, known), known.noise)
    row = Row(row.structures, leaving_out(ready.record, doubt), ready.inputs, row.names, ready.outside)
    if row.count <= row.nuisances:
        return None
    point = _over(row, known)
    # findings of the last solution take precedence: without a noise model inputs seem to answer a coloured error
    of_model = state.findings or (*controlled(row, point, known.noise),) or (*timing(row, point),)
    findings: list[Finding] = []
    if not row.is_stable(point.theta):
        findings.append(Finding("diverged", "an update has made a pole unstable: solve again, with finish, or reset"))
    if known.surprising:
        findings += guard_findings(0.0, False, known.surprising * state.settings.dt, False)
    if known.counts[2]:
        findings.append(Finding("diverged", "an update would have left float64: begin again, with reset"))
    rest = {name: signal[ready.used] for name, signal in others.items()}
    findings += [*state.of_references, *left_out(row, point, known.noise, rest)]  # the column that explains most
    findings += left_out_finding(int((doubt == Doubt.STUCK).sum()))
    if state.record_began:
        findings.append(Finding("trusted", FOLLOWED.format(duration(state.length * state.settings.dt))))
    found = RowEstimate(point, known.noise, known.covariance, (*of_model, *findings))
    verdict = judged(row, point, known.noise, known.covariance, of_model, findings, is_of_record=False)
    return Newest(ready, RowSolution(row, found, doubt), verdict)


def _over(row: Row, known: RowRecursion) -> Point:
    """Return the estimate evaluated over a row."""
    theta = known.parameters_in(row)
    point = evaluate(row, theta, known.noise)
    return evaluate(row, theta, known.noise, point)  # with the initial states of the first
