"""A double integrator under a controller: what a reference explains of its input adds up, and says nothing false."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import replant as rp
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy.controlled import hard_loops

BEAM = next(each for each in hard_loops() if each.key == "K ball-and-beam camera")
TRUTH = np.array([0.0, 0.0, 7.0])


@pytest.mark.slow
@every("run", [200, 201, 202], quick=1)
def test_the_errors_are_as_large_as_their_standard_deviations_say(run: int) -> None:
    """Four standard deviations: one of the three errors of a run is larger with a chance of 2e-4."""
    measured = BEAM.record(run)
    ident = rp.Identifier(BEAM.structure, BEAM.dt)
    ident.update_many(measured.u, measured.y, r=measured.r)
    off = np.abs(ident.parameters - TRUTH)
    assert (off < 4.0 * ident.uncertainty.std).all(), off / ident.uncertainty.std
    fitted = rp.fit(measured.u, measured.y, BEAM.dt, BEAM.structure, reference=measured.r)
    assert (np.abs(fitted.parameters - TRUTH) < 4.0 * fitted.uncertainty.std).all()
    np.testing.assert_allclose(ident.uncertainty.std, fitted.uncertainty.std, rtol=0.7)
