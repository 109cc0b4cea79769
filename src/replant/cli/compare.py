"""``replant compare``: one recorded log through several methods."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from replant.cli.compare_models import are_models, compare_models
from replant.cli.nearest_word import Choice
from replant.cli.options import log_options, open_log
from replant.cli.output import (
    make_folder,
    write_errors_reported,
)
from replant.cli.progress import progress_bar
from replant.cli.save_and_validate import kept
from replant.cli.typed_command import command_line
from replant.data.logs import Log
from replant.errors import InvalidArgumentError
from replant.report.html.comparison import write_comparison
from replant.report.html.comparison_figures import save_figures
from replant.report.terminal.comparison import as_json as comparison_as_json
from replant.report.terminal.comparison import print_comparison
from replant.runs.result import Result
from replant.runs.run_log import METHODS, USUAL, Contender, compare
from replant.settings import Request


def _of_models(given: dict[str, Any]) -> bool:
    """Compare saved models, where the first file is one; return whether that was asked for."""
    if not are_models(given["logs"]):
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
        named = [dataclasses.replace(entry, result=_named(entry.result, log)) for entry in contenders]
        click.echo(json.dumps(comparison_as_json(named), allow_nan=False))
        return
    print_comparison(Console(), contenders, request.structure, len(log))
    for path in paths:
        click.echo(f"wrote {path}")


def _named(result: Result | None, log: Log) -> Result | None:
    return result and dataclasses.replace(result, model=kept(result.model, log))
