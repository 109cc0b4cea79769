"""``replant run`` and ``replant fit``: one pass over a recorded log, or structures fitted to logs.

Of several inputs or outputs each output has a row of transfer functions, and is identified by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click

from replant.cli import results
from replant.cli.advice import OTHER_LOG, NextStep, again
from replant.cli.conditioning_options import is_conditioned
from replant.cli.messages import is_quiet, progress_bar
from replant.cli.option_types import (
    STRUCTURE,
    Choice,
    are_several,
    command_line,
    is_range,
    orders_of,
    path_option,
    refuse_not_yet,
    refuse_ranges,
)
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
from replant.errors import InvalidArgumentError
from replant.estimation.settings import Request
from replant.estimation.simulation.fitted_run import FITTED
from replant.fitting import model_json
from replant.fitting.fit import METHODS, fit
from replant.fitting.miso_fit import RowFit
from replant.fitting.samples import Samples
from replant.fitting.search_result import SearchResult
from replant.fitting.several_outputs import MatrixFit, without_outputs
from replant.fitting.structure_search import as_row, search
from replant.fitting.validation import Validation
from replant.logs import Log, Recording
from replant.logs.recording import digest
from replant.model.structure import Structure
from replant.online.bank_weights import MOST
from replant.online.runs.full_trace import FullTrace
from replant.online.runs.result import Result, result_of_fit
from replant.online.runs.run import run_source
from replant.online.runs.run_log import first_model, judged_by_log, run_row
from replant.report import results_as_text as as_text
from replant.report.python_programs import fit_as_python, row_as_python


@click.command(name="run")
@run_options
@OPTIMIZER
@click.option("--startup", type=int, metavar="N", help="Number of samples for the first model.  [default: a tenth]")
@path_option("--full-trace", "FILE", "Write the estimate after each sample (.parquet).")
@results.keeping_options
def run_command(as_json: bool, out: Path | None, full_trace: Path | None, startup: int | None, **options: Any) -> None:
    """Identify G(s) online from LOG (csv, mat, parquet and more; - is standard input), sample by sample in one pass.

    Settings that no option gives are chosen from the data, and printed as Python code.  LOG may be larger than memory.

    With a range, as in -p 1:4, up to ten structures learn side by side.  Of those that are trusted the most probable
    one is served, given what each predicted of the samples; --json has structures, each with its weight, and leads.

    Several inputs, each with -i, give a transfer function from each, as `replant fit` does: -p 2,1 --delay 0,0.3.
    Several outputs, each with -o, give a row of these each.
    """
    keeping = results.Keeping.of(options)
    if are_several(options):
        identify_rows(_passed_over(startup), as_json, keeping, out, options | {"full_trace": full_trace})
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
        results.make_folder(out)
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
        click.echo(as_text.weights_in_words(result))
    more = as_text.weights_as_json(result) if structures else {}
    results.deliver(result, log, keeping, as_json=as_json, out=out, more=more)


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
@results.keeping_options
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

    keeping, begun = results.Keeping.of(options), time.perf_counter()
    more, report = dict[str, Any](), dict[str, Any]()
    if are_several(options):
        identify_rows(_fitted, as_json, keeping, out, options | {"method": method})
        return
    check_one_input(options)
    if are_ranges(options):
        if method == "least_squares":
            raise click.UsageError("a range of structures is searched by srivc: drop --method least_squares")
        if options["feedthrough"]:
            raise click.UsageError("a range of structures is searched without --feedthrough: give one number of each")
        logs = read_several(options)
        results.make_folder(out)
        zeros = (0,) if options["zeros"] is None and len(options["poles"]) == 1 else options["zeros"]
        asked = {"poles": options["poles"], "zeros": zeros, "delays": options["delay"], "bias": options["bias"]}
        found = _searched(logs, **asked, preprocess=preprocess_of(options))
        fitted = found.best
        report["candidates"] = found
        more["candidates"] = as_text.candidates_as_json(found)
        if not as_json:
            as_text.print_candidates(Console(), found)
    else:
        structure_of(options)
        logs = read_several(options)
        request = request_of(options, logs[0].dt)
        results.make_folder(out)
        fitted = fit(_given(logs), structure=request.structure, method=method, preprocess=request.preprocess)
    log = as_one(logs)
    report |= {"filter": fitted.fixed_filter, "preprocess": fitted.preprocess}
    report["python"] = fit_as_python(fitted, logs)
    result = result_of_fit(fitted, log.input, log.output, begun, log.stamps)
    results.deliver(result, log, keeping, as_json=as_json, out=out, more=more, **report)


def _searched(logs: list[Log], **asked: Any) -> SearchResult:
    """Search structures of logs with a progress bar."""
    with progress_bar() as bar:
        task = bar.add_task("structures", total=None)
        found: SearchResult = search(
            _given(logs), progress=lambda done, of: bar.update(task, completed=done, total=of), **asked
        )
    return found


def _given(logs: list[Log]) -> Any:
    """Return logs as `fit` and `search` take them: one by itself."""
    return logs if len(logs) > 1 else logs[0]


# --- several inputs or outputs


class Solved(NamedTuple):
    """The row of an output, the Python program that makes it, and the search that chose its structure, if one did."""

    row: RowFit
    python: str
    search: SearchResult | None = None


#: Makes the row of an output from its logs and the orders asked for.
Solver = Callable[[list[Log], dict[str, Any]], Solved]


def _fitted(logs: list[Log], asked: dict[str, Any]) -> Solved:
    """Return the row that `fit` makes of logs, or `search` where a range is asked for."""
    if not any(map(is_range, asked.values())):
        row: RowFit = fit(_given(logs), **asked)
        return Solved(row, row_as_python(row.model, logs))
    grid: dict[str, Any] = {}
    for name, each in asked.items():
        ranges = tuple(one if isinstance(one, tuple) else (one,) for one in each)
        grid[name] = ranges if len(ranges) > 1 else ranges[0]
    zeros = None if is_range(asked["poles"]) and not any(asked["zeros"]) else grid["zeros"]
    found = _searched(logs, poles=grid["poles"], zeros=zeros, delays=grid["delay"])
    found = as_row(found, Samples.of(_given(logs), None, None, None, None))
    return Solved(found.best, row_as_python(found.best.model, logs), found)


def _passed_over(startup: int | None) -> Solver:
    """Return what makes a row by one pass over a log, as `Identifier` does, and solves it as a whole at the end."""

    def row_of(logs: list[Log], asked: dict[str, Any]) -> Solved:
        (log,) = logs
        refuse_ranges(asked)
        with progress_bar(rate=True) as bar:
            task = bar.add_task("identifying", total=len(log))
            row = run_row(
                Samples.of(log, None, None, None, None), asked, startup, lambda done: bar.update(task, completed=done)
            )
        return Solved(row, row_as_python(row.model, logs, first_model(len(log)) if startup is None else startup))

    return row_of


def identify_rows(
    solve: Solver, as_json: bool, keeping: results.Keeping, out: Path | None, options: dict[str, Any]
) -> None:
    """Identify a row for each output, print them, save and validate their model, and write a report."""
    begun = time.perf_counter()
    named = (options[name] for name in ("input_column", "output_column"))
    inputs, outputs = (each if isinstance(each, tuple) else (each,) for each in named)
    refuse_not_yet(options, "outputs" if len(outputs) > 1 else "inputs")
    asked = orders_of(options, inputs)
    columns = [{"input_column": inputs, "output_column": each} for each in outputs]
    records = _of_one_output([read_several(options | each) for each in columns])
    results.make_folder(out)
    rows, programs, searches, validations = [], [], [], list[tuple[str, Validation]]()
    for logs, each in zip(records, columns, strict=True):
        row, program, search_of = solve(logs, asked)
        sha256 = digest(logs[0].path) if len(logs) == 1 else ""
        row = replace(row, model=replace(row.model, provenance=replace(row.model.provenance, sha256=sha256)))
        found = replace(keeping, columns=keeping.columns | each).validated(row.model)
        rows.append(row)
        programs.append(program)
        searches += [] if search_of is None else [search_of]
        validations += [(f"{name}, {row.model.output_name}" if len(outputs) > 1 else name, one) for name, one in found]
    model = MatrixFit(tuple(rows)).model if len(rows) > 1 else rows[0].model
    paths = keeping.save(model)
    if out is not None:
        python = results.CONDITIONED if is_conditioned(click.get_current_context().params) else "\n\n".join(programs)
        paths += _reported(out, rows, [as_one(logs) for logs in records], python, validations, searches)
    if as_json:
        whole = model_json.as_object(rows[0].model)
        if len(rows) > 1:
            whole = model_json.rows_object([row.model for row in rows])
        tried = [as_text.candidates_as_json(each) for each in searches]
        whole |= {"candidates": tried if len(rows) > 1 else tried[0]} if tried else {}
        results.echo_json(whole | {"elapsed_seconds": round(time.perf_counter() - begun, 3)}, validations)
    else:
        _print_rows(rows, records, searches)
        step = None
        if not (keeping.saved or validations or is_quiet()) and all(row.verdict.status == "trusted" for row in rows):
            # of what was searched for, what was found
            chosen = {} if not searches or len(rows) > 1 else _orders(rows[0])
            again_with = again(**chosen, save="model.json", validate=OTHER_LOG)
            step = NextStep("keep the model; check it on another log", again_with)
        results.print_rest(validations, paths, step)
    results.check_required(
        keeping.required, [*(row.verdict for row in rows), *(each.verdict for _, each in validations)]
    )


def _print_rows(rows: Sequence[RowFit], records: Sequence[list[Log]], searches: Sequence[SearchResult]) -> None:
    from rich.console import Console

    console = Console()
    for number, (row, logs) in enumerate(zip(rows, records, strict=True)):
        if searches:
            console.print(f"\nStructures for {row.model.output_name}", highlight=False, markup=False, style="bold")
            as_text.print_candidates(console, searches[number])
        samples, seconds = sum(len(each) - each.rest for each in logs), sum(each.duration for each in logs)
        as_text.print_row(console, row.model, record=as_text.record_line(samples, logs[0].dt, seconds))


def _orders(row: RowFit) -> dict[str, object]:
    """Return the options that ask for the structure of a row."""
    return {name: ",".join(f"{getattr(each, name):.6g}" for each in row.model.structures) for name in STRUCTURE}


def _reported(
    out: Path,
    rows: Sequence[RowFit],
    logs: Sequence[Log],
    python: str,
    validations: Sequence[tuple[str, Validation]],
    searches: Sequence[SearchResult],
) -> list[Path]:
    """Write the pictures and the report; return their paths."""
    from replant.report.matrix_page import Output, save_figures, write_rows
    from replant.report.result_page import candidates_of

    shown = [Output(*each) for each in zip(rows, logs, strict=True)]
    with results.write_errors_reported(out):
        paths = save_figures(out, shown)
        tried = "".join(map(candidates_of, searches))
        more: dict[str, Any] = {"validations": validations, "candidates": tried}
        report = write_rows(out / "report.html", shown, command=command_line(), python=python, **more)
    return [*paths, report]


def _of_one_output(records: list[list[Log]]) -> list[list[Log]]:
    """Return the logs of each output, beside which no other output stands: that is no column to explain it."""
    names = {logs[0].output_name for logs in records}
    return [[without_outputs(log, names) for log in logs] for logs in records] if len(names) > 1 else records


def as_one(logs: list[Log]) -> Log:
    """Return several logs as one, for plots of them; a single one as it is."""
    if len(logs) == 1:
        return logs[0]
    all_of = Samples.of_several(logs)
    return Log(
        all_of.u, all_of.y, all_of.dt, all_of.t, all_of.input_name, all_of.output_name, Path(all_of.source),
        reference=all_of.reference, reference_name=all_of.reference_name, irregular=True, input_hold=all_of.input_hold,
        others=all_of.others, more_inputs=all_of.more_inputs, more_references=all_of.more_references, rest=all_of.rest,
    )  # fmt: skip
