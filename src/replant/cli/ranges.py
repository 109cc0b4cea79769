"""Options that are a number or a range of numbers."""

from __future__ import annotations

import math
from typing import Any

import click

from replant.limits import MOST_TRIED


class Range(click.ParamType[tuple[Any, ...]]):
    """The type of options that are a number, or a range first:last or first:last:step."""

    number: type = float
    example = ""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        """Return every number of the range, including the last.

        >>> Whole().convert("1:4", None, None)
        (1, 2, 3, 4)
        """
        if isinstance(value, tuple):
            return value
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

    def written(self, values: tuple[Any, ...]) -> str:
        """Return numbers as `convert` reads them.

        Examples
        --------
        >>> Whole().written((2,)), Seconds().written(Seconds().convert("0:1:0.1", None, None))
        ('2', '0.0:1.0:0.1')
        """
        if len(values) == 1:
            return str(values[0])
        return f"{values[0]}:{values[-1]}:{(values[-1] - values[0]) / (len(values) - 1):.12g}"


class Whole(Range):
    """Whole numbers."""

    name = "whole number"
    example = "1:4"
    number = int


class Seconds(Range):
    """Times in s."""

    name = "time in s"
    example = "0:1:0.1"
