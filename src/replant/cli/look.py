"""``replant look``, ``examples``, ``show`` and ``validate``: logs and saved models, looked at."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import click

from replant.cli.option_types import JSON, column_option, flag, path_option
from replant.cli.output import REQUIRE, check_required, make_folder, model_clock, validated, write_errors_reported
from replant.examples import NAMES, path_of
from replant.fitting.inspect import inspect
from replant.fitting.matrix import MatrixModel, load_model
from replant.fitting.model import Model
from replant.fitting.validation import Validation
from replant.report.terminal import print_kept_model, print_row, print_validation
from replant.report.terminal import validation_as_json as validation_as_json
from replant.report.terminal_look import as_json as look_as_json
from replant.report.terminal_look import print_look


@click.command(name="look")
@click.argument("log", type=click.Path(path_type=Path))
@column_option("input", "Column of the input, if known: name, or number from 0.")
@column_option("output", "Column of the output, if known.")
@click.option("--time", "time_column", metavar="COL", help="Column of time, if known.")
@JSON
@path_option("--out", "DIR", "Write a plot of the columns (PNG) here.")
def look_command(
    log: Path,
    input_column: str | None,
    output_column: str | None,
    time_column: str | None,
    as_json: bool,
    out: Path | None,
) -> None:
    """Show what is in LOG (csv, mat, parquet and more), and suggest a command to begin with.

    Columns with type, range, missing samples and resolution; the clock; which columns look like input, output and
    reference; and the delay between input and output.  What is guessed is called a guess.
    """
    found = inspect(log, input=input_column, output=output_column, time=time_column)
    make_folder(out)
    path = None
    if out is not None:
        from replant.report.figures import save_columns

        with write_errors_reported(out):
            path = save_columns(out, found)
    if as_json:
        click.echo(json.dumps(look_as_json(found), allow_nan=False))
        return
    from rich.console import Console

    print_look(Console(), found)
    if path is not None:
        click.echo(f"wrote {path}")


@click.command(name="examples")
@path_option("--out", "DIR", "Folder.  [default: the current one]", default=".")
def examples_command(out: Path) -> None:
    """Write motor.csv and motor-step.csv, records of a DC motor, with their licence; a file that exists is kept."""
    make_folder(out)
    for name in NAMES:
        file = out / (name if name.endswith(".csv") else "motor-LICENSE")
        if file.exists():
            click.echo(f"kept {file}, which exists")
            continue
        with write_errors_reported(out), path_of(name) as source:
            shutil.copyfile(source, file)
        click.echo(f"wrote {file}")


@click.command(name="show")
@click.argument("model", type=click.Path(path_type=Path))
@JSON
def show_command(model: Path, as_json: bool) -> None:
    """Print MODEL, a file that `--save` has written: G(s), its uncertainty, its verdict, and where it comes from."""
    from rich.console import Console

    loaded = load_model(model)
    if as_json:
        click.echo(loaded.to_json(), nl=False)
        return
    if isinstance(loaded, Model):
        print_kept_model(Console(), loaded)
        return
    for row in loaded.rows if isinstance(loaded, MatrixModel) else (loaded,):
        print_row(Console(), row)


@click.command(name="validate")
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1)
@column_option("input", "Column of the input, or of each of several.  [default: the model's]", several=True)
@column_option("output", "Column of the output, or of each of several.  [default: the model's]", several=True)
@click.option("--reference", "reference_column", metavar="COL", help="Column of the reference, if there is one.")
@click.option("--time", "time_column", metavar="COL", help="Column of time.")
@click.option("--dt", type=float, metavar="S", help="Sampling time in s.  [default: the log's, or the model's]")
@flag("--json", "Print a JSON list, an object a log.", "as_json")
@path_option("--out", "DIR", "Write a plot (PNG) a log here.")
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
        clock = model_clock(path, columns, loaded.dt)
        if isinstance(loaded, MatrixModel):
            found += _of_rows(loaded, path, columns | clock)
        else:
            found += validated(loaded, [path], columns | clock)
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


def _of_rows(model: MatrixModel, path: Path, columns: dict[str, Any]) -> list[tuple[str, Validation]]:
    """Return the validation of each row on a log, by the names of log and output."""
    named = columns["output_column"]
    if not isinstance(named, tuple) or len(named) != len(model.rows):
        raise click.UsageError(f"the model has {len(model.rows)} outputs: name a column for each, or none")
    pairs = zip(model.rows, named, strict=True)
    each = [(row, validated(row, [path], columns | {"output_column": name})) for row, name in pairs]
    return [(f"{name}, {row.output_name}", one) for row, found in each for name, one in found]


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
