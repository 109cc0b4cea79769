"""The use of a reference to a fit: whether it is one, what it explains, and how well the model explains it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.loop_tests import COPIED, IDLE, Reference, fault_of
from replant.assessment.verdict import ALPHA
from replant.engine.record import Record
from replant.kernels.schema import LAGUERRE
from replant.model.structure import Structure
from replant.offline.refined import Refined
from replant.statistics.linear_algebra import chi2_quantile, quiet

WITHOUT = "the fit does without it"


@dataclass(frozen=True, eq=False)
class ReferenceUse:
    """What a reference was worth to a fit.

    Attributes
    ----------
    signal : (K,) array
        The reference as it was given.
    used : bool
        Whether instruments were made from it.
    finding : str
        In one line what is wrong with it; empty where nothing is.
    explained : float
        Share of the input's power that it explains.
    misfit : float
        J, the part of the whitened residual that the reference explains, over the residual's variance: chi-square at a
        right model, whatever the noise is.  NaN where it was not used.
    degrees : int
        Degrees of freedom of J.
    """

    signal: FloatArray
    used: bool
    finding: str
    explained: float
    misfit: float = math.nan
    degrees: int = 0

    @property
    def misfit_limit(self) -> float:
        """What J of a right model exceeds with the chance 1e-4; NaN where the reference was not used."""
        return float(chi2_quantile(1.0 - ALPHA, self.degrees)) if self.degrees > 0 else math.nan

    def given_up(self) -> ReferenceUse:
        """Return it as one that is not used, where there was no reason yet because no model was found with it."""
        reason = self.finding or f"no model was found with the reference: {WITHOUT}"
        return dataclasses.replace(self, used=False, finding=reason)

    def concluded(self, structure: Structure, found: Refined) -> ReferenceUse:
        """Return it with what the fit has found."""
        if not self.used:
            return self
        degrees = max(LAGUERRE - structure.coefficients, 0)  # the constant counts on both sides
        return dataclasses.replace(self, explained=found.explained, misfit=found.misfit, degrees=degrees)


@quiet
def use_of(signal: FloatArray, record: Record) -> ReferenceUse:
    """Return whether a record's reference can be used, and if not why."""
    r, u = record.r, record.u
    assert r is not None
    fault = fault_of(r, u)
    if fault:
        return ReferenceUse(signal, False, f"{fault}: {WITHOUT}", 1.0 if fault == COPIED else 0.0)
    found = Reference.projected(r, u, record.y)
    share = float(found.input @ found.input) / max(float(np.sum((u - u.mean()) ** 2)), np.finfo(float).tiny)
    if not found.strength > 1.0:
        return ReferenceUse(signal, False, f"{IDLE}: {WITHOUT}", share)
    return ReferenceUse(signal, True, "", share)
