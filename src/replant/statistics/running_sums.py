"""Running sums of a record that comes batch by batch: the output's spread, the residual's power and its innovation's.

The sums of the products e_{k-i} e_{k-j} of a residual are those that its autoregression is made from, so that no second
pass is needed, whatever mean is subtracted in the end.
"""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.kernels.schema import LAGS
from replant.statistics.autoregression import LEAST, Autoregression


class OutputSums:
    """Number and spread of the measured outputs."""

    def __init__(self) -> None:
        self.count, self._level, self._sum, self._squares = 0, 0.0, 0.0, 0.0
        self._least, self._most = math.inf, -math.inf

    def take(self, y: FloatArray) -> None:
        """Take outputs (K,)."""
        if y.size == 0:
            return
        if self.count == 0:
            self._level = float(y.mean())
        self._least, self._most = min(self._least, float(y.min())), max(self._most, float(y.max()))
        moved = y - self._level
        self.count += y.size
        self._sum += float(moved.sum())
        self._squares += float(moved @ moved)

    @property
    def spread(self) -> float:
        """Sum of (y - mean y)^2; 0 for a constant output."""
        if self._least == self._most:
            return 0.0
        return self._squares - self._sum**2 / self.count


class ErrorSums:
    """Sums of products of the residual and its past, from which any mean can be subtracted afterwards."""

    def __init__(self) -> None:
        self._lags = LAGS
        self._past, self._known_past = np.zeros(LAGS), np.zeros(LAGS, bool)
        self._samples = 0
        size = LAGS + 2
        #: Products of (e_k .. e_{k-LAGS}, 1) over every sample (unknown ones are zeros) and over those with a known
        #: past, and of (e_k, 1) over the known ones that remain
        self._all, self._usable, self._rest = np.zeros((size, size)), np.zeros((size, size)), np.zeros((2, 2))
        self._head, self._known_head = np.zeros(0), np.zeros(0, bool)  # the first samples
        self._pairs = np.zeros(LAGS + 1)  # by lag: how many samples are known together with the one lag samples before
        self._sums = np.zeros(LAGS + 1)  # by lag: the sum of e_k + e_{k-lag} over them

    def take(self, error: FloatArray, known: BoolArray) -> None:
        """Take residuals (K,), zero where they are not known."""
        lags, count = self._lags, error.size
        if count == 0:
            return
        whole, there = np.concatenate([self._past, error]), np.concatenate([self._known_past, known])
        stack = np.ones((lags + 2, count))
        for lag in range(lags + 1):
            stack[lag] = whole[lags - lag : lags - lag + count]
        if there.all():
            products = stack @ stack.T
            self._all[0] += products[0]
            self._usable += products
            self._pairs += count
            self._sums += products[0, -1] + products[:-1, -1]
        else:
            self._take_some(stack, there)
        self._past, self._known_past = whole[-lags:].copy(), there[-lags:].copy()
        self._samples += count

    def _take_some(self, stack: FloatArray, there: BoolArray) -> None:
        """Take residuals of which some are unknown: row i of ``stack`` has lag i, ``there`` says which are known."""
        lags, count, error = self._lags, stack.shape[1], stack[0]
        known = there[lags:]
        for lag in range(lags + 1):
            both = known & there[lags - lag : lags - lag + count]
            self._pairs[lag] += np.count_nonzero(both)
            self._sums[lag] += float(((error + stack[lag]) * both).sum())
        self._all[0] += stack @ error
        follows = np.convolve(~there, np.ones(lags + 1))[lags : lags + count] == 0  # all lags are known
        alone = known & ~follows
        if self._samples == 0:  # the first samples have zeros, without a mean, as their past: `_of_head` sums them
            self._head, self._known_head = error[:lags].copy(), known[:lags].copy()
            alone[:lags] = False
        usable = stack[:, follows]
        self._usable += usable @ usable.T
        single = np.stack([error[alone], np.ones(np.count_nonzero(alone))])
        self._rest += single @ single.T

    @property
    def mean(self) -> float:
        """Mean of the residuals that are known."""
        return float(self._all[0, -1] / self._pairs[0])

    def power(self, mean: float) -> float:
        """Return the sum of (e - mean)^2."""
        return float(self._covariances(mean)[0])

    def innovation(self, mean: float) -> float:
        """Return the sum of w^2; where the past of a residual is not known, w is the residual itself."""
        count = float(self._usable[-1, -1])
        if self._samples <= self._lags or count < LEAST:
            return self.power(mean)
        # with (e_k - mean) for e_k
        shift = mean * self._usable[:-1, -1]
        sums = self._usable[:-1, :-1] - shift[:, None] - shift[None, :] + mean**2 * count
        model = np.zeros(self._lags + 1)
        chosen = Autoregression.of_sums(sums, count).coefficients
        model[: chosen.size] = chosen
        weights = np.append(model, -mean * model.sum())
        alone = np.array([1.0, -mean])
        return float(weights @ self._usable @ weights + alone @ self._rest @ alone) + self._of_head(model, mean)

    def _of_head(self, model: FloatArray, mean: float) -> float:
        """Return the sum of w^2 over the first samples, which have no past of full length."""
        error = np.where(self._known_head, self._head - mean, 0.0)
        predicted = np.convolve(model, error)[: error.size]
        follows = np.cumsum(~self._known_head) == 0
        return float((np.where(follows, predicted, error) ** 2).sum())

    def _covariances(self, mean: float) -> FloatArray:
        return self._all[0, :-1] - mean * self._sums + mean**2 * self._pairs
