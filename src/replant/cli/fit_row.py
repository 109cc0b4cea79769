"""``replant fit`` and ``replant run`` of several inputs: each with poles, zeros and a dead time of its own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import click

from replant.cli.option_types import Each
from replant.cli.options import progress_bar, read_several
from replant.cli.output import Keeping, check_required
from replant.cli.terminal import is_quiet
from replant.data.logs.recording import digest
from replant.engine.dimensions import RECENT
from replant.errors import InvalidArgumentError
from replant.identified import model_json
from replant.identified.row_model import RowModel
from replant.log import Log
from replant.offline.fit import fit
from replant.online.row_identifier import RowIdentifier
from replant.report.terminal.comparison import print_validation, validation_as_json
from replant.report.terminal.row import print_row
from replant.report.terminal.summary import record_line

#: Options that one input takes, and several do not, with what they are without them.
NOT_YET = {
    "bias": False, "feedthrough": False, "input_map": "identity", "reference_column": None, "out": None,
    "method": "auto", "optimizer": "auto", "full_trace": None,
}  # fmt: skip
CHUNK = 8192  # samples taken between two marks of progress [samples]

Solver = Callable[[list[Log], dict[str, Any]], RowModel]


def fitted_row(logs: list[Log], asked: dict[str, Any]) -> RowModel:
    """Return the model that `fit` makes of logs."""
    model: RowModel = fit(logs if len(logs) > 1 else logs[0], **asked).model
    return model


def passed_over(startup: int | None) -> Solver:
    """Return what makes a model by one pass over a log, as `Identifier` does, and solves it as a whole at the end."""

    def model_of(logs: list[Log], asked: dict[str, Any]) -> RowModel:
        (log,) = logs
        count = len(log)
        first = min(max(count // 10, 1), RECENT) if startup is None else startup
        hold, names = log.input_hold, log.input_names
        ident = RowIdentifier(dt=log.dt, startup=first, input_hold=hold, input_names=names, **asked)
        u, y, t = log.inputs, log.output, log.stamps
        with progress_bar(rate=True) as bar:
            task = bar.add_task("identifying", total=count)
            for begin in range(0, count, CHUNK):
                rows = slice(begin, begin + CHUNK)
                ident.update_many(u[rows], y[rows], None if t is None else t[rows])
                bar.update(task, completed=min(begin + CHUNK, count))
        if startup is None or not ident.has_model:
            ident.finish()
        return ident.model.of_log(log.input_names, log.output_name, log.path.name)

    return model_of


def identify_several(solve: Solver, as_json: bool, keeping: Keeping, options: dict[str, Any]) -> None:
    """Identify a row of transfer functions, print it, save and validate its model."""
    from rich.console import Console

    named, begun = options["input_column"], time.perf_counter()
    for name, usual in NOT_YET.items():
        if options.get(name, usual) != usual:
            raise InvalidArgumentError(f"several inputs take no --{name.removesuffix('_column').replace('_', '-')} yet")
    asked = {name: _of_each(options[name], name, named) for name in ("poles", "zeros", "delay")}
    logs = read_several(options)
    log = logs[0]
    model = solve(logs, asked)
    sha256 = digest(log.path) if len(logs) == 1 else ""
    model = replace(model, provenance=replace(model.provenance, sha256=sha256))
    validations = keeping.validated(model)
    if keeping.saved is not None:
        model.save(keeping.saved)
    if as_json:
        whole = model_json.as_object(model) | {"elapsed_seconds": round(time.perf_counter() - begun, 3)}
        if validations:
            whole["validations"] = [validation_as_json(each, name) for name, each in validations]
        click.echo(json.dumps(whole, allow_nan=False))
    else:
        console = Console()
        samples, seconds = sum(map(len, logs)), sum(each.duration for each in logs)
        print_row(console, model, record=record_line(samples, log.dt, seconds))
        for name, each in validations:
            print_validation(console, each, name)
        if keeping.saved is not None:
            click.echo(f"wrote {keeping.saved}")
        elif not validations and not is_quiet() and model.verdict.status == "trusted":
            click.echo("\nNext: keep the model and check it on another log: --save model.json --validate LOG2")
    check_required(keeping.required, [model.verdict, *(each.verdict for _, each in validations)])


def _of_each(given: tuple[Any, ...] | None, name: str, inputs: tuple[str, ...]) -> tuple[Any, ...]:
    """Return a number for each input: those given, or 0 for all."""
    example = ",".join("1" for _ in inputs)
    if given is None or (name != "poles" and given == (0.0,)):
        return (0,) * len(inputs)
    if not isinstance(given, Each) or len(given) != len(inputs):
        got = f"{len(given)} numbers" if isinstance(given, Each) else "one number or a range"
        raise InvalidArgumentError(
            f"--{name} must have a number for each of {len(inputs)} inputs ({', '.join(inputs)}), as in {example}: "
            f"got {got}"
        )
    return tuple(given)
