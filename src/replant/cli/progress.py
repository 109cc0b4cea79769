"""Progress on standard error: a bar in a terminal; lines elsewhere, if --progress is given."""

from __future__ import annotations

import sys
from typing import Any

import click

from replant.cli.notes import is_quiet
from replant.report.number_format import with_prefix

ASKED = "replant.progress"
STEP = 10  # part of the work after which a line is printed [%]


def ask() -> None:
    """Have the command that is running show its progress where standard error is no terminal, too."""
    click.get_current_context().meta[ASKED] = True


def is_asked_for() -> bool:
    """Return whether the command that is running was called with --progress.

    Examples
    --------
    >>> is_asked_for()
    False
    """
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(ASKED))


def progress_bar(*, rate: bool = False) -> Any:
    """Return a progress bar on standard error, which only a terminal shows; with --progress lines elsewhere.

    With ``rate`` it also shows samples a second and the remaining time.
    """
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
    if is_asked_for() and not sys.stderr.isatty():
        return _lines()
    return Progress(
        *columns, console=Console(stderr=True), transient=True, disable=is_quiet() or not sys.stderr.isatty()
    )


def _rate_column() -> Any:
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if not speed else f"{with_prefix(speed)} samples/s")

    return Rate()


def _lines() -> Any:
    from rich.progress import Progress

    class Lines(Progress):
        """Prints a line to standard error after each tenth of a stage."""

        said: tuple[str, int] = ("", 0)

        def update(self, task_id: Any, **change: Any) -> None:
            super().update(task_id, **change)
            task = self.tasks[task_id]
            percent = int(task.percentage) // STEP * STEP
            stage = task.fields.get("stage", task.description)  # a description that counts is not a stage
            if task.total is not None and (stage, percent) != self.said:
                self.said = stage, percent
                click.echo(f"replant: {task.description} {percent} %".replace("  ", " "), err=True)

    return Lines(disable=True)
