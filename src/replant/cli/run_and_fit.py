"""``replant run`` and ``replant fit``: one pass over a recorded log, or structures of one or several inputs fitted."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click

from replant.cli.messages import progress_bar
from replant.cli.option_types import Choice, are_several, path_option
from replant.cli.results import Keeping, deliver, keeping_options, make_folder
from replant.cli.run_fit_compare_options import (
    OPTIMIZER,
    are_ranges,
    check_one_input,
    fit_options,
    preprocess_of,
    read_several,
    recording_of,
    request_of,
    run_options,
    structure_of,
    structures_of,
)
from replant.cli.run_several_inputs import as_one, identify_rows, passed_over
from replant.cli.run_several_inputs import fitted as fitted_rows
from replant.errors import InvalidArgumentError
from replant.estimation.settings import Request
from replant.estimation.simulation.fitted_run import FITTED
from replant.fitting.fit import METHODS, fit
from replant.fitting.search_result import SearchResult
from replant.fitting.structure_search import search
from replant.logs import Log, Recording
from replant.model.structure import Structure
from replant.online.bank_weights import MOST
from replant.online.runs.full_trace import FullTrace
from replant.online.runs.result import Result, result_of_fit
from replant.online.runs.run import run_source
from replant.online.runs.run_log import judged_by_log
from replant.report import results_as_text as comparison
from replant.report.python_programs import fit_as_python


@click.command(name="run")
@run_options
@OPTIMIZER
@click.option("--startup", type=int, metavar="N", help="Number of samples for the first model.  [default: a tenth]")
@path_option("--full-trace", "FILE", "Write the estimate after each sample (.parquet).")
@keeping_options
def run_command(as_json: bool, out: Path | None, full_trace: Path | None, startup: int | None, **options: Any) -> None:
    """Identify G(s) online from LOG (csv, mat, parquet and more; - is standard input), sample by sample in one pass.

    Settings that no option gives are chosen from the data, and printed as Python code.  LOG may be larger than memory.

    With a range, as in -p 1:4, up to ten structures learn side by side.  Of those that are trusted the most probable
    one is served, given what each predicted of the samples; --json has structures, each with its weight, and leads.

    Several inputs, each with -i, give a transfer function from each, as `replant fit` does: -p 2,1 --delay 0,0.3.
    Several outputs, each with -o, give a row of these each.
    """
    keeping = Keeping.of(options)
    if are_several(options):
        identify_rows(passed_over(startup), as_json, keeping, out, options | {"full_trace": full_trace})
        return
    with progress_bar(rate=True) as bar:
        task = bar.add_task("checking", total=None)

        def progress(stage: str, done: int, total: int) -> None:
            if bar.tasks[task].description != stage:
                bar.reset(task, description=stage)
            bar.update(task, completed=done, total=total)

        possible = _side_by_side(options | {"full_trace": full_trace}) if are_ranges(options) else []
        for first in possible[:1]:
            options |= {"poles": (first.poles,), "zeros": (first.zeros,), "delay": (first.delay,)}
        structures = possible if len(possible) > 1 else []
        recording = recording_of(options, lambda rows, about: progress("checking", rows, about))
        request = request_of(options, recording.dt)
        make_folder(out)
        total = recording.samples
        result = _run(
            recording, request, full_trace, startup, lambda stage, done: progress(stage, done, total), structures
        )
    shown = result.overview
    log = recording.held
    if shown is not None:
        log = recording.newest(shown.newest_input, shown.newest_output, shown.newest_times)
    assert log is not None
    result = judged_by_log(result, log).without_rest(log.rest)
    if full_trace is not None and not as_json:
        click.echo(f"wrote {full_trace}")
    if structures and not as_json:
        click.echo(comparison.weights_in_words(result))
    more = comparison.weights_as_json(result) if structures else {}
    deliver(result, log, keeping, as_json=as_json, out=out, more=more)


def _side_by_side(options: dict[str, Any]) -> list[Structure]:
    """Return the structures of a range, and refuse what they do not take."""
    for name, usual in (("optimizer", "auto"), ("full_trace", None)):
        if options[name] != usual:
            raise InvalidArgumentError(f"a range of structures takes no --{name.replace('_', '-')}: leave it out")
    found = structures_of(options)
    if len(found) > MOST:
        raise InvalidArgumentError(f"at most {MOST} structures learn side by side, got {len(found)}: use replant fit")
    return found


def _run(
    recording: Recording,
    request: Request,
    full_trace: Path | None,
    startup: int | None,
    progress: Callable[[str, int], None],
    structures: list[Structure],
) -> Result:
    newest = None if recording.held is not None else FITTED
    with nullcontext() if full_trace is None else FullTrace(full_trace, recording.dt) as trace:
        sink = (lambda rows: None) if trace is None else trace.take
        return run_source(
            request, recording, progress, sink, newest, startup, recording.irregular, structures=structures
        )


@click.command(name="fit")
@fit_options
@click.option("--method", type=Choice(METHODS), default="auto", show_default=True, help="Method of the fit.")
@keeping_options
def fit_command(as_json: bool, out: Path | None, method: str, **options: Any) -> None:
    """Fit G(s) to all of LOG (csv, mat, parquet and more; - is standard input).

    Several logs of one rig give one model: of each, offset and initial state are its own.

    The method is refined instrumental variables, or least squares.

    With a range of poles, zeros or dead times, the structure with the most evidence is chosen: the log-likelihood of
    all samples, less ln(K) / 2 for every number that is fitted to K samples (BIC).  Structures that cannot win are left
    early.  The dead time is found between the points of the grid.

    Several inputs, each with -i, give a transfer function from each, with poles, zeros and a dead time of its own:
    -p 2,1 --delay 0,0.3.  Several outputs, each with -o, are identified each by itself.
    """
    from rich.console import Console

    keeping, begun = Keeping.of(options), time.perf_counter()
    more, report = dict[str, Any](), dict[str, Any]()
    if are_several(options):
        identify_rows(fitted_rows, as_json, keeping, out, options | {"method": method})
        return
    check_one_input(options)
    if any(len(options[name] or ()) > 1 for name in ("poles", "zeros", "delay")):
        if method == "least_squares":
            raise click.UsageError("a range of structures is searched by srivc: drop --method least_squares")
        if options["feedthrough"]:
            raise click.UsageError("a range of structures is searched without --feedthrough: give one number of each")
        logs = read_several(options)
        make_folder(out)
        found = _search(logs, options)
        fitted = found.best
        report["candidates"] = comparison.HEADINGS, comparison.rows_of(found), found.rest
        more["candidates"] = comparison.candidates_as_json(found)
        if not as_json:
            comparison.print_candidates(Console(), found)
    else:
        structure_of(options)
        logs = read_several(options)
        request = request_of(options, logs[0].dt)
        make_folder(out)
        given = logs if len(logs) > 1 else logs[0]
        fitted = fit(given, structure=request.structure, method=method, preprocess=request.preprocess)
    log = as_one(logs)
    report |= {"filter": fitted.fixed_filter, "preprocess": fitted.preprocess}
    report["python"] = fit_as_python(fitted, logs)
    result = result_of_fit(fitted, log.input, log.output, begun, log.stamps)
    deliver(result, log, keeping, as_json=as_json, out=out, more=more, **report)


def _search(logs: list[Log], options: dict[str, Any]) -> SearchResult:
    zeros = options["zeros"]
    if zeros is None and len(options["poles"]) == 1:
        zeros = (0,)
    with progress_bar() as bar:
        task = bar.add_task("structures", total=None)
        return search(
            logs if len(logs) > 1 else logs[0],
            poles=options["poles"],
            zeros=zeros,
            delays=options["delay"],
            bias=options["bias"],
            preprocess=preprocess_of(options),
            progress=lambda done, of: bar.update(task, completed=done, total=of),
        )
