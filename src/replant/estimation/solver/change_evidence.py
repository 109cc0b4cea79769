r"""Evidence of a change: the knowledge from before it, and the likelihood of a residual.

Known are a model, its information matrix M, and the noise of its residual.  A supposition of what has changed forgets
some directions V of M:

.. math:: M_0(V) = M - M V (V^T M V)^{-1} V^T M.

The likelihood of a residual over a stretch is computed with the noise known from before, or with another noise at a
price.  Each part of a stretch may have its own variance.  Another colour, and a load that drifts along a broken line,
cost ln(K) / 2 per number (Bayes' criterion).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.fitted_run import triangle_of
from replant.estimation.solver.refined_estimate import Prior, Refined, without_nuisances
from replant.estimation.solver.srivc_steps import Problem
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import LEAST, Autoregression
from replant.numerics.linear_algebra import combined, inverse_of, least_norm, products, quiet, sum_of_squares
from replant.numerics.projections import lengths_of

# a normal deviate beyond 4 has the chance 6e-5
UNTOLD = 4.0  # residual beyond which a sample contradicts the model [standard deviations]

# with two coefficients, the dispersion is then known to a third
STRETCHES = 8  # fewest stretches before a change that give the dispersion [count]

PIECES = 1, 2, 4  # pieces of the broken lines that a load may drift along, each at a price [count]
# a thousandth of what a converter of 20 bits resolves
FINEST = 1e-9  # deviation of a residual below which it is no evidence [part of the output's standard deviation]
# some thousand times float64's precision
WEAKEST = 1e-12  # singular value that counts as zero [part of the largest]


@dataclass(frozen=True, eq=False)
class Known:
    """The knowledge from before a change."""

    mean: FloatArray  # (T,), the model
    information: FloatArray  # (T, T) of its coefficients; zero for the nuisances
    error: FloatArray  # (K,) of the model over a record, offset and initial state those of the samples before
    noise: Autoregression  # D(q) of the error before
    variance: float  # of that error filtered by it, in the output's unit squared
    filters: bool  # whether estimates are filtered by the noise model
    slopes: FloatArray  # (B, T) of the output before, filtered by it; none if too few samples are before

    @classmethod
    @quiet
    def before(
        cls, structure: Structure, record: Record, begin: int, mean: FloatArray, information: FloatArray, usual: float,
        *, filters: bool = True,
    ) -> Known | None:  # fmt: skip
        """Return the knowledge by a model and its information before a sample of a record; None if unusable."""
        problem = Problem(structure, record)
        first = record.first(begin)
        enough = first.count > LEAST + mean.size
        if not (problem.is_usable(mean) and np.isfinite(information).all()):
            return None
        done = problem.run_whole(with_nuisances(problem, mean, slice(0, begin) if enough else slice(None)))
        error = done.ahead
        if not np.isfinite(error).all():
            return None
        if not enough:
            known = Autoregression.white(usual, 1.0)
            return cls(mean, information, error, known, usual, filters, np.zeros((0, mean.size)))
        noise = Autoregression.white(sum_of_squares(error[:begin]), first.count)
        if noise.power > 0.0:
            noise = Autoregression.of_residual(error[:begin], first.predecessors, first.count)
        white = noise.whiten_known(error[:begin], first.predecessors)
        slopes = noise.whiten_known(done.zeta[:begin], first.predecessors)
        slopes[~first.is_measured] = 0.0
        variance = sum_of_squares(white) / (first.count - mean.size)
        return cls(mean, information, error, noise, variance, filters, slopes)

    def dispersion(self, record: Record, length: int) -> tuple[float, float]:
        """Return `dispersion_of` the samples before the change, in stretches of ``length``."""
        begin, coefficients = len(self.slopes), np.diag(self.information) > 0.0
        if not coefficients.any():
            return 1.0, math.inf
        white = self.noise.whiten_known(self.error[:begin], record.predecessors[:begin])
        return dispersion_of(self.slopes, white, coefficients, length, self.variance)

    def onset(self, record: Record, earliest: int) -> int:
        """Return the first sample, from ``earliest`` on, that contradicts the model; ``earliest`` without one."""
        # the filter starts at rest: a coloured residual that is already large there may have begun before
        error = np.where(np.arange(self.error.size) < earliest, 0.0, self.error)
        white = self.noise.whiten_known(error, record.predecessors)[earliest:]
        untold = np.flatnonzero(np.abs(white) > UNTOLD * math.sqrt(self.variance))
        return earliest + int(untold[0]) if untold.size else earliest

    def without(self, directions: FloatArray) -> Prior:
        """Return the prior in which directions (T, Q) are forgotten."""
        return Prior(self.mean, forget(self.information, directions), max(self.variance, np.finfo(float).tiny))

    def asked_for(self, plant: Refined, size: int, price: float) -> tuple[FloatArray, FloatArray] | None:
        """Return the model, and the fewest coefficients to forget at a price, given a later estimate; None for all."""
        before, since = self.information[:size, :size], inverse_of(plant.covariance[:size, :size])
        units = np.diag(before) ** -0.5  # the coefficients have units of their own
        before, since = (each * np.outer(units, units) for each in (before, since))
        away = (plant.theta[:size] - self.mean[:size]) / units
        if not (np.isfinite(since).all() and np.isfinite(away).all()):
            return None

        def left(forgotten: list[int]) -> tuple[float, FloatArray]:
            prior = forget(before, np.eye(size)[:, forgotten])
            step = least_norm(since + prior, since @ away, WEAKEST)[0]
            rest = away - step
            return 0.5 * max(float(rest @ since @ rest + step @ prior @ step), 0.0), step

        forgotten: list[int] = []
        (cost, step), open_ = left([]), list(range(size))
        while open_:
            next_ = min(open_, key=lambda each: left([*forgotten, each])[0])
            less, there = left([*forgotten, next_])
            if forgotten and not cost - less > price:
                break
            cost, step = less, there
            forgotten.append(next_)
            open_.remove(next_)
        if not (forgotten and open_):
            return None
        model, directions = plant.theta.copy(), np.zeros((self.mean.size, len(forgotten)))
        model[:size] = self.mean[:size] + step * units
        directions[forgotten, range(len(forgotten))] = units[forgotten]
        return model, directions


def dispersion_of(
    slopes: FloatArray, white: FloatArray, coefficients: BoolArray, length: int, variance: float
) -> tuple[float, float]:
    """Return how many times more (at least 1) another G(s) explains of stretches than chance, and degrees of freedom.

    Slopes (K, T) and residual (K,) before a change are whitened; ``coefficients`` (T,): which are no nuisances.  A
    linear model of a nonlinear plant fits each stretch differently; a change must explain more than this.
    Source: the dispersion of quasi-likelihood, Wedderburn (1974), Biometrika 61.
    """
    begin = len(slopes)
    length = min(length, begin // (STRETCHES + 1))
    if length < 2 * coefficients.size or not np.isfinite(slopes).all():
        return 1.0, math.inf
    slopes = slopes / lengths_of(slopes)
    explained, ranks = 0.0, 0
    # without the stretch just before the change, which may have begun in it
    for end in range(begin - length, length - 1, -length):
        rows = slice(end - length, end)
        beside = slopes[:length, ~coefficients]  # responses to offset and initial state at the begin
        both = np.column_stack([slopes[rows][:, coefficients], white[rows]])
        both -= combined(beside, least_norm(beside, both, WEAKEST)[0])
        both = triangle_of(both)
        directions, values, _ = np.linalg.svd(both[:, :-1], full_matrices=False)
        told = directions[:, values > WEAKEST * values[0]] if values[0] > 0.0 else directions[:, :0]
        explained += sum_of_squares(products(told, both[:, -1]))
        ranks += told.shape[1]
    if not (ranks and variance > 0.0):
        return 1.0, math.inf
    return max(explained / (ranks * variance), 1.0), float(ranks)


def weighed(more: float, dispersion: float, numbers: float) -> float:
    """Return the evidence in a log-likelihood gain by another G(s), half a chi-square(2) with a right model.

    As the dispersion is known with n degrees of freedom, an F distribution with 2 and n replaces the chi-square:
    P{F > f} = (1 + 2 f / n)^(-n / 2),   evidence = (n / 2) ln(1 + (2 / n) more / dispersion)
    """
    if more <= 0.0 or math.isinf(numbers):
        return more / dispersion
    return 0.5 * numbers * math.log1p(2.0 * more / (numbers * dispersion))


def with_nuisances(problem: Problem, model: FloatArray, rows: slice = slice(None)) -> FloatArray:
    """Return a model (T,) with the offset and the initial state that fit some rows of a problem's record best."""
    size = problem.structure.coefficients
    done = problem.run_whole(without_nuisances(problem.structure, model[:size]))
    return np.concatenate([model[:size], least_norm(done.phi[rows, size:], done.error[rows], WEAKEST)[0]])


@quiet
def forget(information: FloatArray, directions: FloatArray) -> FloatArray:
    """Return an information matrix (T, T) without the information on directions (T, Q)."""
    if directions.shape[1] == 0:
        return information
    along = information @ directions
    inside = np.linalg.pinv(directions.T @ along, rcond=WEAKEST, hermitian=True)
    return np.asarray(information - along @ inside @ along.T)


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of K samples, with the data for the likelihood of a residual."""

    predecessors: IntArray  # (K,), residuals before each that are one sampling time apart
    measured: BoolArray  # (K,), residuals that count; the others are zero
    parts: tuple[slice, ...]  # each with its own variance
    least: float  # least variance of a residual

    @classmethod
    def of(cls, record: Record, rows: slice, middle: int = 0) -> Stretch:
        """Return the ``rows`` of a record, divided after ``middle`` of them."""
        measured = record.is_measured[rows]
        parts = tuple(part for part in (slice(0, middle), slice(middle, measured.size)) if measured[part].any())
        least = (FINEST * record.spread) ** 2 + np.finfo(float).tiny
        return cls(record.predecessors[rows], measured, parts, least)

    @property
    def count(self) -> int:
        """The number of residuals that count."""
        return int(self.measured.sum())

    @property
    def price(self) -> float:
        """The price of a fitted number."""
        return 0.5 * math.log(max(self.count, 2))

    @quiet
    def of_usual(self, error: FloatArray, noise: Autoregression, variance: float, *, last: bool = False) -> float:
        """Return the log-likelihood of a residual (K,), up to a constant; noise known in all parts or the ``last``."""
        white, likelihood = noise.whiten_known(error, self.predecessors) ** 2, 0.0
        for part in self.parts:
            count = int(self.measured[part].sum())
            own = float(white[part].sum()) / count + self.least
            usual = own if last and part is not self.parts[-1] else variance + self.least
            likelihood -= 0.5 * count * (math.log(usual) + own / usual - 1.0)
        return likelihood

    @quiet
    def of_other(self, error: FloatArray, noise: Autoregression, beside: FloatArray | None = None) -> float:
        """Return the same with the likeliest variance of each part, minus its price."""
        if not np.isfinite(error).all():
            return -math.inf
        # with another colour, or a load that drifts in addition to nuisances (K, C) ``beside``, if worth the price
        return self._drifted(error, noise, beside)[0] - self.price

    @quiet
    def line(self, error: FloatArray, noise: Autoregression, beside: FloatArray) -> FloatArray:
        """Return the columns (K, P) of the line that a residual follows, zero at its end; P = 0 if none pays."""
        return self._columns(self._drifted(error, noise, beside)[1] if np.isfinite(error).all() else 0)

    def _drifted(self, error: FloatArray, noise: Autoregression, beside: FloatArray | None) -> tuple[float, int]:
        """Return the largest log-likelihood of a residual minus some line, less its price, and the line's pieces."""
        lines = [(0, error)]
        if beside is not None:
            for pieces in PIECES:
                line = np.column_stack([beside, self._columns(pieces)])  # fitted together with the nuisances
                lines.append((pieces, np.asarray(error - combined(line, least_norm(line, error, WEAKEST)[0]))))
        tried = [(self._coloured(left, noise) - pieces * self.price, pieces) for pieces, left in lines]
        return max(tried, key=lambda each: each[0])

    def _columns(self, pieces: int) -> FloatArray:
        """Return the basis (K, P) of the broken lines of ``pieces`` pieces that end at zero."""
        time, ends = np.arange(self.measured.size) + 1.0, np.arange(1, pieces + 1) / max(pieces, 1)
        columns = np.maximum(ends - time[:, None] / self.measured.size, 0.0)
        return np.asarray(columns * self.measured[:, None])

    def colour(self, error: FloatArray) -> Autoregression:
        """Return the noise model of a residual (K,)."""
        return Autoregression.of_residual(error, self.predecessors, max(self.count, 1))

    def _coloured(self, error: FloatArray, noise: Autoregression) -> float:
        likelihood, own = self._of_own_variance(error, noise), self.colour(error)
        return max(likelihood, self._of_own_variance(error, own) - own.order * self.price)

    def _of_own_variance(self, error: FloatArray, noise: Autoregression) -> float:
        white, likelihood = noise.whiten_known(error, self.predecessors) ** 2, 0.0
        for part in self.parts:
            count = int(self.measured[part].sum())
            likelihood -= 0.5 * count * math.log(float(white[part].sum()) / count + self.least)
        return likelihood
