"""Reproduction: run the experiments of a table and compare the figures with the published ones.

A row without a buffer is deterministic and is run once.  A row with a buffer is run with many seeds; its figure is the
mean, and the standard deviation is that of a single run such as the article's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from statistics import fmean, stdev

from replant.fleet.sweep import sweep
from replant.paper.tables.experiment import run_seeds
from replant.paper.tables.published import Row, Table

SEEDS = 20  # runs of a row with a replay buffer: seeds 0 to 19 [count]

LIMIT = 3.0
"""Distance of a published figure of one run from the mean of ours up to which they agree [standard deviations]."""


@dataclass(frozen=True)
class Cell:
    """A figure of a table, ours and the published one.

    Attributes
    ----------
    index : str
        The name of the index, such as "J_a0".
    ours : float
        For a row with buffer, the mean over the seeds.
    published : float
    std : float, optional
        Standard deviation over the seeds; None for a row without buffer.

    Examples
    --------
    >>> Cell("J_a0", ours=5186.3, published=5.19e3).verdict
    'equal'
    >>> Cell("J_a0", ours=2165.0, published=2.14e3, std=29.0).verdict
    'within 3 std'
    """

    index: str
    ours: float
    published: float
    std: float | None = None

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
    table: Table,
    seeds: int = SEEDS,
    on_run: Callable[[], None] | None = None,
    executor: Executor | str | None = None,
) -> TableResult:
    """Run every experiment of a table.

    >>> from replant.paper.tables.published import TABLES
    >>> reproduce(TABLES["table2"])["AMSGrad, amplitude 0.1"]["J_b0"].verdict
    'equal'
    """
    tasks = [(row, len(_seeds_of(row, seeds))) for row in table.rows]
    made, total = 0, runs(table, seeds)

    def progress(done: int, of: int) -> None:
        nonlocal made
        while on_run is not None and made < total * done // of:
            made += 1
            on_run()

    found = sweep(_run_row, tasks, executor, progress)
    return TableResult(
        table, tuple(_row_result(table, row, results) for row, results in zip(table.rows, found, strict=True))
    )


def runs(table: Table, seeds: int = SEEDS) -> int:
    """Return how many runs `reproduce` needs."""
    return sum(len(_seeds_of(row, seeds)) for row in table.rows)


def three_digits(value: float) -> str:
    """Return a figure with three digits, as the article prints it.

    Examples
    --------
    >>> three_digits(5186.32)
    '5.19e+03'
    """
    return f"{value:.2e}"


def _seeds_of(row: Row, seeds: int) -> range:
    return range(1 if row.experiment.replay is None else seeds)


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
