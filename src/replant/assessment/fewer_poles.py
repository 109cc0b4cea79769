"""A model of fewer poles that makes a record likelier: said where the coefficients of the larger are not known."""

from __future__ import annotations

from dataclasses import replace

from replant.assessment.estimate_tests import MOST_UNCERTAIN
from replant.assessment.verdict import Assessment, Finding


def is_asked_for(verdict: Assessment, poles: int) -> bool:
    """Return whether a smaller model is worth trying: a coefficient is not known."""
    return poles > 1 and verdict.uncertainty > MOST_UNCERTAIN and verdict.excited


def with_fewer_poles(verdict: Assessment, poles: int) -> Assessment:
    """Return a verdict that names the smaller model: first, unless the larger one is trusted.

    Parameters
    ----------
    verdict : Assessment
    poles : int
        Those of the smaller model.
    """
    model = "one pole" if poles == 1 else f"{poles} poles"
    finding = Finding(verdict.status, f"with fewer poles the record is likelier: ask for {model}")
    reasons = (*verdict.reasons, finding.reason) if verdict.status == "trusted" else (finding.reason, *verdict.reasons)
    return replace(verdict, reasons=reasons)
