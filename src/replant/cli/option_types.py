"""Types of options, columns, the command as it was typed, and what it lacks."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Callable, Collection
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.messages import TYPED, did_you_mean, plain, terminal
from replant.errors import InvalidArgumentError, LogError
from replant.estimation.optimizers import OPTIMIZERS, Optimizer
from replant.estimation.settings import AUTO
from replant.numerics.limits import MOST_TRIED, typed_path

Option = Callable[[Any], Any]
STRUCTURE = "poles", "zeros", "delay"


class Choice(click.Choice[str]):
    """The type of options that are one of several words, in any case, with - or _; a near one is proposed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the word as the option knows it."""
        found = next((choice for choice in self.choices if plain(choice) == plain(str(value))), None)
        if found is None:
            listed = ", ".join(map(repr, self.choices))
            near = did_you_mean(str(value), self.choices, " ({})")
            self.fail(f"{value!r} is not one of {listed}{near}.", param, ctx)
        return found


def parsed(read: Callable[[str], Any], wrong: str) -> Callable[[str], Any]:
    """Return the type of an option that a function reads, which raises ValueError for a text that it cannot read."""

    def convert(text: str) -> Any:
        try:
            return read(text)
        except ValueError:
            raise click.BadParameter(f"{text!r} {wrong}") from None

    return convert


#: The type of options of one real number.
real = parsed(float, "is no number; write one with a decimal point, such as 0.1")


def group(*options: Option) -> Option:
    """Return a decorator that adds options to a command, in this order."""

    def decorated(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorated


def flag(name: str, text: str, *to: str) -> Option:
    """Return an option without a value, with its line of help, and the argument that it becomes."""
    return click.option(name, *to, is_flag=True, help=text)


def path_option(name: str, metavar: str, text: str, *to: str, **more: Any) -> Option:
    """Return an option that names a file or a folder."""
    return click.option(name, *to, type=click.Path(path_type=Path), metavar=metavar, help=text, **more)


#: Candidates of a number for each input: 1:3 is ((1, 2, 3),), and 2,1:2 is ((2,), (1, 2)).
Candidates = tuple[tuple[Any, ...], ...]


def _candidates(text: str, number: type, name: str, example: str) -> Candidates:
    """Read a number, a range first:last or first:last:step, or several of these with commas, one for each input."""

    def of_input(part: str) -> tuple[Any, ...]:
        try:
            numbers = [number(each) for each in part.split(":")]
        except ValueError:
            wrong = f"{part!r} is neither a {name} nor a range such as {example}"
            if part != text and ":" not in part:
                wrong = f"{text!r} must be a {name} for each input, with commas between"
            raise click.BadParameter(wrong) from None
        if len(numbers) == 1:
            return (numbers[0],)
        first, last, step = numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else number(1)
        if len(numbers) > 3 or not step > 0 or not first <= last or not math.isfinite(last - first):
            raise click.BadParameter(f"{part!r} is not a valid range; write {example}")
        if (last - first) / step > MOST_TRIED:
            raise click.BadParameter(f"{part!r} has more than {MOST_TRIED} numbers: take a larger step")
        count = int((last - first) / step * (1 + 1e-12)) + 1
        return tuple(number(first + k * step) for k in range(count))

    return tuple(map(of_input, text.split(",")))


def whole_numbers(text: str) -> Candidates:
    """Read poles or zeros."""
    return _candidates(text, int, "whole number", "1:4")


def times(text: str) -> Candidates:
    """Read dead times."""
    return _candidates(text, float, "time in s", "0:1:0.1")


def structure_options(poles: str, zeros: str, delay: str) -> Option:
    """Return the options of a structure, with their lines of help."""
    return group(
        click.option("-p", "--poles", type=whole_numbers, metavar="N", help=poles),
        click.option("--zeros", type=whole_numbers, metavar="M", help=zeros),
        click.option("--delay", type=times, default="0", metavar="S", help=delay),
    )


def optimizer_of(text: str) -> str | Optimizer:
    """Return the name of an optimizer as `Request` knows it, or of a name, a colon and settings the optimizer."""
    word, colon, settings = text.partition(":")
    name = Choice([AUTO, *OPTIMIZERS]).convert(word, None, None)
    if not colon:
        return name
    if name == AUTO:
        raise click.BadParameter("auto takes no settings: name the optimizer, as in amsgrad:step_size=0.001")
    try:
        return _with_settings(name, settings)
    except InvalidArgumentError as error:
        raise click.BadParameter(f"{text!r}: {error}") from None


def _with_settings(name: str, settings: str) -> Optimizer:
    """Return an optimizer with settings, written as a list of SETTING=NUMBER with commas."""
    kind = OPTIMIZERS[name]
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    given: dict[str, float] = {}
    for entry in settings.split(","):
        key, equals, number = (part.strip() for part in entry.partition("="))
        key = key.replace("-", "_")
        if key not in fields:
            near = did_you_mean(key, list(fields), " ({})")
            raise InvalidArgumentError(f"{name} has no setting {key!r}{near}; its settings are {', '.join(fields)}")
        if key in given:
            raise InvalidArgumentError(f"{key} is given twice")
        try:
            given[key] = float(number)
        except ValueError:
            raise InvalidArgumentError(f"write a number behind {key}=, got {equals + number!r}") from None
    missing = [key for key, field in fields.items() if field.default is dataclasses.MISSING and key not in given]
    if missing:
        raise InvalidArgumentError(f"{name} needs {missing[0]} too, as in {name}:{missing[0]}=0.001")
    return kind(**given)


#: Options that say what is done with a result, not how it is made.
OF_OUTPUT = ("as_json", "out", "full_trace", "saved", "other_logs", "required", "quiet", "progress")


def typed_words(*, with_output: bool = False, without: Collection[str] = ()) -> list[str]:
    """Return the command as typed, without some options by their long names, and mostly without those of its output."""
    context = click.get_current_context()
    typed, _, _ = context.command.make_parser(context).parse_args(list(context.meta.get(TYPED, ())))
    words = ["replant", context.info_name or ""]
    for parameter in context.command.params:
        name, given = parameter.name or "", typed.get(parameter.name or "")
        if not isinstance(given, str | bool | list | tuple) or (name in OF_OUTPUT and not with_output):
            continue
        if any(option.lstrip("-") in without for option in parameter.opts):
            continue
        for each in given if isinstance(given, list | tuple) else (given,):
            if isinstance(parameter, click.Argument):
                words.append(typed_path(each))
            else:
                words += [parameter.opts[-1], *([] if each is True else [each])]
    return words


def command_line() -> str:
    """Return the command as typed, without the options of its output."""
    return shlex.join(typed_words())


def typed(option: str) -> str:
    """Return the value that an option was given; empty where it was not."""
    words = typed_words()
    return words[words.index(option) + 1] if option in words else ""


JSON = flag("--json", "Print one JSON object.", "as_json")


TAKE_SEVERAL = {
    "input": "fit, run, validate, fleet and live",
    "output": "fit, run and validate",
    "reference": "fit, run, validate and fleet",
}


def column_option(role: str, text: str, *, several: bool = False) -> Option:
    """Return the option of a role, with its line of help: a name, or a tuple of several."""
    names = *(() if role == "reference" else (f"-{role[0]}",)), f"--{role}", f"{role}_column"
    return click.option(*names, multiple=True, metavar="COL", callback=partial(_named, several, role), help=text)


def _named(
    several: bool, role: str, context: click.Context, option: click.Parameter, given: tuple[str, ...]
) -> str | tuple[str, ...] | None:
    twice = next((each for each in given if given.count(each) > 1), None)
    if twice is not None:
        raise click.UsageError(f"{option.opts[0]} {twice} is given twice: name each column once", context)
    if len(given) < 2:
        return given[0] if given else None
    if not several:
        typed = " ".join(f"{option.opts[0]} {each}" for each in given)
        who = TAKE_SEVERAL[role]
        raise click.UsageError(f"{typed}: only replant {who} take several {role}s: name one of them here", context)
    return given


NEEDED = {"input_column": "--input", "output_column": "--output", "poles": "--poles"}
CLOCK = {"--time", "--dt"}  # exclude each other
ONLY_FIT = {"--delay"}  # as a range


def check_complete(given: dict[str, Any]) -> None:
    """Check that input, output and poles are given; print what is in the log where columns are not."""
    missing = [option for name, option in NEEDED.items() if given[name] is None]
    if not missing:
        return
    absent = f"missing {' and '.join(filter(None, (', '.join(missing[:-1]), missing[-1])))}"
    if "log" not in given:  # a fleet: no log stands for all
        raise click.UsageError(f"{absent}; see what is in one of the logs, and how it is identified: replant look LOG")
    if missing == ["--poles"]:
        inputs = given["input_column"]
        if isinstance(inputs, tuple):
            each = ",".join("1" * len(inputs))
            raise click.UsageError(f"{absent}, a number for each input: {_completed(('-p', each))}")
        searched = "a range such as 1:4 has it chosen" if _is_fit() else "`replant fit -p 1:4` chooses it"
        raise click.UsageError(f"{absent}, the number of poles of G(s): {searched}; try: {_completed(('-p', '2'))}")
    raise click.UsageError(f"{absent}; {_look(given)}")


def _look(given: dict[str, Any]) -> str:
    """Print what is in the log; return how the command goes on."""
    from replant.fitting.log_inspection import inspect, lacking, options_of
    from replant.report.log_as_text import print_findings

    columns = {name: given[f"{name}_column"] for name in ("input", "output", "time")}
    columns = {role: each[0] if isinstance(each, tuple) else each for role, each in columns.items()}
    try:
        found = inspect(Path(given["log"]), **columns)
    except LogError as problem:
        return f"and {problem}."
    print_findings(terminal(stderr=True), found)
    options = options_of(found)
    if (found.clock is not None and found.clock.shuffled) or (not options and found.roles.input and found.roles.output):
        return f"{lacking(found)}."
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
    needless = {*typed, *(CLOCK if typed & CLOCK else ()), *(() if _is_fit() else ONLY_FIT)}
    pairs = [pair for pair in zip(options[::2], options[1::2], strict=True) if pair[0] not in needless]
    return shlex.join([*typed_words(with_output=True), *chain(*pairs)])


def _is_fit() -> bool:
    return click.get_current_context().info_name == "fit"
