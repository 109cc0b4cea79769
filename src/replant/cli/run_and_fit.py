"""``replant run`` and ``replant fit``: one pass over a recorded log, or structures fitted to logs.

Of several inputs or outputs each output has a row of transfer functions, and is identified by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click

from replant.cli import results
from replant.cli import run_fit_compare_options as shared
from replant.cli.advice import OTHER_LOG, NextStep, again
from replant.cli.messages import is_given, note, progress_bar, terminal
from replant.cli.option_types import STRUCTURE, Candidates, Choice, command_line, path_option
from replant.errors import InvalidArgumentError
from replant.estimation.simulation.fitted_run import FITTED
from replant.fitting import model_json
from replant.fitting.fit import METHODS, fit
from replant.fitting.miso_fit import RowFit
from replant.fitting.samples import Samples, check_enough
from replant.fitting.search_result import SearchResult
from replant.fitting.several_outputs import MatrixFit, without_outputs
from replant.fitting.structure_search import as_row, search
from replant.fitting.validation import Validation
from replant.logs import Log
from replant.logs.log import JoinedLog
from replant.logs.recording import digest
from replant.model.structure import Structure
from replant.online.bank_weights import MOST
from replant.online.runs.full_trace import FullTrace
from replant.online.runs.result import result_of_fit
from replant.online.runs.run import run_source
from replant.online.runs.run_log import first_model, judged_by_log, run_row
from replant.report import results_as_text as as_text
from replant.report.python_programs import fit_as_python, row_as_python, run_as_python


@click.command(name="run")
@shared.run_options
@shared.OPTIMIZER
@click.option("--startup", type=int, metavar="N", help="Number of samples for the first model.  [default: a tenth]")
@path_option("--full-trace", "FILE", "Write the estimate after each sample (.parquet).")
@results.keeping_options
def run_command(startup: int | None, **options: Any) -> None:
    """Identify G(s) online from LOG (csv, mat, parquet and more; - is standard input), sample by sample in one pass.

    Settings that no option gives are chosen from the data, and printed as Python code.  LOG may be larger than memory.

    With a range, as in -p 1:4, up to ten structures learn side by side.  The result is the trusted structure with the
    highest probability, given its predictions of the samples; --json has structures, each with its weight, and leads.

    Several inputs, each with -i, give a transfer function from each, as `replant fit` does: -p 2,1 --delay 0,0.3.
    Several outputs, each with -o, give such a row each.
    """
    shared.begin(options, "replant run takes one log, in one pass; replant fit makes one model of several")
    to = results.Delivery.of(options)
    if shared.are_several(options):
        identify_rows(partial(_passed_over, startup=startup), to, options)
        return
    with progress_bar(rate=True) as bar:
        task = bar.add_task("checking", total=None)

        def progress(stage: str, done: int, total: int) -> None:
            if bar.tasks[task].description != stage:
                bar.reset(task, description=stage)
            bar.update(task, completed=done, total=total)

        structures = _side_by_side(options) if shared.are_ranges(options) else []
        if structures:
            first = structures[0]
            options |= {"poles": ((first.poles,),), "zeros": ((first.zeros,),), "delay": ((first.delay,),)}
        recording = shared.recording_of(options, partial(progress, "checking"))
        _note_startup(startup, recording.samples)
        request = shared.request_of(options, recording.dt)
        results.make_folder(to.out)
        newest = None if recording.held is not None else FITTED
        path, total = options["full_trace"], recording.samples
        with nullcontext() if path is None else FullTrace(path, recording.dt) as trace:
            result = run_source(
                request, recording, lambda stage, done: progress(stage, done, total),
                (lambda rows: None) if trace is None else trace.take, newest, startup, recording.irregular,
                structures=structures if len(structures) > 1 else [],
            )  # fmt: skip
    shown = result.overview
    log = recording.held
    if shown is not None:
        log = recording.newest(shown.newest_input, shown.newest_output, shown.newest_times)
    assert log is not None
    result, more = judged_by_log(result, log).without_added(log.added), {}
    if not result.parameters.any():
        check_enough(result.used, result.rejected, result.structure)
    if path is not None and not to.as_json:
        click.echo(f"wrote {path}")
    if len(structures) > 1:
        more = as_text.weights_as_json(result)
        if not to.as_json:
            click.echo(as_text.weights_in_words(result))
    python = "" if result.settings is None else run_as_python(result, log, shared.opened_as_python(options))
    results.deliver(to, result, log, more=more, python=python)


def _note_startup(startup: int | None, samples: int) -> None:
    """Note that a log ends before its start-up."""
    if startup is not None and startup > samples:
        note(
            f"--startup {startup:,} is more than the log's {samples:,} samples: the model is made at its end, from all"
        )


def _side_by_side(options: dict[str, Any]) -> list[Structure]:
    """Return the structures of a range, and refuse what they do not take."""
    for name, usual in (("optimizer", "auto"), ("full_trace", None)):
        if options[name] != usual:
            raise InvalidArgumentError(f"a range of structures takes no --{name.replace('_', '-')}: leave it out")
    found = shared.structures_of(options)
    if len(found) > MOST:
        raise InvalidArgumentError(f"at most {MOST} structures learn side by side, got {len(found)}: use replant fit")
    return found


@click.command(name="fit")
@shared.fit_options
@click.option("--method", type=Choice(METHODS), default="auto", show_default=True, help="Method of the fit.")
@results.keeping_options
def fit_command(**options: Any) -> None:
    """Fit G(s) to all of LOG (csv, mat, parquet and more; - is standard input).

    Several logs of one rig give one model; each log has its own offset and initial state.

    The method is refined instrumental variables, or least squares.

    With a range of poles, zeros or dead times, the structure with the most evidence is chosen: the log-likelihood of
    all samples, less ln(K) / 2 for every number that is fitted to K samples (BIC).  The dead time is refined between
    the points of the grid.

    Several inputs, each with -i, give a transfer function from each, with poles, zeros and a dead time of its own:
    -p 2,1 --delay 0,0.3.  Several outputs, each with -o, are identified separately.
    """
    shared.begin(options)
    to, begun, tried = results.Delivery.of(options), time.perf_counter(), None
    if shared.are_several(options):
        identify_rows(_fitted, to, options)
        return
    shared.check_one_input(options)
    if shared.are_ranges(options):
        if options["method"] == "least_squares":
            raise click.UsageError("a range of structures is searched by srivc: drop --method least_squares")
        if options["feedthrough"]:
            raise click.UsageError("a range of structures is searched without --feedthrough: give one number of each")
        logs = shared.read_several(options)
        results.make_folder(to.out)
        (poles,), (delays,) = options["poles"], options["delay"]
        fewer = (0,) if len(poles) == 1 else None  # None: every number below that of the poles
        zeros = options["zeros"][0] if options["zeros"] else fewer
        preprocess = shared.preprocess_of(options)
        tried = _searched(logs, poles=poles, zeros=zeros, delays=delays, bias=options["bias"], preprocess=preprocess)
        fitted = tried.best
    else:
        shared.structure_of(options)
        logs = shared.read_several(options)
        request = shared.request_of(options, logs[0].dt)
        results.make_folder(to.out)
        how = {"method": options["method"], "preprocess": request.preprocess}
        fitted = fit(_given(logs), structure=request.structure, **how)
    log = as_one(logs)
    result = result_of_fit(fitted, log.input, log.output, begun, log.stamps)
    python = fit_as_python(fitted, logs, shared.opened_as_python(options))
    of_fit: dict[str, Any] = {"filter": fitted.fixed_filter, "preprocess": fitted.preprocess, "python": python}
    results.deliver(to, result, log, tried=tried, more={}, **of_fit)


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


#: Makes the row of an output from its logs, the orders asked for, and the begin of a program that reads the logs.
Solver = Callable[[list[Log], dict[str, Candidates], str], Solved]


def _fitted(logs: list[Log], asked: dict[str, Candidates], opened: str) -> Solved:
    """Return the row that `fit` makes of logs, or `search` where a range is asked for."""
    if not any(map(shared.is_range, asked.values())):
        numbers: dict[str, Any] = shared.numbers_of(asked)
        row: RowFit = fit(_given(logs), **numbers)
        return Solved(row, row_as_python(row.model, logs, opened=opened))
    grid: dict[str, Any] = {name: each if len(each) > 1 else each[0] for name, each in asked.items()}
    if shared.is_range(asked["poles"]) and all(each == (0,) for each in asked["zeros"]):
        grid["zeros"] = None
    found = _searched(logs, poles=grid["poles"], zeros=grid["zeros"], delays=grid["delay"])
    found = as_row(found, Samples.of(_given(logs), None, None, None, None))
    return Solved(found.best, row_as_python(found.best.model, logs, opened=opened), found)


def _passed_over(logs: list[Log], asked: dict[str, Candidates], opened: str, *, startup: int | None) -> Solved:
    """Return the row that one pass over a log makes, as `Identifier` does, solved as a whole at the end."""
    (log,), numbers = logs, shared.numbers_of(asked)
    _note_startup(startup, len(log))
    with progress_bar(rate=True) as bar:
        task = bar.add_task("identifying", total=len(log))
        samples = Samples.of(log, None, None, None, None)
        row = run_row(samples, numbers, startup, lambda done: bar.update(task, completed=done))
    return Solved(row, row_as_python(row.model, logs, first_model(len(log)) if startup is None else startup, opened))


def identify_rows(solve: Solver, to: results.Delivery, options: dict[str, Any]) -> None:
    """Identify a row for each output, print them, save and validate their model, and write a report."""
    begun = time.perf_counter()
    named = (options[name] for name in ("input_column", "output_column"))
    inputs, outputs = (each if isinstance(each, tuple) else (each,) for each in named)
    several = len(outputs) > 1
    shared.refuse_not_yet(options, "outputs" if several else "inputs")
    asked = shared.orders_of(options, inputs)
    records = [shared.read_several(options | {"input_column": inputs, "output_column": each}) for each in outputs]
    if several:  # another output is no column to explain one by
        names = {logs[0].output_name for logs in records}
        records = [[without_outputs(log, names) for log in logs] for logs in records]
    results.make_folder(to.out)
    solved, validations = [], list[tuple[str, Validation]]()
    for logs, output in zip(records, outputs, strict=True):
        opened = shared.opened_as_python(options | {"input_column": inputs, "output_column": output})
        found = solve(logs, asked, opened)
        made = replace(found.row.model.provenance, sha256=digest(logs[0].path) if len(logs) == 1 else "")
        model = replace(found.row.model, provenance=made)
        solved.append(found._replace(row=replace(found.row, model=model)))
        of_logs = to.validated(model, input_column=inputs, output_column=output)
        validations += [(f"{name}, {model.output_name}" if several else name, one) for name, one in of_logs]
    rows = [each.row for each in solved]
    step = None
    if to.as_json:
        of_rows = (
            model_json.rows_object([row.model for row in rows]) if several else model_json.as_object(rows[0].model)
        )
        tried = [as_text.candidates_as_json(each.search) for each in solved if each.search is not None]
        candidates = {"candidates": tried if several else tried[0]} if tried else {}
        elapsed = {"elapsed_seconds": round(time.perf_counter() - begun, 3)}
        results.echo_json(of_rows | candidates | elapsed, validations)
    else:
        _print_rows(solved, records)
        results.print_validations(validations)
        if not (to.saved or validations or is_given("quiet")) and all(row.verdict.status == "trusted" for row in rows):
            # of what was searched for, what was found
            structures = () if several or solved[0].search is None else rows[0].model.structures
            chosen = {name: ",".join(f"{getattr(each, name):.6g}" for each in structures) for name in STRUCTURE}
            again_with = again(**(chosen if structures else {}), save="model.json", validate=OTHER_LOG)
            step = NextStep("keep the model; check it on another log", again_with)
    verdicts = [(f"model of {row.model.output_name}" if several else "model", row.verdict) for row in rows]
    made_of_all = MatrixFit(tuple(rows)).model if several else rows[0].model
    to.finish(made_of_all, verdicts, validations, step, lambda out: _reported(out, solved, records, validations))


def _print_rows(solved: Sequence[Solved], records: Sequence[list[Log]]) -> None:
    console = terminal()
    for (row, _, found), logs in zip(solved, records, strict=True):
        if found is not None:
            console.print(f"\nStructures for {row.model.output_name}", highlight=False, markup=False, style="bold")
            as_text.print_candidates(console, found)
        samples, seconds = sum(len(each) - each.rest for each in logs), sum(each.duration for each in logs)
        as_text.print_row(console, row.model, record=as_text.record_line(samples, logs[0].dt, seconds, len(logs)))


def _reported(out: Path, solved: Sequence[Solved], records: Sequence[list[Log]], validations: Any) -> list[Path]:
    """Write the pictures and the report; return their paths."""
    from replant.report.outputs import Output, save_figures
    from replant.report.result_page import candidates_of, write_outputs

    python = "\n\n".join(each.python for each in solved)
    shown = [Output(each.row, as_one(logs)) for each, logs in zip(solved, records, strict=True)]
    tried = "".join(candidates_of(each.search) for each in solved if each.search is not None)
    paths = save_figures(out, shown)
    more: dict[str, Any] = {"validations": validations, "candidates": tried}
    return [*paths, write_outputs(out / "report.html", shown, command=command_line(), python=python, **more)]


def as_one(logs: list[Log]) -> Log:
    """Return several logs as one, for plots of them; a single one as it is."""
    if len(logs) == 1:
        return logs[0]
    all_of = Samples.of_several(logs)
    return JoinedLog(
        all_of.u, all_of.y, all_of.dt, all_of.t, all_of.input_name, all_of.output_name, Path(all_of.source),
        reference=all_of.reference, reference_name=all_of.reference_name, irregular=True, input_hold=all_of.input_hold,
        others=all_of.others, more_inputs=all_of.more_inputs, more_references=all_of.more_references, rest=all_of.rest,
        withheld=all_of.added - all_of.rest, logs=tuple(logs),
    )  # fmt: skip
