"""The verdict on a fit to a whole record: the same tests, in sample, because the fit has used every sample."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import Evidence
from replant.assessment.judge import judge
from replant.assessment.verdict import Assessment
from replant.engine.record import Record
from replant.model.structure import Structure

MOST_SAMPLES = 50_000  # samples of a record that the verdict looks at, the newest of them [samples]


def assess_record(
    structure: Structure,
    parameters: FloatArray,
    record: Record,
    dt: float,
    covariance: FloatArray | None = None,
    *,
    instruments: bool = True,
    unseen: bool = False,
    usual_interval: float | None = None,
    disagreement: float = 0.0,
    left_out: int = 0,
    since_change: int = 0,
) -> Assessment:
    """Return the verdict on a model by a record.

    >>> from replant.model.transfer_function import TransferFunction
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.1)
    >>> verdict = assess_record(Structure(1), np.array([0.5, 2.0]), Record(u, y, np.array([0.1])), 0.1)
    >>> verdict.status, round(verdict.fit, 6)
    ('trusted', 100.0)
    """
    irregular = record.intervals.size > 1
    looked_at = record.last(MOST_SAMPLES).answering(structure.delay)
    evidence = Evidence(
        structure,
        dt,
        looked_at,
        estimate=parameters,
        covariance=None if covariance is None or not np.isfinite(covariance).all() else covariance,
        earlier=parameters,
        unseen=looked_at.u.size if unseen else 0,
        learned=record.u.size,
        in_sample=not unseen,
        adapts=not unseen,
        finished=not unseen,
        instruments=instruments,
        disagreement=disagreement,
        left_out=left_out,
        since_change=since_change,
        usual_interval=usual_interval or (float(np.median(record.intervals[1:])) if irregular else 0.0),
    )
    return judge(evidence)
