"""What a command lacks: instead of a bare refusal, what is in the log, and the command completed."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.typed_command import command_line
from replant.errors import LogError

NEEDED = {"input_column": "--input", "output_column": "--output", "poles": "--poles"}
RANGE = "1:4"
CLOCK = {"--time", "--dt"}  # exclude each other
ONLY_FIT = {"--delay"}  # as a range


def check_complete(given: dict[str, Any]) -> None:
    """Check that input, output and number of poles are given.

    Without input or output, what is in the log is printed to standard error first.
    """
    missing = [option for name, option in NEEDED.items() if given[name] is None]
    if not missing:
        return
    absent = f"missing {' and '.join(filter(None, (', '.join(missing[:-1]), missing[-1])))}"
    if "log" not in given:  # a fleet: no log stands for all
        raise click.UsageError(f"{absent}; see what is in one of the logs, and how it is identified: replant look LOG")
    if missing == ["--poles"]:
        searched = f"a range such as {RANGE} has it chosen" if _name() == "fit" else "`replant fit -p 1:4` chooses it"
        raise click.UsageError(f"{absent}, the number of poles of G(s): {searched}; try: {_completed(('-p', '2'))}")
    raise click.UsageError(f"{absent}; {_look(given)}")


def _look(given: dict[str, Any]) -> str:
    """Print what is in the log; return how the command goes on."""
    from rich.console import Console

    from replant.data.inspection import inspect, options_of
    from replant.report.terminal.look import print_findings

    columns = {name: given[f"{name}_column"] for name in ("input", "output", "time")}
    try:
        found = inspect(Path(given["log"]), **columns)
    except LogError as problem:
        return f"and {problem}."
    print_findings(Console(stderr=True), found)
    options = options_of(found)
    if not options:
        return "no two columns of numbers that change are in the log: name them if you know better."
    return f"try: {_completed(options)}"


def _completed(options: tuple[str, ...]) -> str:
    """Return the command as typed, with those of the suggested options that it lacks."""
    context = click.get_current_context()
    typed = {
        option
        for parameter in context.command.params
        if context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE
        for option in parameter.opts
    }
    needless = {*typed, *(CLOCK if typed & CLOCK else ()), *(() if _name() == "fit" else ONLY_FIT)}
    pairs = [pair for pair in zip(options[::2], options[1::2], strict=True) if pair[0] not in needless]
    return " ".join([command_line(with_output=True), *map(shlex.join, pairs)])


def _name() -> str:
    return click.get_current_context().info_name or ""
