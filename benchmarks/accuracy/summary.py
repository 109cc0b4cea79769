"""From the figures of every run to statistics, promises and coverage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from accuracy.bounds import COVERAGE, Bound, Statistics, statistics
from accuracy.experiment import Experiment
from accuracy.feedback import Outcome, outcome
from accuracy.methods import QUANTILE, Figures

#: Statistics by method and figure.
Table = dict[str, dict[str, Statistics]]


@dataclass(frozen=True)
class Promise:
    """A bound with what was measured.

    Attributes
    ----------
    experiment : Experiment
    bound : Bound
    measured : mapping
        By figure.
    broken : tuple of str
        The figures that do not keep it.
    """

    experiment: Experiment
    bound: Bound
    measured: Mapping[str, float]
    broken: tuple[str, ...]

    @property
    def is_met(self) -> bool:
        """Whether every figure keeps it."""
        return not self.broken


@dataclass(frozen=True, eq=False)
class Summary:
    """What one experiment says.

    Attributes
    ----------
    experiment : Experiment
    table : dict
        Over the runs that are counted.
    covered : dict
        The same over all runs: the coverage is taken from here.
    promises : tuple of Promise
    outcomes : dict
        By method, where a controller makes the input.
    """

    experiment: Experiment
    table: Table
    covered: Table
    promises: tuple[Promise, ...]
    outcomes: Mapping[str, Outcome]


def summarise(experiment: Experiment, runs: Sequence[Mapping[str, Figures]]) -> Summary:
    """Return the statistics of an experiment's runs."""
    table = tabulate(experiment, runs[: experiment.counted or len(runs)])
    promises = tuple(_promise(experiment, bound, table[bound.method]) for bound in experiment.bounds)
    outcomes: dict[str, Outcome] = {}
    if experiment.feedback is not None:
        sizes, truth = experiment.feedback.sizes, experiment.truth
        outcomes = {method: outcome(sizes, truth, [run[method] for run in runs]) for method in experiment.methods}
    return Summary(experiment, table, tabulate(experiment, runs), promises, outcomes)


def tabulate(experiment: Experiment, runs: Sequence[Mapping[str, Figures]]) -> Table:
    """Return statistics by method and figure; figures without a truth are kept where the experiment has none."""
    table: Table = {}
    for method in experiment.methods:
        figures = list(experiment.truth) or _names(run[method] for run in runs)
        table[method] = {}
        for figure in figures:
            found = [run[method].get(figure, (math.nan, math.nan)) for run in runs]
            truth = experiment.truth.get(figure, math.nan)
            table[method][figure] = statistics([v for v, _ in found], [s for _, s in found], truth, QUANTILE)
    return table


def is_covered(percent: float) -> bool:
    """Return whether a coverage is as promised."""
    return COVERAGE[0] <= percent <= COVERAGE[1]


def prints_intervals(figures: Mapping[str, Statistics]) -> bool:
    """Return whether a method has a coverage."""
    return any(math.isfinite(each.coverage) for each in figures.values())


def _promise(experiment: Experiment, bound: Bound, figures: Mapping[str, Statistics]) -> Promise:
    measured = {figure: bound.measured(figures[figure]) for figure in bound.limits}
    broken = tuple(figure for figure in bound.limits if not bound.is_met(figure, figures[figure]))
    return Promise(experiment, bound, measured, broken)


def _names(found: Iterable[Figures]) -> list[str]:
    """Return every figure's name, in the order in which they come."""
    return list(dict.fromkeys(name for figures in found for name in figures))
