"""Other columns of a file that explain a part of the residual: a second input, a measured disturbance.

The alternative "another column" has the columns of the alternative "other dynamics", made of the other signal.  What
the input could explain is projected out first, so that a delayed, filtered or scaled copy of the input explains
nothing.

A signal that is made from the output, as a filtered output or a control error, explains the output's noise, but is no
cause: unlike a cause it answers the residual, at once or later.  A signal that follows the input is a copy of it, the
measured position of the actuator, or another output: the input's past improves its prediction from its own past.  In
a closed loop a reference moves the output through the input: a signal that explains the input is then no cause either.
Nor is a clock, a signal that only increases or only decreases.

The columns are chosen one after the other: each time the one that explains most and follows no other one that explains
something.  Its columns are known from then on, so that a second sensor of the same cause is not named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, run_model
from replant.logs.sampling_time import time_candidates
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import MATTERS
from replant.numerics.linear_algebra import combined, quiet
from replant.numerics.projections import without
from replant.numerics.robust import last_known
from replant.numerics.score_test import Explained, Residual
from replant.verdict.alternatives import Acting, dynamics, power_of, residual_of
from replant.verdict.assess import MOST_SAMPLES
from replant.verdict.estimate_tests import without_longer
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.loop import Loop, Reference, answer
from replant.verdict.verdict import Assessment, percent

REFINED = 2  # times that the noise model is estimated again beside a column: a third changes no verdict [count]


@dataclass(frozen=True)
class OtherColumn:
    """A column that explains a part of the residual."""

    name: str
    size: float  # part of the output's power
    left: float  # part of the residual's power
    bias: float  # part of the output's power by the column that the model takes up, as the column moves with the input

    @property
    def reason(self) -> str:
        """The reason for the verdict."""
        told = f"column {self.name} explains {percent(self.left)} of what is left"
        if time_candidates([self.name]):
            return f"{told}: the output drifts, or the log holds several recordings"
        if self.bias > MATTERS:
            return f"{told}, and moves with the input, so that its effect is in the coefficients"
        return f"{told}: it moves the output, too; record with it held still"


@quiet
def other_columns(
    structure: Structure,
    parameters: FloatArray,
    record: Record,
    dt: float,
    others: Mapping[str, FloatArray],
) -> tuple[OtherColumn, ...]:
    """Return the columns that explain a significant part of the residual that matters, the first chosen first."""
    whole = record.u.size
    record = record.last(MOST_SAMPLES).answering(structure.delay)
    rows = slice(whole - record.u.size, whole)
    signals = {name: _scaled(signal[rows]) for name, signal in others.items() if _moves(signal[rows])}
    evidence = Evidence.of_record(structure, dt, record, parameters)
    if not signals or evidence.counted < evidence.enough or not np.ptp(record.u) > 0.0:
        return ()
    runs = Runs.of(evidence)
    if runs is None:
        return ()
    acting = Acting.of(evidence, runs, Loop(answer(evidence, runs.now, evidence.record.u, int(runs.now.is_direct))))
    causes, at_once = {}, replace(structure, delay=0.0)  # no dead time
    for name, x in signals.items():
        by_x = run_model(at_once, evidence.estimate, replace(evidence.record, u=x, before=None), dt)
        if by_x is not None and not _is_made_of(acting, by_x.u):
            causes[name] = by_x
    return tuple(_chosen(acting, causes))


def _chosen(acting: Acting, causes: dict[str, ModelRun]) -> Iterator[OtherColumn]:
    """Yield those of the causes that explain something, each beside the ones before it."""
    evidence, error, y = acting.evidence, acting.error, acting.made
    residual, left = acting.residual.knowing(acting.linear), dict(causes)
    while left:
        sure = []
        for name, by_x in left.items():
            columns = dynamics(evidence, by_x)
            explained = _explained(residual, error, columns)
            part = explained.of_output(y, error, evidence.used[acting.rows])
            if not (part.is_sure and part.power > MATTERS):
                continue
            size = min(part.power, _explicable(residual, error, columns) / acting.power)
            if size > MATTERS:
                sure.append((size, name, columns, combined(columns, explained.weights)))
        if not sure:
            return
        sure.sort(key=lambda each: -each[0])
        runs = {name: left[name] for _, name, _, _ in sure}

        def follows(name: str, runs: dict[str, ModelRun] = runs) -> bool:
            return any(_follows(evidence, runs[name].u, run) for other, run in runs.items() if other != name)

        # a second sensor of a cause follows it
        size, first, columns, effect = next((each for each in sure if not follows(each[1])), sure[0])
        del left[first]
        residual = residual.knowing(columns)
        yield OtherColumn(first, size, size * acting.power / power_of(evidence, error), _bias(acting, effect))


def _follows(evidence: Evidence, x: FloatArray, run: ModelRun) -> bool:
    """Return whether the past of a run's input improves the prediction of a signal (K,) from its own past."""
    x = x[evidence.known]
    alone = residual_of(evidence, x, np.zeros((x.size, 0)))
    return alone.explained(dynamics(evidence, run, feedback=True)).is_sure


def _explained(residual: Residual, error: FloatArray, columns: FloatArray) -> Explained:
    """Return what columns (K, C) explain of an error, by the noise model of the error beside them."""
    found = residual.explained(columns)
    # the noise model of the error includes a slow effect; a column that explains nothing hardly changes it
    for _ in range(REFINED):
        found = residual.beside(error, combined(columns, found.weights)).explained(columns)
    return found


def _explicable(residual: Residual, error: FloatArray, columns: FloatArray) -> float:
    """Return the largest mean square of an error (K,) that columns (K, C) explain, beside the known ones."""
    # not by weights of whitened signals: for a slow effect in slow noise they may explain more than the error
    rows = residual.whitening.used
    before = without(error[rows, None], residual.known[rows])
    after = without(before, without(columns[rows], residual.known[rows]))
    return float(np.mean(before**2) - np.mean(after**2))


def _bias(acting: Acting, effect: FloatArray) -> float:
    """Return how much of a column's effect (K,) the model's own slopes take up, as a part of the output."""
    slopes = acting.slopes[acting.rows]
    weights = acting.residual.weights_of((effect - effect.mean())[:, None])[: slopes.shape[1], 0]
    taken = combined(slopes, weights)
    return float(np.var(taken[acting.evidence.used[acting.rows]])) / acting.power


def _is_made_of(acting: Acting, x: FloatArray) -> bool:
    """Return whether a signal is made from the output or the input, or moves the output through the input."""
    evidence, run = acting.evidence, acting.runs.now
    if _follows(evidence, x, run) or answer(evidence, run, x).found:
        return True
    return acting.loop.is_closed and Reference.projected(x, evidence.record.u, evidence.record.y).strength > 1.0


def _moves(signal: FloatArray) -> bool:
    """Return whether a signal (K,) has finite values that differ, and is no clock."""
    known = signal[np.isfinite(signal)]
    if known.size < 2 or not np.ptp(known) > 0.0:
        return False
    steps = np.diff(known)
    return not ((steps > 0.0).all() or (steps < 0.0).all())


def _scaled(signal: FloatArray) -> FloatArray:
    """Return a signal (K,) with mean 0 and standard deviation 1; a missing value is replaced by the last one before."""
    filled = last_known(signal, float(signal[np.isfinite(signal).argmax()]))
    moved = filled / np.abs(filled).max()
    moved = moved - moved.mean()
    return np.asarray(moved / moved.std(), np.float64)


def with_other_columns(verdict: Assessment, found: tuple[OtherColumn, ...]) -> Assessment:
    """Return a verdict that names other columns, without the advice to record longer."""
    if not found:
        return verdict
    named = [each.reason for each in found]
    reasons = without_longer(verdict).reasons
    if any(each.bias > MATTERS for each in found) and verdict.status in ("trusted", "converging"):
        return replace(verdict, status="inconsistent", reasons=(*named, *reasons))
    leading = 1 if verdict.status == "trusted" else 0
    return replace(verdict, reasons=(*reasons[:leading], *named, *reasons[leading:]))
