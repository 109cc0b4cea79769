r"""The output of an unstable model beside a record: predicted one step ahead, as a simulation would run away.

The predicted output is the one that makes the residual e = A/D y - B/D u zero, where D is A with its unstable poles
reflected.  It depends on past outputs, and takes the place of the simulated output.
"""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.simulation.auxiliary_model import SLOWEST, AuxiliaryModel
from replant.simulation.nuisances import triangle_of, weights_of
from replant.statistics.linear_algebra import quiet, roots

RUNAWAY = 1.0
"""Growth of a model's free response within a record beyond which it is predicted, not simulated [exponent].
Derivation: an initial state may grow to e times its size; a pole at zero, as it is estimated, grows much less.
"""


@quiet
def runs_away(denominator: FloatArray, span: float) -> bool:
    """Return whether the free response of a model grows too much within ``span`` s for a simulation to mean something.

    >>> runs_away(np.array([1.0, -1.0]), 20.0), runs_away(np.array([1.0, 1.0, 0.0]), 20.0)
    (True, False)
    """
    fastest = float(roots(denominator).real.max())
    return math.isfinite(fastest) and fastest * span > RUNAWAY


@quiet
def prediction_error(structure: Structure, parameters: FloatArray, record: Record, dt: float) -> FloatArray | None:
    """Return the error (K,) of the output predicted one step ahead, offset and initial state fitted to the record.

    For a model of any stability; that of a stable one is simulated.  None where it leaves float64.
    """
    model = AuxiliaryModel(structure, dt, record.input_hold, margin=SLOWEST / record.span)
    theta, known = np.zeros(model.entries), structure.coefficients
    theta[:known] = parameters[:known]
    done = model.run(theta, record)
    theta[known:] = weights_of(triangle_of(done.phi[:, known:], done.error))
    done = model.run(theta, record)
    return done.ahead if np.isfinite(done.ahead).all() else None
