"""One sample with an optimizer that keeps a covariance: its output is examined before it is learned.

The stages of `step.gradient.take`, and around them the tests that a covariance makes possible: outliers, stuck sensors,
outputs that are missing, changes of the plant.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import reference, whitening
from replant.kernels.monitoring import estimate_path as trail
from replant.kernels.monitoring import outliers, residual_colour
from replant.kernels.monitoring.interruptions import (
    begin_initial_state,
    input_leaps,
    input_rests,
    interval_of,
    is_far,
)
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Ints, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance as loops
from replant.kernels.schema import Alarm, Doubt
from replant.kernels.step.stages import (
    acceptable,
    cut_estimate,
    direction_of,
    keep_estimate,
    keep_guarded_sample,
    lacks_output_alone,
    mapped_input,
    may_learn,
    note_reference,
    renew_model,
    take_many,
    update_estimate,
)


def learn(ints, reals, buffer, batch, interval):
    """Let the optimizer consume the first ``batch`` of the drawn rows; ``interval`` is in s."""
    theta, memory, _, _, _, _, settings, rows = cut_estimate(ints, reals)
    loops.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, direction_of(ints), interval)


def record_residual(ints, reals, error):
    """Keep power and colour of the residual, and the estimate's path, where the optimizer keeps a covariance."""
    T = ints[at.ENTRIES]
    colour, path = reals[ints[at.AT_COLOUR] :], reals[ints[at.AT_PATH] :]
    zeta = reals[ints[at.AT_ZETA] : ints[at.AT_ZETA] + T]
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + T]
    if ints[at.INSTRUMENTS] == 0:
        for i in range(T):
            zeta[i] = phi[i]
    forgetting = reals[ints[at.AT_SETTINGS]]
    alpha = reals[ints[at.AT_MEMORY] + ints[at.MEMORY_SIZE] - 1]
    residual_colour.record(colour, error, alpha, forgetting, zeta)
    if colour[residual_colour.COUNT] >= path[trail.DUE]:
        theta, memory = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T], ints[at.AT_MEMORY]
        U, D = reals[memory : memory + T * T], reals[memory + T * T : memory + T * T + T]
        trail.keep(path, theta, U, D, colour[residual_colour.COUNT])


def take(ints, reals, banks, buffer, recent, u, y, t, r):
    """Take one sample as `step.gradient.take` does, with an optimizer that keeps a covariance.

    Its output is examined; of a sample whose output alone is missing, NaN, the input is used.  ``r`` is its reference,
    NaN where there is none.
    """
    u, y = mapped_input(ints, reals, u), y - reals[at.OUTPUT_OFFSET]
    if not (acceptable(ints, u, y) or lacks_output_alone(ints, u, y)):
        return np.nan
    if is_far(reals, u) and input_leaps(ints, reals, u, y, t, r):
        return np.nan
    interval = interval_of(ints, reals, banks, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if ints[at.HAS_REFERENCE] == 1:
        note_reference(ints, reals, r)
        reference.project(ints, reals)
    at_rest = ints[at.RESTS_WITH_INPUT] == 1 and input_rests(ints, reals, u)
    if ints[at.INSTRUMENTS] == 1:
        renew_model(ints, reals, banks)
    if ints[at.STARTED] == 0 and ints[at.GAP_AT] > 0 and ints[at.REFINED] * ints[at.COLOURED] == 1:
        begin_initial_state(ints, reals, banks, y)
    target = outliers.observe(ints, reals, banks, u, y, interval)
    if ints[at.RECENT_SIZE] > 0:
        keep_guarded_sample(ints, reals, recent, u, y, interval)
    ints[at.SAMPLES] += 1
    if ints[at.HAS_NOISE_MODEL] == 1:
        target = whitening.whiten(ints, reals, target, interval)
    error = reals[at.ERROR]
    if ints[at.HAS_NOISE_MODEL] == 1 and ints[at.DOUBT] == Doubt.NONE:
        error = outliers.equation_error(ints, reals, target)
    tells = not at_rest and may_learn(ints, reals)
    if not tells or ints[at.ALARM] >= Alarm.RESTS:
        ints[at.RESTED] += 1
    elif ints[at.DOUBT] == Doubt.NONE and outliers.is_calm(ints, reals):
        if ints[at.HAS_NOISE_MODEL] == 1 and not outliers.begins_anew(ints, reals):
            whitening.record(ints, reals)
        update_estimate(ints, reals, buffer, target, interval, learn)
        if ints[at.COLOURED] == 1 and not outliers.begins_anew(ints, reals):
            record_residual(ints, reals, error)
        if ints[at.HAS_REFERENCE] == 1:
            reference.learn(ints, reals, u, y)
    outliers.watch(ints, reals, tells, error)
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    if ints[at.SAMPLES] == ints[at.ATTENTION_AT] or ints[at.ALARM] == Alarm.RAISED:
        ints[at.ATTENTION] = 1
    return reals[at.ERROR] * reals[at.OUTPUT_SCALE]


@kernel(IS_SOUND, LEARNS)
def step(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: float, y: float, t: float, r: float
):  # fmt: skip
    """Take one sample; return its error as `take` does."""
    return take(ints, reals, banks, buffer, recent, u, y, t, r)


@kernel(IS_SOUND, LEARNS, *AS_MANY)
def steps(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: Reals, y: Reals, t: Reals, r: Reals,
    errors: Reals, parameters: Matrix,
):  # fmt: skip
    """Take many samples as `take_many` does."""
    return take_many(ints, reals, banks, buffer, recent, u, y, t, r, errors, parameters, take)
