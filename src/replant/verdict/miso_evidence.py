"""A row reduced to each of its inputs, so that the tests of a plant with one input apply to each.

The modelled outputs of the other inputs are subtracted from the output, y_i = y - sum of x_j, and their slopes join the
offset and the initial states as nuisances, except in the test of the hold.  A fault of input i, or of the plant behind
it, is then found as for a plant with one input, see `input_faults` and `plant_faults`.

If references move inputs, modelled outputs and slopes are those by the signals from outside, which do not depend on the
noise: each input is then tested as one input with a reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from replant.estimation.simulation.miso import Point, Row
from replant.estimation.simulation.model_run import PER_COEFFICIENT, run_model
from replant.numerics.arguments import FloatArray
from replant.verdict.alternatives import Acting
from replant.verdict.assess import MOST_IRREGULAR, MOST_SAMPLES
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.input_faults import bends_of, dead_time_findings, hold_findings, rhythm_findings, surest_of
from replant.verdict.loop import Loop, Reference
from replant.verdict.plant_faults import plant_findings
from replant.verdict.verdict import Finding

Seen = tuple[str, Acting]  # the input that a fault belongs to, in words, and the row reduced to it


def seen_by_each(row: Row, point: Point, covariance: FloatArray) -> list[Seen]:
    """Return the row reduced to each input that moves, over the stretch with the most measured outputs."""
    if not row.stretches:
        return []
    longest, driven = int(np.argmax([np.count_nonzero(each.measured) for each in row.stretches])), row.from_outside
    found = (_seen_by(row, driven, point, covariance, number, longest) for number in range(len(row.names)))
    return [each for each in found if each is not None]


def faults_of_row(seen: Sequence[Seen], *, in_time: bool = True) -> Iterator[Finding]:
    """Yield faults of the sensor, or else of actuators, and of timing, disturbances and plants, for each input."""
    bends = [bends_of(acting) for _, acting in seen]
    actuators, sensors = zip(*bends, strict=True) if bends else ((), ())
    # a missing pole of one input looks like a curve to the other ones: a fault of the sensor must be seen by all
    sensor = min(filter(None, sensors), key=lambda bend: bend.statistic) if sensors and all(sensors) else None
    is_surest = sensor is surest_of((sensor, *actuators))
    of_sensor = sensor.findings if sensor is not None and is_surest else []
    yield from of_sensor
    plants = plant_findings(*(acting for _, acting in seen), in_time=in_time)
    for (subject, acting), bend, plant in zip(seen, actuators, plants, strict=True):
        found = [*_of_timing(acting), *([] if bend is None or of_sensor else bend.findings), *plant]
        yield from (Finding(one.status, f"{subject}: {one.reason}") for one in found)


def _of_timing(acting: Acting) -> list[Finding]:
    """Return findings on the hold and a disturbance's rhythm or, with a reference, on the dead time of the input."""
    part = acting.unexplained()
    if acting.loop.is_closed:
        return dead_time_findings(acting, part)
    return [*hold_findings(acting), *rhythm_findings(acting, part)]


def _seen_by(row: Row, driven: Row, point: Point, covariance: FloatArray, number: int, which: int) -> Seen | None:
    """Return a stretch reduced to an input; None if the input does not move, or the stretch is too short.

    ``driven`` is the row driven by the signals from outside alone, whose outputs and slopes are free of the noise.
    """
    stretch, nuisances, places = row.stretches[which], point.nuisances[which], row.places[number]
    outputs, slopes, free = row.signals(point.theta, stretch, nuisances)
    left = stretch.y - np.delete(outputs, number, axis=1).sum(axis=1)
    if row.outside is not None:
        outputs, slopes, _ = driven.signals(point.theta, driven.stretches[which], nuisances)
    y = np.where(stretch.measured, left, 0.0)
    whole = replace(row.record.part(stretch.rows), u=stretch.inputs[number].u, y=y, measured=stretch.measured)
    record = whole.last(MOST_SAMPLES if whole.intervals.size == 1 else MOST_IRREGULAR)
    rows, zero = slice(whole.u.size - record.u.size, None), -float(row.inputs[stretch.rows][0, number])
    evidence = Evidence.of_record(
        row.structures[number], row.dt, record, point.theta[places], covariance=covariance[places, places],
        finished=True, input_zero=zero, measured=stretch.y[rows],
    )  # fmt: skip
    enough = max(evidence.enough, PER_COEFFICIENT * (free.shape[1] + slopes.shape[1]))  # for the columns of all inputs
    if evidence.counted < enough or not np.ptp(record.u) > 0.0:
        return None
    run = run_model(evidence.structure, evidence.estimate, evidence.record, evidence.dt)
    if run is None:
        return None
    error = point.residual[which][rows] / evidence.output_unit
    run = replace(run, error=error, nuisances=np.hstack([free, np.delete(slopes, places, axis=1)])[rows])
    sensed = outputs.sum(axis=1)[rows] / evidence.output_unit
    reference = None
    if row.outside is not None:
        u = driven.stretches[which].inputs[number].u[rows] / evidence.input_unit
        made = run_model(evidence.structure, evidence.estimate, replace(evidence.record, u=u, before=None), row.dt)
        if made is None:
            return None
        run = replace(run, instruments=made.zeta)
        functions = row.outside.functions(stretch.rows)[rows]
        reference = Reference(functions - functions.mean(axis=0), u - u.mean(), made.forced - made.forced.mean())
    runs = Runs(run, run, error - error.mean(), float(np.var(evidence.record.y)))
    subject = f"input {row.names[number]}{', beside the others' if row.names[1:] else ''}"
    return subject, Acting.of(evidence, runs, Loop(reference=reference), sensed)
