"""One sample with an optimizer of the gradient family: any filter, any clock, dead time, instruments.

`take` is the plain reading of what happens to a sample; `step.fixed_filter` is faster for the method of the article.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import chain
from replant.kernels.monitoring import outliers
from replant.kernels.monitoring.interruptions import input_rests, interval_of
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Ints, Matrix, Reals, kernel
from replant.kernels.optimizers import gradient as loops
from replant.kernels.step.stages import (
    acceptable,
    cut_estimate,
    direction_of,
    keep_estimate,
    keep_sample,
    mapped_input,
    may_learn,
    renew_model,
    take_many,
    update_estimate,
)


def learn(ints, reals, buffer, batch, interval):
    """Let the optimizer consume the first ``batch`` of the drawn rows; ``interval``, in s, does not matter to it."""
    theta, memory, _, _, _, _, settings, rows = cut_estimate(ints, reals)
    loops.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, direction_of(ints))


def take(ints, reals, banks, buffer, recent, u, y, t, r):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``t`` is its time stamp in s, or NaN where the clock is regular.  ``r``, a reference, is not used.
    """
    u, y = mapped_input(ints, reals, u), y - reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    interval = interval_of(ints, reals, banks, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    at_rest = ints[at.RESTS_WITH_INPUT] == 1 and input_rests(ints, reals, u)
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, interval)
    if ints[at.INSTRUMENTS] == 1:
        renew_model(ints, reals, banks)
    target = chain.observe(ints, reals, banks, u, y, interval)
    error = outliers.equation_error(ints, reals, target)
    ints[at.SAMPLES] += 1
    if at_rest or not may_learn(ints, reals):
        ints[at.RESTED] += 1
    else:
        update_estimate(ints, reals, buffer, target, interval, learn)
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    return error * reals[at.OUTPUT_SCALE]


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
