"""The output of any model beside a record: simulated from the input, or predicted where a simulation runs away."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.simulation.offset_fit import Simulation, fit_percent, simulate
from replant.simulation.prediction import prediction_error, runs_away


def model_output(
    model: TransferFunction,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    input_hold: str = "zoh",
    t: FloatArray | None = None,
) -> Simulation:
    """Return the output of a model beside a record, offset and initial state fitted to the measured output.

    >>> g = TransferFunction([1.0], [1.0, -1.0])
    >>> u = np.sin(np.arange(40.0))
    >>> found = model_output(g, u, g.simulate(u, 0.1), 0.1)
    >>> found.is_prediction, found.fit > 99.0
    (True, True)
    """
    span = dt * (u.size - 1) if t is None else float(t[-1] - t[0])
    if not runs_away(model.den, span):
        return simulate(model, u, y, dt, input_hold=input_hold, t=t)
    kept = np.isfinite(u) & np.isfinite(y)
    output = np.full(u.size, np.nan)
    clock = dt * np.arange(u.size) if t is None else t
    intervals = np.diff(clock[kept], prepend=clock[kept][:1] - dt)
    if t is None and kept.all():
        intervals = np.array([dt])
    n, m = model.den.size - 1, model.num.size - 1
    parameters = np.concatenate([model.den[1:], model.num])
    structure = Structure(n, m, model.delay, feedthrough=n == m)
    error = None
    if kept.any():
        error = prediction_error(structure, parameters, Record(u[kept], y[kept], intervals, input_hold), dt)
    if error is not None:
        output[kept] = y[kept] - error
    return Simulation(output, 0.0, fit_percent(y, output), is_prediction=True)
