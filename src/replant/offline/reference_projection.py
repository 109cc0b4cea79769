r"""The reference's projection over a whole record: instruments of a record that was taken under a controller.

Input and output are projected on the Laguerre functions of the reference and a constant.  The weights are found by
generalised least squares, with the autoregression of what is left, as disturbances in a loop are seldom white:

.. math:: u_r = L w_u, \qquad y_r = L w_y.

Source: Van den Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data",
Automatica 29.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.kernels.schema import FIXED, LAGUERRE, ReferenceSlots
from replant.statistics.linear_algebra import factor_information
from replant.statistics.projections import best_pole, laguerre, products, weights_of


@dataclass(frozen=True, eq=False)
class Projection:
    """What the reference of a record of K samples explains.

    Attributes
    ----------
    functions : (K, L) array
        Laguerre functions of the reference, and ones.
    parts : (K, 2) array
        u_r and y_r.
    share : float
        Part of the input's power that u_r takes off.
    slots : ReferenceSlots
        For a recursion that goes on from the record's end.
    """

    functions: FloatArray
    parts: FloatArray
    share: float
    slots: ReferenceSlots

    @classmethod
    def of(cls, record: Record) -> Projection:
        """Project input and output of a record that has a reference."""
        assert record.r is not None
        pole = best_pole(record.r, record.u, record.y)
        states = laguerre(record.r, pole)
        functions = np.column_stack([states, np.ones(record.u.size)])
        weights = np.array([weights_of(functions, signal) for signal in (record.u, record.y)])
        slots = ReferenceSlots.zeros(FIXED | {"L": LAGUERRE + 1})
        slots.pole, slots.origin = pole, float(record.r.mean())
        slots.states[:], slots.weights[:] = functions[-1], weights
        slots.factors[:], slots.diagonal[:] = factor_information(products(functions, functions))
        parts = functions @ weights.T
        power = float(np.var(record.u))
        left = float(np.var(record.u - parts[:, 0]))
        return cls(functions, parts, max(1.0 - left / power, 0.0) if power > 0.0 else 0.0, slots)
