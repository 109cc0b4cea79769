r"""The output of an unstable model beside a record: predicted one step ahead, as a simulation would run away.

The residual of B/A is e = A/D y - B/D u, where D is A with its unstable poles reflected.  It is as large as the noise,
whatever the poles are, and y - e takes the place of the simulated output.
"""

from __future__ import annotations

import math

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.simulation.model_run import run_model
from replant.statistics.linear_algebra import quiet, roots

RUNAWAY = 1.0
"""Growth of a model's free response within a record beyond which it is predicted, not simulated [exponent].
Derivation: an initial state may grow to e times its size; a pole at zero, as it is estimated, grows much less.
"""


@quiet
def runs_away(denominator: FloatArray, span: float) -> bool:
    """Return whether the free response of a model grows too much within ``span`` s for a simulation to mean something.

    Parameters
    ----------
    denominator : (n + 1,) array
        A(s), monic.
    span : float
        Duration of the record in s.

    Examples
    --------
    >>> runs_away(np.array([1.0, -1.0]), 20.0), runs_away(np.array([1.0, 1.0, 0.0]), 20.0)
    (True, False)
    """
    fastest = float(roots(denominator).real.max())
    return math.isfinite(fastest) and fastest * span > RUNAWAY


def prediction_error(structure: Structure, parameters: FloatArray, record: Record, dt: float) -> FloatArray | None:
    """Return the residual (K,) of a model of any stability, offset and initial state fitted; None if not finite.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array
        In the order of ``structure.names``.
    record : Record
    dt : float
        Nominal sampling time in s.
    """
    run = run_model(structure, parameters, record, dt)
    return None if run is None else run.error
