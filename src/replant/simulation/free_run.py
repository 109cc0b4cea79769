"""A model run from the input alone over an irregular clock, and what an initial state adds."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.state import State
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction


def free_run(
    model: TransferFunction, u: FloatArray, intervals: FloatArray, dt: float, input_hold: str = "zoh"
) -> tuple[FloatArray, FloatArray]:
    """Return the output (K,) from rest, and the responses (K, n) to an initial state, exact for each interval.

    Parameters
    ----------
    model : TransferFunction
        Of order 1 or more.
    u : (K,) array
    intervals : (K,) array
        Time since the sample before, in s; the first is not used.
    dt : float
        Nominal sampling time in s: after 1.5 of it without a sample, a held input is taken to have moved.

    Examples
    --------
    >>> output, free = free_run(TransferFunction([1.0], [1.0, 1.0]), np.ones(3), np.array([1.0, 1.0, 2.0]), 2.0)
    >>> output.round(4), free.round(4).ravel()
    (array([0.    , 0.6321, 0.9502]), array([1.    , 0.3679, 0.0498]))
    """
    from replant.kernels.step.shared import regressors

    n, zeros = model.den.size - 1, model.num.size - 1
    structure = Structure(n, zeros, model.delay, feedthrough=zeros == n)
    state = State.for_model(structure, dt, input_hold)
    state.install(np.concatenate([model.den[1:], model.num, np.zeros(n + 1)]))
    size, samples = state.entries, u.size
    phi, unused = np.empty((samples, size)), np.empty((samples, size))
    target, output = np.empty(samples), np.empty(samples)
    state.started = False
    regressors(
        state.ints, state.reals, state.banks, u, np.zeros(samples), intervals, phi, unused, target, output
    )  # fmt: skip
    return output, phi[:, -n:]
