"""The command that is running, as it was typed."""

from __future__ import annotations

import shlex
from collections.abc import Collection
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.conditioning_options import Band, Stretch
from replant.cli.option_types import OptimizerChoice, Range

#: Options that say what is done with a result, not how it is made.
OF_OUTPUT = ("as_json", "out", "full_trace", "saved", "other_logs", "required", "quiet", "progress")


def command_line(*, with_output: bool = False, without: Collection[str] = ()) -> str:
    """Return the command that is running, as typed, without the options of its output unless they are asked for.

    ``without`` are the long names of options that are left out.
    """
    context = click.get_current_context()
    words = ["replant", context.info_name or ""]
    for parameter in context.command.params:
        name = parameter.name or ""
        value: Any = context.params.get(name)
        source = context.get_parameter_source(name)
        if (name in OF_OUTPUT and not with_output) or source is not ParameterSource.COMMANDLINE:
            continue
        if any(option.lstrip("-") in without for option in parameter.opts):
            continue
        if isinstance(parameter, click.Argument):
            words += map(str, value if isinstance(value, tuple) else (value,))
        elif value is True:
            words.append(parameter.opts[-1])
        elif isinstance(parameter.type, Range | OptimizerChoice | Band):
            words += [parameter.opts[-1], parameter.type.written(value)]
        else:
            write = parameter.type.written if isinstance(parameter.type, Stretch) else str
            for entry in value if isinstance(value, tuple) else (value,):
                words += [parameter.opts[-1], write(entry)]
    return shlex.join(words)
