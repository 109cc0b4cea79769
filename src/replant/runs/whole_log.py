"""What the verdict of a run says by the whole log: of fewer poles, and of other columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replant.assessment.other_columns import other_columns, with_other_columns
from replant.assessment.verdict import Verdict
from replant.log import Log
from replant.offline.fewer_poles import is_asked_for, with_fewer_poles
from replant.offline.fit import RawRecord
from replant.runs.result import Result
from replant.simulation.stretches import flags_of


def judged_by_log(result: Result, log: Log) -> Result:
    """Return the result of a run over a whole log; its verdict names fewer poles, and columns that explain the rest."""
    settings = result.settings
    smaller = is_asked_for(result.verdict, result.structure)
    if not (log.others or smaller) or settings is None or not result.parameters.any() or log.earlier:
        return result
    y = np.where(flags_of(result.left_out, 0, log.output.size), np.nan, log.output)
    raw = RawRecord(result.structure, log.dt, settings.preprocess, log.input, y, log.stamps, settings.filter.input_hold)
    if not raw.usable.any():
        return result
    record, verdict = raw.made_ready(y, None), result.verdict
    if smaller and settings.instruments:
        verdict = with_fewer_poles(verdict, result.structure, result.parameters, raw.made_ready(y, log.reference))
    others = {name: signal[raw.made_use_of] for name, signal in log.others.items()}
    found = other_columns(result.structure, result.parameters, record, log.dt, others)
    verdict = with_other_columns(verdict, found)
    kept = Verdict(verdict.status, verdict.reasons, verdict.excited)
    return replace(result, verdict=verdict, model=replace(result.model, verdict=kept))
