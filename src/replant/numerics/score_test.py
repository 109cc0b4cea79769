r"""The score test: what named columns could explain of a residual, and whether that may be chance.

Known columns Z, the model's own slopes and nuisances, have had their part already.  All are filtered by the
autoregression that whitens the residual e,

.. math:: w = D e, \qquad C' = D C - Z' (Z'^T Z')^{-1} Z'^T D C, \qquad Z' = D Z,

and what is left of the columns explains of w, where the model is right,

.. math:: w^T C' (C'^T C')^{-1} C'^T w / \sigma^2 \sim \chi^2.

As nothing of Z is left in C', the samples that the model was made from can test it.  A model of other samples, whose
slopes S are then not among Z, has an error with a covariance P, which adds :math:`C'^T D S P S^T D^T C'` to that of the
scores.  Noise of more colour than D takes widens the scores: by how much is seen in those of stretches of the record.
How large the part is, is told by the columns as they are in the output.

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
    exactly: float = 0.0  # the same if the model's coefficients were exact, see ``own`` of `Residual.explained`
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
class Whitening:
    """A noise model, and the samples that it whitens."""

    noise: Autoregression
    past: IntArray  # (K,): how many samples in a row come before each
    used: BoolArray | slice  # (K,), or all
    unbroken: IntArray | None  # (K,): the same where the samples not used count; None where their part is not known

    def of(self, signals: FloatArray) -> FloatArray:
        """Return signals (K, ...) whitened (W, ...), in as many degrees of freedom as there are samples used."""
        noise, unbroken, used = self.noise, self.unbroken, self.used
        if unbroken is None or isinstance(used, slice) or not noise.order:
            return np.asarray(noise.whiten_known(signals, self.past)[used])
        # by a shorter past the samples behind holes are not independent: slow noise puts them on one level
        return noise.without_unknown(noise.whiten_known(signals, unbroken), unbroken, np.flatnonzero(~used))


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual (K,) less what known columns explain of it, whitened, over the samples used."""

    whitening: Whitening
    white: FloatArray  # (W,): the whitened residual
    known: FloatArray  # (K, N): the known columns, scaled to one
    lengths: FloatArray  # (N,): of these as they were given
    white_known: FloatArray  # (W, N): whitened
    from_known: FloatArray  # (N, R): what makes them orthonormal

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
        error = error - error[used].mean()
        noise = Autoregression.of_residual(error, past, error.size) if noise is None else noise
        known = np.column_stack([known, np.ones(error.size)])
        lengths = lengths_of(known)
        known /= lengths
        whitening = Whitening(noise, past, used, unbroken)
        return cls._projected(whitening, whitening.of(error), known, lengths, whitening.of(known))

    @classmethod
    def _projected(
        cls, whitening: Whitening, white: FloatArray, known: FloatArray, lengths: FloatArray, white_known: FloatArray
    ) -> Residual:
        """Return it less what the known columns explain of it."""
        basis = orthogonal(products(white_known, white_known))
        explained = basis @ (basis.T @ products(white_known, white[:, None])[:, 0])
        white = white - np.einsum("ij,j->i", white_known, explained)
        return cls(whitening, white, known, lengths, white_known, basis)

    def knowing(self, columns: FloatArray) -> Residual:
        """Return it where further columns (K, C) are known."""
        lengths = lengths_of(columns)
        columns = columns / lengths
        known, lengths = np.hstack([self.known, columns]), np.append(self.lengths, lengths)
        white_known = np.hstack([self.white_known, self.whitening.of(columns)])
        return self._projected(self.whitening, self.white, known, lengths, white_known)

    def beside(self, error: FloatArray, effect: FloatArray) -> Residual:
        """Return that of the same error (K,), whitened by the noise that an effect (K,) leaves of it."""
        used, left = self.whitening.used, error - effect
        noise = Autoregression.of_residual(left - left[used].mean(), self.whitening.past, left.size)
        whitening = replace(self.whitening, noise=noise)
        white = whitening.of(error - error[used].mean())
        return self._projected(whitening, white, self.known, self.lengths, whitening.of(self.known))

    def weights_of(self, columns: FloatArray) -> FloatArray:
        """Return the weights (N, C) with which the known columns make up for columns (K, C)."""
        return np.asarray(self._along(self.whitening.of(columns)) / self.lengths[:, None])

    def left_of(self, columns: FloatArray, weights: FloatArray) -> FloatArray:
        """Return what columns (K, C) by their weights (C,) make beside the known ones (K,)."""
        left = combined(columns, weights) - combined(self.known, self._along(self.whitening.of(columns)) @ weights)
        return np.asarray(left - left[self.whitening.used].mean())

    def explained(
        self, columns: FloatArray, spent: int = 0, *, measures_chance: bool = False,
        own: tuple[FloatArray, FloatArray] | None = None,
    ) -> Explained:  # fmt: skip
        """Return what columns (K, C) could explain of it; how large that is, only if it is sure, or chance counts.

        ``own``: slopes (K, N) of a model that was made from other samples, and the covariance (N, N) of its error.
        """
        from scipy.special import fdtrc  # slow to import

        weights = np.zeros(columns.shape[1])
        columns = columns - columns[self.whitening.used].mean(axis=0)
        filtered = self.whitening.of(columns)
        before, along = lengths_of(filtered), self._along(filtered)
        left = filtered - combined(self.white_known, along)
        lengths = lengths_of(left)
        told = columns.any(axis=0) & (lengths > LEFT * before) & (before > TAKEN_AWAY * lengths_of(columns))
        if not told.any() or not sum_of_squares(self.white) > 0.0:
            return Explained(weights)
        left = (left if told.all() else left[:, told]) / lengths[told]
        basis = orthogonal(products(left, left))
        amounts = basis.T @ products(left, self.white[:, None])[:, 0]
        count, part = amounts.size, sum_of_squares(amounts)
        if not count:
            return Explained(weights)
        weights[told] = basis @ amounts / lengths[told]
        rest = self.white - combined(left, basis @ amounts)
        size = len(self.whitening.past[self.whitening.used])
        free = max(size - count - self.from_known.shape[1], 1)
        variance = sum_of_squares(rest) / free
        if not variance > 0.0:
            made = float(np.mean(self.left_of(columns, weights)[self.whitening.used] ** 2))
            return Explained(weights, made, 0.0, math.inf, math.inf, 0.0, 0.0)
        chance = float(fdtrc(count, free, part / count / variance))  # colour that the noise model leaves counts
        variance *= widening(left, rest, variance, basis)
        limit = float(chi2_quantile(1.0 - ALPHA, max(count - spent, 1)))
        exactly = statistic = part / (variance * limit)
        if own is not None:
            slopes = basis.T @ products(left, self.whitening.of(own[0]))
            spread, places = np.linalg.eigh(slopes @ own[1] @ slopes.T)
            statistic = sum_of_squares((places.T @ amounts) / np.sqrt(variance + np.maximum(spread, 0.0))) / limit
        deviation = math.sqrt(variance) / float(lengths[told][0]) if count == 1 else math.inf
        roots = np.zeros((weights.size, count))
        roots[told] = math.sqrt(variance) * basis / lengths[told][:, None]
        found = Explained(weights, 0.0, 0.0, statistic, exactly, chance, deviation, roots)
        if not (found.is_sure or measures_chance):
            return found
        whole = (columns - combined(self.known, along))[self.whitening.used]  # as they are in the output
        square = products(whole, whole)
        gram, output = roots.T @ square @ roots, square @ weights
        power = (float(weights @ output) - float(np.trace(gram))) / size
        std = math.sqrt(2.0 * float(np.sum(gram**2)) + 4.0 * sum_of_squares(roots.T @ output)) / size
        return replace(found, power=max(power, 0.0), std=std)

    def _along(self, white: FloatArray) -> FloatArray:
        """Return what of the known columns, scaled to one, whitened columns (W, C) hold (N, C)."""
        return np.asarray(self.from_known @ (self.from_known.T @ products(self.white_known, white)))
