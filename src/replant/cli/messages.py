"""What a command prints beside its result: notes, progress, proposals for misspelled words."""

from __future__ import annotations

import codecs
import io
import re
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

import click

PLAIN = "replant.plain"  # the error handler's name
_SIGNS = str.maketrans({"±": "+-", "−": "-", "–": "-", "×": "x", "µ": "u", "μ": "u", "°": "deg", "∞": "inf"})
_SUPERSCRIPTS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
_LOWERED = str.maketrans(_SUPERSCRIPTS, "-0123456789")


def replace_unencodable() -> None:
    """Have standard output and error write ASCII for characters that their encoding lacks."""
    codecs.register_error(PLAIN, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)


def to_ascii(text: str) -> str:
    r"""Return text in ASCII; a character without a similar one in ASCII is written as its number."""
    text = re.sub(f"[{_SUPERSCRIPTS}]+", lambda found: "^" + found[0].translate(_LOWERED), text)
    return text.translate(_SIGNS).encode("ascii", "backslashreplace").decode("ascii")


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return to_ascii(error.object[error.start : error.end]), error.end


NEAR = 0.6  # least similarity of a misspelled word [ratio of difflib]


def did_you_mean(word: str, words: Sequence[str], form: str = "{}") -> str:
    """Return a question for the nearest of ``words``, in the place of {} in ``form``; empty if none is near."""
    near = get_close_matches(plain(word), words, n=1, cutoff=NEAR)
    return form.format(f"did you mean {near[0]!r}?") if near else ""


def plain(word: str) -> str:
    """Return a word in the form for comparisons: in lower case, with _ for -."""
    return word.lower().replace("-", "_")


SAID = "replant.said"  # notes that were printed
TYPED = "replant.typed"  # the words behind the name of the command that is running


def is_given(flag: str) -> bool:
    """Return whether the running command was called with a flag, "quiet" or "progress"."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.params.get(flag))


def note(text: str) -> None:
    """Print a note in one line to standard error, once in a command."""
    context = click.get_current_context(silent=True)
    said: set[str] = set() if context is None else context.meta.setdefault(SAID, set())
    if not is_given("quiet") and text not in said:
        said.add(text)
        click.echo(f"replant: note: {text}", err=True)


WIDEST_BAR = 40  # width of a bar in a wide terminal, as by default in rich [characters]
STEP = 10  # share of the work per line of progress [%]


def terminal(**how: Any) -> Any:
    """Return a terminal of rich, which is imported where something is printed, not before."""
    from rich.console import Console

    return Console(**how)


def progress_bar(*, rate: bool = False) -> Any:
    """Return a progress bar on standard error, with ``rate`` also samples a second and the time left."""
    from rich import progress as bar
    from rich.table import Column

    is_terminal = sys.stderr.isatty()
    if is_given("progress") and not is_terminal:
        return _lines()
    # in a narrow terminal the bar is shorter, and no text is broken
    whole: dict[str, Any] = {"table_column": Column(no_wrap=True)}
    short: dict[str, Any] = {"table_column": Column(max_width=WIDEST_BAR)}
    columns: list[Any] = [bar.TextColumn("{task.description:11}", **whole), bar.BarColumn(None, **short)]
    columns += [bar.TaskProgressColumn(**whole)]
    columns += (
        [_rate_column(**whole), bar.TimeRemainingColumn(**whole), bar.TextColumn("left", **whole)]
        if rate
        else [bar.TimeElapsedColumn(**whole)]
    )
    is_hidden = is_given("quiet") or not is_terminal
    return bar.Progress(*columns, console=terminal(stderr=True), transient=True, disable=is_hidden)


def _rate_column(**how: Any) -> Any:
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    from replant.plotting.numbers import with_prefix

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if not speed else f"{with_prefix(speed)} samples/s")

    return Rate(**how)


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
