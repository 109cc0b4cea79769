"""What is promised, and whether it is kept: bounds on the statistics of a figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Statistics:
    """One figure of one method over the runs.

    Attributes
    ----------
    truth : float
        NaN where there is none.
    runs, failed : int
        Runs made, and those without an estimate; the rest of the statistics is over the others.
    mean, std, rmse : float
        std with n - 1 in the denominator.
    lowest, highest : float
    printed : float
        Root mean square of the standard deviations that the method prints; NaN where it prints none.
    coverage : float
        Percentage of runs whose nominal 95 % interval holds the truth; a run without an estimate misses it.  NaN
        where the method prints no intervals.
    """

    truth: float
    runs: int
    failed: int
    mean: float
    std: float
    rmse: float
    lowest: float
    highest: float
    printed: float
    coverage: float

    @property
    def bias(self) -> float:
        """Mean minus truth."""
        return self.mean - self.truth

    @property
    def bias_percent(self) -> float:
        """Bias in percent of the truth; NaN where that is zero."""
        return 100.0 * self.bias / abs(self.truth) if self.truth else math.nan

    @property
    def worst_percent(self) -> float:
        """Largest error of any run in percent of the truth, or as it is where that is zero."""
        worst = max(abs(self.lowest - self.truth), abs(self.highest - self.truth))
        return 100.0 * worst / abs(self.truth) if self.truth else 100.0 * worst

    @property
    def standard_error(self) -> float:
        """Of the mean."""
        return self.std / math.sqrt(max(self.runs - self.failed, 1))


def statistics(values: Sequence[float], stds: Sequence[float], truth: float, quantile: float) -> Statistics:
    """Return the statistics of a figure's values over the runs, NaN where a run has no estimate.

    Examples
    --------
    >>> kept = statistics([1.0, 3.0], [1.0, 0.1], truth=2.0, quantile=1.96)
    >>> kept.mean, kept.rmse, kept.coverage
    (2.0, 1.0, 50.0)
    """
    every, std = np.asarray(values, np.float64), np.asarray(stds, np.float64)
    good = np.isfinite(every)
    x, spread = every[good], std[good]
    if x.size == 0:
        return Statistics(truth, every.size, every.size, *([math.nan] * 7))
    told = np.isfinite(spread)
    inside = np.abs(x[told] - truth) <= quantile * spread[told]
    known = told.any() and math.isfinite(truth)
    return Statistics(
        truth,
        every.size,
        int(every.size - x.size),
        float(x.mean()),
        float(x.std(ddof=1)) if x.size > 1 else 0.0,
        float(np.sqrt(np.mean((x - truth) ** 2))),
        float(x.min()),
        float(x.max()),
        float(np.sqrt(np.mean(spread[told] ** 2))) if told.any() else math.nan,
        float(100.0 * inside.sum() / (told.sum() + every.size - x.size)) if known else math.nan,
    )


@dataclass(frozen=True)
class Kind:
    """A way to bound a figure.

    Attributes
    ----------
    words : str
        What must be so, with a place for the limit.
    measured : callable
        What is compared with the limit.
    keeps : callable
        Whether a measured value keeps a limit.
    """

    words: str
    measured: Callable[[Statistics], float]
    keeps: Callable[[float, float], bool]


def _within(value: float, limit: float) -> bool:
    return abs(value) <= limit


def _at_most(value: float, limit: float) -> bool:
    return value <= limit


KINDS: dict[str, Kind] = {
    "bias": Kind("mean within {} %", lambda s: s.bias_percent, _within),
    "std": Kind("std at most {}", lambda s: s.std, _at_most),
    "rmse": Kind("RMSE at most {}", lambda s: s.rmse, _at_most),
    "near": Kind("std within 20 % of {}", lambda s: s.std, lambda value, limit: abs(value / limit - 1.0) <= 0.2),
    "standard errors": Kind("mean within {} standard errors", lambda s: s.bias / s.standard_error, _within),
    "error": Kind("each run within {} %", lambda s: s.worst_percent, _at_most),
    "at most": Kind("mean over runs at most {}", lambda s: s.mean, _at_most),
    "at least": Kind("at least {}", lambda s: s.mean, lambda value, limit: value >= limit),
}


@dataclass(frozen=True)
class Bound:
    """A promise about a method in an experiment.

    Attributes
    ----------
    method : str
    kind : str
        A key of `KINDS`.
    limits : mapping
        By figure.
    """

    method: str
    kind: str
    limits: Mapping[str, float]

    @property
    def words(self) -> str:
        """What is promised."""
        limits = list(self.limits.values())
        text = f"{limits[0]:.4g}" if len(set(limits)) == 1 else ", ".join(f"{limit:.4g}" for limit in limits)
        return KINDS[self.kind].words.format(text)

    def measured(self, statistics: Statistics) -> float:
        """Return what is compared with the limit."""
        return KINDS[self.kind].measured(statistics)

    def is_met(self, figure: str, statistics: Statistics) -> bool:
        """Return whether the statistics keep it; a run without an estimate breaks every promise."""
        value = self.measured(statistics)
        return statistics.failed == 0 and bool(KINDS[self.kind].keeps(value, self.limits[figure]))


#: Percentage of nominal 95 % intervals that must hold the truth.
COVERAGE = (90.0, 99.0)
