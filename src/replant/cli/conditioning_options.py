"""The options that condition a log before it is identified: bands of frequencies, stretches of time, trends, rates."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any

import click
import numpy as np

from replant.cli.messages import note
from replant.cli.option_types import Choice, flag, group, parsed, real
from replant.errors import InvalidArgumentError
from replant.logs.conditioning import STEPS, Stretch, from_rest, leave_out
from replant.logs.log import Log
from replant.report.python_programs import changes_as_python


def _band(text: str) -> tuple[float | None, float | None]:
    low, colon, high = text.partition(":")
    edges = _edge(low), _edge(high)
    if not colon or edges == (None, None):
        raise ValueError(text)
    return edges


def _edge(text: str) -> float | None:
    text = text.strip().removesuffix("Hz").strip()
    if not text:
        return None
    edge = float(text)
    if not 0.0 < edge < math.inf:
        raise ValueError(text)
    return edge


#: Reads a band of frequencies in Hz, such as 0.1:10; an edge that is left out is open.
band_of = parsed(_band, "is no band of frequencies; write 0.1:10, 0.1: or :10, in Hz")


def words_of(low: float | None, high: float | None) -> str:
    """Return a band in words."""
    if high is None:
        return f"{low:g} Hz and more"
    return f"{high:g} Hz and less" if low is None else f"{low:g} to {high:g} Hz"


UNITS = {"": 1.0, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def seconds_of(text: str) -> float:
    """Return a length of time in s, such as 500ms, 60s, 10min or 24h."""
    found = re.fullmatch(rf"\s*(\d+(?:\.\d*)?)\s*({'|'.join(UNITS)})\s*", text)
    if not found:
        raise ValueError(text)
    return float(found[1]) * UNITS[found[2]]


def _stretch(text: str) -> Stretch:
    first, colon, last = text.partition(":")
    begin, end = seconds_of(first) if first.strip() else 0.0, seconds_of(last) if last.strip() else None
    if not colon or (end is not None and not begin < end):
        raise ValueError(text)
    return begin, end


#: Reads a stretch of time in s from the first sample, such as 12s:32s; without an end it goes on to the last sample.
stretch_of = parsed(_stretch, "is no stretch of time; write 12s:32s, from and to after the first sample")
#: The options that name stretches, and their lines of help.
STRETCHES = {
    "use": "Use only this stretch of time, such as 0s:60s, without its end; the input before it is still used.",
    "leave_out": "Leave out the output of this stretch of time, such as 12s:32s; that at its end stays.",
    "validate_on": "Leave out this stretch, and validate the model on it.",
}


_OF_STRETCH: dict[str, Any] = {"type": stretch_of, "multiple": True, "metavar": "A:B"}
stretch_options = group(
    *(
        click.option(f"--{name.replace('_', '-')}", **_OF_STRETCH, help=f"{text}  Repeat it for several.")
        for name, text in STRETCHES.items()
    )
)


def stretched(log: Log, options: dict[str, Any]) -> Log:
    """Return a log up to the last output that the options leave in, and without those that they leave out."""
    left_out, use = _stretches(options)
    with _named("--use, --leave-out, --validate-on"):
        left = leave_out(log, left_out, use=use)
    count = np.isfinite(log.output).sum() - np.isfinite(left.output).sum()
    note(f"{count:,} of {log.output.size:,} outputs are left out by --use, --leave-out or --validate-on")
    return left


def _stretches(options: dict[str, Any]) -> tuple[list[Stretch], list[Stretch]]:
    """Return the stretches of time that are left out, and those that are used."""
    use, *others = (options.get(name) or () for name in STRETCHES)
    return [*chain.from_iterable(others)], [*use]


ESTIMATE, REST = "estimate", "rest"
condition_options = group(
    click.option(
        "--input-hold",
        type=Choice(["zoh", "foh"]),
        help="The input between two samples: held (zoh), or a straight line (foh).  "
        "[default: zoh; foh with --decimate]",
    ),
    flag("--detrend", "Subtract from each signal the straight line that fits it best."),
    click.option(
        "--decimate",
        type=click.IntRange(2),
        metavar="N",
        help="Filter the signals against aliasing and keep one sample of N; the input is then interpolated linearly.",
    ),
    click.option(
        "--resample",
        type=real,
        metavar="S",
        help="Put the samples S seconds apart: the input's mean over each interval, the output interpolated.",
    ),
    click.option(
        "--band",
        type=band_of,
        metavar="LOW:HIGH",
        help="Use only this band of frequencies, in Hz: both signals pass the same filter, so G(s) does not change.  "
        "0.1: has no upper edge, :10 no lower one.",
    ),
    click.option(
        "--x0",
        type=Choice([ESTIMATE, REST]),
        default=ESTIMATE,
        show_default=True,
        help="State at the first sample: estimated, or at rest, with the plant settled at the first input.",
    ),
)


def is_conditioned(options: dict[str, Any]) -> bool:
    """Return whether the options change the samples, so that the whole log must be in memory."""
    return bool(_steps(options)) or any(map(options.get, STRETCHES)) or options.get("x0") == REST


def conditioning_as_python(options: dict[str, Any]) -> list[str]:
    """Return the calls that condition a log as the options do, see `changes_as_python`."""
    calls = changes_as_python(_steps(options), *_stretches(options), at_rest=options.get("x0") == REST)
    hold = input_hold_of(options)
    # decimated samples have the other one
    return (
        calls
        if (hold == "foh") is bool(options.get("decimate"))
        else [*calls, f"dataclasses.replace({{}}, input_hold={hold!r})"]
    )


def _steps(options: dict[str, Any]) -> dict[str, Any]:
    """Return the steps that the options ask for, in the order in which they are taken, with their arguments."""
    given = {name: options.get(name) for name in STEPS}
    return {name: argument for name, argument in given.items() if argument is not None and argument is not False}


def input_hold_of(options: dict[str, Any]) -> str:
    """Return what the input does between two samples, as `replant.Log.input_hold`."""
    given = options.get("input_hold")
    return str(given) if given is not None else "foh" if options.get("decimate") else "zoh"


def conditioned(log: Log | None, options: dict[str, Any]) -> Log:
    """Return a log as the options ask for it, and say on standard error what was done."""
    assert log is not None
    steps = {name: (argument, f"--{name}{_written(argument)}") for name, argument in _steps(options).items()}
    for number, (name, (argument, option)) in enumerate(steps.items(), 1):
        later = ", ".join(after for _, after in [*steps.values()][number:])
        with _named(f"{option}, taken before {later}" if later else option):
            log = STEPS[name](log, argument)
        note(_done(name, log, options))
    log = stretched(log, options) if any(map(options.get, STRETCHES)) else log
    if options.get("x0") == REST:
        with _named(f"--x0 {REST}"):
            log = from_rest(log)
        note(f"from rest: {log.rest:,} samples at the first input are put before the record")
    return log


@contextmanager
def _named(option: str) -> Iterator[None]:
    """Put an option before the message of what it leads to."""
    try:
        yield
    except InvalidArgumentError as error:
        raise InvalidArgumentError(f"{option}: {error}") from None


def _written(argument: Any) -> str:
    if isinstance(argument, tuple):
        return " " + ":".join("" if edge is None else f"{edge:.12g}" for edge in argument)
    return "" if argument is True else f" {argument:g}"


def _done(name: str, log: Log, options: dict[str, Any]) -> str:
    """Return what a step has done, in words; ``log`` is what came of it."""
    if name == "resample":
        return f"resampled: {len(log):,} samples, {log.dt:g} s apart; where gaps are, both signals are missing"
    if name == "decimate":
        kept = f"one sample of {options['decimate']} kept, now {len(log):,}, {log.dt:g} s apart"
        return f"decimated: filtered against aliasing, {kept}"
    if name == "detrend":
        return "detrended: a straight line is subtracted from each signal, its mean kept"
    left = int(np.flatnonzero(np.isfinite(log.output))[0]) if np.isfinite(log.output).any() else log.input.size
    counts = words_of(*options["band"])
    return f"filtered: {counts} count; the first {left:,} outputs are missing, while the filter settles"
