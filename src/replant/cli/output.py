"""Output of a command: a table or JSON on standard output, plots and a report in a folder."""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from replant.cli.conditioning_options import is_conditioned
from replant.cli.next_step import OTHER_LOG, NextStep, next_step
from replant.cli.notes import is_quiet
from replant.cli.save_and_validate import Keeping, check_required, kept
from replant.cli.typed_command import command_line
from replant.data.logs import Log
from replant.report.html.python_program import identifier_as_python
from replant.report.terminal.summary import as_json as result_as_json
from replant.report.terminal.summary import print_result, record_line
from replant.report.terminal.validation import as_json as validation_as_json
from replant.report.terminal.validation import print_validation
from replant.runs.result import Result

CONDITIONED = "# options of the command change the log first: repeat the command in the shell"


def deliver(
    result: Result,
    log: Log,
    keeping: Keeping,
    *,
    as_json: bool,
    out: Path | None,
    more: dict[str, Any] | None = None,
    **report: Any,
) -> None:
    """Print a result, write its plots and its report, save and validate its model."""
    from rich.console import Console

    result = dataclasses.replace(result, model=kept(result.model, log))
    validations = keeping.validated(result.model)
    paths = []
    asked = not (is_quiet() or validations)
    step = _next(result, log, keeping, is_searched="candidates" in report) if asked else None
    if keeping.saved is not None:
        result.model.save(keeping.saved)
        paths.append(keeping.saved)
    if out is not None:
        from replant.report.figures import save_figures
        from replant.report.html.report import write_report

        if is_conditioned(click.get_current_context().params):
            report["python"] = CONDITIONED
        names: Any = {"input_label": log.input_name, "output_label": log.output_name}
        with write_errors_reported(out):
            paths += save_figures(out, result, log.input, log.output, log.dt, **names)
            report["validations"] = validations
            report["advice"] = None if step is None else (step.words, step.command)
            paths.append(write_report(out / "report.html", result, log, command=command_line(), **report))
    if as_json:
        whole = result_as_json(result) | (more or {})
        if validations:
            whole["validations"] = [validation_as_json(each, name) for name, each in validations]
        click.echo(json.dumps(whole, allow_nan=False))
    else:
        console = Console()
        record = record_line(len(log), log.dt, log.duration)
        print_result(console, result, record=record, lead="" if step is None else step.words)
        for name, each in validations:
            print_validation(console, each, name)
        if result.settings is not None:
            click.echo(f"\nSettings chosen from the data; in Python:\n{identifier_as_python(result.settings)}")
        for path in paths:
            click.echo(f"wrote {path}")
        if step is not None:
            click.echo(f"\nNext: {step.words}:\n{step.command}")
    check_required(keeping.required, [result.verdict, *(each.verdict for _, each in validations)])


def _next(result: Result, log: Log, keeping: Keeping, *, is_searched: bool) -> NextStep:
    """Return what to do with the model, as far as the command did not ask for it."""
    if keeping.saved is not None and result.verdict.status == "trusted":
        command = shlex.join(["replant", "validate", str(keeping.saved), OTHER_LOG])
        return NextStep("check the model on another log", command)
    path = str(click.get_current_context().params["logs"][0])
    return next_step(result, log, path, is_searched=is_searched)


@contextmanager
def write_errors_reported(out: Path) -> Iterator[None]:
    """Turn errors of the file system into `click.BadParameter`, which names the file."""
    try:
        yield
    except OSError as cause:
        where = cause.filename or out
        raise click.BadParameter(f"cannot write {where}: {cause.strerror}", param_hint="--out") from cause


def make_folder(out: Path | None) -> None:
    """Make the folder for results; called before the computation, so that a mistake costs no time.

    >>> make_folder(None)
    """
    if out is None:
        return
    if out.exists() and not out.is_dir():
        raise click.BadParameter(f"{out} is a file; name a folder", param_hint="--out")
    with write_errors_reported(out):
        out.mkdir(parents=True, exist_ok=True)
