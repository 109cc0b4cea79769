r"""Excitation: whether the samples determine every coefficient, and whether the newest ones do so as well.

The information matrix of the coefficients, :math:`\sum \zeta\zeta^T` over the instruments (the slopes of the simulated
output along a and b), offset and initial state eliminated, each entry scaled by its size over all samples.

Source: Ljung (1999), "System Identification: Theory for the User", sections 13.2 and 14.4; Soderstrom and Stoica
(1989), "System Identification", section 5.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.assessment.score_test import MATTERS
from replant.assessment.verdict import Finding, percent
from replant.simulation.model_run import ModelRun
from replant.statistics.linear_algebra import eigenvalues
from replant.statistics.projections import TAKEN_AWAY, products, without

WORST_CONDITION = 1e7
"""Condition number of the scaled regressors beyond which float64 does not tell the parameters apart [ratio].
Derivation: its square, which the normal equations see, leaves two digits of the sixteen.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEAST_SHARE = MATTERS
"""Smallest eigenvalue of the newest samples' information below which nothing that they show speaks for or against the
model [part of what it is over all samples].
Derivation: standard deviations from them would be ten times those from as many others: a tenth is what matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@dataclass(frozen=True)
class Excitation:
    """How well the samples determine the coefficients; `Assessment` describes the two figures."""

    condition: float
    share: float

    @property
    def findings(self) -> list[Finding]:
        """What the input lacks."""
        if not self.condition < WORST_CONDITION:
            figure = "infinite" if math.isinf(self.condition) else f"{self.condition:.1e}"
            reason = f"the input does not excite every coefficient (condition number {figure}): move it more"
            return [Finding("not excited", f"{reason}, or ask for fewer poles and zeros")]
        if not self.share >= LEAST_SHARE:
            reason = (
                f"the newest samples hold {percent(max(self.share, 0.0))} of the information that as many others hold"
            )
            return [Finding("not excited", f"the input hardly moves any more: {reason}")]
        return []


def excitation(run: ModelRun, newest: slice) -> Excitation:
    """Return the excitation over a run, and over its ``newest`` samples as a part of that."""
    zeta = without(run.zeta, run.nuisances)
    lengths = np.linalg.norm(zeta, axis=0)
    # of a column that the nuisances explain completely, only rounding is left
    if not (lengths > TAKEN_AWAY * np.linalg.norm(run.zeta, axis=0)).all():
        return Excitation(math.inf, 0.0)
    scaled = zeta / lengths * math.sqrt(len(zeta))
    values = eigenvalues(products(scaled, scaled) / len(zeta))
    condition = math.sqrt(values[-1] / values[0]) if values[0] > 0.0 else math.inf
    if not condition < WORST_CONDITION:
        return Excitation(condition, 0.0)
    recent = run.zeta[newest] / lengths * math.sqrt(len(zeta))
    recent = recent - recent.mean(axis=0)
    least = float(eigenvalues(products(recent, recent) / len(recent))[0])
    return Excitation(condition, least / float(values[0]))
