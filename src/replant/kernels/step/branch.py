r"""The output of a model, and its derivatives with respect to the parameters, from the input alone.

The model stands alone or is one branch of a row of transfer functions.  With x = B/A u + the response to an initial
state, the derivatives are

.. math::
    -\frac{s^k}{A} x, \qquad \frac{s^k}{A} u, \qquad \text{and the responses to each state.}

`stages.regressors` gives the same to the bit, in twice the time: it filters a measured output, too.
"""

import numpy as np

from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.native import LAID_OUT, Matrix, Reals, kernel
from replant.kernels.schema import StateSlots
from replant.kernels.step.stages import acceptable


def respond(s, u, interval, constant, row):
    """Pass an input through dead time and model; fill the row (T,), with a constant if asked; return the output."""
    n, T, bank, work = s.order, s.entries, s.banks[s.serving_bank], s.work
    first = chain.filters_begin(s, u, 0.0, interval)
    slot = 0
    if not first:
        slot = bk.discretization(bank, n, T, interval, work)
        s.input_now = chain.advance_input(s, bank, interval, slot, work, bk.INPUT)
        # again: the discretisations of the pieces may have replaced that of the whole interval
        slot = bk.discretization(bank, n, T, interval, work)
        bk.advance_channel(bank, n, T, bk.IMPULSE, slot, 0.0, 0.0, work)
        if constant:
            bk.advance_channel(bank, n, T, bk.CONSTANT, slot, 1.0, 1.0, work)
    output = bk.fill_known_entries(s, bank, bk.INPUT, s.input_now, constant, False, row)
    if not first:
        bk.advance_channel(bank, n, T, bk.MODEL, slot, bank[bk.INSTRUMENT], output, work)
    bank[bk.INSTRUMENT] = bank[bk.MODEL_OUTPUT] = output
    bk.fill_output_entries(bank, n, T, bk.MODEL, output, row)
    if s.unknown_input > 0.0:  # the delayed input is unknown: the sample carries no information
        for i in range(T):
            row[i] = 0.0
    return output


@kernel(
    LAID_OUT, "s.refined and s.instruments and not s.has_reference and not s.bilinear",
    "intervals.size == 1 or intervals.size >= u.size",
    "output.size >= u.size and rows.shape[0] >= u.size and rows.shape[1] >= s.entries",
)  # fmt: skip
def branch(s: StateSlots, u: Reals, intervals: Reals, constant: bool, rows: Matrix, output: Reals):
    """Run a model over inputs (K,), from where its last run ended.

    ``intervals`` are (K,) or (1,) in s.  Writes ``rows`` (K, T or more), in the order of the model's entries, and
    ``output`` (K,).  The entry of the constant is zero unless asked for.  Both are NaN where an input is not finite or
    too large.
    """
    T, bank = s.entries, s.banks[s.serving_bank]
    for k in range(u.size):
        interval = intervals[0] if intervals.size == 1 else intervals[k]
        if not acceptable(s, u[k], 0.0):
            output[k] = np.nan
            for i in range(T):
                rows[k, i] = np.nan
        elif bank[bk.REFLECTED] == 1.0:  # an unstable model predicts from the measured output, here zero
            chain.observe(s, u[k], 0.0, interval)
            output[k] = bank[bk.MODEL_OUTPUT]
            for i in range(T):
                rows[k, i] = s.zeta[i]
        else:
            rows[k, s.order + s.input_entries] = 0.0
            output[k] = respond(s, u[k], interval, constant, rows[k])
