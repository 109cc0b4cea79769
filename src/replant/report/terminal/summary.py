"""A result as the JSON object of the command line, and as tables for the terminal."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from typing import Any

from replant.model.transfer_function import TransferFunction
from replant.report.number_format import off_by, percent, with_std
from replant.runs.result import Result

REASON_INDENT = 9
"""Indent of the reasons, below the figures [columns]."""


def as_json(result: Result) -> dict[str, Any]:
    """Return the JSON object of `run` and `fit`; figures that are not finite become null."""
    model = result.transfer_function
    return {
        "num": model.num.tolist(),
        "den": model.den.tolist(),
        "delay": model.delay,
        "parameters": {
            name: {"value": finite(value), "std": finite(std)}
            for name, value, std in zip(result.structure.names, result.parameters.tolist(), _stds(result), strict=True)
        },
        "poles": [_pole(pole) for pole in model.poles.tolist()],
        "zeros": [{"real": zero.real, "imag": zero.imag} for zero in model.zeros.tolist()],
        "dc_gain": finite(model.dc_gain),
        "fit": {"one_step": finite(result.one_step), "simulated": finite(result.simulation.fit)},
        "samples": result.samples,
        "rejected": result.rejected,
        "verdict": {
            "status": result.verdict.status,
            "excited": result.verdict.excited,
            "reasons": list(result.verdict.reasons),
        },
        "elapsed_seconds": round(result.elapsed, 3),
    }


def print_result(console: Any, result: Result, *, truth: TransferFunction | None = None) -> None:
    """Print G(s), coefficients, poles, fit and verdict.

    Parameters
    ----------
    console : rich.console.Console
    result : Result
    truth : TransferFunction, optional
        The true model, of a simulated plant.
    """
    console.print()
    if result.parameters.any():
        _print_model(console, result, truth)
    else:
        console.print("No model yet: the record gave no estimate.\n", highlight=False)
    rejected = ", ".join(f"{count} {reason}" for reason, count in result.rejected.items() if count)
    samples = f"{result.samples:,}" + (f", rejected: {rejected}" if rejected else "")
    console.print(f"Samples  {samples}", highlight=False)
    colour = "green" if result.verdict.status == "trusted" else "yellow" if _mild(result) else "red"
    console.print(f"Verdict  [bold {colour}]{result.verdict.status}[/]", highlight=False)
    for reason in result.verdict.reasons:
        for line in wrapped(reason, console.width - REASON_INDENT):
            console.print(" " * REASON_INDENT + line, highlight=False, markup=False, soft_wrap=True)


def _print_model(console: Any, result: Result, truth: TransferFunction | None) -> None:
    for line in fraction(result.transfer_function):
        console.print(line, highlight=False, markup=False)
    console.print()
    console.print(_parameter_table(result, truth))
    console.print()
    console.print(_mode_table(result))
    console.print()
    gain = with_std(result.transfer_function.dc_gain, _dc_gain_std(result))
    console.print(f"DC gain  {gain}", highlight=False)
    simulated, one_step = (percent(fit, ascii_only=True) for fit in (result.simulation.fit, result.one_step))
    console.print(f"Fit      {simulated} {result.simulation.how}, {one_step} one step ahead", highlight=False)


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


def _table(*headings: str) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(Text(heading), justify="right")  # as Text: rich would take "[s]" for a style
    return table


def _parameter_table(result: Result, truth: TransferFunction | None) -> Any:
    """Return the table of coefficients, with standard deviations and true values if known."""
    known = result.uncertainty is not None
    headings = ["coefficient", "identified", *(["std"] if known else []), *(["true", "off by"] if truth else [])]
    table = _table(*headings)
    true = true_parameters(truth) if truth else [math.nan] * result.structure.size
    for name, value, std, target in zip(result.structure.names, result.parameters, _stds(result), true, strict=False):
        cells = [name, f"{value:.4g}", *([f"{std:.2g}"] if known else [])]
        if truth:
            cells += [f"{target:.4g}", off_by(value, target)]
        table.add_row(*cells)
    return table


def _mode_table(result: Result) -> Any:
    """Return the table of poles: frequency, damping and time constant, with standard deviations if known."""
    table = _table("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    uncertain = result.uncertainty.modes if result.uncertainty else None
    for i, mode in enumerate(result.transfer_function.modes):
        stds = (
            (uncertain[i].frequency_std, uncertain[i].damping_std, uncertain[i].time_constant_std) if uncertain else ()
        )
        figures = (mode.frequency, mode.damping, mode.time_constant)
        shown = [with_std(figure, stds[k] if stds else math.nan) for k, figure in enumerate(figures)]
        pole = f"{mode.pole.real:.4g}" + (f" +- {mode.pole.imag:.4g}j" if mode.pole.imag else "")
        if not mode.pole.imag:
            shown[1] = f"{mode.damping:.3g}"  # of a real pole it is exactly 1 or -1
        table.add_row(pole, *shown)
    return table


def _dc_gain_std(result: Result) -> float:
    return result.uncertainty.dc_gain_std if result.uncertainty else math.nan


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


def _pole(pole: complex) -> dict[str, Any]:
    magnitude = abs(pole)
    return {
        "real": pole.real,
        "imag": pole.imag,
        "frequency_hz": magnitude / (2 * math.pi),
        "damping": -pole.real / magnitude if magnitude else None,
        "time_constant": -1 / pole.real if pole.real else None,
    }


def _stds(result: Result) -> list[float]:
    return [math.nan] * result.structure.size if result.uncertainty is None else result.uncertainty.std.tolist()


def finite(value: float) -> float | None:
    """Return a figure for JSON: None where it is not finite."""
    return value if math.isfinite(value) else None


def _mild(result: Result) -> bool:
    return result.verdict.status == "converging"
