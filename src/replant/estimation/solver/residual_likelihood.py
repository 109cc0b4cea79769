"""How likely a residual is over a stretch of samples: with the noise known from before, or with other noise at a price.

A stretch may have parts of which each has a variance of its own.  Another colour, and a load that drifts along a broken
line, cost ln(K) / 2 for each number, as Bayes' criterion has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.estimation.engine.record import Record
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import combined, least_norm, quiet

PIECES = 1, 2, 4  # pieces of the broken lines that a load may drift along; a line has to pay for them [count]
# a thousandth of what a converter of 20 bits resolves
FINEST = 1e-9  # deviation of a residual below which it is no evidence [part of the output's standard deviation]
# some thousand times float64's precision
WEAKEST = 1e-12  # singular value below which a direction counts as not there [part of the largest]


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of K samples, and what the likelihood of a residual is told by."""

    predecessors: IntArray  # (K,), residuals before each that are one sampling time apart
    measured: BoolArray  # (K,), residuals that count; the others are zero
    parts: tuple[slice, ...]  # those of a variance of their own
    least: float  # variance that a residual is not told below

    @classmethod
    def of(cls, record: Record, rows: slice, middle: int = 0) -> Stretch:
        """Return the ``rows`` of a record, parted behind so many of them."""
        measured = record.is_measured[rows]
        parts = tuple(part for part in (slice(0, middle), slice(middle, measured.size)) if measured[part].any())
        least = (FINEST * float(np.std(record.y) if record.y.size else 0.0)) ** 2 + np.finfo(float).tiny
        return cls(record.predecessors[rows], measured, parts, least)

    @property
    def count(self) -> int:
        """How many residuals count."""
        return int(self.measured.sum())

    @property
    def price(self) -> float:
        """What a number costs that is fitted."""
        return 0.5 * math.log(max(self.count, 2))

    @quiet
    def of_usual(self, error: FloatArray, noise: Autoregression, variance: float, *, last: bool = False) -> float:
        """Return the log-likelihood of a residual (K,) of noise that is known, up to a constant that all share."""
        white, likelihood = noise.whiten_known(error, self.predecessors) ** 2, 0.0
        for part in self.parts:
            count = int(self.measured[part].sum())
            own = float(white[part].sum()) / count + self.least
            usual = own if last and part is not self.parts[-1] else variance + self.least
            likelihood -= 0.5 * count * (math.log(usual) + own / usual - 1.0)
        return likelihood

    @quiet
    def of_other(self, error: FloatArray, noise: Autoregression, beside: FloatArray | None = None) -> float:
        """Return the same where each part has the variance that makes it most likely, and the price is taken off."""
        if not np.isfinite(error).all():
            return -math.inf
        # another colour, and beside the nuisances (K, C) a load that drifts, where they pay for themselves
        return self._drifted(error, noise, beside)[0] - self.price

    @quiet
    def line(self, error: FloatArray, noise: Autoregression, beside: FloatArray) -> FloatArray:
        """Return the columns (K, P) of the line along which a residual drifts, zero at its end; P = 0 if none pays."""
        return self._columns(self._drifted(error, noise, beside)[1] if np.isfinite(error).all() else 0)

    def _drifted(self, error: FloatArray, noise: Autoregression, beside: FloatArray | None) -> tuple[float, int]:
        """Return the largest log-likelihood of a residual less some line, paid for, and the line's pieces."""
        lines = [(0, error)]
        if beside is not None:
            lines += [(pieces, self._less_line(error, pieces, beside)) for pieces in PIECES]
        tried = [(self._coloured(left, noise) - pieces * self.price, pieces) for pieces, left in lines]
        return max(tried, key=lambda each: each[0])

    def _columns(self, pieces: int) -> FloatArray:
        """Return what broken lines (K, P) of so many pieces are made of that end at zero."""
        time, ends = np.arange(self.measured.size) + 1.0, np.arange(1, pieces + 1) / max(pieces, 1)
        columns = np.maximum(ends - time[:, None] / self.measured.size, 0.0)
        return np.asarray(columns * self.measured[:, None])

    def _less_line(self, error: FloatArray, pieces: int, beside: FloatArray) -> FloatArray:
        """Return a residual (K,) less the line of so many pieces that explains it best beside the nuisances."""
        line = np.column_stack([beside, self._columns(pieces)])
        return np.asarray(error - combined(line, least_norm(line, error, WEAKEST)[0]))

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
