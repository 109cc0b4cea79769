"""What `run` and `fit` do with several inputs or outputs: a row of transfer functions for each output."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click

from replant.cli.advice import OTHER_LOG, NextStep, again
from replant.cli.conditioning_options import is_conditioned
from replant.cli.messages import is_quiet, progress_bar
from replant.cli.option_types import command_line, is_range, orders_of, refuse_not_yet, refuse_ranges
from replant.cli.results import (
    CONDITIONED,
    Keeping,
    check_required,
    echo_json,
    make_folder,
    print_rest,
    write_errors_reported,
)
from replant.cli.run_fit_compare_options import read_several
from replant.fitting import model_json
from replant.fitting.fit import fit
from replant.fitting.miso_fit import RowFit
from replant.fitting.samples import Samples
from replant.fitting.search_result import SearchResult
from replant.fitting.several_outputs import MatrixFit, without_outputs
from replant.fitting.structure_search import as_row, search
from replant.fitting.validation import Validation
from replant.logs import Log
from replant.logs.recording import digest
from replant.online.runs.run_miso import first_model, run_row
from replant.report.python_programs import row_as_python
from replant.report.results_as_text import (
    HEADINGS,
    candidates_as_json,
    print_candidates,
    print_row,
    record_line,
    rows_of,
)


class Solved(NamedTuple):
    """The row of an output, the Python program that makes it, and the search that chose its structure, if one did."""

    row: RowFit
    python: str
    search: SearchResult | None = None


#: Makes the row of an output from its logs and the orders asked for.
Solver = Callable[[list[Log], dict[str, Any]], Solved]


def fitted(logs: list[Log], asked: dict[str, Any]) -> Solved:
    """Return the row that `fit` makes of logs, or `search` where a range is asked for."""
    given = logs if len(logs) > 1 else logs[0]
    if not any(is_range(each) for each in asked.values()):
        row: RowFit = fit(given, **asked)
        return Solved(row, row_as_python(row.model, logs))
    count = len(logs[0].input_names)
    ranges: dict[str, Any] = {
        name: tuple(each if isinstance(each, tuple) else (each,) for each in given) for name, given in asked.items()
    }
    if asked["zeros"] == (0,) * count and is_range(asked["poles"]):
        ranges["zeros"] = None
    poles, zeros, delays = ranges.values()
    with progress_bar() as bar:
        task = bar.add_task("structures", total=None)
        found = search(
            given, poles=_unless_one(poles), zeros=_unless_one(zeros), delays=_unless_one(delays),
            progress=lambda done, of: bar.update(task, completed=done, total=of),
        )  # fmt: skip
    found = as_row(found, Samples.of(given, None, None, None, None))
    return Solved(found.best, row_as_python(found.best.model, logs), found)


def _unless_one(ranges: Any) -> Any:
    return ranges[0] if ranges is not None and len(ranges) == 1 else ranges


def passed_over(startup: int | None) -> Solver:
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


def identify_rows(solve: Solver, as_json: bool, keeping: Keeping, out: Path | None, options: dict[str, Any]) -> None:
    """Identify a row for each output, print them, save and validate their model, and write a report."""
    begun = time.perf_counter()
    named = (options[name] for name in ("input_column", "output_column"))
    inputs, outputs = (each if isinstance(each, tuple) else (each,) for each in named)
    refuse_not_yet(options, "outputs" if len(outputs) > 1 else "inputs")
    asked = orders_of(options, inputs)
    columns = [{"input_column": inputs, "output_column": each} for each in outputs]
    records = _of_one_output([read_several(options | each) for each in columns])
    make_folder(out)
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
        python = CONDITIONED if is_conditioned(click.get_current_context().params) else "\n\n".join(programs)
        paths += _reported(out, rows, [as_one(logs) for logs in records], python, validations, searches)
    if as_json:
        whole = model_json.as_object(rows[0].model)
        if len(rows) > 1:
            whole = model_json.rows_object([row.model for row in rows])
        tried = [candidates_as_json(each) for each in searches]
        whole |= {"candidates": tried if len(rows) > 1 else tried[0]} if tried else {}
        echo_json(whole | {"elapsed_seconds": round(time.perf_counter() - begun, 3)}, validations)
    else:
        _print(rows, records, searches)
        step = None
        if not (keeping.saved or validations or is_quiet()) and all(row.verdict.status == "trusted" for row in rows):
            # of what was searched for, what was found
            chosen = {} if not searches or len(rows) > 1 else _orders(rows[0])
            again_with = again(**chosen, save="model.json", validate=OTHER_LOG)
            step = NextStep("keep the model; check it on another log", again_with)
        print_rest(validations, paths, step)
    check_required(keeping.required, [*(row.verdict for row in rows), *(each.verdict for _, each in validations)])


def _print(rows: Sequence[RowFit], records: Sequence[list[Log]], searches: Sequence[SearchResult]) -> None:
    from rich.console import Console

    console = Console()
    for number, (row, logs) in enumerate(zip(rows, records, strict=True)):
        if searches:
            console.print(f"\nStructures for {row.model.output_name}", highlight=False, markup=False, style="bold")
            print_candidates(console, searches[number])
        samples, seconds = sum(len(each) - each.rest for each in logs), sum(each.duration for each in logs)
        print_row(console, row.model, record=record_line(samples, logs[0].dt, seconds))


def _orders(row: RowFit) -> dict[str, object]:
    """Return the options that ask for the structure of a row."""
    names = "poles", "zeros", "delay"
    return {name: ",".join(f"{getattr(each, name):.6g}" for each in row.model.structures) for name in names}


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
    with write_errors_reported(out):
        paths = save_figures(out, shown)
        tried = "".join(candidates_of((HEADINGS, rows_of(each), each.rest)) for each in searches)
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
