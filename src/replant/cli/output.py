"""How a command hands over its result: a table or JSON on stdout, plots and a report in a folder."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.options import Range
from replant.data.logs import Log
from replant.report.html.recipe import identifier_as_python
from replant.report.terminal.summary import as_json as result_as_json
from replant.report.terminal.summary import print_result
from replant.runs.result import Result

COMPILING = "compiling (once): later runs start at once"


def deliver(result: Result, log: Log, *, as_json: bool, out: Path | None, **report: Any) -> None:
    """Print ``result`` and, with ``out``, write its plots and its report; ``report`` is for `write_report`."""
    from rich.console import Console

    paths = []
    if out is not None:
        from replant.report.figures import save_figures
        from replant.report.html.report import write_report

        names: Any = {"input_label": log.input_name, "output_label": log.output_name}
        with writable(out):
            paths = save_figures(out, result, log.input, log.output, log.dt, **names)
            paths.append(write_report(out / "report.html", result, log, command=command_line(), **report))
    if as_json:
        click.echo(json.dumps(result_as_json(result), allow_nan=False))
        return
    console = Console()
    print_result(console, result)
    if result.settings is not None:
        click.echo(f"\nChosen from the data; to repeat by hand:\n{identifier_as_python(result.settings)}")
    for path in paths:
        click.echo(f"wrote {path}")


@contextmanager
def writable(out: Path) -> Iterator[None]:
    """Turn what the file system refuses into a line that names it."""
    try:
        yield
    except OSError as cause:
        where = cause.filename or out
        raise click.BadParameter(f"cannot write {where}: {cause.strerror}", param_hint="--out") from cause


def make_folder(out: Path | None) -> None:
    """Make the folder that results go to: before the work, so that nothing is lost where that cannot be."""
    if out is None:
        return
    if out.exists() and not out.is_dir():
        raise click.BadParameter(f"{out} is a file; name a folder", param_hint="--out")
    with writable(out):
        out.mkdir(parents=True, exist_ok=True)


def progress_bar(*, rate: bool = False) -> Any:
    """Return a progress bar on stderr, shown if a person sees it; with ``rate``, samples a second and time left too."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: list[Any] = [TextColumn("{task.description:11}"), BarColumn(), TaskProgressColumn()]
    columns += [_rate_column(), TimeRemainingColumn(), TextColumn("left")] if rate else [TimeElapsedColumn()]
    return Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def _rate_column() -> Any:
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if not speed else f"{in_thousands(speed)} samples/s")

    return Rate()


def in_thousands(value: float) -> str:
    """Return a number with three digits and a letter for its thousands.

    Examples
    --------
    >>> in_thousands(1234567.0), in_thousands(65432.1), in_thousands(7.0)
    ('1.23 M', '65.4 k', '7')
    """
    for power, letter in ((9, " G"), (6, " M"), (3, " k")):
        if value >= 10.0**power:
            return f"{value / 10.0**power:.3g}{letter}"
    return f"{value:.3g}"


@contextmanager
def announced_compiling() -> Iterator[None]:
    """Say on stderr, once, that a kernel is being compiled: it takes seconds, and later runs find it in the cache."""
    from numba.core import event

    said = False

    class Announcer(event.Listener):
        def on_start(self, event: Any) -> None:
            nonlocal said
            if not said:
                said = True
                click.echo(COMPILING, err=True)

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Announcer()):
        yield


def command_line() -> str:
    """Return the command that is running, as it would be typed; where its output goes is left out."""
    context = click.get_current_context()
    words = ["replant", context.info_name or ""]
    for parameter in context.command.params:
        name = parameter.name or ""
        value: Any = context.params.get(name)
        source = context.get_parameter_source(name)
        if name in ("as_json", "out", "full_trace") or source is not ParameterSource.COMMANDLINE:
            continue
        if isinstance(parameter, click.Argument):
            words += map(str, value if isinstance(value, tuple) else (value,))
        elif value is True:
            words.append(parameter.opts[-1])
        elif isinstance(parameter.type, Range):
            words += [parameter.opts[-1], parameter.type.written(value)]
        else:
            for entry in value if isinstance(value, tuple) else (value,):
                words += [parameter.opts[-1], str(entry)]
    return shlex.join(words)
