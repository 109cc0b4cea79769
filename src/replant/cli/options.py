"""The options that `run` and `fit` share, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from replant.logs import Log, read_log
from replant.preprocess import Preprocess
from replant.settings import Request
from replant.structure import Structure

_OPTIONS: list[Callable[[Any], Any]] = [
    click.argument("log", type=click.Path(path_type=Path)),
    click.option("--input", "input_column", required=True, metavar="COL", help="Column of the input: name or index."),
    click.option("--output", "output_column", required=True, metavar="COL", help="Column of the output."),
    click.option("--poles", type=int, required=True, metavar="N", help="Number of poles."),
    click.option("--zeros", type=int, default=0, metavar="M", show_default=True, help="Number of zeros."),
    click.option("--time", "time_column", metavar="COL", help="Column of time in s; its steps must be equal."),
    click.option("--dt", type=float, metavar="S", help="Sampling time in s, instead of a column of time."),
    click.option("--delay", type=float, default=0.0, metavar="S", help="Known dead time in s."),
    click.option("--bias", is_flag=True, help="Identify a constant beside G(s)."),
    click.option("--input-map", type=click.Choice(["identity", "square"]), default="identity", help="Applied first."),
    click.option("--json", "as_json", is_flag=True, help="Print one JSON object."),
    click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write plots (PNG) into this folder."),
]


def log_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a click command with the options that `run` and `fit` share."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def open_log(options: dict[str, Any]) -> tuple[Log, Request]:
    """Read the log that the options name, and make the request that they spell."""
    structure = Structure(options["poles"], options["zeros"], options["delay"], options["bias"])
    log = read_log(
        options["log"],
        input=options["input_column"],
        output=options["output_column"],
        time=options["time_column"],
        dt=options["dt"],
    )
    # a recorded rig hardly ever rests at zero: the record's mean is its working point
    preprocess = Preprocess(options["input_map"], "mean", "mean")
    return log, Request(structure, log.dt, preprocess=preprocess, optimizer=options.get("optimizer", "auto"))
