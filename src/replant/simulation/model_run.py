"""A model run over a record from the input alone: its error, and the signals that the tests correlate it with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import LARGEST
from replant.model.structure import Structure
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
        What the input makes of the simulated output.
    states : (K, S) array
        s^i/A u, highest i first: n of them, one more where the input acts at once.
    zeta : (K, n + m + 1) array
        Slopes of the simulated output along a and b: -s^i/A of itself, and s^j/A u.
    nuisances : (K, n + 1) array
        What an offset and an initial state add to the output.
    """

    structure: Structure
    parameters: FloatArray
    u: FloatArray
    error: FloatArray
    forced: FloatArray
    states: FloatArray
    zeta: FloatArray
    nuisances: FloatArray


@quiet
def run_model(structure: Structure, parameters: FloatArray, record: Record, dt: float) -> ModelRun | None:
    """Run a model over a record; None where it leaves float64.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array
        In the order of ``structure.names``; a bias is not used, the offset is fitted anew.
    record : Record
    dt : float
        Nominal sampling time in s.
    """
    from replant.kernels.step.shared import regressors

    n, inputs, samples = structure.poles, structure.zeros + 1, record.u.size
    states = n + structure.is_biproper
    full = Structure(n, states - 1, structure.delay, feedthrough=structure.is_biproper)
    state = State.for_model(full, dt, record.input_hold)
    theta = np.zeros(state.entries)
    theta[:n] = parameters[:n]
    theta[n + states - inputs : n + states] = parameters[n : n + inputs]
    state.install(theta)
    state.started = False
    phi, zeta = np.empty((samples, theta.size)), np.empty((samples, theta.size))
    target, forced = np.empty(samples), np.empty(samples)
    regressors(
        state.ints, state.reals, state.banks, record.u, record.y, record.intervals, phi, zeta, target, forced
    )  # fmt: skip
    columns = np.hstack([zeta[:, :n], phi[:, n:]])
    if not (np.isfinite(columns).all() and np.isfinite(forced).all() and np.abs(columns).max() < LARGEST):
        return None
    of_input, nuisances = phi[:, n : n + states], phi[:, n + states :]
    slopes = np.hstack([zeta[:, :n], of_input[:, states - inputs :]])
    error = without((record.y - forced)[:, None], nuisances)[:, 0]
    return ModelRun(structure, parameters, record.u, error, forced, of_input, slopes, nuisances)
