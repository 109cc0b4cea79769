"""One sample with an optimizer that keeps a covariance: its output is examined before it is learned.

The stages are those of `step.gradient.take`, with the tests that a covariance makes possible: outliers, stuck sensors,
missing outputs, changes of the plant.
"""

import math

import numpy as np

from replant.kernels.filters import reference, whitening
from replant.kernels.monitoring import outliers, scatter
from replant.kernels.monitoring.interruptions import (
    begin_initial_state,
    input_leaps,
    input_rests,
    interval_of,
    is_far,
)
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance as loops
from replant.kernels.schema import Alarm, Doubt, StateSlots
from replant.kernels.step.stages import (
    acceptable,
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


def record_residual(s, error):
    """Update power and colour of the residual, and the path of the estimate."""
    if not s.instruments:
        for i in range(s.entries):
            s.zeta[i] = s.phi[i]
    scatter.record(s.colour, error, loops.alpha_of(s), s.settings[0], s.zeta)
    if s.path_size > 0 and s.colour.count >= s.path.due:
        U, D = loops.factors_of(s)
        scatter.keep(s.path, s.theta, U, D, scatter.lasting(s), s.colour.count, s.work)


def take(s, u, y, t, r):
    """Take one sample as `step.gradient.take` does, and examine its output; if the output is NaN the input is used.

    ``r`` is the reference, NaN without one.
    """
    u, y = mapped_input(s, u), y - s.output_offset
    if not (acceptable(s, u, y) or lacks_output_alone(s, u, y)):
        return np.nan
    if is_far(s, u) and input_leaps(s, u, y, t, r):
        return np.nan
    interval = interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if s.has_reference:
        note_reference(s, r)
        reference.project(s)
    at_rest = s.rests_with_input and input_rests(s, u)
    if s.instruments:
        renew_model(s)
    if not s.started and s.gap_at > 0 and s.refined and s.coloured:
        begin_initial_state(s, y)
    target = outliers.observe(s, u, y, interval)
    if s.recent_size > 0:
        keep_guarded_sample(s, u, y, interval)
    s.samples += 1
    if s.has_noise_model:
        target = whitening.whiten(s, target, interval)
    error = s.error
    if s.has_noise_model and s.doubt == Doubt.NONE:
        error = outliers.equation_error(s, target)
    tells = not at_rest and may_learn(s)
    if not tells or s.alarm >= Alarm.RESTS:
        s.rested += 1
    elif s.doubt == Doubt.NONE and outliers.is_calm(s):
        if s.has_noise_model and not outliers.begins_anew(s):
            whitening.record(s)
        update_estimate(s, target, interval, loops.learn)
        if s.coloured and not outliers.begins_anew(s):
            record_residual(s, error)
        if s.has_reference:
            reference.learn(s, u, y)
    outliers.watch(s, tells, error)
    if s.path_size == 0:
        scatter.follow(s.sums, y, s.error * s.output_scale, s.doubt, at_rest)
    if s.samples >= s.past_due:
        keep_estimate(s)
    if s.samples == s.attention_at or s.alarm == Alarm.RAISED:
        s.attention = True
    return s.error * s.output_scale


@kernel(IS_SOUND, LEARNS)
def step(s: StateSlots, u: float, y: float, t: float, r: float):
    """Take one sample; return its error as `take` does."""
    return take(s, u, y, t, r)


@kernel(IS_SOUND, LEARNS, *AS_MANY)
def steps(s: StateSlots, u: Reals, y: Reals, t: Reals, r: Reals, errors: Reals, parameters: Matrix):
    """Take many samples as `take_many` does."""
    return take_many(s, u, y, t, r, errors, parameters, take)
