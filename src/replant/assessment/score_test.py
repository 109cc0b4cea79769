r"""The score test: what a named alternative could explain of a model's residual, and whether that may be chance.

An alternative is a few columns C: signals that the residual would hold if the alternative were so.  Known columns Z,
the model's own slopes and nuisances, have had their part already.  All are filtered by the autoregression that whitens
the residual e,

.. math:: w = D e, \qquad C' = D C - Z' (Z'^T Z')^{-1} Z'^T D C, \qquad Z' = D Z,

and what is left of the columns explains of w, where the model is right,

.. math:: w^T C' (C'^T C')^{-1} C'^T w / \sigma^2 \sim \chi^2.

As nothing of Z is left in C', the samples that the model was made from can test it.  Noise of more colour than D takes
widens the scores: by how much is seen in those of stretches of the record.  How large the part is, is told by the
columns as they are in the output.

Sources: Rao (1948), "Large sample tests of statistical hypotheses concerning several parameters", Proc. Cambridge Phil.
Soc. 44; Soderstrom and Stoica (1989), "System Identification", section 11.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray
from replant.statistics.autoregression import LEAST, Autoregression, sums_of
from replant.statistics.linear_algebra import chi2_quantile
from replant.statistics.projections import TAKEN_AWAY, lengths_of, orthogonal, products

ALPHA = 1e-4
"""Chance that a test finds something where there is nothing [probability].
Level: 0.01 %: the verdict is asked for many times in a run.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MATTERS = 0.01
"""What matters: a tenth of the output's amplitude [part of the output's power].
Origin: a choice of what a user may rely on.
Sensitivity: not measured.
"""

LEFT = 1e-6
"""Length of a column, what known ones explain of it, below which the samples cannot tell it from them [part of its
length].
Derivation: the square root of what rounding leaves of a column's power.
"""

STRETCHES = 16
"""Stretches of the record whose scores tell how far these scatter [count].
Derivation: with two columns and more their scatter is known to a quarter.
"""

WIDER = 4.0
"""Scatter of the scores beyond which it is no chance [standard deviations].
Level: a normal deviate beyond 4 has the chance 3e-5.
"""


@dataclass(frozen=True, eq=False)
class Explained:
    """What an alternative could still explain of a residual.

    Attributes
    ----------
    weights : (C,) array
        Of its columns.
    power : float
        Mean square of the part, less its expected value under noise alone; in the output's unit squared.
    std : float
        Standard deviation of ``power``.
    statistic : float
        The test statistic over its limit: above 1 the part is no chance.
    spread : float
        Standard deviation of the weight of a single column; infinite where the samples cannot tell it.
    """

    weights: FloatArray
    power: float = 0.0
    std: float = 0.0
    statistic: float = 0.0
    spread: float = math.inf

    @property
    def is_sure(self) -> bool:
        """Whether the part is no chance."""
        return self.statistic > 1.0


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual less what known columns explain of it, whitened.

    Attributes
    ----------
    noise : Autoregression
        Of the residual.
    known : (K, N) array
        The known columns, scaled to one.
    white_known, from_known : (U, N) and (N, R) arrays
        Whitened, the samples used alone, and what makes them orthonormal.
    white : (U,) array
        The whitened residual.
    lengths : (N,) array
        Of the known columns as they were given.
    past, used : (K,) arrays
        See `of`.
    """

    noise: Autoregression
    known: FloatArray
    white_known: FloatArray
    from_known: FloatArray
    white: FloatArray
    lengths: FloatArray
    past: IntArray
    used: BoolArray

    @classmethod
    def of(
        cls, error: FloatArray, known: FloatArray, past: IntArray, used: BoolArray, noise: Autoregression | None = None
    ) -> Residual:
        """Return that of an error (K,) and known columns (K, N); a constant is always known."""
        known = np.column_stack([known, np.ones(error.size)])
        lengths = lengths_of(known)
        known = known / lengths
        error = error - error[used].mean()
        noise = _noise_of(error, past) if noise is None else noise
        white_known, white = noise.whiten_known(known, past)[used], noise.whiten_known(error, past)[used]
        basis = orthogonal(products(white_known, white_known))
        explained = basis @ (basis.T @ products(white_known, white[:, None])[:, 0])
        white = white - np.einsum("ij,j->i", white_known, explained)
        return cls(noise, known, white_known, basis, white, lengths, past, used)

    def beside(self, error: FloatArray, effect: FloatArray) -> Residual:
        """Return that of the same error (K,), whitened by the noise that an effect (K,) leaves of it."""
        left = error - effect
        noise = _noise_of(left - left[self.used].mean(), self.past)
        return Residual.of(error, self.known[:, :-1], self.past, self.used, noise)

    def _whitened(self, columns: FloatArray) -> FloatArray:
        """Return columns (K, C) filtered by the noise model, over the samples used."""
        return np.asarray(self.noise.whiten_known(columns, self.past)[self.used])

    def weights_of(self, columns: FloatArray) -> FloatArray:
        """Return the weights (N, C) with which the known columns make up for columns (K, C)."""
        along = products(self.white_known, self._whitened(columns))
        return np.asarray(self.from_known @ (self.from_known.T @ along) / self.lengths[:, None])

    def explained(self, columns: FloatArray, spent: int = 0) -> Explained:
        """Return what columns (K, C) could explain of it."""
        weights = np.zeros(columns.shape[1])
        columns = columns - columns[self.used].mean(axis=0)
        filtered = self._whitened(columns)
        before = lengths_of(filtered)
        along = self.from_known @ (self.from_known.T @ products(self.white_known, filtered))
        left = filtered - self.white_known @ along
        lengths = lengths_of(left)
        told = columns.any(axis=0) & (lengths > LEFT * before) & (before > TAKEN_AWAY * lengths_of(columns))
        if not told.any() or not float(self.white @ self.white) > 0.0:
            return Explained(weights)
        left = left[:, told] / lengths[told]
        whole = (columns - self.known @ along)[self.used][:, told] / lengths[told]
        basis = orthogonal(products(left, left))
        amounts = basis.T @ products(left, self.white[:, None])[:, 0]
        count, part = amounts.size, float(amounts @ amounts)
        if not count:
            return Explained(weights)
        weights[told] = basis @ amounts / lengths[told]
        rest = self.white - left @ (basis @ amounts)
        variance = float(rest @ rest) / max(self.white.size - count - self.from_known.shape[1], 1)
        if not variance > 0.0:
            return Explained(weights, float(np.mean((whole @ basis @ amounts) ** 2)), 0.0, math.inf, 0.0)
        variance *= _widening(left @ basis, rest, variance)
        gram = basis.T @ products(whole, whole) @ basis
        output = gram @ amounts
        size = self.white.size
        power = (float(amounts @ output) - variance * float(np.trace(gram))) / size
        std = math.sqrt(variance * (2.0 * variance * float(np.sum(gram**2)) + 4.0 * float(output @ output))) / size
        limit = variance * float(chi2_quantile(1.0 - ALPHA, max(count - spent, 1)))
        spread = math.sqrt(variance) / float(lengths[told][0]) if count == 1 else math.inf
        return Explained(weights, max(power, 0.0), std, part / limit, spread)


def _noise_of(error: FloatArray, past: IntArray) -> Autoregression:
    sums, count = sums_of(error, past)
    return Autoregression.of_sums(sums, count) if count >= LEAST else Autoregression.white(1.0, count)


def _widening(basis: FloatArray, rest: FloatArray, variance: float) -> float:
    """Return by how much colour widens the scores of stretches of a residual's rest (K,); 1 where that may be chance.

    Of a white rest the squares of the scores have the mean of those of the columns (K, R) there, times its variance.
    """
    parts = np.array_split(np.arange(rest.size), STRETCHES)
    squares = sum(float(np.sum((basis[part].T @ rest[part]) ** 2)) for part in parts)
    wider = squares / (basis.shape[1] * variance)
    chance = WIDER * math.sqrt(2.0 / (STRETCHES * basis.shape[1]))
    return wider if wider > 1.0 + chance else 1.0
