"""Rendering: reproduced tables as JSON, as Markdown and for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from replant.paper.tables.reproduction import (
    LIMIT,
    Cell,
    RowResult,
    TableResult,
    three_digits,
)

if TYPE_CHECKING:
    from rich.table import Table as RichTable

SOURCE = (
    "Bernat and Kolota (2023), doi 10.24425/acs.2023.146960: the performance index J of each parameter, "
    "the sum over all samples of its squared error, (21)."
)
COLUMNS = ("index", "ours", "std", "published", "match")


def as_json(results: Sequence[TableResult]) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return {table: {row: {index: {ours, published, agrees}}}}; a row with buffer has std and seeds as well.

    For a row with buffer ``ours`` is the mean over the seeds.  ``agrees`` is `Cell.agrees`.
    """
    return {
        result.table.name: {
            row.row.label: {cell.index: _cell_as_json(cell, row.seeds) for cell in row.cells} for row in result.rows
        }
        for result in results
    }


def as_markdown(results: Sequence[TableResult]) -> str:
    """Return the tables as a Markdown page."""
    parts = ["# The article's tables, reproduced", SOURCE]
    for result in results:
        buffered = _has_std(result)
        columns = (result.table.heading, *(name for name in COLUMNS if buffered or name != "std"))
        lines = ["| " + " | ".join(columns) + " |", "|---|---" + "|--:" * (len(columns) - 3) + "|---|"]
        for row in result.rows:
            for cell in row.cells:
                fields = (row.row.label, *_fields(cell, buffered))
                lines.append("| " + " | ".join(fields) + " |")
        parts += [f"## {result.table.title}", "\n".join(lines), "\n".join(f"* {note}" for note in notes(result))]
    parts += ["## Summary", "\n".join(f"* {line}" for line in summary(results))]
    return "\n\n".join(parts) + "\n"


def as_rich(result: TableResult) -> RichTable:
    """Return a table for the terminal without title and notes: a section for each row, a line for each figure."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    buffered = _has_std(result)
    table = Table(box=box.SIMPLE_HEAD, show_lines=True, pad_edge=False)
    table.add_column(result.table.heading)  # wraps on a narrow terminal
    for name in COLUMNS:
        if buffered or name != "std":
            table.add_column(name, justify="left" if name in ("index", "match") else "right", no_wrap=True)
    for row in result.rows:
        columns = zip(*(_fields(cell, buffered) for cell in row.cells), strict=True)
        *figures, _ = ("\n".join(column) for column in columns)
        match = Text("\n").join(Text(cell.verdict, "green" if cell.agrees else "yellow") for cell in row.cells)
        table.add_row(row.row.label, *figures, match)
    return table


def notes(result: TableResult) -> list[str]:
    """Return the notes to a table."""
    lines = list(result.table.notes)
    seeds = max(row.seeds for row in result.rows)
    if seeds > 1:
        lines.append(f"With buffer: mean and standard deviation (std) over {seeds} seeds; the article prints one run.")
    if result.improvement is not None and result.table.improvement is not None:
        printed, ours = result.improvement
        lines.append(
            f"The article's text gives the improvement of J_sum as {result.table.improvement.published} %. "
            f"By its own table the improvement is {printed:.1f} %, by ours {ours:.1f} %."
        )
    return lines


def summary(results: Sequence[TableResult]) -> list[str]:
    """Return how many figures agree: for the rows without buffer, then for those with a buffer, by batch size."""
    rows = [row for result in results for row in result.rows]
    lines = []
    for batch in sorted({row.batch for row in rows}, key=lambda batch: batch or 0):
        chosen = [row for row in rows if row.batch == batch]
        if batch is None:
            lines.append(f"Without buffer: {_count(chosen)} equal in all printed digits.")
        else:
            said = " as the article prints it" if any("as printed" in row.row.label for row in chosen) else ""
            lines.append(f"With buffer, batch {batch}{said}: {_count(chosen)} within {LIMIT:g} standard deviations.")
    return lines


def _count(rows: Sequence[RowResult]) -> str:
    parameters = [cell.agrees for row in rows for cell in row.cells if cell.index != "J_sum"]
    sums = [row["J_sum"].agrees for row in rows]
    return f"{sum(parameters)} of {len(parameters)} figures and {sum(sums)} of {len(sums)} sums"


def _cell_as_json(cell: Cell, seeds: int) -> dict[str, Any]:
    chance = {} if cell.std is None else {"std": cell.std, "seeds": seeds}
    return {"ours": cell.ours, **chance, "published": cell.published, "agrees": cell.agrees}


def _fields(cell: Cell, buffered: bool) -> tuple[str, ...]:
    std = () if not buffered else ("",) if cell.std is None else (f"{cell.std:.1e}",)
    return (cell.index, three_digits(cell.ours), *std, three_digits(cell.published), cell.verdict)


def _has_std(result: TableResult) -> bool:
    return any(row.batch is not None for row in result.rows)
