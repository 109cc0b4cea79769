"""``replant examples``: write the logs that the documentation uses."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from replant.cli.output import make_folder, write_errors_reported
from replant.examples import NAMES, path_of


@click.command(name="examples")
@click.option(
    "--out", type=click.Path(path_type=Path), default=".", metavar="DIR", help="Folder.  [default: the current one]"
)
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
