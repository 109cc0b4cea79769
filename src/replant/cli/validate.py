"""``replant validate``: compare a saved model with other logs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from replant.cli.keeping import OPTIONS, Keeping, whole_log
from replant.cli.output import make_folder, write_errors_reported
from replant.identified.model import load_model
from replant.identified.validation import Validation
from replant.report.terminal.validation import as_json as validation_as_json
from replant.report.terminal.validation import print_validation


@click.command(name="validate")
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("-i", "--input", "input_column", metavar="COL", help="Column of the input.  [default: the model's]")
@click.option("-o", "--output", "output_column", metavar="COL", help="Column of the output.  [default: the model's]")
@click.option("--time", "time_column", metavar="COL", help="Column of time.")
@click.option("--dt", type=float, metavar="S", help="Sampling time in s, instead of a time column.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list, an object a log.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write a plot (PNG) a log here.")
@OPTIONS[-1]
def command(
    model: Path, logs: tuple[Path, ...], as_json: bool, out: Path | None, required: str | None, **columns: Any
) -> None:
    """Compare MODEL with LOGS that it was not made from; offset and initial state are estimated, nothing else."""
    from rich.console import Console

    loaded = load_model(model)
    make_folder(out)
    columns["input_column"] = columns["input_column"] or loaded.input_name
    columns["output_column"] = columns["output_column"] or loaded.output_name
    found = [(path, loaded.validate(whole_log(path, columns))) for path in logs]
    written = [] if out is None else _plots(found, out)
    if as_json:
        click.echo(json.dumps([validation_as_json(each, path.name) for path, each in found], allow_nan=False))
    else:
        for path, each in found:
            print_validation(Console(), each, path.name)
        for file in written:
            click.echo(f"wrote {file}")
    Keeping(None, (), required, {}).end([each.verdict for _, each in found])


def _plots(found: list[tuple[Path, Validation]], out: Path) -> list[Path]:
    """Write a plot for each log; return the files."""
    files = []
    with write_errors_reported(out):
        for path, each in found:
            files.append(out / f"{path.stem}-validation.png")
            each.plot()[0].figure.savefig(files[-1], dpi=110)
    return files
