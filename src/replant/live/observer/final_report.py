"""The report of a running identification, over the samples that the identifier keeps."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from replant.assessment import fit_percent, simulate
from replant.data.logs import Log
from replant.errors import ReplantError
from replant.live.observer.view import View
from replant.online.identifier import Identifier
from replant.online.kept_model import model_of
from replant.runs.result import Clock, History, Result
from replant.simulation.stretches import stretches_of
from replant.statistics.autoregression import one_step, one_step_with_lost

ROUNDING = 1e-6  # difference between an interval and the sampling time that is rounding [sampling times]


def report_of(identifier: Identifier, view: View) -> bytes:
    """Return the HTML report of an identifier."""
    from replant.report.html.report import write_report

    if identifier.settings is None:
        raise ReplantError("there is no model to report on yet")
    u, y, intervals = identifier.recent.T.copy()
    t = np.cumsum(intervals) - intervals[0]
    regular = bool((np.abs(intervals[1:] - identifier.dt) <= ROUNDING * identifier.dt).all())
    log = Log(u, y, identifier.dt, t, "input", "output", Path(view.source), irregular=not regular)
    if identifier.reference:
        log = dataclasses.replace(log, reference=identifier.recent_reference, reference_name="reference")
    with tempfile.TemporaryDirectory() as folder:
        page = write_report(
            Path(folder, "report.html"), _result(identifier, view, log), log, command=f"live {view.source}"
        )
        return page.read_bytes()


def _result(identifier: Identifier, view: View, log: Log) -> Result:
    settings = identifier.settings
    assert settings is not None
    u, y, t = log.input, log.output, log.stamps
    judged = identifier.judged
    y = np.where(judged, y, np.nan)
    seen = dataclasses.replace(settings, preprocess=dataclasses.replace(settings.preprocess, input_map="identity"))
    simulation = simulate(
        identifier.transfer_function, u - float(settings.preprocess.input_offset), y, identifier.dt,
        input_hold=settings.filter.input_hold, t=t,
    )  # fmt: skip
    rows = view.history
    known = np.isfinite(rows.parameters).all(axis=1)
    # the report's log holds the newest samples only, so rows are numbered from its first sample
    if t is None:
        samples = np.round((rows.t - view.at) / identifier.dt).astype(np.int64) + u.size
        errors = one_step(y - simulation.output)
    else:
        samples = np.searchsorted(t, rows.t - view.at + t[-1], side="right").astype(np.int64)
        errors = one_step_with_lost(y - simulation.output, t, identifier.dt)
    known &= samples > 0
    verdict, ahead = identifier.assess(), fit_percent(y, y - errors)
    return Result(
        model_of(identifier, simulation, ahead, verdict),
        ahead,
        simulation,
        identifier.samples,
        identifier.rejected,
        verdict,
        0.0,
        seen,
        History(samples[known], rows.parameters[known], rows.std[known]),
        left_out=stretches_of(~judged),
        clock=Clock.of(identifier.dt, t),
    )
