"""The option that names an optimizer, and perhaps its settings: ``amsgrad:step_size=0.001,beta1=0.8``."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from replant.cli.nearest_word import Choice, did_you_mean
from replant.errors import InvalidArgumentError
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.settings import AUTO


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
