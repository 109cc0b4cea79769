"""Step disturbance: the new offset is found after a step of the load, while G(s) stays."""

from __future__ import annotations

import numpy as np

from replant.engine.record import Record
from replant.engine.state import NOTHING, State
from replant.kernels.schema import BELIEVED, Alarm
from replant.settings import Settings
from replant.simulation.model_run import run_model
from replant.statistics.projections import without

TELLING = 0.2
"""Change of the gain that the record must be able to show before another constant is believed instead: where the input
hardly moves they look alike [part of the gain].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

KEPT = (State.outliers, State.stuck, State.rested, State.gaps)  # counters of samples, each of which is counted once


def only_constant_moved(state: State, settings: Settings, record: Record) -> bool:
    """Return whether the present G(s) explains a record with another constant, and does not with the present one.

    The initial state is fitted in both cases.  Over a record shorter than the plant's memory it explains much of the
    output by itself, which is no evidence for another constant.

    Parameters
    ----------
    state : State
        Of the present model.
    settings : Settings
    record : Record
        The samples since the alarm.
    """
    if not state.coloured:  # a tracking optimizer lets the constant walk by itself
        return False
    from replant.kernels.monitoring import outliers

    size, constant = settings.structure.size, state.entries - settings.structure.poles - 1
    physical = state.physical
    run = run_model(settings.structure, physical[:size], record, settings.dt)
    if run is None:
        return False
    usual = max(state.usual_variance, outliers.LEAST * state.largest_output) * settings.scaling.output**2
    known = slice(record.unknown(settings.structure.delay), None)
    if not record.u[known].size:
        return False
    unforced, nuisances = (record.y - run.forced)[known], run.nuisances[known]
    by_input = without(run.forced[known][:, None], nuisances)
    if not TELLING**2 * np.mean(by_input**2) > outliers.GROWN * usual:
        return False
    as_before = unforced - physical[constant] * nuisances[:, 0]
    left = np.mean(without(unforced[:, None], nuisances) ** 2)
    left_as_before = np.mean(without(as_before[:, None], nuisances[:, 1:]) ** 2)
    return bool(left < outliers.GROWN * usual <= left_as_before)


def with_new_constant(old: State, record: Record) -> State:
    """Return the state after learning its newest samples again, with constant and initial state unknown.

    The other parameters keep their estimate and covariance, as after a gap.

    Parameters
    ----------
    old : State
    record : Record
        The newest samples of ``old``.
    """
    from replant.engine.dispatch import step_kernels
    from replant.kernels.monitoring.interruptions import forget_constant, interrupt

    new, count = old.copy(), record.u.size
    regular = record.intervals.size == 1
    span = float(record.intervals[0]) * count if regular else float(record.intervals.sum())
    stamps = np.zeros(0) if regular else old.last_time - (span - np.cumsum(record.intervals))
    new.samples -= count
    new.recent_head = new.samples % len(new.recent)
    new.elapsed -= span
    new.last_time -= span
    new.alarm = Alarm.NONE
    interrupt(new.ints, new.reals, new.banks, 0.0)
    forget_constant(new.ints, new.reals, new.banks)
    errors, unseen = np.empty(count), np.empty((count, 0))
    _, steps = step_kernels(new, regular=regular)
    limit, new.cusum_limit = new.cusum_limit, 0.0  # these samples have been looked into: they raise no alarm
    new.held_at = BELIEVED  # all of it was taken before
    with new.without_preprocessing():
        steps(*new.arrays, record.u, record.y, stamps, NOTHING if record.r is None else record.r, errors, unseen)
    new.cusum_limit, new.cusum, new.held_at = limit, 0.0, 0
    new.change_began = new.samples
    new.recent[:] = old.recent
    new.take_over(old, *KEPT, State.last_time, State.last_raw, State.sensor_step)
    return new
