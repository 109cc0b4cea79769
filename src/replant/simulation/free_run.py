"""The free run of a model on an irregular clock: its output from the input alone, and its initial-state responses."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.simulation.auxiliary_model import AuxiliaryModel


def free_run(
    model: TransferFunction, u: FloatArray, intervals: FloatArray, dt: float, input_hold: str = "zoh"
) -> tuple[FloatArray, FloatArray, int]:
    """Return what `RecordResponse.take` does, exact for each interval.

    Parameters
    ----------
    model : TransferFunction
        Of order 1 or more.
    u : (K,) array
    intervals : (K,) array
        Time since the previous sample, in s; the first is not used.
    dt : float
        Nominal sampling time in s: after 1.5 of it without a sample, a held input is taken to have moved.
    input_hold : {"zoh", "foh"}
        What the input does between samples.

    Examples
    --------
    >>> output, free, _ = free_run(TransferFunction([1.0], [1.0, 1.0]), np.ones(3), np.array([1.0, 1.0, 2.0]), 2.0)
    >>> output.round(4), free.round(4).ravel()
    (array([0.    , 0.6321, 0.9502]), array([1.    , 0.3679, 0.0498]))
    """
    n, zeros = model.den.size - 1, model.num.size - 1
    structure = Structure(n, zeros, model.delay, feedthrough=zeros == n)
    theta = np.concatenate([model.den[1:], model.num, np.zeros(n + 1)])
    simulated = AuxiliaryModel(structure, dt, input_hold, margin=-1.0)
    record = Record(u, np.zeros(u.size), intervals, input_hold)
    done = simulated.run(theta, record)
    return done.output, done.phi[:, -n:], record.unknown(model.delay)
