"""One sample of one identifier: in its start-up, with the gradient family, or with an optimizer with a covariance.

`take_gradient` shows the plain order of the stages; `step.fixed_filter` is faster for the method of the article.
`collect` and `take_covariance` examine what arrives in the same way.  The first only keeps the samples: nothing is
filtered or learned yet.  The second has the tests that a covariance makes possible: outliers, stuck sensors, missing
outputs, changes of the plant.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import autoregressions, chain, reference
from replant.kernels.monitoring import interruptions, outliers, scatter
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Kernel, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance, gradient
from replant.kernels.schema import Alarm, Doubt, StateSlots
from replant.kernels.step import stages


def take_gradient(s, u, y, t, r):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``t`` is the time stamp in s, NaN if the clock is regular.  ``r``, a reference, is not used.
    """
    u, y = stages.mapped_input(s, u), y - s.output_offset
    if not stages.acceptable(s, u, y):
        return np.nan
    interval = interruptions.interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    at_rest = s.rests_with_input and interruptions.input_rests(s, u)
    if s.recent_size > 0:
        stages.keep_sample(s, s.recent, u, y, interval)
    if s.instruments:
        stages.renew_model(s)
    target = chain.observe(s, u, y, interval)
    error = outliers.equation_error(s, target)
    s.samples += 1
    if at_rest or not stages.may_learn(s):
        s.rested += 1
    else:
        stages.update_estimate(s, target, interval, gradient.learn)
    if s.samples >= s.past_due:
        stages.keep_estimate(s)
    return error * s.output_scale


def lacks_first_reference(s, r):
    """Return whether the first reference cannot be used; count it if so."""
    if not s.has_reference or s.samples > 0 or abs(r) <= at.LARGEST:
        return False
    if math.isfinite(r):
        s.too_large += 1
    else:
        s.not_finite += 1
    return True


def collect(s, u, y, t, r):
    """Keep one sample of the start-up; return NaN, as nothing is predicted yet.

    If the optimizer examines outputs, a sample without one is kept for its input: it is stored with the previous output
    and `Doubt.MISSING`; so not before the first output.
    """
    u, y = stages.mapped_input(s, u), y - s.output_offset
    has_one_before = s.examines_output and s.samples > 0
    if not (stages.acceptable(s, u, y) or (has_one_before and stages.lacks_output_alone(s, u, y))):
        interruptions.pass_time(s, t, 1)
        return np.nan
    if lacks_first_reference(s, r) or (interruptions.is_far(s, u) and interruptions.input_leaps(s, u, y, t, r)):
        return np.nan
    interval = interruptions.interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if s.has_reference:
        stages.note_reference(s, r)
    interruptions.input_rests(s, u)
    if s.examines_output:
        s.doubt = Doubt.MISSING if math.isnan(y) else Doubt.NONE
        if s.doubt == Doubt.MISSING:
            s.no_output += 1
        else:
            s.used_output = y
        stages.keep_guarded_sample(s, u, y, interval)
    else:
        stages.keep_sample(s, s.recent, u, y, interval)
    s.samples += 1
    if s.samples == s.attention_at:
        s.attention = True
    return np.nan


def record_residual(s, error):
    """Update power and colour of the residual, and the path of the estimate."""
    if not s.instruments:
        for i in range(s.entries):
            s.zeta[i] = s.phi[i]
    scatter.record(s.colour, error, covariance.alpha_of(s), s.settings[0], s.zeta)
    if s.path_size > 0 and s.colour.count >= s.path.due:
        U, D = covariance.factors_of(s)
        scatter.keep(s.path, s.theta, U, D, scatter.lasting(s), s.colour.count, s.work)


def take_covariance(s, u, y, t, r):
    """Take one sample as `take_gradient` does, and examine its output; if the output is NaN the input is used.

    ``r`` is the reference, NaN without one.
    """
    u, y = stages.mapped_input(s, u), y - s.output_offset
    if not (stages.acceptable(s, u, y) or stages.lacks_output_alone(s, u, y)):
        interruptions.pass_time(s, t, 1)
        return np.nan
    if interruptions.is_far(s, u) and interruptions.input_leaps(s, u, y, t, r):
        return np.nan
    interval = interruptions.interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if s.has_reference:
        stages.note_reference(s, r)
        reference.project(s)
    at_rest = s.rests_with_input and interruptions.input_rests(s, u)
    if s.instruments:
        stages.renew_model(s)
    if not s.started and s.gap_at > 0 and s.refined and s.coloured:
        interruptions.begin_initial_state(s, y)
    target = outliers.observe(s, u, y, interval)
    if s.recent_size > 0:
        stages.keep_guarded_sample(s, u, y, interval)
    s.samples += 1
    if s.has_noise_model:
        target = autoregressions.whiten(s, target, interval)
    error = s.error
    if s.has_noise_model and s.doubt == Doubt.NONE:
        error = outliers.equation_error(s, target)
    tells = not at_rest and stages.may_learn(s)
    if not tells or s.alarm >= Alarm.RESTS:
        s.rested += 1
    elif s.doubt == Doubt.NONE and outliers.is_calm(s):
        if s.has_noise_model and not outliers.begins_anew(s):
            autoregressions.record(s)
        stages.update_estimate(s, target, interval, covariance.learn)
        if s.coloured and not outliers.begins_anew(s):
            record_residual(s, error)
        if s.has_reference:
            reference.learn(s, u, y)
    outliers.watch(s, tells, error)
    if s.path_size == 0:
        scatter.follow(s.sums, y, s.error * s.output_scale, s.doubt, at_rest)
    if s.samples >= s.past_due:
        stages.keep_estimate(s)
    if s.samples == s.attention_at or s.alarm == Alarm.RAISED:
        s.attention = True
    return s.error * s.output_scale


def kernels_of(take: Callable[..., Any], *requirements: str) -> tuple[Kernel, Kernel]:
    """Return the kernels that take one sample by ``take``, and many; they are named after it."""

    def one(s: StateSlots, u: float, y: float, t: float, r: float):
        """Take one sample; return its error."""
        return take(s, u, y, t, r)

    def many(s: StateSlots, u: Reals, y: Reals, t: Reals, r: Reals, errors: Reals, parameters: Matrix):
        """Take many samples."""
        return stages.take_many(s, u, y, t, r, errors, parameters, take)

    one.__name__, many.__name__ = f"{take.__name__}_one", f"{take.__name__}_many"
    return kernel(IS_SOUND, *requirements)(one), kernel(IS_SOUND, *requirements, *AS_MANY)(many)


by_gradient = kernels_of(take_gradient, LEARNS)
by_covariance = kernels_of(take_covariance, LEARNS)
collecting = kernels_of(collect)
