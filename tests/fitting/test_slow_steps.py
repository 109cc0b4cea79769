"""Where the steps go to and fro about a pole on the imaginary axis: the estimate starts a recursion all the same."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.srivc import refine
from support.cases import every
from support.loops import DT, coloured, controlled, steps

INTEGRATOR = rp.TransferFunction([1.0], [1.0, 1.0, 0.0])


@every("seed", range(6))
def test_an_integrator_under_a_controller_starts_a_recursion(seed: int) -> None:
    loop = controlled(INTEGRATOR, steps(seed, 3000, hold=40), 0.1 * coloured(seed, 3000, 0.95), gain=0.5)
    found = refine(rp.Structure(2), Record(loop.u, loop.y, np.array([DT])))
    assert found is not None
    assert found.ends
    assert found.acceptable
    std = np.sqrt(np.diag(found.covariance)[:3])
    assert (np.abs(found.theta[:3] - [1.0, 0.0, 1.0]) < 4.0 * std).all()
