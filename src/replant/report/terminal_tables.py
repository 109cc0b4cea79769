"""Tables for the terminal: methods compared, structures tried, logs that a model was validated on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from replant.fitting.model_json import finite, verdict_object
from replant.fitting.search_result import Candidate, SearchResult
from replant.fitting.validation import Validation
from replant.model.structure import Structure
from replant.online.runs.result import Result
from replant.online.runs.run_log import Contender, best
from replant.plotting.numbers import percent, uncertain
from replant.report.findings import BAD, COLOURS, GOOD, findings, without_reasons
from replant.report.terminal import as_json as result_as_json
from replant.report.terminal import print_verdict
from replant.verdict.verdict import percent as share

OUTCOME = ("verdict", "simulated", "one step", "time")
VERDICT = 1 + OUTCOME.index("verdict")  # its column, behind the method's
GAP = 2  # spaces between columns of the terminal's table [columns]


def comparison_as_json(contenders: Sequence[Contender]) -> dict[str, Any]:
    """Return the JSON object of `run` by method; ``{"problem": reason}`` for a method that found no model."""
    return {
        entry.name: {"problem": entry.problem} if entry.result is None else result_as_json(entry.result)
        for entry in contenders
    }


def cells_of(entry: Contender, size: int) -> list[str]:
    """Return the row of a method: verdict, fits, time, and the ``size`` coefficients, with their std if known."""
    result = entry.result
    if result is None:
        return ["no model", *["–"] * (len(OUTCOME) - 1 + size)]
    known = result.uncertainty
    stds: Sequence[float | None] = [None] * size if known is None else known.std.tolist()
    return [
        without_reasons(result.verdict.status, excited=result.verdict.excited),
        percent(result.simulation.fit),
        percent(result.one_step),
        f"{result.elapsed:.2f} s",
        *(uncertain(value, std) for value, std in zip(result.parameters.tolist(), stds, strict=True)),
    ]


def gravity_of(entry: Contender, samples: int) -> str:
    """Return the gravity of the gravest finding about a method's model, see `Finding.gravity`."""
    return BAD if entry.result is None else findings(entry.result, samples)[0].gravity


def print_comparison(console: Any, contenders: Sequence[Contender], structure: Structure, samples: int) -> None:
    """Print a table with a row for each method, that of the best simulated fit in bold.

    On a narrow terminal the columns are printed in several blocks.
    """
    from rich.cells import cell_len

    headings = ["method", *OUTCOME, *structure.names]
    columns = [[entry.name for entry in contenders]]
    columns += [
        _aligned(column) for column in zip(*(cells_of(entry, structure.size) for entry in contenders), strict=True)
    ]
    widths = [max(map(cell_len, [heading, *cells])) for heading, cells in zip(headings, columns, strict=True)]
    for chosen in _blocks(widths, console.width):
        console.print(_terminal_table(headings, columns, chosen, contenders, samples))
        console.print()
    for entry in contenders:
        if gravity_of(entry, samples) != GOOD:
            why = entry.problem if entry.result is None else "; ".join(entry.result.verdict.reasons[:1])
            console.print(f"{entry.name}: {why}", style="dim", highlight=False, markup=False)


def _aligned(cells: Sequence[str]) -> list[str]:
    """Return the cells of a right-aligned column with their plus-minus signs below each other."""
    parts = [cell.partition(" ± ") for cell in cells]
    width = max(len(std) for _, _, std in parts)
    if width == 0:
        return list(cells)
    return [value + (f" +- {std:<{width}}" if sign else " " * (width + 4)) for value, sign, std in parts]


def _blocks(widths: Sequence[int], room: int) -> list[list[int]]:
    """Return the columns of each block: all in one if they fit, else the outcome first, then as many as fit."""
    if sum(widths) + GAP * (len(widths) - 1) <= room:
        return [list(range(len(widths)))]
    blocks = [list(range(len(OUTCOME) + 1)), [0]]
    for i in range(len(OUTCOME) + 1, len(widths)):
        if sum(widths[k] + GAP for k in [*blocks[-1], i]) - GAP > room and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1].append(i)
    return blocks


def _terminal_table(
    headings: Sequence[str],
    columns: Sequence[Sequence[str]],
    chosen: Sequence[int],
    contenders: Sequence[Contender],
    samples: int,
) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    first = best(contenders)
    for i in chosen:
        table.add_column(headings[i], justify="left" if i in (0, VERDICT) else "right", no_wrap=True)
    for k, entry in enumerate(contenders):
        colour = COLOURS[gravity_of(entry, samples)]
        shown = [Text(columns[i][k], f"bold {colour}" if i == VERDICT else "") for i in chosen]
        table.add_row(*shown, style="bold" if entry is first else None)
    return table


HEADINGS = ("poles", "zeros", "dead time", "fit", "least known coefficient", "evidence", "")
CHOSEN = "chosen"


def rows_of(found: SearchResult) -> list[tuple[str, ...]]:
    """Return a row for each structure worth reading, its evidence beside the most; the chosen one is marked."""
    rows: list[tuple[str, ...]] = []
    for candidate in found.likely:
        size = (candidate.of_inputs("poles"), candidate.of_inputs("zeros"), f"{candidate.of_inputs('delay')} s")
        evidence = 0.5 * (found.likely[0].criterion - candidate.criterion)
        figures = (percent(candidate.fit), _known(candidate.uncertainty), f"{evidence:.1f}")
        rows.append((*size, *figures, CHOSEN if candidate is found.chosen else ""))
    return rows


def _known(uncertainty: float) -> str:
    """Return how well the least known coefficient is known."""
    return f"± {share(uncertainty)}" if uncertainty < 1.0 else "unknown"


def candidates_as_json(found: SearchResult) -> list[dict[str, Any]]:
    """Return an object of JSON for each structure; figures that are not finite become null."""
    return [_object(candidate, chosen=candidate is found.chosen) for candidate in found.candidates]


def _object(candidate: Candidate, *, chosen: bool) -> dict[str, Any]:
    orders = {name: [getattr(each, name) for each in candidate.structures] for name in ("poles", "zeros", "delay")}
    single = not isinstance(candidate.structure, tuple)
    return {
        **{name: each[0] if single else each for name, each in orders.items()},
        "fit": finite(candidate.fit),
        "uncertainty": finite(candidate.uncertainty),
        "likelihood": finite(candidate.likelihood),
        "criterion": finite(candidate.criterion),
        "chosen": chosen,
    }


def weights_in_words(result: Result) -> str:
    """Return a line on structures that learned side by side, and one on which of them was served, and since when."""
    weights = ", ".join(f"{_in_words(each)} {weight:.3f}" for each, weight in result.weights)
    served = "; ".join(f"from sample {each.taken:,} on {_in_words(each.structure)}" for each in result.leads)
    return f"Weights: {weights}\nServed: {served or 'none'}"


def _in_words(structure: Structure) -> str:
    delay = f" {structure.delay:g} s" if structure.delay else ""
    return f"poles {structure.poles} zeros {structure.zeros}{delay}"


def weights_as_json(result: Result) -> dict[str, Any]:
    """Return what JSON has of structures that learned side by side."""
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
    """Print the table, and the dead time where it lies between the points of the grid."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for row in rows_of(found):
        table.add_row(*row, style="bold" if row[-1] == CHOSEN else None)
    console.print(table)
    if found.rest:
        console.print(found.rest, highlight=False)
    if found.likely[0] is not found.chosen:
        console.print("Orders are compared with the dead time found between the points of the grid", highlight=False)
    if found.delays != tuple(each.delay for each in found.chosen.structures):
        delays = ", ".join(f"{delay:.4g}" for delay in found.delays)
        console.print(f"\nThe dead time between the points of the grid: {delays} s", highlight=False)


def validation_as_json(validation: Validation, source: str) -> dict[str, Any]:
    """Return the JSON object of a validation; figures that are not known become null."""
    auto, cross = validation.outside
    by_frequency = validation.by_frequency
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
    """Print a validation: fits, offset, tests of the residual, and the verdict in words."""
    console.print(f"\nOn {source}", highlight=False, markup=False, style="bold")
    simulated, one_step = (percent(fit, ascii_only=True) for fit in (validation.fit, validation.one_step))
    console.print(f"Fit      {simulated} {validation.how}, {one_step} one step ahead", highlight=False)
    if math.isfinite(validation.offset):
        console.print(f"Offset   {validation.offset:+.4g} beside the model's working point", highlight=False)
    auto, cross = validation.outside
    if math.isfinite(auto):
        outside = f"{100 * auto:.0f} % with itself, {100 * cross:.0f} % with the input"
        console.print(f"Residual correlated beyond the 95 % limit: {outside} (of a right model 5 %)", highlight=False)
    if validation.by_frequency is not None:
        worst = validation.by_frequency.worst
        error = f"up to {share(worst)} of |G|" if worst else "none beyond chance"
        console.print(f"Error    {error}, by frequency", highlight=False)
    console.print(f"Samples  {validation.samples:,}", highlight=False)
    print_verdict(console, validation.verdict)
