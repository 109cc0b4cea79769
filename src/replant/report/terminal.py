"""A result as the JSON object of the command line, and as tables for the terminal."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from replant.assessment.verdict import Verdict
from replant.identified import model_json
from replant.identified.model import Model
from replant.model.transfer_function import TransferFunction
from replant.plotting.numbers import duration, interval, off_by, percent, std_alone, with_std
from replant.report.findings import colour_of
from replant.runs.result import Clock, Result

REASON_INDENT = 9  # indent of the reasons, below the figures [columns]


def as_json(result: Result) -> dict[str, Any]:
    """Return the JSON object of `run` and `fit`: that of the model, how long it took, and an irregular clock."""
    clock = {} if result.clock is None else {"clock": _clock(result.clock)}
    return model_json.as_object(result.model) | {"elapsed_seconds": round(result.elapsed, 3)} | clock


def record_line(samples: int, dt: float, seconds: float) -> str:
    """Return the size of a record in words: number of samples, sampling time and length, both in s.

    Examples
    --------
    >>> record_line(20_000, 0.001, 20.0)
    '20,000 samples, dt 1 ms, 20 s'
    """
    return f"{samples:,} samples, dt {interval(dt)}, {duration(seconds)}"


def print_result(
    console: Any, result: Result, *, truth: TransferFunction | None = None, record: str = "", lead: str = ""
) -> None:
    """Print G(s), coefficients, poles, fit and verdict."""
    console.print()
    if result.parameters.any():
        _print_model(console, result.model, truth)
        simulated, one_step = (percent(fit, ascii_only=True) for fit in (result.simulation.fit, result.one_step))
        console.print(f"Fit      {simulated} {result.simulation.how}, {one_step} one step ahead", highlight=False)
    else:
        console.print("No model yet: the record gave no estimate.\n", highlight=False)
    if record:
        console.print(f"Record   {record}", highlight=False)
    _print_samples(console, result.samples, result.rejected)
    if result.clock is not None and result.clock.irregular:
        console.print(f"Clock    {_irregular(result.clock)}", highlight=False)
    print_verdict(console, result.verdict, lead)


def print_kept_model(console: Any, model: Model) -> None:
    """Print a model that was kept: G(s), coefficients, poles, fit, verdict, and where it comes from."""
    console.print()
    _print_model(console, model, None)
    fits = (percent(fit, ascii_only=True) for fit in (model.simulated_fit, model.one_step_fit))
    console.print("Fit      {} simulated, {} one step ahead".format(*fits), highlight=False)
    _print_samples(console, model.provenance.samples, dict(model.rejected))
    mapped = f" (map: {model.input_map})" if model.input_map != "identity" else ""
    signals = f"{model.input_name}{mapped} -> {model.output_name}, dt {model.dt:g} s"
    made = model.provenance
    console.print(f"Signals  {signals}", highlight=False, markup=False)
    rest = f"output {model.output_level:.5g} at input {model.input_level:.5g}"
    console.print(f"Rest     {rest}", highlight=False)
    source = f"{made.source or 'samples'}, {made.method}, replant {made.version}, {made.date}"
    console.print(f"Made of  {source}", highlight=False, markup=False)
    print_verdict(console, model.verdict)


def print_verdict(console: Any, verdict: Verdict, lead: str = "") -> None:
    """Print a verdict's status in its colour and what to do by it, and its reasons below."""
    from rich.text import Text

    status = Text("Verdict  ").append(verdict.status, f"bold {colour_of(verdict.status)}")
    console.print(status.append(f": {lead}" if lead else ""), highlight=False, soft_wrap=True)
    for reason in verdict.reasons:
        for line in wrapped(reason, console.width - REASON_INDENT):
            console.print(" " * REASON_INDENT + line, highlight=False, markup=False, soft_wrap=True)


def _print_samples(console: Any, samples: int, rejected: Mapping[str, int]) -> None:
    left_out = ", ".join(f"{count} {reason}" for reason, count in rejected.items() if count)
    console.print(f"Samples  {samples:,}" + (f", rejected: {left_out}" if left_out else ""), highlight=False)


def _clock(clock: Clock) -> dict[str, Any]:
    return {
        "irregular": clock.irregular,
        "shortest": model_json.finite(clock.shortest),
        "longest": model_json.finite(clock.longest),
    }


def _irregular(clock: Clock) -> str:
    """Return in words what the intervals of an irregular clock are."""
    gaps = len(clock.gaps)
    said = f"irregular: {clock.shortest:.4g} to {clock.longest:.4g} s between samples, usually {clock.dt:.4g} s"
    return said + (f"; {gaps:,} gap{'s' if gaps > 1 else ''}" if gaps else "")


def _print_model(console: Any, model: Model, truth: TransferFunction | None) -> None:
    for line in fraction(model.transfer_function):
        console.print(line, highlight=False, markup=False)
    console.print()
    console.print(_parameter_table(model, truth))
    console.print()
    console.print(_mode_table(model))
    console.print()
    known = model.uncertainty
    gain = with_std(model.transfer_function.dc_gain, known.dc_gain_std if known else math.nan)
    console.print(f"DC gain  {gain}", highlight=False)


def wrapped(text: str, width: int) -> list[str]:
    """Return text in lines of at most ``width`` characters, without a break between a figure and its unit.

    Examples
    --------
    >>> wrapped("the model fits the output to 83.0 %; a coefficient has moved by 2.6 %", 36)
    ['the model fits the output to 83.0 %;', 'a coefficient has moved by 2.6 %']
    >>> wrapped("a coefficient has moved by 2.6 %", 31)
    ['a coefficient has moved by', '2.6 %']
    """
    glued = re.sub(r"(?<=\d) (?=(?:%|s|h)(?:\W|$))", "\N{NO-BREAK SPACE}", text)
    lines = textwrap.wrap(glued, max(width, 1), break_long_words=False, break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def table(*headings: str) -> Any:
    """Return an empty table whose columns are flush right."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(Text(heading), justify="right")  # as Text: rich would take "[s]" for a style
    return table


def _parameter_table(model: Model, truth: TransferFunction | None) -> Any:
    """Return the table of coefficients, with standard deviations and true values if known."""
    known = model.uncertainty is not None
    headings = ["coefficient", "identified", *(["std"] if known else []), *(["true", "off by"] if truth else [])]
    shown = table(*headings)
    true = true_parameters(truth) if truth else [math.nan] * model.structure.size
    for name, value, std, target in zip(model.structure.names, model.parameters, _stds(model), true, strict=False):
        cells = [name, f"{value:.4g}", *([std_alone(std)] if known else [])]
        if truth:
            cells += [f"{target:.4g}", off_by(value, target)]
        shown.add_row(*cells)
    return shown


def _mode_table(model: Model) -> Any:
    """Return the table of poles: frequency, damping and time constant, with standard deviations if known."""
    shown = table("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    uncertain = model.uncertainty.modes if model.uncertainty else None
    for i, mode in enumerate(model.transfer_function.modes):
        stds = (
            (uncertain[i].frequency_std, uncertain[i].damping_std, uncertain[i].time_constant_std) if uncertain else ()
        )
        figures = (mode.frequency, mode.damping, mode.time_constant)
        cells = [with_std(figure, stds[k] if stds else math.nan) for k, figure in enumerate(figures)]
        pole = f"{mode.pole.real:.4g}" + (f" +- {mode.pole.imag:.4g}j" if mode.pole.imag else "")
        if not mode.pole.imag:
            cells[1] = f"{mode.damping:.3g}"  # of a real pole it is exactly 1 or -1
        shown.add_row(pole, *cells)
    return shown


def fraction(model: TransferFunction) -> list[str]:
    r"""Return G(s) as three lines of text, numerator over denominator.

    Examples
    --------
    >>> print("\n".join(fraction(TransferFunction([2.0], [1.0, 4.0, 3.0]))))
               2
    G(s) = -------------
           s^2 + 4 s + 3
    """
    top, _, bottom = str(TransferFunction(model.num, model.den)).partition(" / ")
    top, bottom = top.strip("()"), bottom.strip("()")
    width = max(len(top), len(bottom))
    dead_time = f" exp(-{model.delay:.4g} s)" if model.delay else ""
    return [
        f"       {top:^{width}}".rstrip(),
        f"G(s) = {'-' * width}{dead_time}",
        f"       {bottom:^{width}}".rstrip(),
    ]


def true_parameters(truth: TransferFunction) -> Sequence[float]:
    """Return the coefficients of a transfer function in the order a_{n-1} .. a_0, b_m .. b_0."""
    return [*truth.den[1:].tolist(), *truth.num.tolist()]


def _stds(model: Model) -> list[float]:
    return [math.nan] * model.structure.size if model.uncertainty is None else model.uncertainty.std.tolist()
