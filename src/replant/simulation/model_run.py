"""The free run of a model over a record: its error, and the signals that the tests correlate the error with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.kernels.schema import LARGEST
from replant.model.structure import Structure
from replant.simulation.auxiliary_model import AuxiliaryModel
from replant.statistics.linear_algebra import quiet
from replant.statistics.projections import without


@dataclass(frozen=True, eq=False)
class ModelRun:
    """The free run of a model B/A over a record of K samples, offset and initial state fitted.

    Attributes
    ----------
    structure : Structure
    parameters : (P,) array
    u : (K,) array
        The input.
    error : (K,) array
        Measured minus simulated output.
    forced : (K,) array
        Simulated output by the input alone, without offset and initial state.
    states : (K, S) array
        s^i/A u, highest i first: n of them, and one more if the transfer function is biproper.
    zeta : (K, n + m + 1) array
        Derivatives of the simulated output with respect to a and b: -s^i/A of itself, and s^j/A u.
    nuisances : (K, n + 1) array
        Outputs by a unit offset and by unit initial states.
    is_direct : bool
        Whether the output depends on the input of the same sample, at once or by the straight line to it.
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


@quiet
def run_model(structure: Structure, parameters: FloatArray, record: Record, dt: float) -> ModelRun | None:
    """Run a model over a record; None where its signals leave float64.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array
        In the order of ``structure.names``; the bias is not used, because the offset is fitted to the record.
    record : Record
    dt : float
        Nominal sampling time in s.
    """
    n = structure.poles
    # with as many zeros as there can be, the columns hold every s^i/A u; the derivatives along b are the last of them
    full = Structure(n, n - 1 + structure.is_biproper, structure.delay, feedthrough=structure.is_biproper)
    model = AuxiliaryModel(full, dt, record.input_hold)
    theta = np.zeros(model.entries)
    theta[full.denominator] = parameters[structure.denominator]
    own = slice(full.coefficients - structure.zeros - 1, full.coefficients)
    theta[own] = parameters[structure.numerator]
    done = model.run(theta, record)
    slopes_of_a = done.zeta[:, full.denominator]
    columns = np.hstack([slopes_of_a, done.phi[:, n:]])
    if not (np.isfinite(columns).all() and np.isfinite(done.output).all() and np.abs(columns).max() < LARGEST):
        return None
    states, nuisances = done.phi[:, full.numerator], done.phi[:, full.coefficients :]
    slopes = np.hstack([slopes_of_a, done.phi[:, own]])
    error = without(done.error[:, None], nuisances)[:, 0]
    direct = structure.delay < dt if record.input_hold == "foh" else structure.is_biproper and structure.delay == 0.0
    return ModelRun(structure, parameters, record.u, error, done.output, states, slopes, nuisances, direct)
