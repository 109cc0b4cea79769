"""``replant look``: what is in a recorded log, and a command to begin with."""

from __future__ import annotations

import json
from pathlib import Path

import click

from replant.cli.column_options import input_option, output_option
from replant.cli.output import make_folder, write_errors_reported
from replant.data.inspection import inspect
from replant.report.terminal.look import as_json as look_as_json
from replant.report.terminal.look import print_look


@click.command(name="look")
@click.argument("log", type=click.Path(path_type=Path))
@input_option("Column of the input, if known: name, or number from 0.")
@output_option("Column of the output, if known.")
@click.option("--time", "time_column", metavar="COL", help="Column of time, if known.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write a plot of the columns (PNG) here.")
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
        from replant.report.figures.columns import save_columns

        with write_errors_reported(out):
            path = save_columns(out, found)
    if as_json:
        click.echo(json.dumps(look_as_json(found), allow_nan=False))
        return
    from rich.console import Console

    print_look(Console(), found)
    if path is not None:
        click.echo(f"wrote {path}")
