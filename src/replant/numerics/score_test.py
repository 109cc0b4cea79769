r"""The score test: what named columns could explain of a residual, and whether that may be chance.

Known columns Z, the model's own slopes and nuisances, have had their part already.  All are filtered by the
autoregression that whitens the residual e,

.. math:: w = D e, \qquad C' = D C - Z' (Z'^T Z')^{-1} Z'^T D C, \qquad Z' = D Z,

and what is left of the columns explains of w, where the model is right,

.. math:: w^T C' (C'^T C')^{-1} C'^T w / \sigma^2 \sim \chi^2.

As nothing of Z is left in C', the samples that the model was made from can test it.  Noise of more colour than D takes
widens the scores: by how much is seen in those of stretches of the record.  How large the part is, is told by the
columns as they are in the output.

Sources: Rao (1948), "Large sample tests of statistical hypotheses concerning several parameters", Proc. Cambridge Phil.
Soc. 44; Ljung (1999), "System Identification: Theory for the User", sections 16.5 and 16.6; Soderstrom and Stoica
(1989), "System Identification", section 11.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, LARGEST_PART
from replant.numerics.linear_algebra import chi2_quantile, combined, products, sum_of_squares
from replant.numerics.projections import LEFT, TAKEN_AWAY, lengths_of, orthogonal, widening


@dataclass(frozen=True, eq=False)
class Explained:
    """What an alternative could still explain of a residual."""

    weights: FloatArray  # (C,): of its columns
    power: float = 0.0  # mean square of the part, less its expected value under noise alone
    std: float = 0.0  # of ``power``
    statistic: float = 0.0  # over its limit: above 1 the part is no chance
    chance: float = 1.0  # of so large a part in a residual that the noise model whitens, by the F distribution
    spread: float = math.inf  # standard deviation of the weight of a single column
    roots: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (C, R): R R' is the covariance of the weights

    @property
    def is_sure(self) -> bool:
        """Whether the part is no chance."""
        return self.statistic > 1.0

    @property
    def is_large(self) -> bool:
        """Whether, of a part of the output's power, it may exceed what a trusted model may leave unexplained."""
        return self.power + self.std > LARGEST_PART

    def of_output(self, output: FloatArray, error: FloatArray, used: BoolArray) -> Explained:
        """Return it as a part of an output's power, found of an error, both (K,), over the samples used (K,)."""
        # as Python's floats, which become infinite without a warning where the output is constant
        power, most = max(float(np.var(output[used])), float(np.finfo(float).tiny)), float(np.var(error[used]))
        return replace(self, power=min(float(self.power), most) / power, std=float(self.std) / power)


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual (K,) less what known columns explain of it, whitened, over the samples used."""

    noise: Autoregression  # of the residual
    known: FloatArray  # (K, N): the known columns, scaled to one
    white_known: FloatArray  # (W, N): whitened
    from_known: FloatArray  # (N, R): what makes them orthonormal
    white: FloatArray  # (W,): the whitened residual
    lengths: FloatArray  # (N,): of the known columns as they were given
    past: IntArray  # (K,): how many samples in a row come before each
    used: BoolArray | slice  # (K,), or all
    unbroken: IntArray | None  # (K,): the same where the samples not used count; None where their part is not known

    @classmethod
    def of(
        cls,
        error: FloatArray,
        known: FloatArray,
        past: IntArray,
        used: BoolArray | slice,
        noise: Autoregression | None = None,
        unbroken: IntArray | None = None,
    ) -> Residual:
        """Return that of an error (K,) and known columns (K, N); a constant is always known."""
        used = slice(None) if not isinstance(used, slice) and used.all() else used  # a view where a copy takes longer
        known = np.column_stack([known, np.ones(error.size)])
        lengths = lengths_of(known)
        known = known / lengths
        error = error - error[used].mean()
        noise = Autoregression.of_residual(error, past, error.size) if noise is None else noise
        white_known, white = (_whitened(noise, each, past, used, unbroken) for each in (known, error))
        basis = orthogonal(products(white_known, white_known))
        explained = basis @ (basis.T @ products(white_known, white[:, None])[:, 0])
        white = white - np.einsum("ij,j->i", white_known, explained)
        return cls(noise, known, white_known, basis, white, lengths, past, used, unbroken)

    def beside(self, error: FloatArray, effect: FloatArray) -> Residual:
        """Return that of the same error (K,), whitened by the noise that an effect (K,) leaves of it."""
        left = error - effect
        noise = Autoregression.of_residual(left - left[self.used].mean(), self.past, left.size)
        return Residual.of(error, self.known[:, :-1], self.past, self.used, noise, self.unbroken)

    def weights_of(self, columns: FloatArray) -> FloatArray:
        """Return the weights (N, C) with which the known columns make up for columns (K, C)."""
        along = products(self.white_known, self._whitened(columns))
        return np.asarray(self.from_known @ (self.from_known.T @ along) / self.lengths[:, None])

    def left_of(self, columns: FloatArray, weights: FloatArray) -> FloatArray:
        """Return what columns (K, C) by their weights (C,) make beside the known ones (K,)."""
        along = self.from_known @ (self.from_known.T @ products(self.white_known, self._whitened(columns)))
        left = combined(columns, weights) - combined(self.known, along @ weights)
        return np.asarray(left - left[self.used].mean())

    def explained(self, columns: FloatArray, spent: int = 0) -> Explained:
        """Return what columns (K, C) could explain of it."""
        from scipy.special import fdtrc  # slow to import

        weights = np.zeros(columns.shape[1])
        columns = columns - columns[self.used].mean(axis=0)
        filtered = self._whitened(columns)
        before = lengths_of(filtered)
        along = self.from_known @ (self.from_known.T @ products(self.white_known, filtered))
        left = filtered - combined(self.white_known, along)
        lengths = lengths_of(left)
        told = columns.any(axis=0) & (lengths > LEFT * before) & (before > TAKEN_AWAY * lengths_of(columns))
        if not told.any() or not sum_of_squares(self.white) > 0.0:
            return Explained(weights)
        left = left[:, told] / lengths[told]
        whole = (columns - combined(self.known, along))[self.used][:, told] / lengths[told]
        basis = orthogonal(products(left, left))
        amounts = basis.T @ products(left, self.white[:, None])[:, 0]
        count, part = amounts.size, sum_of_squares(amounts)
        if not count:
            return Explained(weights)
        weights[told] = basis @ amounts / lengths[told]
        rest = self.white - combined(left, basis @ amounts)
        size = len(self.past[self.used])
        free = max(size - count - self.from_known.shape[1], 1)
        variance = sum_of_squares(rest) / free
        if not variance > 0.0:
            return Explained(weights, float(np.mean((combined(whole, basis @ amounts)) ** 2)), 0.0, math.inf, 0.0, 0.0)
        chance = float(fdtrc(count, free, part / count / variance))  # colour that the noise model leaves counts
        variance *= widening(combined(left, basis), rest, variance)
        gram = basis.T @ products(whole, whole) @ basis
        output = gram @ amounts
        power = (float(amounts @ output) - variance * float(np.trace(gram))) / size
        std = math.sqrt(variance * (2.0 * variance * float(np.sum(gram**2)) + 4.0 * sum_of_squares(output))) / size
        limit = variance * float(chi2_quantile(1.0 - ALPHA, max(count - spent, 1)))
        spread = math.sqrt(variance) / float(lengths[told][0]) if count == 1 else math.inf
        roots = np.zeros((weights.size, count))
        roots[told] = math.sqrt(variance) * basis / lengths[told][:, None]
        return Explained(weights, max(power, 0.0), std, part / limit, chance, spread, roots)

    def _whitened(self, columns: FloatArray) -> FloatArray:
        return _whitened(self.noise, columns, self.past, self.used, self.unbroken)


def _whitened(
    noise: Autoregression, signals: FloatArray, past: IntArray, used: BoolArray | slice, unbroken: IntArray | None
) -> FloatArray:
    """Return signals (K, ...) whitened (W, ...), in as many degrees of freedom as there are samples used."""
    if unbroken is None or isinstance(used, slice) or not noise.order:
        return np.asarray(noise.whiten_known(signals, past)[used])
    # by a shorter past the samples behind holes are not independent of each other: slow noise puts them on one level
    return noise.without_unknown(noise.whiten_known(signals, unbroken), unbroken, np.flatnonzero(~used))
