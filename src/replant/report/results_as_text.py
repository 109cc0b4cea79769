"""Results, models, comparisons, structure searches and validations as tables for the terminal, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from replant.fitting import model_json
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fitting.model_json import finite, verdict_object
from replant.fitting.search_result import SearchResult
from replant.fitting.validation import Validation
from replant.model.preprocess import rejected_in_words
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.online.runs.result import Clock, Result
from replant.online.runs.run_log import Contender, best
from replant.plotting.numbers import (
    duration,
    fraction,
    interval,
    of_integrator,
    off_by,
    percent,
    std_alone,
    true_parameters,
    uncertain,
    with_std,
    wrapped,
)
from replant.report.findings import BAD, COLOURS, GOOD, colour_of, findings, without_reasons
from replant.verdict.verdict import Verdict
from replant.verdict.verdict import percent as share

INDENT = 9  # width of a heading; the text after it is indented by this [columns]


def as_json(result: Result, clocks: Sequence[Clock] = ()) -> dict[str, Any]:
    """Return the JSON object of `run` and `fit`: the model's, with the elapsed time and the clock if known.

    ``clocks``: those of several logs.
    """
    found = model_json.as_object(result.model) | {"elapsed_seconds": round(result.elapsed, 3)}
    if every := clocks or ([] if result.clock is None else [result.clock]):
        irregular = [clock for clock in every if clock.irregular]
        shortest, longest = intervals_of(irregular) if irregular else (math.nan, math.nan)
        found["clock"] = {"irregular": bool(irregular), "shortest": finite(shortest), "longest": finite(longest)}
    return found


def intervals_of(irregular: Sequence[Clock]) -> tuple[float, float]:
    """Return the shortest and the longest interval of irregular clocks in s."""
    return min(each.shortest for each in irregular), max(each.longest for each in irregular)


def record_line(samples: int, dt: float, seconds: float, logs: int = 1) -> str:
    """Return the size of a record as text; ``dt`` and ``seconds`` are its sampling time and duration in s."""
    return f"{samples:,} samples{f' of {logs} logs' if logs > 1 else ''}, dt {interval(dt)}, {duration(seconds)}"


def clock_line(clocks: Sequence[Clock]) -> str:
    """Return the intervals and gaps of the irregular ones among the clocks of some logs; empty if there is none."""
    irregular = [clock for clock in clocks if clock.irregular]
    if not irregular:
        return ""
    shortest, longest = intervals_of(irregular)
    count = sum(len(each.gaps) for each in irregular)
    gaps = f"; {count:,} gap{'s' if count > 1 else ''}" if count else ""
    usual = f"usually {irregular[0].dt:.4g} s"
    return f"irregular: {shortest:.4g} to {longest:.4g} s between samples, {usual}{gaps}"


def print_result(
    console: Any, result: Result, *, truth: TransferFunction | None = None, record: str = "", lead: str = "",
    clocks: Sequence[Clock] = (),
) -> None:  # fmt: skip
    """Print G(s), coefficients, poles, fit and verdict; ``clocks``: those of several logs."""
    console.print()
    if result.has_model:
        _print_model(console, result.model, truth)
        _say(console, "Fit", _fits(result.simulation.fit, result.simulation.how, result.one_step))
    else:
        console.print("No model yet: the record gave no estimate.\n", highlight=False)
    _say(console, "Record", record)
    _say(console, "Samples", _samples(result.used, result.rejected))
    _say(console, "Clock", clock_line(clocks or ([] if result.clock is None else [result.clock])))
    print_verdict(console, result.verdict, lead)


def print_kept_model(console: Any, model: Model) -> None:
    """Print a saved model: G(s), coefficients, poles, fit, verdict, and its origin."""
    console.print()
    _print_model(console, model, None)
    _say(console, "Fit", _fits(model.simulated_fit, "simulated", model.one_step_fit))
    _say(console, "Samples", _samples(model.provenance.samples, dict(model.rejected)))
    mapped = f" (map: {model.input_map})" if model.input_map != "identity" else ""
    _say(console, "Signals", f"{model.input_name}{mapped} -> {model.output_name}, dt {model.dt:g} s")
    _say(console, "Rest", f"output {model.output_level:.5g} at input {model.input_level:.5g}")
    _say(console, "Made of", _source(model))
    print_verdict(console, model.verdict)


def print_row(console: Any, model: RowModel, *, record: str = "") -> None:
    """Print each G(s), gains, time constants, coefficients, fit and verdict; without a record also the origin."""
    console.print()
    coefficients, gains = [], []
    for number, name in enumerate(model.input_names):
        each = model.of_input(number)
        console.print(f"From {name} to {model.output_name}", highlight=False, markup=False, style="bold")
        _print_lines(console, fraction(each.transfer_function))
        rows = zip(each.structure.names, each.parameters.tolist(), stds_of(each), strict=True)
        for k, (coefficient, value, std) in enumerate(rows):
            known = [] if std is None else [std_alone(std)]
            coefficients.append([name if k == 0 else "", coefficient, f"{value:.4g}", *known])
        gain, times = gain_and_times(each, with_std)
        gains.append([name, gain, f"{each.structure.delay:.4g}", ", ".join(times)])
    headings = ["input", "coefficient", "identified", *(["std"] if model.uncertainty else [])]
    console.print(table(headings, coefficients))
    console.print()
    console.print(table(("input", "DC gain", "dead time [s]", "time constants [s]"), gains))
    console.print()
    _say(console, "Fit", _fits(model.simulated_fit, "simulated from the inputs alone", model.one_step_fit))
    _say(console, "Record", record)
    _say(console, "Samples", _samples(model.provenance.samples, dict(model.rejected)))
    levels = ", ".join(f"{level:.5g}" for level in model.input_levels.tolist())
    _say(console, "Rest", f"output {model.output_level:.5g} at inputs {levels}")
    _say(console, "Made of", "" if record else _source(model))
    print_verdict(console, model.verdict)


def print_verdict(console: Any, verdict: Verdict, lead: str = "") -> None:
    """Print a verdict's status in its colour with the advice ``lead``, and its reasons below."""
    from rich.text import Text

    said = f"{verdict.status}: {lead}" if lead else verdict.status
    for number, line in enumerate(lines_behind("Verdict", said, console.width)):
        styled = Text(line)
        if not number:
            styled.stylize(f"bold {colour_of(verdict.status)}", INDENT, INDENT + len(verdict.status))
        console.print(styled, highlight=False, soft_wrap=True)
    for reason in verdict.reasons:
        _say(console, "", reason)


def lines_behind(heading: str, text: str, width: int) -> list[str]:
    """Break a text into lines behind its heading, whose place stays free in the later lines."""
    lines = wrapped(text, width - INDENT)
    return [f"{'' if number else heading:{INDENT}}{line}" for number, line in enumerate(lines)]


def _say(console: Any, heading: str, text: str) -> None:
    """Print a text behind its heading; print nothing if the text is empty."""
    for line in lines_behind(heading, text, console.width):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _print_lines(console: Any, lines: Sequence[str]) -> None:
    for line in lines:
        console.print(line, highlight=False, markup=False)
    console.print()


def _fits(simulated: float, how: str, one_step: float) -> str:
    return f"{percent(simulated, ascii_only=True)} {how}, {percent(one_step, ascii_only=True)} one step ahead"


def _samples(samples: int, rejected: Mapping[str, int]) -> str:
    left_out = rejected_in_words(rejected)
    return f"{samples:,}" + (f", rejected: {left_out}" if left_out else "")


def _source(model: Model | RowModel) -> str:
    made = model.provenance
    return f"{made.source or 'samples'}, {made.method}, replant {made.version}, {made.date}"


def _print_model(console: Any, model: Model, truth: TransferFunction | None) -> None:
    _print_lines(console, fraction(model.transfer_function))
    known = model.uncertainty
    std = None if known is None else known.std.tolist()
    console.print(parameter_table(model.structure.names, model.parameters.tolist(), std, truth))
    console.print()
    rows = []
    for mode, (frequency, damping, time) in zip(model.transfer_function.modes, modes_of(model, with_std), strict=True):
        pole = f"{mode.pole.real:.4g}" + (f" +- {mode.pole.imag:.4g}j" if mode.pole.imag else "")
        rows.append([pole, frequency, damping, time])
    console.print(table(POLE, rows))
    console.print()
    gain, gain_std = model.transfer_function.dc_gain, known.dc_gain_std if known else None
    _say(console, "DC gain", with_std(gain, gain_std) + of_integrator(gain, gain_std))


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    left: Collection[int] = (),
    bold: Callable[[Any], bool] = lambda row: False,
    no_wrap: bool = False,
) -> Any:
    """Return a table with right-aligned columns, except those in ``left``; text is not parsed as markup."""
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    for k, heading in enumerate(headings):  # as Text: rich would read "[s]" as markup
        shown.add_column(Text(heading), justify="left" if k in left else "right", no_wrap=no_wrap)
    for row in rows:
        cells = (Text(cell) if isinstance(cell, str) else cell for cell in row)
        shown.add_row(*cells, style="bold" if bold(row) else None)
    return shown


def parameter_table(
    names: Sequence[str],
    values: Sequence[float],
    std: Sequence[float] | None,
    truth: TransferFunction | None,
    heading: str = "identified",
    digits: int = 4,
) -> Any:
    """Return the table of coefficients, with standard deviations, and true values if the plant has this structure."""
    columns = {"coefficient": list(names), heading: [f"{value:.{digits}g}" for value in values]}
    if std is not None:
        columns["std"] = [*map(std_alone, std)]
    sizes = [sum(name.startswith(letter) for name in names) for letter in "ab"]
    if truth is not None and sizes == [truth.den.size - 1, truth.num.size]:
        true = true_parameters(truth)
        columns["true"] = [f"{value:.{digits}g}" for value in true]
        columns["off by"] = [*map(off_by, values, true)]
    return table(list(columns), zip_longest(*columns.values(), fillvalue=""))


POLE = ("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
Write = Callable[[float, float | None], str]  # formats a figure with its standard deviation, for a page or a terminal


def stds_of(model: Model) -> list[float | None]:
    """Return the standard deviation of each coefficient; None if it is unknown."""
    return [None] * model.parameters.size if model.uncertainty is None else [*model.uncertainty.std.tolist()]


def modes_of(model: Model, write: Write) -> list[list[str]]:
    """Return frequency, damping and time constant of each pole."""
    modes = model.transfer_function.modes
    stds: Sequence[tuple[float | None, ...]] = [(None, None, None)] * len(modes)
    if model.uncertainty is not None:
        stds = [
            # a real pole's damping is exactly 1 or -1
            (each.frequency_std, each.damping_std if each.mode.pole.imag else None, each.time_constant_std)
            for each in model.uncertainty.modes
        ]
    return [
        [*map(write, (mode.frequency, mode.damping, mode.time_constant), std)]
        for mode, std in zip(modes, stds, strict=True)
    ]


def gain_and_times(model: Model, write: Write) -> tuple[str, list[str]]:
    """Return the DC gain, and the time constant of each pole."""
    known = model.uncertainty
    gain = write(float(model.transfer_function.dc_gain), None if known is None else known.dc_gain_std)
    return gain, [time_constant for *_, time_constant in modes_of(model, write)]


OUTCOME = ("verdict", "simulated", "one step", "time")
VERDICT = 1 + OUTCOME.index("verdict")  # number of its column; the method's is 0
GAP = 2  # spaces between columns of the terminal's table [columns]


def cells_of(entry: Contender, size: int) -> list[str]:
    """Return the row of a method: verdict, fits, time, and the ``size`` coefficients, with their std if known."""
    result = entry.result
    if result is None:
        return ["no model", *["–"] * (len(OUTCOME) - 1 + size)]
    return [
        without_reasons(result.verdict.status, excited=result.verdict.excited),
        percent(result.simulation.fit),
        percent(result.one_step),
        f"{result.elapsed:.2f} s",
        *map(uncertain, result.parameters.tolist(), stds_of(result.model)),
    ]


def gravity_of(entry: Contender, samples: int) -> str:
    """Return the gravity of the gravest finding on a method's model, see `Finding.gravity`."""
    return BAD if entry.result is None else findings(entry.result, samples)[0].gravity


def print_comparison(console: Any, contenders: Sequence[Contender], structure: Structure, samples: int) -> None:
    """Print a row for each method, the best simulated fit in bold."""
    from rich.text import Text

    headings = ["method", *OUTCOME, *structure.names]
    gravities = [gravity_of(entry, samples) for entry in contenders]
    cells = zip(*(cells_of(entry, structure.size) for entry in contenders), strict=True)
    columns: list[list[Any]] = [[entry.name for entry in contenders], *map(_aligned, cells)]
    columns[VERDICT] = [
        Text(verdict, f"bold {COLOURS[gravity]}") for verdict, gravity in zip(columns[VERDICT], gravities, strict=True)
    ]
    print_blocks(console, headings, columns, first.name if (first := best(contenders)) else None)
    console.print()
    for entry, gravity in zip(contenders, gravities, strict=True):
        if gravity != GOOD:
            why = entry.problem if entry.result is None else "; ".join(entry.result.verdict.reasons[:1])
            console.print(f"{entry.name}: {why}", style="dim", highlight=False, markup=False)


def print_blocks(
    console: Any, headings: Sequence[str], columns: Sequence[Sequence[Any]], top: str | None, **how: int
) -> None:
    """Print the columns of a comparison, the row of ``top`` in bold; a narrow terminal gets several `_blocks`."""
    from rich.cells import cell_len

    widths = [max(map(cell_len, map(str, [heading, *cells]))) for heading, cells in zip(headings, columns, strict=True)]
    for number, chosen in enumerate(_blocks(widths, console.width, **how)):
        if number:
            console.print()
        rows = zip(*(columns[i] for i in chosen), strict=True)
        look: Any = {"left": [k for k, i in enumerate(chosen) if i in (0, VERDICT)], "no_wrap": True}
        console.print(table([headings[i] for i in chosen], rows, bold=lambda row: row[0] == top, **look))


def _aligned(cells: Sequence[str]) -> list[str]:
    """Return the cells of a right-aligned column with aligned plus-minus signs."""
    parts = [cell.partition(" ± ") for cell in cells]
    width = max(len(std) for _, _, std in parts)
    if width == 0:
        return list(cells)
    return [value + (f" +- {std:<{width}}" if sign else " " * (width + 4)) for value, sign, std in parts]


def _blocks(widths: Sequence[int], room: int, first: int = len(OUTCOME) + 1) -> list[list[int]]:
    """Return the columns of each block: all in one if they fit; else the ``first`` ones, then as many as fit."""
    if sum(widths) + GAP * (len(widths) - 1) <= room:
        return [list(range(len(widths)))]
    blocks = [[0]]
    for i in range(1, len(widths)):
        is_full = sum(widths[k] + GAP for k in [*blocks[-1], i]) - GAP > room
        if (is_full or i == first) and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1].append(i)
    return blocks


HEADINGS = ("poles", "zeros", "dead time", "fit", "least known coefficient", "evidence", "")
CHOSEN = "chosen"


def rows_of(found: SearchResult) -> list[tuple[str, ...]]:
    """Return a row for each likely structure, with its evidence relative to the likeliest; the chosen one is marked."""
    rows: list[tuple[str, ...]] = []
    for candidate in found.likely:
        size = (candidate.of_inputs("poles"), candidate.of_inputs("zeros"), f"{candidate.of_inputs('delay')} s")
        evidence = 0.5 * (found.likely[0].criterion - candidate.criterion)
        known = f"± {share(candidate.uncertainty)}" if candidate.uncertainty < 1.0 else "unknown"
        figures = (percent(candidate.fit), known, f"{evidence:.1f}")
        rows.append((*size, *figures, CHOSEN if candidate is found.chosen else ""))
    return rows


def candidates_as_json(found: SearchResult) -> list[dict[str, Any]]:
    """Return a JSON object for each structure; values that are not finite become null."""
    objects = []
    for candidate in found.candidates:
        orders: dict[str, Any] = _orders(candidate.structures[0])
        if isinstance(candidate.structure, tuple):
            orders = {name: [getattr(each, name) for each in candidate.structure] for name in orders}
        figures = {name: finite(getattr(candidate, name)) for name in ("fit", "uncertainty", "likelihood", "criterion")}
        objects.append({**orders, **figures, "chosen": candidate is found.chosen})
    return objects


def weights_in_words(result: Result) -> str:
    """Return a line on the weights of structures that learned in parallel, and one on which was used from when."""

    def in_words(structure: Structure) -> str:
        delay = f" {structure.delay:g} s" if structure.delay else ""
        return f"poles {structure.poles} zeros {structure.zeros}{delay}"

    weights = ", ".join(f"{in_words(each)} {weight:.3f}" for each, weight in result.weights)
    served = "; ".join(f"from sample {each.taken:,} on {in_words(each.structure)}" for each in result.leads)
    return f"Weights: {weights}\nServed: {served or 'none'}"


def weights_as_json(result: Result) -> dict[str, Any]:
    """Return the JSON object of structures that learned in parallel."""
    return {
        "structures": [_orders(structure) | {"weight": weight} for structure, weight in result.weights],
        "leads": [
            {"taken": lead.taken, **_orders(lead.structure), "weight": lead.weight, "status": lead.status}
            for lead in result.leads
        ],
    }


def _orders(structure: Structure) -> dict[str, Any]:
    return {"poles": structure.poles, "zeros": structure.zeros, "delay": structure.delay}


def print_candidates(console: Any, found: SearchResult) -> None:
    """Print the table of candidates, and the dead time if it lies between points of the grid."""
    console.print(table(HEADINGS, rows_of(found), bold=lambda row: row[-1] == CHOSEN))
    if found.rest:
        console.print(found.rest, highlight=False)
    if found.likely[0] is not found.chosen:
        console.print("Orders are compared with the dead time found between the points of the grid", highlight=False)
    if found.between:
        delays = ", ".join(f"{delay:.4g}" for delay in found.delays)
        console.print(f"\nThe dead time between the points of the grid: {delays} s", highlight=False)


def validation_as_json(validation: Validation, source: str) -> dict[str, Any]:
    """Return the JSON object of a validation; unknown figures become null."""
    (auto, cross), by_frequency = validation.outside, validation.by_frequency
    return {
        "source": source,
        "fit": {"one_step": finite(validation.one_step), "simulated": finite(validation.fit)},
        "offset": finite(validation.offset),
        "samples": validation.samples,
        "residual": {"outside_auto": finite(auto), "outside_cross": finite(cross)},
        "worst_error": None if by_frequency is None else finite(by_frequency.worst),
        "verdict": verdict_object(validation.verdict),
    }


def print_validation(console: Any, validation: Validation, source: str) -> None:
    """Print a validation: fits, offset, tests of the residual, and the verdict."""
    console.print(f"\nOn {source}", highlight=False, markup=False, style="bold")
    _say(console, "Fit", _fits(validation.fit, validation.how, validation.one_step))
    if math.isfinite(validation.offset):
        _say(console, "Offset", f"{validation.offset:+.4g} beside the model's working point")
    auto, cross = validation.outside
    if math.isfinite(auto):
        outside = f"{100 * auto:.0f} % with itself, {100 * cross:.0f} % with the input"
        usual = "on average 5 % for a correct model"
        _say(console, "Residual", f"correlated beyond the 95 % limit: {outside} ({usual})")
    if validation.by_frequency is not None:
        worst = validation.by_frequency.worst
        _say(console, "Error", f"{f'up to {share(worst)} of |G|' if worst else 'none beyond chance'}, by frequency")
    left_out = {"outlier": validation.outliers, "stuck": validation.stuck}
    _say(console, "Samples", _samples(validation.samples, left_out))
    print_verdict(console, validation.verdict)
