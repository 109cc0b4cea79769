"""The free run of a model on an irregular clock: its output from the input alone, and its initial-state responses."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import SAME, Record
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.simulation.auxiliary_model import AuxiliaryModel


class FreeRun:
    """What `RecordResponse` is, exact for each interval of an irregular clock.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Nominal sampling time in s: after 1.5 of it without a sample, a held input is taken to have moved.
    input_hold : {"zoh", "foh"}
        What the input does between samples.

    Examples
    --------
    >>> run = FreeRun(TransferFunction([1.0], [1.0, 1.0]), dt=2.0)
    >>> parts = [run.take(np.ones(2), np.ones(2)), run.take(np.ones(1), np.array([2.0]))]
    >>> [forced.round(4).tolist() for forced, _, _ in parts]
    [[0.0, 0.6321], [0.9502]]
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        n, zeros = model.den.size - 1, model.num.size - 1
        structure = Structure(n, zeros, model.delay, feedthrough=zeros == n)
        self._theta = np.concatenate([model.den[1:], model.num, np.zeros(n + 1)])
        self._model = AuxiliaryModel(structure, dt, input_hold, margin=-1.0)
        self._order, self._delay, self._hold = n, model.delay, input_hold
        self._elapsed: float | None = None  # time since the first sample

    def take(self, u: FloatArray, intervals: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        """Take the next inputs (K,); return what `RecordResponse.take` does.

        Parameters
        ----------
        u : (K,) array
        intervals : (K,) array
            Time since the previous sample, in s; that of the very first one is not used.
        """
        record = Record(u, np.zeros(u.size), intervals, self._hold)
        done = self._model.run(self._theta, record, goes_on=self._elapsed is not None)
        since = np.cumsum(intervals) + (self._elapsed if self._elapsed is not None else -float(intervals[0]))
        self._elapsed = float(since[-1])
        unknown = int(np.count_nonzero(self._delay - since > SAME * intervals))
        free = done.phi[:, -self._order :]
        if unknown < u.size:  # as the output: that of the first sample which answers to a known input
            free[:unknown] = free[unknown]
        return done.output, free, unknown


def free_run(
    model: TransferFunction, u: FloatArray, intervals: FloatArray, dt: float, input_hold: str = "zoh"
) -> tuple[FloatArray, FloatArray, int]:
    """Return what `FreeRun.take` does, of a whole record (K,).

    Examples
    --------
    >>> output, free, _ = free_run(TransferFunction([1.0], [1.0, 1.0]), np.ones(3), np.array([1.0, 1.0, 2.0]), 2.0)
    >>> output.round(4), free.round(4).ravel()
    (array([0.    , 0.6321, 0.9502]), array([1.    , 0.3679, 0.0498]))
    """
    return FreeRun(model, dt, input_hold).take(u, intervals)
