r"""Projection of input and output on the reference of a loop, sample by sample, from which instruments are made.

The reference r is applied from outside, such as a set-point or a dither, and does not depend on the noise.  The
projections are

.. math:: u_{r,k} = w_u^T l_k, \qquad y_{r,k} = w_y^T l_k,

where l holds the states of the discrete Laguerre functions of r - r_0, and a one.  The weights are those before the
sample, so that u_r and y_r depend only on r and on past noise.  An error of the weights adds variance, never bias.
Recursive least squares estimates them; input and output share the gain, as they have the same regressor.

Sources: Van den Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data",
Automatica 29; Wahlberg (1991), "System identification using Laguerre models", IEEE Transactions on Automatic
Control 36.
"""

import math

from replant.kernels.native import Matrix, Reals, kernel
from replant.kernels.optimizers.covariance import measurement_update
from replant.kernels.schema import LAGUERRE

SIZE = LAGUERRE + 1  # functions, and the constant [count]


def carry_on(states, a, r):
    """Advance the functions by r: sqrt(1 - a^2) / (1 - a/z), then each (1/z - a) / (1 - a/z) of the previous one."""
    before = states[0]
    states[0] = a * before + math.sqrt(1.0 - a * a) * r
    for i in range(1, LAGUERRE):
        old = states[i]
        states[i] = before + a * (old - states[i - 1])
        before = old


@kernel(
    "states.shape[0] >= poles.size and states.shape[1] == LAGUERRE and signals.shape[1] >= poles.size",
    "written.shape[0] >= signals.shape[0] and written.shape[1] >= LAGUERRE * poles.size",
)
def functions(signals: Matrix, poles: Reals, states: Matrix, written: Matrix):
    """Write the functions (K, S L) of signals (K, S), each with its own pole, starting from ``states`` (S, L)."""
    for k in range(signals.shape[0]):
        for i in range(poles.size):
            carry_on(states[i], poles[i], signals[k, i])
            for j in range(LAGUERRE):
                written[k, LAGUERRE * i + j] = states[i, j]


def explained(reference, which):
    """Return the projection w' l of the input (0) or of the output (1)."""
    total = 0.0
    for i in range(SIZE):
        total += reference.weights[which, i] * reference.states[i]
    return total


def project(s):
    """Take the newest reference, and project input and output on it with the weights of the previous sample."""
    reference = s.reference
    carry_on(reference.states, reference.pole, s.reference_now - reference.origin)
    s.input_by_reference = explained(reference, 0)
    s.output_by_reference = explained(reference, 1)


def learn(s, u, y):
    """Update the weights with the newest input and output, without forgetting."""
    reference, gain = s.reference, s.work[SIZE:]
    alpha = measurement_update(SIZE, reference.factors, reference.diagonal, reference.states, 1.0, s.work, gain)
    for_input = (u - explained(reference, 0)) / alpha
    for_output = (y - explained(reference, 1)) / alpha
    for i in range(SIZE):
        reference.weights[0, i] += gain[i] * for_input
        reference.weights[1, i] += gain[i] * for_output
