"""``replant show``: print a model that was saved."""

from __future__ import annotations

from pathlib import Path

import click

from replant.identified.model import load_model
from replant.report.terminal.summary import print_kept_model


@click.command(name="show")
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def show_command(model: Path, as_json: bool) -> None:
    """Print MODEL, a file that `--save` has written: G(s), its uncertainty, its verdict, and where it comes from."""
    from rich.console import Console

    loaded = load_model(model)
    if as_json:
        click.echo(loaded.to_json(), nl=False)
        return
    print_kept_model(Console(), loaded)
