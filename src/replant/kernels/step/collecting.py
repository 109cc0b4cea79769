"""One sample of the start-up: it is checked as later ones are, and kept; nothing is filtered or learned yet.

The checks of stamps, inputs and references are those of `step.covariance`.  If the optimizer examines outputs, a sample
without an output is kept for its input: it is stored with the previous output and `Doubt.MISSING`.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.monitoring.interruptions import input_leaps, input_rests, interval_of, is_far
from replant.kernels.native import AS_MANY, IS_SOUND, Matrix, Reals, kernel
from replant.kernels.schema import Doubt, StateSlots
from replant.kernels.step.stages import (
    acceptable,
    keep_guarded_sample,
    keep_sample,
    lacks_output_alone,
    mapped_input,
    note_reference,
    take_many,
)


def has_one_before(s):
    """Return whether a sample without an output can be used: only after the first output."""
    return s.examines_output and s.samples > 0


def lacks_first_reference(s, r):
    """Return whether the first reference cannot be used; count it if so."""
    if not s.has_reference or s.samples > 0 or abs(r) <= at.LARGEST:
        return False
    if math.isfinite(r):
        s.too_large += 1
    else:
        s.not_finite += 1
    return True


def take(s, u, y, t, r):
    """Collect one sample; return NaN, as nothing is predicted yet."""
    u, y = mapped_input(s, u), y - s.output_offset
    if not (acceptable(s, u, y) or (has_one_before(s) and lacks_output_alone(s, u, y))):
        return np.nan
    if lacks_first_reference(s, r) or (is_far(s, u) and input_leaps(s, u, y, t, r)):
        return np.nan
    interval = interval_of(s, u, y, t, r)
    if math.isnan(interval):
        return np.nan
    if s.has_reference:
        note_reference(s, r)
    input_rests(s, u)
    if s.examines_output:
        s.doubt = Doubt.MISSING if math.isnan(y) else Doubt.NONE
        if s.doubt == Doubt.MISSING:
            s.no_output += 1
        else:
            s.used_output = y
        keep_guarded_sample(s, u, y, interval)
    else:
        keep_sample(s, s.recent, u, y, interval)
    s.samples += 1
    if s.samples == s.attention_at:
        s.attention = True
    return np.nan


@kernel(IS_SOUND)
def step(s: StateSlots, u: float, y: float, t: float, r: float):
    """Take one sample as `take` does."""
    return take(s, u, y, t, r)


@kernel(IS_SOUND, *AS_MANY)
def steps(s: StateSlots, u: Reals, y: Reals, t: Reals, r: Reals, errors: Reals, parameters: Matrix):
    """Take many samples as `take_many` does; ``parameters`` (K, 0), as there are none."""
    return take_many(s, u, y, t, r, errors, parameters, take)
