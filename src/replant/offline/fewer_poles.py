"""Fewer poles: where a model's coefficients are not known, its verdict names a smaller one that is likelier."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.assess import MOST_SAMPLES
from replant.assessment.estimate_tests import MOST_UNCERTAIN, without_longer
from replant.assessment.verdict import Assessment
from replant.engine.dimensions import entries_of
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.structure_evidence import Evidence


def is_asked_for(verdict: Assessment, structure: Structure) -> bool:
    """Return whether a smaller model is worth trying: a coefficient is not known."""
    return (
        structure.poles > 1
        and not structure.feedthrough
        and verdict.uncertainty > MOST_UNCERTAIN
        and bool(verdict.excited)
    )


def with_fewer_poles(verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record) -> Assessment:
    """Return the verdict on a model (P,) that names the fewer poles of more evidence: first, unless it is trusted."""
    fewer = _fewer_poles(structure, parameters, record.last(MOST_SAMPLES))
    if fewer is None:
        return verdict
    reason = f"with fewer poles the record is likelier: ask for {'one pole' if fewer == 1 else f'{fewer} poles'}"
    verdict = without_longer(verdict)  # of a pole that is not there no record tells more
    reasons = (*verdict.reasons, reason) if verdict.status == "trusted" else (reason, *verdict.reasons)
    return replace(verdict, reasons=reasons)


def _fewer_poles(structure: Structure, parameters: FloatArray, record: Record) -> int | None:
    """Return the fewer poles with the most evidence, by the measure of the search; None where the model has more."""
    theta = np.zeros(entries_of(structure, refined=True))
    theta[: parameters.size] = parameters
    evidence = Evidence(record, at_rest=not structure.delay)
    trials = [evidence.of(structure, [theta])]
    for poles in range(1, structure.poles):
        smaller = Structure(poles, min(structure.zeros, poles - 1), structure.delay, structure.bias)
        trials.append(evidence.of(smaller, ()))
    best = max(filter(None, trials), key=lambda trial: trial.evidence, default=None)
    return None if best is None or best.structure.poles == structure.poles else best.structure.poles
