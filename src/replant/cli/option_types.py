"""Types of options, columns, what a command lacks, the command as it was typed, and the orders of several inputs."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.messages import TYPED, did_you_mean, plain
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


class Parsed(click.ParamType[Any]):
    """The type of options that a function reads, which raises ValueError for a text that it cannot read."""

    def __init__(self, name: str, read: Callable[[str], Any], wrong: str) -> None:
        self.name, self._read, self._wrong = name, read, wrong

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what the option says."""
        if not isinstance(value, str):
            return value
        try:
            return self._read(value)
        except ValueError:
            self.fail(f"{value!r} {self._wrong}", param, ctx)


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


def structure_options(poles: str, zeros: str, delay: str) -> Option:
    """Return the options of a structure, with their lines of help; each may be a range, or a number for each input."""
    return group(
        click.option("-p", "--poles", type=WHOLE, metavar="N", help=poles),
        click.option("--zeros", type=WHOLE, metavar="M", help=zeros),
        click.option("--delay", type=SECONDS, default="0", metavar="S", help=delay),
    )


class Each(tuple[Any, ...]):
    """Numbers of several inputs, in their order, or ranges, each a tuple."""

    __slots__ = ()


class Range(click.ParamType[tuple[Any, ...]]):
    """The type of options that are a number, a range first:last or first:last:step, or a number for each input."""

    def __init__(self, name: str, number: type, example: str) -> None:
        self.name, self.number, self.example = name, number, example

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        """Return every number of the range, including the last."""
        if isinstance(value, tuple):
            return value
        if "," in str(value):
            each = str(value).split(",")
            return Each(self.convert(p, param, ctx) if ":" in p else self._one(p, value, param, ctx) for p in each)
        try:
            parts = [self.number(part) for part in str(value).split(":")]
        except ValueError:
            self.fail(f"{value!r} is neither a {self.name} nor a range such as {self.example}", param, ctx)
        if len(parts) == 1:
            return (parts[0],)
        first, last, step = parts[0], parts[1], parts[2] if len(parts) == 3 else self.number(1)
        if len(parts) > 3 or not step > 0 or not first <= last or not math.isfinite(last - first):
            self.fail(f"{value!r} is not a valid range; write {self.example}", param, ctx)
        if (last - first) / step > MOST_TRIED:
            self.fail(f"{value!r} has more than {MOST_TRIED} numbers: take a larger step", param, ctx)
        count = int((last - first) / step * (1 + 1e-12)) + 1
        return tuple(self.number(first + k * step) for k in range(count))

    def _one(self, part: str, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number of one input."""
        try:
            return self.number(part)
        except ValueError:
            self.fail(f"{value!r} must be a {self.name} for each input, with commas between", param, ctx)


WHOLE, SECONDS = Range("whole number", int, "1:4"), Range("time in s", float, "0:1:0.1")


class OptimizerChoice(click.ParamType["str | Optimizer"]):
    """The type of an option that is the name of an optimizer, or a name, a colon and settings."""

    name = "optimizer"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | Optimizer:
        """Return the name as `Request` knows it, or the optimizer with the settings that were given."""
        if isinstance(value, Optimizer):
            return value
        typed, colon, settings = str(value).partition(":")
        name = Choice([AUTO, *OPTIMIZERS]).convert(typed, param, ctx)
        if not colon:
            return name
        if name == AUTO:
            self.fail("auto takes no settings: name the optimizer, as in amsgrad:step_size=0.001", param, ctx)
        try:
            return _with_settings(name, settings)
        except InvalidArgumentError as error:
            self.fail(f"{value!r}: {error}", param, ctx)

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return what the help shows in place of the value."""
        return "NAME[:SETTING=X,...]"


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


def command_line(*, with_output: bool = False, without: Collection[str] = ()) -> str:
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
    return shlex.join(words)


def typed(option: str) -> str:
    """Return the value that an option was given; empty where it was not."""
    words = shlex.split(command_line())
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
RANGE = "1:4"
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
        searched = f"a range such as {RANGE} has it chosen" if _name() == "fit" else "`replant fit -p 1:4` chooses it"
        inputs = given["input_column"]
        if isinstance(inputs, tuple):
            raise click.UsageError(
                f"{absent}, a number for each input: {_completed(('-p', ','.join('1' * len(inputs))))}"
            )
        raise click.UsageError(f"{absent}, the number of poles of G(s): {searched}; try: {_completed(('-p', '2'))}")
    raise click.UsageError(f"{absent}; {_look(given)}")


def _look(given: dict[str, Any]) -> str:
    """Print what is in the log; return how the command goes on."""
    from rich.console import Console

    from replant.fitting.log_inspection import inspect, options_of
    from replant.report.log_as_text import print_findings

    columns = {name: given[f"{name}_column"] for name in ("input", "output", "time")}
    columns = {role: each[0] if isinstance(each, tuple) else each for role, each in columns.items()}
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


#: Options that one input takes, and several do not, with what they are without them.
NOT_YET = {
    "bias": False, "feedthrough": False, "input_map": "identity", "method": "auto",
    "optimizer": "auto", "full_trace": None, "background": False,
}  # fmt: skip


def are_several(options: dict[str, Any]) -> bool:
    """Return whether the options name several inputs or outputs."""
    return any(isinstance(options.get(name), tuple) for name in ("input_column", "output_column"))


def refuse_not_yet(options: dict[str, Any], several: str = "inputs") -> None:
    """Raise InvalidArgumentError for an option that several inputs, or outputs, do not take yet."""
    for name, usual in NOT_YET.items():
        if options.get(name, usual) != usual:
            raise InvalidArgumentError(
                f"several {several} take no --{name.removesuffix('_column').replace('_', '-')} yet"
            )


def orders_of(options: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
    """Return poles, zeros and dead time of each input: numbers, or ranges, each a tuple."""
    return {name: _of_each(options[name], name, inputs) for name in STRUCTURE}


def is_range(given: Any) -> bool:
    """Return whether an order of several inputs has a range."""
    return any(isinstance(each, tuple) for each in given)


def numbers_of(options: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
    """Return poles, zeros and dead time of each input, where a range is refused."""
    refuse_not_yet(options)
    asked = orders_of(options, inputs)
    refuse_ranges(asked)
    return asked


def refuse_ranges(asked: dict[str, tuple[Any, ...]]) -> None:
    """Raise InvalidArgumentError where an order of an input is a range."""
    if any(map(is_range, asked.values())):
        raise InvalidArgumentError("a range is searched by replant fit: give a number for each input here")


def _of_each(given: tuple[Any, ...] | None, name: str, inputs: tuple[str, ...]) -> tuple[Any, ...]:
    """Return a number for each input, or a range: those given, or 0 for all."""
    if given is not None and len(given) > 1 and not isinstance(given, Each):
        return (given,) * len(inputs)
    example = ",".join("1" for _ in inputs)
    if given is None or (name != "poles" and given == (0.0,)):
        return (0,) * len(inputs)
    if len(given) != len(inputs) or not (isinstance(given, Each) or len(inputs) == 1):
        got = f"{len(given)} numbers" if isinstance(given, Each) else "one number"
        raise InvalidArgumentError(
            f"--{name} must have a number for each of {len(inputs)} inputs ({', '.join(inputs)}), as in {example}: "
            f"got {got}"
        )
    return tuple(given)
