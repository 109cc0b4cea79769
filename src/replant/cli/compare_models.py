"""``replant compare MODEL.json ... LOG``: saved models over one recorded log."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from replant.cli.output import make_folder, write_errors_reported
from replant.cli.save_and_validate import model_clock, whole_log
from replant.cli.typed_command import command_line
from replant.identified.model import load_model
from replant.identified.model_file import holds_model
from replant.report.html.compared_models import write_models
from replant.report.html.model_comparison import HEADINGS, ModelComparison
from replant.report.html.model_comparison import compare as compare_saved
from replant.report.terminal.validation import as_json as validation_as_json

SHOWN = 7  # columns of the table that fit into a terminal [count]


def are_models(paths: Sequence[Path]) -> bool:
    """Return whether the first file of several is a saved model: models are then compared, not methods."""
    return holds_model(paths[0])


def compare_models(paths: Sequence[Path], options: dict[str, Any]) -> None:
    """Compare the models in all files but the last over the log in the last one."""
    *saved, path = paths
    if not saved or holds_model(path):
        raise click.UsageError("name the log behind the models: replant compare MODEL.json MODEL2.json LOG")
    if options["poles"] is not None:
        raise click.UsageError("--poles makes models: it is of no use where saved models are compared")
    models = {_name(each, saved): load_model(each) for each in saved}
    first = next(iter(models.values()))
    columns = dict(options)
    columns["input_column"] = options["input_column"] or first.input_name
    columns["output_column"] = options["output_column"] or first.output_name
    out: Path | None = options["out"]
    make_folder(out)
    log = whole_log(path, columns | model_clock(path, columns, first.dt))
    comparison = compare_saved(models, log)
    written = [] if out is None else _written(comparison, out)
    if options["as_json"]:
        found = {name: validation_as_json(each, path.name) for name, each in comparison.validations.items()}
        click.echo(json.dumps(found, allow_nan=False))
        return
    _print(comparison)
    for file in written:
        click.echo(f"wrote {file}")


def _name(path: Path, saved: Sequence[Path]) -> str:
    return path.stem if sum(each.stem == path.stem for each in saved) == 1 else str(path)


def _written(comparison: ModelComparison, out: Path) -> list[Path]:
    picture = out / "models.png"
    with write_errors_reported(out):
        comparison.plot()[0].figure.savefig(picture, dpi=110)
        return [picture, write_models(out / "report.html", comparison, command_line())]


def _print(comparison: ModelComparison) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for k, heading in enumerate(HEADINGS[:SHOWN]):
        table.add_column(heading, justify="left" if k < 2 else "right", no_wrap=True)
    for row in comparison.rows:
        cells = [cell.replace("±", "+-").replace("−", "-").replace("–", "-") for cell in row[:SHOWN]]
        table.add_row(*cells, style="bold" if row[0] == comparison.best else None)
    console.print(table)
    for name, found in comparison.validations.items():
        if found.verdict.status != "trusted" and found.verdict.reasons:
            console.print(f"\n{name}: {found.verdict.reasons[0]}", style="dim", highlight=False, markup=False)
