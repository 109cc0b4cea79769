"""The other columns of a log that explain what the model of a run leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replant.assessment.other_columns import other_columns, with_other_columns
from replant.assessment.verdict import Verdict
from replant.log import Log
from replant.offline.fit import RawRecord
from replant.runs.result import Result
from replant.simulation.stretches import flags_of


def with_columns_named(result: Result, log: Log) -> Result:
    """Return the result of a run over a whole log; its verdict names the columns that explain what the model leaves."""
    settings = result.settings
    if not log.others or settings is None or not result.parameters.any() or log.earlier:
        return result
    y = np.where(flags_of(result.left_out, 0, log.output.size), np.nan, log.output)
    raw = RawRecord(result.structure, log.dt, settings.preprocess, log.input, y, log.stamps, settings.filter.input_hold)
    if not raw.usable.any():
        return result
    others = {name: signal[raw.made_use_of] for name, signal in log.others.items()}
    found = other_columns(result.structure, result.parameters, raw.made_ready(y, None), log.dt, others)
    verdict = with_other_columns(result.verdict, found)
    kept = Verdict(verdict.status, verdict.reasons, verdict.excited)
    return replace(result, verdict=verdict, model=replace(result.model, verdict=kept))
