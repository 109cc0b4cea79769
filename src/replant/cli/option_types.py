"""Types of options: a number or a range of numbers, an optimizer with its settings."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import click

from replant.cli.nearest_word import Choice, did_you_mean
from replant.errors import InvalidArgumentError
from replant.limits import MOST_TRIED
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.settings import AUTO


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


class OptimizerChoice(click.ParamType["str | Optimizer"]):
    """The type of an option that is the name of an optimizer, or a name, a colon and settings."""

    name = "optimizer"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | Optimizer:
        """Return the name as `Request` knows it, or the optimizer with the settings that were given.

        >>> OptimizerChoice().convert("amsgrad:step_size=0.001", None, None)
        AMSGrad(step_size=0.001, beta1=0.9, beta2=0.999, epsilon=1e-08)
        >>> OptimizerChoice().convert("AMSGrad", None, None)
        'amsgrad'
        """
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

    def written(self, value: str | Optimizer) -> str:
        """Return the optimizer as `convert` reads it.

        Examples
        --------
        >>> from replant.optimizers import Gradient
        >>> OptimizerChoice().written(Gradient(gain=2.0))
        'gradient:gain=2.0'
        """
        if isinstance(value, str):
            return value
        name = next(name for name, kind in OPTIMIZERS.items() if kind is type(value))
        given = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}  # type: ignore[arg-type]
        return f"{name}:" + ",".join(f"{key}={number}" for key, number in given.items() if number is not None)

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
            question = did_you_mean(key, list(fields))
            near = f" ({question})" if question else ""
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
