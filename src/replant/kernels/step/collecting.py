"""One sample of the start-up: it is examined as later ones are, and kept; nothing is filtered or learned yet.

Which stamps, inputs and references are believed is told by the same functions as in `step.covariance`.  A sample whose
output alone is missing keeps its input, where the optimizer examines outputs: it is stored with the output before it,
and with the doubt that says so.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.monitoring.interruptions import input_leaps, input_rests, interval_of, is_far
from replant.kernels.native import AS_MANY, IS_SOUND, Ints, Matrix, Reals, kernel
from replant.kernels.schema import Doubt
from replant.kernels.step.stages import (
    acceptable,
    keep_guarded_sample,
    keep_sample,
    lacks_output_alone,
    mapped_input,
    note_reference,
    take_many,
)


def has_one_before(ints):
    """Return whether a sample without an output can be used: not before the first output, which nothing tells of."""
    return ints[at.EXAMINES_OUTPUT] == 1 and ints[at.SAMPLES] > 0


def lacks_first_reference(ints, r):
    """Return whether there is no reference yet, and this one cannot be used; count it."""
    if ints[at.HAS_REFERENCE] == 0 or ints[at.SAMPLES] > 0 or abs(r) <= at.LARGEST:
        return False
    ints[at.TOO_LARGE if math.isfinite(r) else at.NOT_FINITE] += 1
    return True


def take(ints, reals, banks, buffer, recent, u, y, t, r):
    """Collect one sample; return NaN, as nothing is predicted yet."""
    u, y = mapped_input(ints, reals, u), y - reals[at.OUTPUT_OFFSET]
    if not (acceptable(ints, u, y) or (has_one_before(ints) and lacks_output_alone(ints, u, y))):
        return np.nan
    if lacks_first_reference(ints, r) or (is_far(reals, u) and input_leaps(ints, reals, u, y, t, r)):
        return np.nan
    interval = interval_of(ints, reals, banks, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if ints[at.HAS_REFERENCE] == 1:
        note_reference(ints, reals, r)
    input_rests(ints, reals, u)
    if ints[at.EXAMINES_OUTPUT] == 1:
        ints[at.DOUBT] = Doubt.MISSING if math.isnan(y) else Doubt.NONE
        if ints[at.DOUBT] == Doubt.MISSING:
            ints[at.NO_OUTPUT] += 1
        else:
            reals[at.USED_OUTPUT] = y
        keep_guarded_sample(ints, reals, recent, u, y, interval)
    else:
        keep_sample(ints, recent, u, y, interval)
    ints[at.SAMPLES] += 1
    if ints[at.SAMPLES] == ints[at.ATTENTION_AT]:
        ints[at.ATTENTION] = 1
    return np.nan


@kernel(IS_SOUND)
def step(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: float, y: float, t: float, r: float
):  # fmt: skip
    """Take one sample as `take` does."""
    return take(ints, reals, banks, buffer, recent, u, y, t, r)


@kernel(IS_SOUND, *AS_MANY)
def steps(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: Reals, y: Reals, t: Reals, r: Reals,
    errors: Reals, parameters: Matrix,
):  # fmt: skip
    """Take many samples as `take_many` does; ``parameters`` (K, 0), as there are none."""
    return take_many(ints, reals, banks, buffer, recent, u, y, t, r, errors, parameters, take)
