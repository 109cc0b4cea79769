"""Options that name a column of a log: one input, one output."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import click

MANY_INPUTS = (
    "several inputs are not supported yet: name one of them, and read what `replant look` or the verdict says of the "
    "others"
)
MANY_OUTPUTS = "several outputs are not supported: identify them one after the other"


def column_option(*names: str, many: str, **options: Any) -> Callable[[Any], Any]:
    """Return an option that names one column, and says ``many`` where it is given more than once."""
    return click.option(*names, multiple=True, metavar="COL", callback=partial(_only, many), **options)


def input_option(text: str) -> Callable[[Any], Any]:
    """Return the option of the input, with its line of help."""
    return column_option("-i", "--input", "input_column", many=MANY_INPUTS, help=text)


def output_option(text: str) -> Callable[[Any], Any]:
    """Return the option of the output, with its line of help."""
    return column_option("-o", "--output", "output_column", many=MANY_OUTPUTS, help=text)


def _only(many: str, context: click.Context, option: click.Parameter, given: tuple[str, ...]) -> str | None:
    if len(set(given)) > 1:
        raise click.UsageError(f"{' '.join(f'{option.opts[0]} {each}' for each in given)}: {many}", context)
    return given[0] if given else None
