"""Progress of a command: a line at a terminal, drawn again in place; with --progress lines elsewhere."""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from types import TracebackType

import click

from replant.cli.terminal import is_quiet
from replant.report.number_format import with_prefix
from replant.report.terminal.console import Console, Redrawn, Text

ASKED = "replant.progress"
STEP = 10  # part of the work after which a line is printed [%]
BAR = 40  # width of the bar, where there is room [columns]
APART = 0.1  # time between two drawings of a line: none is seen that comes sooner [s]


def ask() -> None:
    """Have the command that is running show its progress where standard error is no terminal, too."""
    click.get_current_context().meta[ASKED] = True


def is_asked_for() -> bool:
    """Return whether the command that is running was called with --progress."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(ASKED))


class Progress:
    """How far a command is: nothing is shown here, but by the classes derived from it."""

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def show(self, words: str, done: float = 0.0, total: float | None = None, *, stage: str | None = None) -> None:
        """Show what is being done, and how much of it is; words that count name their stage as well."""

    def end(self) -> None:
        """Show no more."""


class Lines(Progress):
    """Prints a line to standard error after each tenth of a stage."""

    def __init__(self) -> None:
        self._said = ("", 0)

    def show(self, words: str, done: float = 0.0, total: float | None = None, *, stage: str | None = None) -> None:
        """Print a line, if it is time."""
        if not total:
            return
        percent = int(100.0 * min(done / total, 1.0)) // STEP * STEP
        if (stage or words, percent) != self._said:
            self._said = stage or words, percent
            click.echo(f"replant: {words} {percent} %".replace("  ", " "), err=True)


class Bar(Progress):
    """Draws a line: words, a bar, percent, and the time taken; or samples a second, and the time left."""

    def __init__(self, *, rate: bool = False) -> None:
        self._console, self._rate = Console(stderr=True), rate
        self._line = Redrawn(self._console)
        self._begun, self._first, self._last = time.monotonic(), 0.0, 0.0
        self._words, self._next = "", 0.0

    def show(self, words: str, done: float = 0.0, total: float | None = None, *, stage: str | None = None) -> None:
        """Draw the line, if the one before has been seen; what has less done than before has begun anew."""
        now = time.monotonic()
        if done < self._last:
            self._begun, self._first = now, done
        self._last = done
        if words == self._words and now < self._next:
            return
        self._words, self._next = words, now + APART
        part = min(done / total, 1.0) if total else 0.0
        percent, times = f"{100.0 * part:3.0f}%" if total else "    ", self._times(now - self._begun, done, total)
        before, behind = f"{words:11} ", f" {percent} {times}"
        size = min(BAR, max(self._console.width - 1 - len(before) - len(behind), 0))
        filled = round(size * part)
        bar = (("━" * filled, "green"), ("━" * (size - filled), "dim"))
        self._line.show(Text(before, *bar, behind, cut=True))

    def _times(self, taken: float, done: float, total: float | None) -> str:
        if not self._rate:
            return clock(taken)
        speed = (done - self._first) / taken if taken > 0.0 else 0.0
        if speed <= 0.0:
            return ""
        left = f" {clock(max(total - done, 0.0) / speed)} left" if total else ""
        return f"{with_prefix(speed)} samples/s{left}"

    def end(self) -> None:
        """Remove the line."""
        self._line.clear()


def clock(seconds: float) -> str:
    """Return a time as hours, minutes and seconds."""
    return str(timedelta(seconds=int(seconds)))


def progress_bar(*, rate: bool = False) -> Progress:
    """Return what shows the progress of a command, see `Bar`."""
    if is_quiet() or not sys.stderr.isatty():
        return Lines() if is_asked_for() else Progress()
    return Bar(rate=rate)
