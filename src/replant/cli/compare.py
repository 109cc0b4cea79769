"""``replant compare``: one recorded log through several methods, or saved models over it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from replant.cli.option_types import command_line
from replant.cli.options import log_options, open_log, progress_bar
from replant.cli.output import kept, make_folder, model_clock, whole_log, write_errors_reported
from replant.cli.terminal import Choice
from replant.errors import InvalidArgumentError, ModelFileError
from replant.estimation.settings import Request
from replant.fitting.matrix import load_model
from replant.fitting.model import Model
from replant.fitting.model_file import holds_model
from replant.fitting.row_model import RowModel
from replant.logs import Log
from replant.online.runs.run_log import METHODS, USUAL, Contender, compare
from replant.report.compared_page import HEADINGS, ModelComparison, save_figures, write_comparison, write_models
from replant.report.compared_page import compare as compare_saved
from replant.report.terminal import comparison_as_json as comparison_as_json
from replant.report.terminal import print_comparison, table
from replant.report.terminal import validation_as_json as validation_as_json

SHOWN = 7  # columns of the table that fit into a terminal [count]


def compare_models(paths: Sequence[Path], options: dict[str, Any]) -> None:
    """Compare the models in all files but the last over the log in the last one."""
    *saved, path = paths
    if not saved or holds_model(path):
        raise click.UsageError("name the log behind the models: replant compare MODEL.json MODEL2.json LOG")
    if options["poles"] is not None:
        raise click.UsageError("--poles makes models: it is of no use where saved models are compared")
    models = {_name(each, saved): _of_one_input(each) for each in saved}
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


def _of_one_input(path: Path) -> Model:
    model = load_model(path)
    if not isinstance(model, Model):
        several = "inputs" if isinstance(model, RowModel) else "outputs"
        raise ModelFileError(f"{path}: it has several {several}, and compare takes models of one: use replant validate")
    return model


def _name(path: Path, saved: Sequence[Path]) -> str:
    return path.stem if sum(each.stem == path.stem for each in saved) == 1 else str(path)


def _written(comparison: ModelComparison, out: Path) -> list[Path]:
    picture = out / "models.png"
    with write_errors_reported(out):
        comparison.plot()[0].figure.savefig(picture, dpi=110)
        return [picture, write_models(out / "report.html", comparison, command_line())]


def _print(comparison: ModelComparison) -> None:
    from rich.console import Console

    console, best = Console(), comparison.best
    plain = str.maketrans({"±": "+-", "−": "-", "–": "-"})
    rows = ([cell.translate(plain) for cell in row[:SHOWN]] for row in comparison.rows)
    console.print(table(HEADINGS[:SHOWN], rows, left=(0, 1), bold=lambda row: row[0] == best, no_wrap=True))
    for name, found in comparison.validations.items():
        if found.verdict.status != "trusted" and found.verdict.reasons:
            console.print(f"\n{name}: {found.verdict.reasons[0]}", style="dim", highlight=False, markup=False)


def _of_models(given: dict[str, Any]) -> bool:
    """Compare saved models, where the first file is one; return whether that was asked for."""
    if not holds_model(given["logs"][0]):
        return False
    compare_models(given["logs"], given)
    return True


@click.command(name="compare")
@log_options(several="replant compare takes one log, or saved models and a log", otherwise=_of_models, is_kept=False)
@click.option(
    "--optimizer",
    "methods",
    type=Choice(METHODS),
    multiple=True,
    default=USUAL,
    show_default=True,
    metavar="NAME",
    help=f"A method; repeat the option for several: {', '.join(METHODS)}.",
)
def compare_command(as_json: bool, out: Path | None, methods: tuple[str, ...], **options: Any) -> None:
    """Compare saved models over LOG: MODEL.json MODEL2.json LOG.  Or identify G(s) from LOG by several methods.

    An optimizer identifies online, in one pass, as `replant run` does; "default" is the method of `replant run` without
    options.  srivc and least_squares fit the whole log at once, as `replant fit` does.
    """
    log, request = open_log(options)
    make_folder(out)
    methods = tuple(dict.fromkeys(methods))
    with progress_bar() as progress:
        task = progress.add_task("", total=len(methods))
        contenders = compare(
            request, log.input, log.output, methods,
            lambda name, part: progress.update(task, description=name, completed=methods.index(name) + part),
            reference=log.reference, t=log.stamps,
        )  # fmt: skip
    if all(entry.result is None for entry in contenders):
        raise InvalidArgumentError(f"no method found a model; {contenders[0].name}: {contenders[0].problem}")
    _deliver(contenders, log, request, as_json=as_json, out=out)


def _deliver(contenders: Sequence[Contender], log: Log, request: Request, *, as_json: bool, out: Path | None) -> None:
    from rich.console import Console

    paths: list[Path] = []
    if out is not None:
        with write_errors_reported(out):
            paths += save_figures(out, contenders, log, request.preprocess)
            paths.append(write_comparison(out / "report.html", contenders, log, request.preprocess, command_line()))
    if as_json:
        named = [
            entry if (found := entry.result) is None
            else dataclasses.replace(entry, result=dataclasses.replace(found, model=kept(found.model, log)))
            for entry in contenders
        ]  # fmt: skip
        click.echo(json.dumps(comparison_as_json(named), allow_nan=False))
        return
    print_comparison(Console(), contenders, request.structure, len(log))
    for path in paths:
        click.echo(f"wrote {path}")
