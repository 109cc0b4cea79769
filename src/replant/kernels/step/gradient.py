"""One sample with an optimizer of the gradient family: any filter, any clock, dead time, instruments.

`take` shows the plain order of the stages; `step.fixed_filter` is faster for the method of the article.
"""

import math

import numpy as np

from replant.kernels.filters import chain
from replant.kernels.monitoring import outliers
from replant.kernels.monitoring.interruptions import input_rests, interval_of
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Matrix, Reals, kernel
from replant.kernels.optimizers import gradient as loops
from replant.kernels.schema import StateSlots
from replant.kernels.step.stages import (
    acceptable,
    keep_estimate,
    keep_sample,
    mapped_input,
    may_learn,
    renew_model,
    take_many,
    update_estimate,
)


def take(s, u, y, t, r):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``t`` is the time stamp in s, NaN if the clock is regular.  ``r``, a reference, is not used.
    """
    u, y = mapped_input(s, u), y - s.output_offset
    if not acceptable(s, u, y):
        return np.nan
    interval = interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    at_rest = s.rests_with_input and input_rests(s, u)
    if s.recent_size > 0:
        keep_sample(s, s.recent, u, y, interval)
    if s.instruments:
        renew_model(s)
    target = chain.observe(s, u, y, interval)
    error = outliers.equation_error(s, target)
    s.samples += 1
    if at_rest or not may_learn(s):
        s.rested += 1
    else:
        update_estimate(s, target, interval, loops.learn)
    if s.samples >= s.past_due:
        keep_estimate(s)
    return error * s.output_scale


@kernel(IS_SOUND, LEARNS)
def step(s: StateSlots, u: float, y: float, t: float, r: float):
    """Take one sample; return its error as `take` does."""
    return take(s, u, y, t, r)


@kernel(IS_SOUND, LEARNS, *AS_MANY)
def steps(s: StateSlots, u: Reals, y: Reals, t: Reals, r: Reals, errors: Reals, parameters: Matrix):
    """Take many samples as `take_many` does."""
    return take_many(s, u, y, t, r, errors, parameters, take)
