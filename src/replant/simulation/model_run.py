r"""Model run: the residual of a model over a record, and the signals that the tests correlate it with.

The residual of B/A is :math:`e = A/D\, y - B/D\, u`.  D is A where that is stable: e is then the measured output minus
the simulated one.  Else D is A with its unstable poles reflected: the residual of a right model is as white as the
noise, and needs no simulation that diverges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.kernels.schema import LARGEST
from replant.model.structure import Structure
from replant.simulation.auxiliary_model import AuxiliaryModel
from replant.simulation.nuisances import triangle_of, weights_of
from replant.statistics.linear_algebra import quiet


@dataclass(frozen=True, eq=False)
class ModelRun:
    """A model B/A run over a record of K samples, offset and initial state fitted.

    Attributes
    ----------
    structure : Structure
    parameters : (P,) array
    u : (K,) array
        The input.
    error : (K,) array
        The residual: of a stable model measured minus simulated output.
    forced : (K,) array
        Simulated output by the input alone, without offset and initial state; of an unstable model y - e.
    states : (K, S) array
        s^i/D u, highest i first: n of them, and one more if the transfer function is biproper.
    zeta : (K, n + m + 1) array
        Derivatives of the simulated output with respect to a and b: -s^i/D of itself, and s^j/D u.
    nuisances : (K, n + 1) array
        Outputs by a unit offset and by unit initial states.
    is_direct : bool
        Whether the output depends on the input of the same sample, at once or by the straight line to it.
    instruments : (K, n + m + 1) array or None
        The same derivatives of what a reference explains of input and output; None where there is none.
    """

    structure: Structure
    parameters: FloatArray
    u: FloatArray
    error: FloatArray
    forced: FloatArray
    states: FloatArray
    zeta: FloatArray
    nuisances: FloatArray
    is_direct: bool = False
    instruments: FloatArray | None = None


@quiet
def run_model(
    structure: Structure, parameters: FloatArray, record: Record, dt: float, by_reference: FloatArray | None = None
) -> ModelRun | None:
    """Run a model over a record; None where its signals leave float64."""
    n = structure.poles
    # with as many zeros as there can be, the columns hold every s^i/A u; the derivatives along b are the last of them
    full = Structure(n, n - 1 + structure.is_biproper, structure.delay, feedthrough=structure.is_biproper)
    model = AuxiliaryModel(full, dt, record.input_hold)
    theta = np.zeros(model.entries)
    theta[full.denominator] = parameters[structure.denominator]
    own = slice(full.coefficients - structure.zeros - 1, full.coefficients)
    theta[own] = parameters[structure.numerator]
    whole = record.joined
    known = whole.u.size - record.u.size
    done = model.run(theta, whole).since(known)
    slopes_of_a = done.zeta[:, full.denominator]
    columns = np.hstack([slopes_of_a, done.phi[:, n:]])
    if not (np.isfinite(columns).all() and np.isfinite(done.output).all() and np.abs(columns).max() < LARGEST):
        return None
    states, nuisances = done.phi[:, full.numerator], done.phi[:, full.coefficients :]
    slopes = np.hstack([slopes_of_a, done.phi[:, own]])
    error = done.error - nuisances @ weights_of(triangle_of(nuisances, done.error))
    direct = structure.delay < dt if record.input_hold == "foh" else structure.is_biproper and structure.delay == 0.0
    instruments = None
    if by_reference is not None:
        apart = AuxiliaryModel(full, dt, record.input_hold, reference=True)
        by_reference = np.pad(by_reference, ((known, 0), (0, 0)), mode="edge")
        zeta = apart.run(theta, whole, by_reference).since(known).zeta
        instruments = np.hstack([zeta[:, full.denominator], zeta[:, own]])
    return ModelRun(structure, parameters, record.u, error, done.output, states, slopes, nuisances, direct, instruments)
