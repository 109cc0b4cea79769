"""A disturbance that has stepped: the constant beside G(s) is another one, and the plant still the same."""

from __future__ import annotations

import numpy as np

from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels import schema as at
from replant.settings import Settings
from replant.simulation.model_run import run_model
from replant.statistics.projections import without

# Where the input hardly moves, another gain looks like another constant: a gain this part larger would have to show.
TELLING = 0.2
KEPT = (at.OUTLIERS, at.STUCK, at.RESTED, at.GAPS)  # counters of samples, each of which is counted once


def only_constant_moved(state: State, settings: Settings, record: Record) -> bool:
    """Return whether G(s) as it is explains a record as well as usual, but only with another constant.

    The initial state is fitted in either case: over a record shorter than the plant's memory it makes up for much, and
    what it explains by itself does not tell the constant.
    """
    if not state.ints[at.COLOURED]:  # what tracks lets the constant walk by itself
        return False
    from replant.kernels.monitoring import outliers

    size, constant = settings.structure.size, state.entries - settings.structure.poles - 1
    physical = state.theta * state.unit
    run = run_model(settings.structure, physical[:size], record, settings.dt)
    if run is None:
        return False
    usual = max(state.reals[at.USUAL], outliers.LEAST * state.reals[at.PEAK]) * settings.scaling.output**2
    # before a dead time has passed the input lies before the record
    intervals = np.broadcast_to(record.intervals, record.u.size)
    known = np.cumsum(intervals) > settings.structure.delay + intervals
    if not known.any():
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
    """Return the state after learning a record, its newest samples, once more: constant and initial state unknown.

    The other parameters keep estimate and covariance, as after a gap.
    """
    from replant.engine.dispatch import step_kernels
    from replant.kernels.monitoring.interruptions import forget_constant, interrupt

    new = State(old.ints.copy(), old.reals.copy(), old.banks.copy(), old.buffer.copy(), old.recent.copy())
    ints, reals, count = new.ints, new.reals, record.u.size
    regular = record.intervals.size == 1
    span = float(record.intervals[0]) * count if regular else float(record.intervals.sum())
    stamps = np.zeros(0) if regular else old.reals[at.LAST_TIME] - (span - np.cumsum(record.intervals))
    ints[at.SAMPLES] -= count
    ints[at.RECENT_HEAD] = ints[at.SAMPLES] % len(new.recent)
    reals[at.ELAPSED] -= span
    reals[at.LAST_TIME] -= span
    ints[at.ALARM] = 0
    interrupt(ints, reals, new.banks, 0.0)
    reals[at.LEARN_FROM] = reals[at.ELAPSED] + reals[at.DELAY]  # until then the input lies before the record
    forget_constant(ints, reals, new.banks)
    errors, unseen = np.empty(count), np.empty((count, 0))
    _, steps = step_kernels(new, regular=regular)
    limit, reals[at.LIMIT] = reals[at.LIMIT], 0.0  # no alarm from what has been looked into
    with new.without_preprocessing():
        steps(ints, reals, new.banks, new.buffer, new.recent, record.u, record.y, stamps, errors, unseen)
    reals[at.LIMIT], reals[at.CUSUM] = limit, 0.0
    ints[list(KEPT)] = old.ints[list(KEPT)]
    ints[at.CHANGE_BEGAN] = ints[at.SAMPLES]
    new.recent[:] = old.recent
    for slot in (at.LAST_TIME, at.LAST_RAW, at.LEAST_STEP):
        reals[slot] = old.reals[slot]
    return new
