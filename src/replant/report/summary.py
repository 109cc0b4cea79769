"""A result in words and numbers: the JSON object of the command line, and the table that a person reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from replant.runs import Result
from replant.transfer_function import Mode, TransferFunction
from replant.uncertainty import Uncertainty


def as_json(result: Result) -> dict[str, Any]:
    """Return the JSON object of `run` and `fit`; figures that are not finite become null."""
    model = result.transfer_function
    return {
        "num": model.num.tolist(),
        "den": model.den.tolist(),
        "delay": model.delay,
        "parameters": {
            name: {"value": _finite(value), "std": std}
            for name, value, std in zip(result.structure.names, result.parameters.tolist(), _stds(result), strict=True)
        },
        "poles": [_pole(pole) for pole in model.poles.tolist()],
        "zeros": [{"real": zero.real, "imag": zero.imag} for zero in model.zeros.tolist()],
        "dc_gain": _finite(model.dc_gain),
        "fit": {"one_step": _finite(result.one_step), "simulated": _finite(result.simulation.fit)},
        "samples": result.samples,
        "rejected": result.rejected,
        "verdict": {"status": result.verdict.status, "reasons": list(result.verdict.reasons)},
        "elapsed_seconds": round(result.elapsed, 3),
    }


def print_result(console: Any, result: Result, *, truth: TransferFunction | None = None) -> None:
    """Print what a control engineer wants to see first: G(s), poles, fit, verdict."""
    from rich.table import Table
    from rich.text import Text

    model = result.transfer_function
    console.print()
    for line in fraction(model):
        console.print(line, highlight=False, markup=False)
    if truth is not None:
        console.print(_parameter_table(result, truth))
    table = Table(box=None, pad_edge=False, title="Poles", title_justify="left", title_style="bold")
    for heading in ("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]"):
        table.add_column(Text(heading), justify="right")  # as Text: rich would take "[s]" for a style
    for mode in model.modes:
        table.add_row(*_mode_cells(mode))
    console.print(table)
    console.print(f"DC gain        {model.dc_gain:.4g}", highlight=False)
    console.print(
        f"Fit            {_percent(result.simulation.fit)} simulated from the input alone, "
        f"{_percent(result.one_step)} one step ahead",
        highlight=False,
    )
    rejected = ", ".join(f"{count} {reason}" for reason, count in result.rejected.items() if count)
    console.print(
        f"Samples        {result.samples:,}" + (f", rejected: {rejected}" if rejected else ""), highlight=False
    )
    colour = "green" if result.verdict.status == "trusted" else "yellow" if _mild(result) else "red"
    console.print(f"Verdict        [bold {colour}]{result.verdict.status}[/]: {'; '.join(result.verdict.reasons)}")


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


def _parameter_table(result: Result, truth: TransferFunction) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title="Parameters", title_justify="left", title_style="bold")
    for heading in ("", "identified", "true", "off by"):
        table.add_column(heading, justify="right")
    for name, value, true in zip(result.structure.names, result.parameters, true_parameters(truth), strict=False):
        table.add_row(name, f"{value:.4g}", f"{true:.4g}", f"{100 * (value / true - 1):+.2f} %")
    return table


def true_parameters(truth: TransferFunction) -> Sequence[float]:
    """Return the coefficients of a transfer function in the order a_{n-1} .. a_0, b_m .. b_0."""
    return [*truth.den[1:].tolist(), *truth.num.tolist()]


def _mode_cells(mode: Mode) -> tuple[str, str, str, str]:
    pole = f"{mode.pole.real:.4g}" + (f" +- {mode.pole.imag:.4g}j" if mode.pole.imag else "")
    return pole, f"{mode.frequency:.4g}", f"{mode.damping:.3g}", f"{mode.time_constant:.4g}"


def _pole(pole: complex) -> dict[str, Any]:
    magnitude = abs(pole)
    return {
        "real": pole.real,
        "imag": pole.imag,
        "frequency_hz": magnitude / (2 * math.pi),
        "damping": -pole.real / magnitude if magnitude else None,
        "time_constant": -1 / pole.real if pole.real else None,
    }


def _stds(result: Result) -> list[float | None]:
    """Return the standard deviation of each parameter, None where it is not known."""
    if result.covariance is None:
        return [None] * result.structure.size
    known = Uncertainty(result.structure, result.parameters, result.covariance)
    return [_finite(std) for std in known.std.tolist()]


def _percent(value: float) -> str:
    return f"{value:.1f} %" if math.isfinite(value) else "no figure"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mild(result: Result) -> bool:
    return result.verdict.status == "converging"
