"""A result, a kept model and a model of several inputs as tables for the terminal; a result as an object of JSON."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from replant.fitting import model_json
from replant.fitting.model import Model
from replant.fitting.row_model import RowModel
from replant.model.transfer_function import TransferFunction
from replant.online.runs.result import Clock, Result
from replant.plotting.numbers import duration, interval, off_by, percent, std_alone, with_std
from replant.report.findings import colour_of
from replant.verdict.verdict import Verdict

INDENT = 9  # indent of what stands behind a heading [columns]


def as_json(result: Result) -> dict[str, Any]:
    """Return the JSON object of `run` and `fit`: that of the model, how long it took, and an irregular clock."""
    found = model_json.as_object(result.model) | {"elapsed_seconds": round(result.elapsed, 3)}
    if result.clock is not None:
        shortest, longest = map(model_json.finite, (result.clock.shortest, result.clock.longest))
        found["clock"] = {"irregular": result.clock.irregular, "shortest": shortest, "longest": longest}
    return found


def record_line(samples: int, dt: float, seconds: float) -> str:
    """Return the size of a record in words: number of samples, sampling time and length, both in s."""
    return f"{samples:,} samples, dt {interval(dt)}, {duration(seconds)}"


def print_result(
    console: Any, result: Result, *, truth: TransferFunction | None = None, record: str = "", lead: str = ""
) -> None:
    """Print G(s), coefficients, poles, fit and verdict."""
    console.print()
    if result.parameters.any():
        _print_model(console, result.model, truth)
        _say(console, "Fit", _fits(result.simulation.fit, result.simulation.how, result.one_step))
    else:
        console.print("No model yet: the record gave no estimate.\n", highlight=False)
    if record:
        _say(console, "Record", record)
    _say(console, "Samples", _samples(result.samples, result.rejected))
    if result.clock is not None and result.clock.irregular:
        _say(console, "Clock", _irregular(result.clock))
    print_verdict(console, result.verdict, lead)


def print_kept_model(console: Any, model: Model) -> None:
    """Print a model that was kept: G(s), coefficients, poles, fit, verdict, and where it comes from."""
    console.print()
    _print_model(console, model, None)
    _say(console, "Fit", _fits(model.simulated_fit, "simulated", model.one_step_fit))
    _say(console, "Samples", _samples(model.provenance.samples, dict(model.rejected)))
    mapped = f" (map: {model.input_map})" if model.input_map != "identity" else ""
    _say(console, "Signals", f"{model.input_name}{mapped} -> {model.output_name}, dt {model.dt:g} s")
    _say(console, "Rest", f"output {model.output_level:.5g} at input {model.input_level:.5g}")
    _say(console, "Made of", _source(model))
    print_verdict(console, model.verdict)


def print_row(console: Any, model: RowModel, *, record: str = "", lead: str = "") -> None:
    """Print each G(s) with its gain and time constants, the coefficients, fit and verdict.

    Of a kept model, without a line on its record, also where it comes from.
    """
    console.print()
    for name, g in zip(model.input_names, model.transfer_functions, strict=True):
        console.print(f"From {name} to {model.output_name}", highlight=False, markup=False, style="bold")
        _print_lines(console, fraction(g))
    for shown in (_row_coefficients(model), _row_gains(model)):
        console.print(shown)
        console.print()
    _say(console, "Fit", _fits(model.simulated_fit, "simulated from the inputs alone", model.one_step_fit))
    if record:
        _say(console, "Record", record)
    _say(console, "Samples", _samples(model.provenance.samples, dict(model.rejected)))
    levels = ", ".join(f"{level:.5g}" for level in model.input_levels.tolist())
    _say(console, "Rest", f"output {model.output_level:.5g} at inputs {levels}")
    if not record:
        _say(console, "Made of", _source(model))
    print_verdict(console, model.verdict, lead)


def print_verdict(console: Any, verdict: Verdict, lead: str = "") -> None:
    """Print a verdict's status in its colour and what to do by it, and its reasons below."""
    from rich.text import Text

    status = Text("Verdict  ").append(verdict.status, f"bold {colour_of(verdict.status)}")
    console.print(status.append(f": {lead}" if lead else ""), highlight=False, soft_wrap=True)
    for reason in verdict.reasons:
        for line in wrapped(reason, console.width - INDENT):
            console.print(" " * INDENT + line, highlight=False, markup=False, soft_wrap=True)


def _say(console: Any, heading: str, text: str) -> None:
    console.print(f"{heading:{INDENT}}{text}", highlight=False, markup=False)


def _print_lines(console: Any, lines: Sequence[str]) -> None:
    for line in lines:
        console.print(line, highlight=False, markup=False)
    console.print()


def _fits(simulated: float, how: str, one_step: float) -> str:
    return f"{percent(simulated, ascii_only=True)} {how}, {percent(one_step, ascii_only=True)} one step ahead"


def _samples(samples: int, rejected: Mapping[str, int]) -> str:
    left_out = ", ".join(f"{count} {reason}" for reason, count in rejected.items() if count)
    return f"{samples:,}" + (f", rejected: {left_out}" if left_out else "")


def _source(model: Model | RowModel) -> str:
    made = model.provenance
    return f"{made.source or 'samples'}, {made.method}, replant {made.version}, {made.date}"


def _irregular(clock: Clock) -> str:
    """Return in words what the intervals of an irregular clock are."""
    gaps = len(clock.gaps)
    said = f"irregular: {clock.shortest:.4g} to {clock.longest:.4g} s between samples, usually {clock.dt:.4g} s"
    return said + (f"; {gaps:,} gap{'s' if gaps > 1 else ''}" if gaps else "")


def _print_model(console: Any, model: Model, truth: TransferFunction | None) -> None:
    _print_lines(console, fraction(model.transfer_function))
    console.print(_parameter_table(model, truth))
    console.print()
    console.print(_mode_table(model))
    console.print()
    known = model.uncertainty
    _say(console, "DC gain", with_std(model.transfer_function.dc_gain, known.dc_gain_std if known else None))


def wrapped(text: str, width: int) -> list[str]:
    """Return text in lines of at most ``width`` characters, without a break between a figure and its unit."""
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
    columns = {"coefficient": list(model.structure.names)}
    columns["identified"] = [f"{value:.4g}" for value in model.parameters]
    if model.uncertainty is not None:
        columns["std"] = [*map(std_alone, model.uncertainty.std.tolist())]
    if truth is not None:
        true = true_parameters(truth)
        columns["true"] = [f"{value:.4g}" for value in true]
        columns["off by"] = [*map(off_by, model.parameters.tolist(), true)]
    shown = table(*columns)
    for cells in zip(*columns.values(), strict=False):
        shown.add_row(*cells)
    return shown


def _mode_table(model: Model) -> Any:
    """Return the table of poles: frequency, damping and time constant, with standard deviations if known."""
    shown = table("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    uncertain = model.uncertainty.modes if model.uncertainty else None
    for i, mode in enumerate(model.transfer_function.modes):
        known = uncertain and uncertain[i]
        stds = (known.frequency_std, known.damping_std, known.time_constant_std) if known else (None, None, None)
        cells = [*map(with_std, (mode.frequency, mode.damping, mode.time_constant), stds)]
        pole = f"{mode.pole.real:.4g}" + (f" +- {mode.pole.imag:.4g}j" if mode.pole.imag else "")
        if not mode.pole.imag:
            cells[1] = f"{mode.damping:.3g}"  # of a real pole it is exactly 1 or -1
        shown.add_row(pole, *cells)
    return shown


def fraction(model: TransferFunction) -> list[str]:
    r"""Return G(s) as three lines of text, numerator over denominator."""
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


def _row_coefficients(model: RowModel) -> Any:
    """Return the table of coefficients with their standard deviations."""
    known = model.uncertainty
    shown = table("input", "coefficient", "identified", *(["std"] if known else []))
    for number, (name, structure) in enumerate(zip(model.input_names, model.structures, strict=True)):
        values = model.parameters[model.places[number]].tolist()
        stds = known[number].std.tolist() if known else [math.nan] * len(values)
        for k, (coefficient, value, std) in enumerate(zip(structure.names, values, stds, strict=True)):
            cells = [_plain(name) if k == 0 else "", coefficient, f"{value:.4g}", *([std_alone(std)] if known else [])]
            shown.add_row(*cells)
    return shown


def _row_gains(model: RowModel) -> Any:
    """Return the table of DC gain, dead time and time constants from each input."""
    shown = table("input", "DC gain", "dead time [s]", "time constants [s]")
    known = model.uncertainty
    for number, (name, g) in enumerate(zip(model.input_names, model.transfer_functions, strict=True)):
        gain = with_std(g.dc_gain, known[number].dc_gain_std if known else None)
        modes = known[number].modes if known else [None] * len(g.modes)
        constants = (
            with_std(mode.time_constant, None if std is None else std.time_constant_std)
            for mode, std in zip(g.modes, modes, strict=True)
        )
        shown.add_row(_plain(name), gain, f"{g.delay:.4g}", ", ".join(constants))
    return shown


def _plain(text: str) -> Any:
    """Return a text as rich prints it to the letter: a name may have a unit in brackets."""
    from rich.text import Text

    return Text(text)
