"""A model of several inputs as tables for the terminal."""

from __future__ import annotations

import math
from typing import Any

from replant.identified.row_model import RowModel
from replant.plotting.numbers import percent, std_alone, with_std
from replant.report.terminal import fraction, print_verdict, table


def print_row(console: Any, model: RowModel, *, record: str = "", lead: str = "") -> None:
    """Print each G(s) with its gain and time constants, the coefficients, fit and verdict.

    Of a kept model, without a line on its record, also where it comes from.
    """
    console.print()
    for name, g in zip(model.input_names, model.transfer_functions, strict=True):
        console.print(f"From {name} to {model.output_name}", highlight=False, markup=False, style="bold")
        for line in fraction(g):
            console.print(line, highlight=False, markup=False)
        console.print()
    console.print(_coefficients(model))
    console.print()
    console.print(_gains(model))
    console.print()
    simulated, one_step = (percent(fit, ascii_only=True) for fit in (model.simulated_fit, model.one_step_fit))
    console.print(f"Fit      {simulated} simulated from the inputs alone, {one_step} one step ahead", highlight=False)
    if record:
        console.print(f"Record   {record}", highlight=False)
    console.print(f"Samples  {model.provenance.samples:,}", highlight=False)
    levels = ", ".join(f"{level:.5g}" for level in model.input_levels.tolist())
    console.print(f"Rest     output {model.output_level:.5g} at inputs {levels}", highlight=False)
    if not record:
        made = model.provenance
        source = f"{made.source or 'samples'}, {made.method}, replant {made.version}, {made.date}"
        console.print(f"Made of  {source}", highlight=False, markup=False)
    print_verdict(console, model.verdict, lead)


def _coefficients(model: RowModel) -> Any:
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


def _gains(model: RowModel) -> Any:
    """Return the table of DC gain, dead time and time constants from each input."""
    shown = table("input", "DC gain", "dead time [s]", "time constants [s]")
    known = model.uncertainty
    for number, (name, g) in enumerate(zip(model.input_names, model.transfer_functions, strict=True)):
        gain = with_std(g.dc_gain, known[number].dc_gain_std if known else math.nan)
        modes = known[number].modes if known else [None] * len(g.modes)
        constants = (
            with_std(mode.time_constant, math.nan if std is None else std.time_constant_std)
            for mode, std in zip(g.modes, modes, strict=True)
        )
        shown.add_row(_plain(name), gain, f"{g.delay:.4g}", ", ".join(constants))
    return shown


def _plain(text: str) -> Any:
    """Return a text as rich prints it to the letter: a name may have a unit in brackets."""
    from rich.text import Text

    return Text(text)
