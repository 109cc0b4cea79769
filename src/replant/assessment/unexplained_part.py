"""The part of the output's power that a signal could still explain: the cross test beside the whole output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.cross_test import Unexplained, unexplained, unexplained_by_reference
from replant.assessment.evidence import Evidence
from replant.assessment.reference_test import Reference
from replant.simulation.model_run import ModelRun

LARGEST_PART = (1.0 / 16.0) ** 2
"""What the input could still explain, up to which a model is trusted with a caveat: a sixteenth of the output's
amplitude. The surest of the tests must stay below it with its doubt added [part of the output's power].
Origin: real plants are never quite linear, nor of finite order.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@dataclass(frozen=True)
class Part:
    """The part of the output's power that the input could still explain.

    Attributes
    ----------
    size : float
        As a part of the output's power.
    std : float
        Standard deviation of ``size``.
    statistic : float
        The test statistic over its limit.
    source : str
        Name of the signal that could explain it.
    """

    size: float
    std: float
    statistic: float
    source: str = "input"

    @classmethod
    def of(cls, evidence: Evidence, run: ModelRun, rows: slice, surplus: float, *, feedback: bool = False) -> Part:
        """Apply the cross test to a run.

        Parameters
        ----------
        evidence : Evidence
        run : ModelRun
        rows : slice
            The samples tested.
        surplus : float
            See `unexplained`.
        feedback : bool
            Whether the input answers the residual.
        """
        found = unexplained(run, rows, evidence.dt, surplus, feedback=feedback)
        return cls._of(evidence, run, rows, found, evidence.record.y, "input")

    @classmethod
    def by_reference(
        cls, evidence: Evidence, run: ModelRun, rows: slice, surplus: float, *, reference: Reference
    ) -> Part:
        """Test a run with what a reference explains: a part of the power that the reference makes of the output."""
        spent = evidence.coefficients if evidence.in_sample else 0
        found = unexplained_by_reference(run, rows, reference.columns, surplus, spent)
        return cls._of(evidence, run, rows, found, reference.output, "reference")

    @classmethod
    def _of(
        cls, evidence: Evidence, run: ModelRun, rows: slice, found: Unexplained, output: FloatArray, source: str
    ) -> Part:
        used = evidence.used[rows]
        if not used.any():
            return cls(0.0, 0.0, 0.0, source)
        whole, error = float(np.var(output[rows][used])), float(np.var(run.error[rows][used]))
        power = max(whole, float(np.finfo(float).tiny))
        share = float(used.mean())  # the residual of a bridged sample is zero: it adds to neither power
        # as Python's floats, which become infinite without a warning where the output is constant
        size = min(float(found.power) / share, error) / power
        return cls(size, float(found.std) / share / power, found.statistic, source)

    @property
    def is_sure(self) -> bool:
        """Whether the part is statistically significant."""
        return self.statistic > 1.0

    @property
    def is_large(self) -> bool:
        """Whether the part may exceed what a trusted model may leave unexplained."""
        return self.size + self.std > LARGEST_PART
