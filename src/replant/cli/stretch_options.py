"""Options that name stretches of time of a log: those that are used, left out, or kept to validate on."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from replant.arguments import BoolArray
from replant.cli.notes import note
from replant.errors import InvalidArgumentError
from replant.log import Log

UNITS = {"": 1.0, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


class Stretch(click.ParamType[tuple[float, float]]):
    """The type of options that are a stretch of time, such as 12s:32s; without an end it goes on to the last sample."""

    name = "stretch"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return begin and end in s from the first sample.

        >>> Stretch().convert("12s:1.5min", None, None), Stretch().convert("60:", None, None)
        ((12.0, 90.0), (60.0, inf))
        """
        if isinstance(value, tuple):
            return value
        begin, colon, end = str(value).partition(":")
        times = _seconds(begin, 0.0), _seconds(end, math.inf)
        if not colon or math.isnan(times[0]) or not times[0] < times[1]:
            self.fail(f"{value!r} is no stretch of time; write 12s:32s, from and to after the first sample", param, ctx)
        return times

    def written(self, stretch: tuple[float, float]) -> str:
        """Return a stretch as `convert` reads it.

        Examples
        --------
        >>> Stretch().written((12.0, 90.0)), Stretch().written((60.0, math.inf))
        ('12:90', '60:')
        """
        begin, end = stretch
        return f"{begin:g}:" + (f"{end:g}" if math.isfinite(end) else "")


def _seconds(text: str, otherwise: float) -> float:
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(ms|s|min|h|d|)\s*", text)
    return float(found[1]) * UNITS[found[2]] if found else math.nan if text.strip() else otherwise


def _option(name: str, text: str) -> Callable[[Any], Any]:
    return click.option(name, type=Stretch(), multiple=True, metavar="A:B", help=f"{text}  Repeat it for several.")


STRETCHES = [
    _option("--use", "Use only this stretch of time, such as 0s:60s; the input before it is known all the same."),
    _option("--leave-out", "Leave out the output of this stretch of time, such as 12s:32s."),
    _option("--validate-on", "Leave out this stretch, and validate the model on it."),
]
NAMES = ("use", "leave_out", "validate_on")


def has_stretches(options: dict[str, Any]) -> bool:
    """Return whether an option names a stretch."""
    return any(options.get(name) for name in NAMES)


def stretched(log: Log, options: dict[str, Any]) -> Log:
    """Return a log without the outputs that the options leave out; the input goes on to act."""
    from dataclasses import replace

    clock = log.dt * np.arange(log.input.size) if log.time is None else log.time - log.time[0]
    clock = clock + (options.get("begin") or 0.0)
    used, kept, held = (_within(clock, name, options) for name in NAMES)
    left = (used if options.get("use") else np.ones(clock.size, bool)) & ~kept & ~held
    if not (left & np.isfinite(log.output)).any():
        raise InvalidArgumentError("--use, --leave-out, --validate-on: no output is left to make a model of")
    note(f"{int((~left).sum()):,} of {clock.size:,} outputs are left out, as --use, --leave-out or --validate-on say")
    return replace(log, output=np.where(left, log.output, np.nan))


def _within(clock: Any, name: str, options: dict[str, Any]) -> BoolArray:
    """Return which samples (K,) lie in the stretches of an option."""
    found = np.zeros(clock.size, bool)
    for begin, end in options.get(name) or ():
        inside = (clock >= begin) & (clock < end)
        if not inside.any():
            option = name.replace("_", "-")
            lasts = f"{clock[0]:.6g} to {clock[-1]:.6g} s" if clock.size else "no time"
            raise InvalidArgumentError(f"--{option} {begin:g}:{end:g}: no sample lies there; the log has {lasts}")
        found |= inside
    return found
