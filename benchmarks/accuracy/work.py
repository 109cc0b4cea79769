"""The work: every run of every experiment, shared among all cores, with progress shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from accuracy import verdicts
from accuracy.experiment import Experiment
from accuracy.methods import Figures
from accuracy.scenarios import experiments
from replant.fleet import sweep

RIGHT, WRONG = "H right", "H wrong"


@dataclass(frozen=True)
class Assessed:
    """One verdict: what was the case, and what was said of it."""

    kind: str
    status: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Results:
    """What came out.

    Attributes
    ----------
    figures : dict
        By experiment: one entry a run, the figures by method.
    verdicts : dict
        `RIGHT` and `WRONG`: one entry a case.
    """

    figures: dict[str, list[dict[str, Figures]]] = field(default_factory=dict)
    verdicts: dict[str, list[Assessed]] = field(default_factory=dict)


def carry_out(chosen: Sequence[Experiment], runs: int | None, with_verdicts: bool, on: str) -> Results:
    """Make every run of the chosen experiments, at most ``runs`` of each where that is given, on an executor."""
    tasks = [(each.key, number) for each in chosen for number in range(min(each.runs, runs or each.runs))]
    if with_verdicts:
        cases = min(verdicts.CASES, runs or verdicts.CASES)
        tasks += [(key, number) for key in (RIGHT, WRONG) for number in range(cases)]
    columns = (TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as progress:
        bar = progress.add_task("runs", total=len(tasks))
        ordered = longest_first(tasks)
        outcomes = sweep(
            carry_out_one, ordered, on, lambda done, of: progress.update(bar, completed=done, description="runs")
        )
        done = dict(zip(ordered, outcomes, strict=True))
    results = Results()
    for (key, number), outcome in sorted(done.items()):
        table = results.verdicts if key in (RIGHT, WRONG) else results.figures
        table.setdefault(key, []).append(outcome)  # type: ignore[arg-type, union-attr]
        assert len(table[key]) == number + 1
    return results


def carry_out_one(task: tuple[str, int]) -> dict[str, Figures] | Assessed:
    """Make one run, of an experiment by its key."""
    key, number = task
    if key in (RIGHT, WRONG):
        case = verdicts.right(number) if key == RIGHT else verdicts.wrong(number)
        return Assessed(case.kind, *case.assessed)
    return experiments()[key].run(number)


def longest_first(tasks: Sequence[tuple[str, int]]) -> list[tuple[str, int]]:
    """Return the tasks with the long ones at the beginning, so that no process is left alone with one at the end."""
    weights = {"D": 3, "C": 2, "J": 1}
    return sorted(tasks, key=lambda task: -weights.get(task[0].split()[0], 0))
