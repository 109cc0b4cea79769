r"""The reference of a loop, sample by sample: what it explains of input and output, from which instruments are made.

The reference r is applied from outside, as a set-point or a dither is, and does not depend on the noise.  Input and
output are projected on it, sample by sample:

.. math:: u_{r,k} = w_u^T l_k, \qquad y_{r,k} = w_y^T l_k,

where l holds the states of the discrete Laguerre functions of r - r_0 and a one.  The weights are those before the
sample, so that u_r and y_r depend on r and on past noise alone.  An error of the weights costs variance, never bias.
Recursive least squares finds them; input and output share its gain, as they have the same regressor.

Sources: Van den Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data",
Automatica 29; Wahlberg (1991), "System identification using Laguerre models", IEEE Transactions on Automatic
Control 36.
"""

import math

from replant.kernels import schema as at
from replant.kernels.optimizers.covariance import measurement_update
from replant.kernels.schema import FIXED, LAGUERRE, ReferenceSlots

POLE, ORIGIN = ReferenceSlots.pole.index, ReferenceSlots.origin.index
SIZE = LAGUERRE + 1
"""Functions, and the constant [count]."""
_BEGINS = ReferenceSlots.begins(FIXED | {"L": SIZE})
STATES, WEIGHTS, FACTORS, DIAGONAL = (_BEGINS[name] for name in ("states", "weights", "factors", "diagonal"))


def advance(reference, r):
    """Carry the Laguerre functions on by one sample r.

    The first is sqrt(1 - a^2) / (1 - a/z), each other one (1/z - a) / (1 - a/z) of the one before.
    """
    a, states = reference[POLE], reference[STATES:]
    before = states[0]
    states[0] = a * before + math.sqrt(1.0 - a * a) * (r - reference[ORIGIN])
    for i in range(1, LAGUERRE):
        old = states[i]
        states[i] = before + a * (old - states[i - 1])
        before = old


def explained(reference, weights):
    """Return w' l; the weights lie in ``reference`` from ``weights`` on."""
    total = 0.0
    for i in range(SIZE):
        total += reference[weights + i] * reference[STATES + i]
    return total


def project(ints, reals):
    """Take the newest reference: what it explains of input and output, by what was known before."""
    reference = reals[ints[at.AT_REFERENCE] :]
    advance(reference, reals[at.REFERENCE_NOW])
    reals[at.INPUT_BY_REFERENCE] = explained(reference, WEIGHTS)
    reals[at.OUTPUT_BY_REFERENCE] = explained(reference, WEIGHTS + SIZE)


def learn_weights(reference, u, y, work):
    """Let the weights learn input and output; ``work`` holds 2 (LAGUERRE + 1) numbers."""
    states, gain = reference[STATES:], work[SIZE:]
    alpha = measurement_update(SIZE, reference[FACTORS:], reference[DIAGONAL:], states, 1.0, work, gain)
    for_input = (u - explained(reference, WEIGHTS)) / alpha
    for_output = (y - explained(reference, WEIGHTS + SIZE)) / alpha
    for i in range(SIZE):
        reference[WEIGHTS + i] += gain[i] * for_input
        reference[WEIGHTS + SIZE + i] += gain[i] * for_output


def learn(ints, reals, u, y):
    """Let the weights learn the newest input and output; they forget nothing."""
    learn_weights(reals[ints[at.AT_REFERENCE] :], u, y, reals[ints[at.AT_WORK] :])
