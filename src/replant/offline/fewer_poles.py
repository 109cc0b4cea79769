"""Whether a structure of fewer poles has more evidence, by the measure of the search."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dimensions import entries_of
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.structure_evidence import Evidence


def fewer_poles(structure: Structure, parameters: FloatArray, record: Record) -> int | None:
    """Return the fewer poles with the most evidence where that is more than a model's (P,); else None."""
    theta = np.zeros(entries_of(structure, refined=True))
    theta[: parameters.size] = parameters
    evidence = Evidence(record, at_rest=not structure.delay)
    trials = [evidence.of(structure, [theta])]
    for poles in range(1, structure.poles):
        smaller = Structure(poles, min(structure.zeros, poles - 1), structure.delay, structure.bias)
        trials.append(evidence.of(smaller, ()))
    best = max(filter(None, trials), key=lambda trial: trial.evidence, default=None)
    return None if best is None or best.structure.poles == structure.poles else best.structure.poles
