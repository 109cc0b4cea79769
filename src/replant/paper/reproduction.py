"""The tables of the article computed again, compared with the published figures, as JSON, Markdown and text.

A row without a buffer is deterministic and is run once.  A row with a buffer is run with many seeds; its figure is the
mean, and the standard deviation is that of a single run such as the article's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any

from replant.fleet.fit import sweep
from replant.paper.tables import Row, Table, run_seeds

if TYPE_CHECKING:
    from rich.table import Table as RichTable


SEEDS = 20  # runs of a row with a replay buffer: seeds 0 to 19 [count]
LIMIT = 3.0  # distance from the mean of our runs up to which a published figure agrees [standard deviations]


@dataclass(frozen=True)
class Cell:
    """A figure of a table, ours and the published one."""

    index: str  # the name of the index, such as "J_a0"
    ours: float  # for a row with buffer, the mean over the seeds
    published: float
    std: float | None = None  # standard deviation over the seeds; None for a row without buffer

    @property
    def distance(self) -> float | None:
        """How many standard deviations the published figure lies from ours; None without a buffer."""
        if self.std is None:
            return None
        gap = abs(self.ours - self.published)
        return gap / self.std if self.std > 0 else math.inf if gap else 0.0

    @property
    def agrees(self) -> bool:
        """Whether ours rounds to the published digits or, with a buffer, lies within 3 standard deviations."""
        distance = self.distance
        return three_digits(self.ours) == three_digits(self.published) if distance is None else distance <= LIMIT

    @property
    def verdict(self) -> str:
        """The result of the comparison: "equal", "differs", "within 3 std", or how many std away."""
        if self.distance is None:
            return "equal" if self.agrees else "differs"
        if self.agrees:
            return f"within {LIMIT:g} std"
        return f"{self.distance:.{0 if self.distance >= 10 else 1}f} std away"


@dataclass(frozen=True)
class RowResult:
    """A row of a table with our figures; ``seeds`` is the number of runs: 1 without a buffer."""

    row: Row
    cells: tuple[Cell, ...]
    seeds: int

    @property
    def batch(self) -> int | None:
        """The batch size of a row with buffer; None without a buffer."""
        replay = self.row.experiment.replay
        return None if replay is None else replay.batch_size

    def __getitem__(self, index: str) -> Cell:
        return next(cell for cell in self.cells if cell.index == index)


@dataclass(frozen=True)
class TableResult:
    """A table with our figures."""

    table: Table
    rows: tuple[RowResult, ...]

    def __getitem__(self, label: str) -> RowResult:
        return next(result for result in self.rows if result.row.label == label)

    @property
    def improvement(self) -> tuple[float, float] | None:
        """The improvement of J_sum in percent, by the article's table and by ours; None if the article claims none."""
        claim = self.table.improvement
        if claim is None:
            return None
        over, of = self[claim.over]["J_sum"], self[claim.of]["J_sum"]
        return 100 * (1 - of.published / over.published), 100 * (1 - of.ours / over.ours)


def reproduce(
    table: Table, seeds: int = SEEDS, on_row: Callable[[], None] = lambda: None, executor: Executor | str | None = None
) -> TableResult:
    """Run every experiment of a table; call ``on_row`` after each row."""
    tasks = [(row, 1 if row.experiment.replay is None else seeds) for row in table.rows]
    found = sweep(_run_row, tasks, executor, lambda done, of: on_row())
    return TableResult(
        table, tuple(_row_result(table, row, results) for row, results in zip(table.rows, found, strict=True))
    )


def three_digits(value: float) -> str:
    """Return a figure with three digits, as the article prints it."""
    return f"{value:.2e}"


def _run_row(task: tuple[Row, int]) -> list[dict[str, float]]:
    """Return the performance indices of each seed of a row; what an executor calls."""
    row, seeds = task
    return run_seeds(row.experiment, range(seeds), row.experiment.plant.record())


def _row_result(table: Table, row: Row, results: list[dict[str, float]]) -> RowResult:
    cells = []
    for index, published in zip(table.indices, row.published, strict=True):
        values = [result[index] for result in results]
        std = None if row.experiment.replay is None else stdev(values)
        cells.append(Cell(index, fmean(values), published, std))
    return RowResult(row, tuple(cells), len(results))


SOURCE = (
    "Bernat and Kolota (2023), doi 10.24425/acs.2023.146960: the performance index J of each parameter, "
    "the sum over all samples of its squared error, (21)."
)
COLUMNS = ("index", "ours", "std", "published", "match")


def as_json(results: Sequence[TableResult]) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return {table: {row: {index: {ours, published, agrees}}}}; a row with buffer has ours, a mean, std and seeds."""
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
        rows = [(row.row.label, *_fields(cell, buffered)) for row in result.rows for cell in row.cells]
        shown = markdown_table(columns, rows, left=("index", "match"))
        parts += [f"## {result.table.title}", shown, "\n".join(f"* {note}" for note in notes(result))]
    parts += ["## Summary", "\n".join(f"* {line}" for line in summary(results))]
    return "\n\n".join(parts) + "\n"


def markdown_table(headings: Sequence[str], rows: Iterable[Iterable[str]], left: Collection[str] = ()) -> str:
    """Return a table in Markdown; its columns are flush right, but for the first one and those in ``left``."""
    below = ["---" if heading in left else "--:" for heading in headings[1:]]
    return "\n".join("| " + " | ".join(row) + " |" for row in (headings, ["---", *below], *rows))


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
