"""``replant validate``: compare a saved model with other logs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from replant.cli.column_options import input_option, output_option
from replant.cli.output import make_folder, write_errors_reported
from replant.cli.save_and_validate import REQUIRE, check_required, model_clock, validated
from replant.identified.model import load_model
from replant.identified.validation import Validation
from replant.report.terminal.validation import as_json as validation_as_json
from replant.report.terminal.validation import print_validation


@click.command(name="validate")
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1)
@input_option("Column of the input.  [default: the model's]")
@output_option("Column of the output.  [default: the model's]")
@click.option("--reference", "reference_column", metavar="COL", help="Column of the reference, if there is one.")
@click.option("--time", "time_column", metavar="COL", help="Column of time.")
@click.option("--dt", type=float, metavar="S", help="Sampling time in s.  [default: the log's, or the model's]")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list, an object a log.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write a plot (PNG) a log here.")
@REQUIRE
def validate_command(
    model: Path, logs: tuple[Path, ...], as_json: bool, out: Path | None, required: str | None, **columns: Any
) -> None:
    """Compare MODEL with LOGS that it was not made from; offset and initial state are estimated, nothing else."""
    from rich.console import Console

    loaded = load_model(model)
    if not logs:
        raise click.UsageError(f"name the logs to compare the model with: replant validate {model} LOG")
    make_folder(out)
    columns["input_column"] = columns["input_column"] or loaded.input_name
    columns["output_column"] = columns["output_column"] or loaded.output_name
    found = []
    for path in logs:
        found += validated(loaded, [path], columns | model_clock(path, columns, loaded.dt))
    if len({name for name, _ in found}) < len(found):
        found = [(str(path), each) for path, (_, each) in zip(logs, found, strict=True)]
    written = [] if out is None else _plots(found, out)
    if as_json:
        click.echo(json.dumps([validation_as_json(each, name) for name, each in found], allow_nan=False))
    else:
        for name, each in found:
            print_validation(Console(), each, name)
        for file in written:
            click.echo(f"wrote {file}")
    check_required(required, [each.verdict for _, each in found])


def _plots(found: list[tuple[str, Validation]], out: Path) -> list[Path]:
    """Write a plot for each log; return the files."""
    files: list[Path] = []
    with write_errors_reported(out):
        for name, each in found:
            stem = Path(name).stem
            taken = sum(file.name.startswith(f"{stem}-validation") for file in files)
            files.append(out / f"{stem}-validation{f'-{taken + 1}' if taken else ''}.png")
            each.plot()[0].figure.savefig(files[-1], dpi=110)
    return files
