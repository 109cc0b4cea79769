"""The response of a model to a record that begins while the plant runs, on a regular clock, batch by batch.

With a dead time the first outputs answer to inputs from before the record, which nobody knows.  The run begins at the
first output that answers to the record's own inputs; its state there is free.
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.model.dead_time import split_delay, unknown_outputs
from replant.model.response import Response
from replant.model.transfer_function import TransferFunction


class RecordResponse:
    """The output by the inputs of a record, and the responses to the state that it begins in.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Sampling time in s.
    input_hold : {"zoh", "foh"}

    Examples
    --------
    >>> response = RecordResponse(TransferFunction([1.0], [1.0, 1.0], delay=2.0), dt=1.0)
    >>> forced, free, unknown = response.take(np.ones(4))
    >>> forced.round(4), free.round(4).ravel(), unknown
    (array([0.    , 0.    , 0.    , 0.6321]), array([1.    , 1.    , 1.    , 0.3679]), 2)
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        self._lag, fraction = split_delay(model.delay, dt)
        self._response = Response(TransferFunction(model.num, model.den, fraction * dt), dt, input_hold)
        self._unknown = unknown_outputs(model.delay, dt)  # outputs still to come that answer to unknown inputs
        self._waiting = np.zeros(0)  # inputs that have not acted yet

    def take(self, u: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        """Take the next inputs (K,).

        Returns
        -------
        forced : (K,) array
            Output by the inputs of the record alone.
        free : (K, n) array
            Responses to a unit of each state at the first output that answers to them.
        unknown : int
            How many of these outputs, the first ones, answer to inputs from before the record; they stand still.
        """
        inputs = np.concatenate([self._waiting, u])
        acting = max(inputs.size - self._lag, 0)
        self._waiting = inputs[acting:]
        forced, free = self._response.output(inputs[:acting]), self._response.free(acting)
        if acting < u.size:
            before = u.size - acting
            forced = np.pad(forced, (before, 0), mode="edge" if acting else "constant")
            free = np.pad(free, ((before, 0), (0, 0)), mode="edge" if acting else "constant")
        unknown = min(self._unknown, u.size)
        self._unknown -= unknown
        return forced, free, unknown
