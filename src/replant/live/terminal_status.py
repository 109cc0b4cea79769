"""Terminal status: the view, redrawn in place or printed as a line every few seconds; and the dashboard's report."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ReplantError
from replant.fitting.miso_fit import RowFit
from replant.live.progress import Identification
from replant.live.view import View
from replant.logs import Log
from replant.model.transfer_function import TransferFunction
from replant.numerics.robust import stretches_of
from replant.online.identifier import Identifier
from replant.online.miso_identifier import RowIdentifier
from replant.online.running_model import model_of, newest_run, newest_samples
from replant.online.runs.result import Clock, History, Result
from replant.plotting.numbers import fraction, grouped, with_std
from replant.report.findings import colour_of, without_reasons, words_of
from replant.report.results_as_text import lines_behind, parameter_table

LINES_APART = 5.0  # time between two status lines if standard error is not a terminal [s]


class TerminalStatus:
    """Write views to standard error."""

    def __init__(self, truth: TransferFunction | None = None) -> None:
        from rich.console import Console

        self._truth = truth
        self._console = Console(stderr=True)
        self._live: Any = None
        self._next = 0.0
        self._gone = False
        if self._console.is_terminal:
            from rich.live import Live

            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()

    def show(self, view: View | None, lines: Sequence[str] = ()) -> None:
        """Print lines, and show the view, if any, until the next call; do nothing once the terminal is closed."""
        if self._gone:
            return
        try:
            for line in lines:
                self._console.print(line, markup=False, highlight=False, soft_wrap=True)
            if view is not None and self._live is not None:
                self._live.update(render(view, self._truth), refresh=True)
            elif view is not None and time.monotonic() >= self._next:
                self._next = time.monotonic() + LINES_APART
                print(status_line(view), file=sys.stderr, flush=True)
        except (OSError, SystemExit):  # the window or the pipe was closed; rich raises SystemExit for a pipe
            self._gone = True

    def close(self) -> None:
        """Remove the status; printed lines remain."""
        if self._live is not None:
            with contextlib.suppress(OSError, SystemExit):
                self._live.stop()


def status_line(view: View) -> str:
    """Return a view in one line: time, samples, rate, losses, verdict and estimate."""
    figures = ", ".join(
        f"{name} {with_std(value, std)}"
        for name, value, std in zip(view.names, view.parameters.tolist(), view.std.tolist(), strict=True)
        if math.isfinite(value)
    )
    verdict = without_reasons(view.verdict, excited=view.excited)
    parts = [*_progress(view), f"{grouped(view.rate, 0)}/s", _lost(view), verdict, figures]
    if view.source_state != "connected":
        parts.insert(0, view.source_state)
    return "; ".join(part for part in parts if part)


def render(view: View, truth: TransferFunction | None = None, *, running: bool = True) -> Any:
    """Return a view as an object that rich prints."""
    from rich.console import Group
    from rich.text import Text

    shape, colour = words_of(view.verdict).shape, colour_of(view.verdict)
    frozen = "" if view.adapting else "  (frozen: samples arrive, but the estimate is not updated)"
    cut: Any = {"no_wrap": True, "overflow": "ellipsis"}
    of_source = {"connected": "green", "ended": "default"}.get(view.source_state, "yellow")
    head = Text.assemble((view.source, "bold"), "  ", (view.source_state, of_source), **cut)
    rows: list[Any] = [head, Text(_traffic(view, running=running), **cut)]
    if view.window.r.size:
        newest = {"reference": view.window.r, "output": view.window.y}
        inputs = (view.window.u, *(each.u for each in view.more_inputs))
        names = [each.input_label for each in view.inputs] if view.more_inputs else ["input"]
        newest |= dict(zip(names, inputs, strict=True))
        rows.append(Text("   ".join(f"{name} {grouped(float(signal[-1]))}" for name, signal in newest.items())))
    rows.append(Text(""))
    if view.den.size:
        several = len(view.inputs) > 1
        for each in view.inputs:
            rows += [Text(f"From {each.input_label} to {view.output_label}", "bold")] if several else []
            model = TransferFunction(each.num, each.den, each.delay)
            rows += [Text(line, **cut) for line in fraction(model)]
            rows.append(Text(""))
        figures = view.parameters.tolist(), view.std.tolist()
        rows += [parameter_table(view.names, *figures, truth, "estimate", 5), Text("")]
        fit = f"{grouped(view.simulated)} % from the input{'s' if several else ''} alone, newest samples"
        fit = fit if math.isfinite(view.simulated) else ""
        gains = ", ".join(with_std(each.dc_gain, each.dc_gain_std) for each in view.inputs)
        told = [("DC gain", gains), ("Fit", fit)] if several else [("DC gain", f"{gains}{fit and f'    Fit  {fit}'}")]
        rows += [_Behind(*each) for each in told]
    rows.append(Text.assemble("Verdict  ", (f"{shape} {view.verdict}", f"bold {colour}"), frozen))
    rows += [_Behind("", reason) for reason in view.reasons]
    if running:
        rows.append(Text("Ctrl-C ends", style="dim"))
    return Group(*rows)


@dataclasses.dataclass(frozen=True)
class _Behind:
    """A text behind its heading, broken into the lines of the terminal."""

    heading: str
    text: str

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        from rich.text import Text

        return (Text(line) for line in lines_behind(self.heading, self.text, options.max_width))


def _traffic(view: View, *, running: bool) -> str:
    parts = _progress(view)
    if running:
        lag = f"{grouped(1e3 * view.lag)} ms behind" if view.lag < 1.0 else f"{grouped(view.lag)} s behind"
        parts += [f"{grouped(view.rate, 0)}/s", lag]
    return "   ".join(part for part in (*parts, _lost(view)) if part)


def _progress(view: View) -> list[str]:
    return [f"{grouped(view.at)} s", f"{grouped(view.samples, 0)} samples"]


def _lost(view: View) -> str:
    """Return the samples and lines that were not learned, by reason."""
    counts = [*view.rejected.items(), *view.counters.items()]
    return ", ".join(f"{grouped(count, 0)} {reason}" for reason, count in counts if count)


def report_of(identifier: Identification, view: View) -> bytes:
    """Return the HTML report of an identifier."""
    from replant.report.result_page import write_report

    of = _of_several(identifier, view) if isinstance(identifier, RowIdentifier) else _of_one(identifier, view)
    if of is None:
        raise ReplantError("there is no model to report on yet")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "report.html")
        write_report(path, *of, command=f"live {view.source}")
        return path.read_bytes()


def _of_several(identifier: RowIdentifier, view: View) -> tuple[RowFit, Log] | None:
    """Return the fit of the newest samples of several inputs, and their log; None without a model."""
    found = identifier.fit_of_newest()
    if found is None:
        return None
    newest, names = identifier.newest_samples(found), identifier.request.input_names
    first, *more = newest.input.T
    log = Log(
        first, newest.output, identifier.dt, np.cumsum(newest.intervals) - newest.intervals[0], names[0],
        view.output_label, Path(view.source), irregular=not newest.regular, input_hold=identifier.input_hold,
        others=dict(zip(names[1:], more, strict=True)), more_inputs=names[1:],
    )  # fmt: skip
    return dataclasses.replace(found, model=found.model.of_log(names, view.output_label, view.source)), log


def _of_one(identifier: Identifier, view: View) -> tuple[Result, Log] | None:
    """Return the result of the newest samples of one input, and their log; None without a model."""
    settings, newest = identifier.settings, newest_samples(identifier)
    if settings is None:
        return None
    u, y, intervals = identifier.recent.T.copy()
    since = np.cumsum(intervals) - intervals[0]
    log = Log(u, y, identifier.dt, since, "input", "output", Path(view.source), irregular=not newest.regular)
    if identifier.reference:
        log = dataclasses.replace(log, reference=identifier.recent_reference, reference_name="reference")
    seen = dataclasses.replace(settings, preprocess=dataclasses.replace(settings.preprocess, input_map="identity"))
    rows, t, judged, verdict = view.history, log.stamps, identifier.judged, identifier.assess()
    whole = {"input": u, "output": y, "intervals": intervals, "judged": judged}
    simulation, ahead = newest_run(identifier, dataclasses.replace(newest, **whole))
    # the report's log holds the newest samples only, so rows are numbered from its first sample
    if t is None:
        samples = np.round((rows.t - view.at) / identifier.dt).astype(np.int64) + u.size
    else:
        samples = np.searchsorted(t, rows.t - view.at + t[-1], side="right").astype(np.int64)
    known = np.isfinite(rows.parameters).all(axis=1) & (samples > 0)
    result = Result(
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
    return result, log
