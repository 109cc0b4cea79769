r"""A model run over a record on any clock, with the regressors and instruments that its own denominator filters.

For a model B/A the compiled chain gives, sample by sample, the regressor :math:`\varphi` of :math:`s^n/A\, y =
\varphi^T \theta`, the instruments :math:`\zeta` (the same regressor built from the model's own output) and the model's
output B/A u.  All are exact for the hold over every interval, so that the clock may be irregular.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import State
from replant.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass of a model over a record of K samples; T entries, in the order of `AuxiliaryModel.run`.

    Attributes
    ----------
    phi, zeta : (K, T) arrays
        Regressors and instruments.
    target : (K,) array
        s^n/A y.
    output : (K,) array
        Of the model, offset and initial state included.
    error : (K,) array
        Measured output minus that.
    """

    phi: FloatArray
    zeta: FloatArray
    target: FloatArray
    output: FloatArray
    error: FloatArray

    @property
    def cost(self) -> float:
        """Mean square of the error; infinite where that leaves float64."""
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(np.mean(self.error**2))
        return cost if math.isfinite(cost) else math.inf


class AuxiliaryModel:
    """Runs models of one structure over records.

    Parameters
    ----------
    structure : Structure
    dt : float
        Nominal sampling time in s: after 1.5 of it without a sample, a held input is taken to have moved.
    input_hold : {"zoh", "foh"}
        What the input does between samples.

    Examples
    --------
    >>> model = AuxiliaryModel(Structure(poles=1), dt=1.0)
    >>> record = Record(np.ones(3), np.zeros(3), np.array([1.0, 1.0, 2.0]))
    >>> model.run(np.array([1.0, 1.0, 0.0, 0.0]), record).output.round(4)
    array([0.    , 0.6321, 0.9502])
    """

    def __init__(self, structure: Structure, dt: float, input_hold: str = "zoh") -> None:
        self._state = State.for_model(structure, dt, input_hold)

    @property
    def entries(self) -> int:
        """How many entries a model has, T."""
        return self._state.entries

    def run(self, theta: FloatArray, record: Record) -> Pass:
        """Run a model over a record from rest.

        Parameters
        ----------
        theta : (T,) array
            a_{n-1} .. a_0, b_m .. b_0, then the nuisances: the constant of A y = B u + constant, and the initial state.
        record : Record
        """
        from replant.kernels.step.stages import regressors

        state, size, samples = self._state, self.entries, record.u.size
        state.install(theta)
        state.started = False
        phi, zeta = np.empty((samples, size)), np.empty((samples, size))
        target, output = np.empty(samples), np.empty(samples)
        regressors(
            state.ints, state.reals, state.banks, record.u, record.y, record.intervals, phi, zeta, target, output
        )  # fmt: skip
        return Pass(phi, zeta, target, output, record.y - output)
