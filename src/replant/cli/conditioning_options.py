"""The options that condition a log before it is identified."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click
import numpy as np

from replant.cli.band_option import Band, words_of
from replant.cli.nearest_word import Choice
from replant.cli.notes import note
from replant.cli.stretch_options import has_stretches, stretched
from replant.data.band import bandpass
from replant.data.conditioning import decimate, detrend, resample
from replant.data.rest import from_rest
from replant.errors import InvalidArgumentError
from replant.log import Log

ESTIMATE, REST = "estimate", "rest"
CONDITIONING: list[Callable[[Any], Any]] = [
    click.option("--detrend", is_flag=True, help="Subtract from each signal the straight line that fits it best."),
    click.option(
        "--decimate",
        type=click.IntRange(2),
        metavar="N",
        help="Filter the signals against aliasing and keep one sample of N; the input then goes in straight lines.",
    ),
    click.option(
        "--resample",
        type=float,
        metavar="S",
        help="Put the samples S seconds apart: the input's mean over each interval, the output interpolated.",
    ),
    click.option(
        "--band",
        type=Band(),
        metavar="LOW:HIGH",
        help="Let this band of frequencies count alone, in Hz: both signals pass the same filter, so that G(s) stays.  "
        "0.1: has no upper edge, :10 no lower one.",
    ),
    click.option(
        "--x0",
        type=Choice([ESTIMATE, REST]),
        default=ESTIMATE,
        show_default=True,
        help="State at the first sample: estimated, or at rest, the plant settled at the first input.",
    ),
]


def is_conditioned(options: dict[str, Any]) -> bool:
    """Return whether the options change the samples, so that the whole log must be in memory."""
    return (
        bool(options.get("detrend"))
        or has_stretches(options)
        or options.get("x0") == REST
        or any(options.get(name) is not None for name in ("decimate", "resample", "band"))
    )


def input_hold_of(options: dict[str, Any]) -> str:
    """Return what the input does between two samples, as `replant.Log.input_hold`."""
    given = options.get("input_hold")
    return str(given) if given is not None else "foh" if options.get("decimate") else "zoh"


def conditioned(log: Log | None, options: dict[str, Any]) -> Log:
    """Return a log as the options ask for it, and say on standard error what was done."""
    assert log is not None
    for name, change in (("resample", resample), ("decimate", decimate)):
        if options.get(name) is not None:
            try:
                log = change(log, options[name])
            except InvalidArgumentError as error:
                raise InvalidArgumentError(f"--{name} {options[name]:g}: {error}") from None
    if options.get("resample") is not None:
        note(f"resampled: {len(log):,} samples, {log.dt:g} s apart; where gaps are, both signals are missing")
    if options.get("decimate") is not None:
        note(
            f"decimated: filtered against aliasing, one sample of {options['decimate']} kept, now {len(log):,}, "
            f"{log.dt:g} s apart"
        )
    if options.get("detrend"):
        log = detrend(log)
        note("detrended: a straight line is subtracted from each signal, its mean kept")
    if options.get("band") is not None:
        low, high = options["band"]
        try:
            log = bandpass(log, low, high)
        except InvalidArgumentError as error:
            raise InvalidArgumentError(f"--band {Band().written(options['band'])}: {error}") from None
        left = int(np.flatnonzero(np.isfinite(log.output))[0]) if np.isfinite(log.output).any() else log.input.size
        note(
            f"filtered: {words_of(low, high)} count; the first {left:,} outputs, while the filter settles, are missing"
        )
    log = stretched(log, options) if has_stretches(options) else log
    if options.get("x0") == REST:
        try:
            log = from_rest(log)
        except InvalidArgumentError as error:
            raise InvalidArgumentError(f"--x0 {REST}: {error}") from None
        note(f"from rest: as many samples at the first input are put before the record, now {len(log):,}")
    return log
