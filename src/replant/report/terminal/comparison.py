"""A comparison of methods as JSON and as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from replant.model.structure import Structure
from replant.report.findings import BAD, GOOD, findings, without_reasons
from replant.report.number_format import percent, uncertain
from replant.report.terminal.summary import as_json as result_as_json
from replant.report.verdict_words import COLOURS
from replant.runs.run_log import Contender, best

OUTCOME = ("verdict", "simulated", "one step", "time")
VERDICT = 1 + OUTCOME.index("verdict")  # its column, behind the method's
GAP = 2  # spaces between columns of the terminal's table [columns]


def as_json(contenders: Sequence[Contender]) -> dict[str, Any]:
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
    """Return the cells of a right-aligned column with their plus-minus signs below each other.

    Examples
    --------
    >>> _aligned(["2.1 ± 0.05", "10 ± 1", "3"])
    ['2.1 +- 0.05', '10 +- 1   ', '3         ']
    """
    parts = [cell.partition(" ± ") for cell in cells]
    width = max(len(std) for _, _, std in parts)
    if width == 0:
        return list(cells)
    return [value + (f" +- {std:<{width}}" if sign else " " * (width + 4)) for value, sign, std in parts]


def _blocks(widths: Sequence[int], room: int) -> list[list[int]]:
    """Return the columns of each block: all in one if they fit, else the outcome first, then as many as fit.

    Examples
    --------
    >>> _blocks([7, 9, 8, 6, 9, 20, 20], room=72), _blocks([7, 9, 8, 6, 9, 20, 20], room=100)
    ([[0, 1, 2, 3, 4], [0, 5, 6]], [[0, 1, 2, 3, 4, 5, 6]])
    """
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
