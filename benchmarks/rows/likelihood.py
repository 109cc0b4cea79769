"""Estimates of a known row: what maximum likelihood finds from the truth, and the scores of what others find."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from replant.estimation.simulation.miso import Row, RowRecord, evaluate
from replant.fitting.miso_solve import covariance_of, likeliest
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import chi2_quantile

#: A coefficient so many standard deviations of the anchor's error off: the run has diverged.
FAR = 10.0
LEVEL = 1.96  # of a 95 % interval [standard deviations]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Coefficients (P,) and their covariance (P, P)."""

    theta: FloatArray
    covariance: FloatArray
    status: str = ""


def likeliest_from(
    truth: FloatArray, structures: tuple[Structure, ...], u: FloatArray, y: FloatArray, dt: float
) -> Estimate:
    """Return the maximum of likelihood beside the truth."""
    ready = RowRecord.of(u, y, dt)
    row = Row(structures, ready.record, ready.inputs)
    begin = [evaluate(row, truth, Autoregression.white(1.0, row.count))]
    point = likeliest(row, begin, lambda _: begin).point
    return Estimate(point.theta, covariance_of(row, point))


@dataclass(frozen=True)
class Score:
    """How estimates of several runs lie beside the truth and beside those of the first method."""

    name: str
    ratio: float  # largest root mean square of a coefficient's error, over that of the first method
    coverage: float  # of 95 % intervals, pooled over coefficients [percent]
    bias: float  # joint statistic of the means of all coefficients, over its limit at 1 %
    diverged: int  # runs
    trusted: int  # runs
    runs: int


def scores(found: dict[str, Sequence[Estimate]], truth: FloatArray) -> Iterator[Score]:
    """Yield the score of each method; the first is what the others are beside."""
    anchor: FloatArray | None = None
    for name, each in found.items():
        off = np.array([one.theta for one in each]) - truth
        std = np.array([np.sqrt(np.diag(one.covariance)) for one in each])
        rms = np.sqrt(np.mean(off**2, axis=0))
        anchor = rms if anchor is None else anchor
        mean, spread = off.mean(axis=0), np.cov(off.T)
        runs, size = off.shape
        # Hotelling: the covariance of the errors is estimated, too
        statistic = runs * float(mean @ np.linalg.lstsq(spread, mean, rcond=None)[0]) * (runs - size) / (runs - 1)
        far = ~np.isfinite(off).all(axis=1) | (np.abs(off) > FAR * anchor).any(axis=1)
        yield Score(
            name, float((rms / anchor).max()), 100.0 * float(np.mean(np.abs(off) < LEVEL * std)),
            statistic / chi2_quantile(0.99, size), int(far.sum()), sum(one.status == "trusted" for one in each), runs,
        )  # fmt: skip
