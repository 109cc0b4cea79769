"""``replant fit`` of several inputs: each with poles, zeros and a dead time of its own."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from replant.cli.option_types import Each
from replant.cli.options import read_several
from replant.cli.output import Keeping, check_required
from replant.cli.terminal import is_quiet
from replant.data.logs.recording import digest
from replant.errors import InvalidArgumentError
from replant.identified import model_json
from replant.offline.fit import fit
from replant.report.terminal.comparison import print_validation, validation_as_json
from replant.report.terminal.row import print_row
from replant.report.terminal.summary import record_line

#: Options that one input takes, and several do not, with what they are without them.
NOT_YET = {"bias": False, "feedthrough": False, "input_map": "identity", "reference_column": None}


def fit_several(as_json: bool, out: Path | None, method: str, keeping: Keeping, options: dict[str, Any]) -> None:
    """Fit a row of transfer functions, print it, save and validate its model."""
    from rich.console import Console

    named, begun = options["input_column"], time.perf_counter()
    for name, usual in {**NOT_YET, "method": "auto", "out": None}.items():
        if {**options, "method": method, "out": out}[name] != usual:
            raise InvalidArgumentError(f"several inputs take no --{name.removesuffix('_column').replace('_', '-')} yet")
    asked = {name: _of_each(options[name], name, named) for name in ("poles", "zeros", "delay")}
    logs = read_several(options)
    log = logs[0]
    found = fit(logs if len(logs) > 1 else log, poles=asked["poles"], zeros=asked["zeros"], delay=asked["delay"])
    sha256 = digest(log.path) if len(logs) == 1 else ""
    model = replace(found.model, provenance=replace(found.model.provenance, sha256=sha256))
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
