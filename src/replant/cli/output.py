"""How a command hands over its result: a table or JSON on stdout, plots in a folder."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import click

from replant.logs import Log
from replant.report.summary import as_json as result_as_json
from replant.report.summary import print_result
from replant.runs import Result


def deliver(result: Result, log: Log, *, as_json: bool, out: Path | None) -> None:
    """Print ``result`` and, with ``out``, write its plots."""
    from rich.console import Console

    paths = []
    if out is not None:
        from replant.report.figures import save_figures

        paths = save_figures(
            out, result, log.input, log.output, log.dt, input_label=log.input_name, output_label=log.output_name
        )
    if as_json:
        click.echo(json.dumps(result_as_json(result), allow_nan=False))
        return
    console = Console()
    print_result(console, result)
    if result.settings is not None:
        click.echo(f"\nChosen from the data; to repeat by hand:\n{settings_as_python(result)}")
    for path in paths:
        click.echo(f"wrote {path}")


def settings_as_python(result: Result) -> str:
    """Return the Python that makes the same identifier."""
    settings = result.settings
    assert settings is not None
    parts = [
        f"    rp.{settings.structure!r}, dt={settings.dt!r},",
        f"    filter=rp.{_short(settings.filter)},",
        f"    scaling=rp.{_short(settings.scaling)},",
        f"    optimizer=rp.{_short(settings.optimizer)},",
        f"    replay={'rp.' + _short(settings.replay) if settings.replay else None},",
        f"    preprocess=rp.{_short(settings.preprocess)},",
    ]
    return "\n".join(["ident = rp.Identifier(", *parts, ")"])


def _short(value: Any) -> str:
    """Write a frozen dataclass as the call that makes it, defaults left out."""
    given = [
        f"{field.name}={_number(getattr(value, field.name))}"
        for field in dataclasses.fields(value)
        if getattr(value, field.name) != field.default
    ]
    return f"{type(value).__name__}({', '.join(given)})"


def _number(value: Any) -> str:
    """Write numbers with the digits that matter, so that a line can be read."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_number(entry) for entry in value) + "]"
    return repr(value)
