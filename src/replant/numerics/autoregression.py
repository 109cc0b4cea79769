"""Autoregression: the model D(q) e = w that whitens a residual; and the regular grid of samples.

Models of every order up to `LAGS` are fitted by least squares to sums of products e_{k-i} e_{k-j} over the samples
whose predecessors are all known, see `replant.kernels.filters.autoregressions`.  The Bayesian information criterion
chooses the order; white noise gets order 0 and is not filtered.

Sources: Ljung (1999), "System Identification: Theory for the User", section 16.6; Soderstrom and Stoica (1989), "System
Identification", section 11.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replant.kernels.schema import LAGS
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.linear_algebra import chi2_quantile, inner, quiet, roots, sum_of_squares

WHITENESS_LAGS = 25
"""Number of lags of the portmanteau statistic [samples].
Origin: a usual number for records of hundreds to thousands of samples.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

WHITENESS_LEVEL = 0.99  # level of the portmanteau statistic's limit [probability]
# four for each parameter of a model of the largest order
LEAST = 4 * (LAGS + 1)  # samples with known predecessors below which a residual is assumed to be white [samples]


def duration_of(coefficients: FloatArray) -> float:
    """Return after how many samples the noise 1/D (p + 1,) is nearly independent: twice its e-fold decay time.

    >>> duration_of(np.array([1.0])), round(duration_of(np.array([1.0, -0.9])))
    (1.0, 19)
    """
    slowest = float(np.abs(roots(coefficients)).max(initial=0.0))
    if slowest >= 1.0:
        return math.inf
    return max(-2.0 / math.log(slowest), 1.0) if slowest > 0.0 else 1.0


@dataclass(frozen=True, eq=False)
class Autoregression:
    r"""The model :math:`e_k + d_1 e_{k-1} + \ldots + d_p e_{k-p} = w_k`, w white."""

    coefficients: FloatArray  # (p + 1,): 1, d_1 .. d_p, in falling powers of the shift q
    power: float  # sum of w^2 over the samples that the model was fitted to
    models: FloatArray  # (LAGS + 1, LAGS + 1): row j: the best model of order j, 1, d_1 .. d_j, 0 ..
    powers: FloatArray  # (LAGS + 1,): sum of w^2 of each
    sums: FloatArray  # (LAGS + 1, LAGS + 1): of e_{k-i} e_{k-j}, lower triangle
    count: float  # samples that the models were fitted to

    @property
    def order(self) -> int:
        """The order p."""
        return self.coefficients.size - 1

    @property
    def variances(self) -> FloatArray:
        """Variance (LAGS + 1,) of the residual of each order's model."""
        return np.asarray(self.powers / max(self.count, 1.0))

    @classmethod
    def of(cls, error: FloatArray) -> Autoregression:
        """Return the model of ``error`` (K,), every sample finite."""
        return cls.of_residual(error, np.minimum(np.arange(error.size), LAGS), error.size)

    @classmethod
    def of_sums(cls, sums: FloatArray, count: float) -> Autoregression:
        """Return the model for sums of e_{k-i} e_{k-j}, (LAGS + 1, LAGS + 1), over ``count`` samples."""
        from replant.kernels.filters.autoregressions import nested_models

        size = LAGS + 1
        lower, models, variances = np.tril(sums), np.empty((size, size)), np.empty(size)
        order = int(nested_models(lower, float(count), models, variances, np.empty(size * size + size)))
        powers = variances * max(float(count), 1.0)
        return cls(models[order, : order + 1].copy(), float(powers[order]), models, powers, lower, float(count))

    @classmethod
    def of_covariances(cls, covariances: FloatArray) -> Autoregression:
        """Return the model of order LAGS from sums (LAGS + 1,) of e_k e_{k-lag}, by Levinson; poor for a smooth e."""
        from replant.kernels.monitoring import scatter

        size = covariances.size
        coefficients = np.empty(size)
        power = float(scatter.autoregression(covariances, coefficients, np.empty(size)))
        models = np.tile(coefficients, (size, 1))
        return cls(coefficients, power, models, np.full(size, power), np.zeros((size, size)), 1.0)

    @classmethod
    def of_residual(cls, error: FloatArray, known: IntArray, samples: int) -> Autoregression:
        """Return the model of a residual (K,); white if too few samples have ``known`` predecessors."""
        return cls.of_stretches([error], [known], samples)

    @classmethod
    def of_stretches(cls, errors: Sequence[FloatArray], known: Sequence[IntArray], samples: int) -> Autoregression:
        """Return one model of the residuals (K,) of several stretches, which have ``samples`` samples together."""
        found = [sums_of(*each) for each in zip(errors, known, strict=True)]
        sums, count = np.asarray(sum(each for each, _ in found)), sum(number for _, number in found)
        if count >= LEAST and np.isfinite(sums).all():
            return cls.of_sums(sums, count)
        return cls.white(float(sum(sum_of_squares(error) for error in errors)), samples)

    @classmethod
    def white(cls, power: float, count: float) -> Autoregression:
        """Return the model of order 0."""
        models = np.zeros((LAGS + 1, LAGS + 1))
        models[:, 0] = 1.0
        return cls(np.ones(1), power, models, np.full(LAGS + 1, power), np.zeros_like(models), float(count))

    def ahead(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...) along the first axis, with zeros before the first sample."""
        result = signals.copy()
        for lag in range(1, self.order + 1):
            result[lag:] += self.coefficients[lag] * signals[:-lag]
        return result

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` from the first sample with p predecessors on."""
        return self.ahead(signals)[self.order :]

    def whiten_known(self, signals: FloatArray, known: IntArray) -> FloatArray:
        """Return ``signals`` (K, ...), whitened along the first axis with as many predecessors as are known.

        A sample with j < p known ones is whitened by the best model of order j, whose residual has the larger variance
        V_j, and weighted by the root of V_p / V_j: the likelihood of an autoregression with a missing past.
        """
        from replant.kernels.filters import autoregressions

        if self.order == 0:
            return signals
        flat = np.ascontiguousarray(signals, np.float64).reshape(-1)
        result, channels = np.empty(flat.size), flat.size // max(known.size, 1)
        autoregressions.whiten_known(
            self.models, self._weights, flat, channels, np.ascontiguousarray(known, np.int64), result
        )
        return result.reshape(signals.shape)

    @property
    def _weights(self) -> FloatArray:
        """Factors (p + 1,) of samples with 0 .. p known predecessors."""
        return np.append(np.sqrt(self.powers[self.order] / self.powers[: self.order]), 1.0)

    def without_unknown(self, white: FloatArray, known: IntArray, missing: IntArray) -> FloatArray:
        """Return the result of `whiten_known` (K, ...) for the values at ``missing`` samples that minimise it.

        An impulse x at a missing sample m adds d_i x to sample m + i.  With these columns E the normal equations
        E'E x = -E'w have bandwidth p, and the remainder has the likelihood of the known samples.
        """
        from scipy.linalg import solveh_banded  # slow to import

        p, rows = self.order, missing[:, None] + np.arange(self.order + 1)
        there = rows < known.size
        rows = np.where(there, rows, 0)
        orders = np.minimum(known[rows], p)
        lags = np.arange(p + 1)
        impulses = np.where(there & (orders >= lags), self.models[orders, lags] * self._weights[orders], 0.0)
        left = white.reshape(len(white), -1).copy()
        right = np.zeros((missing.size, left.shape[1]))
        for lag in lags:
            right += impulses[:, lag, None] * left[rows[:, lag]]
        band = np.zeros((p + 2, missing.size))  # at least three rows: SciPy's routine for two fails with one sample
        for j in range(min(p + 1, missing.size)):
            early, late = impulses[: missing.size - j], impulses[j:]
            places = (missing[j:] - missing[: missing.size - j])[:, None] + lags  # lags of the late rows in the early
            shared = np.take_along_axis(early, np.minimum(places, p), axis=1)
            band[j, : missing.size - j] = np.sum(np.where(places <= p, shared, 0.0) * late, axis=1)
        try:
            amounts = solveh_banded(band, right, lower=True, check_finite=False)
        except np.linalg.LinAlgError:  # weights have overflowed
            return np.full_like(white, np.nan)
        for lag in lags:  # no two impulses meet at the same lag
            left[rows[:, lag]] -= impulses[:, lag, None] * amounts
        return left.reshape(white.shape)

    def whiten_whole(self, signals: FloatArray, known: IntArray, used: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Return D(q) x of ``signals`` (K, ...), 0 unless a used sample has p known predecessors; and a mask (K,)."""
        # samples with a shorter past still depend on those before the hole: slow noise shifts all of them alike
        whole = used & (known >= self.order)
        white = self.ahead(signals)
        white[~whole] = 0.0
        return white, whole

    def colour(self, signals: FloatArray) -> FloatArray:
        """Return x / D(q) of ``signals`` (K, ...) from rest; roots of D outside the unit circle are reflected."""
        from replant.kernels.filters.autoregressions import all_pole

        model, gain, places = self.coefficients, 1.0, roots(self.coefficients)
        outside = np.abs(places) > 1.0
        if outside.any():  # the gain keeps the magnitude
            moved = np.where(outside, 1.0 / np.conj(np.where(outside, places, 1.0)), places)
            model, gain = np.asarray(np.poly(moved).real), float(np.abs(places[outside]).prod())
        channels = all_pole(model, signals.reshape(signals.shape[0], -1).T)
        return np.ascontiguousarray(channels.T / gain).reshape(signals.shape)


def since_break(broken: BoolArray) -> IntArray:
    """Return the number of samples since the last break for each sample (K,); 0 at a break."""
    index = np.arange(broken.size)
    if not broken[1:].any():
        return index
    return index - np.maximum.accumulate(np.where(broken, index, 0))


def in_a_row(used: BoolArray, broken: BoolArray | bool = False) -> IntArray:
    """Return the number of used samples directly before each used one (K,), without a break; 0 if it is not used.

    >>> in_a_row(np.array([True, True, False, True, True]))
    array([0, 1, 0, 0, 1])
    """
    behind_hole = np.concatenate([[True], ~used[:-1]]) if used.size else ~used
    return np.where(used, since_break(behind_hole | broken), 0)


def sums_of(error: FloatArray, known: IntArray) -> tuple[FloatArray, int]:
    """Return sums (LAGS + 1, LAGS + 1) of e_{k-i} e_{k-j} over samples with LAGS known predecessors; their number."""
    from replant.kernels.filters import sums

    size = LAGS + 1
    found, work = np.empty((size, size)), (np.empty((size, sums.WIDTH)), np.empty((size * size, sums.WIDTH)))
    count = sums.lagged_products(np.ascontiguousarray(error), np.ascontiguousarray(known, np.int64), found, *work)
    return found, int(count)


@quiet
def likelihood_ratio(error: FloatArray, other: FloatArray) -> float:
    """Return K / 2 ln of the power ratio of two whitened residuals (K,): positive if the first is more likely."""
    # a residual that is not finite is the less likely one
    held, other_held = bool(np.isfinite(error).all()), bool(np.isfinite(other).all())
    if not (held and other_held):
        return 0.0 if held == other_held else math.inf if held else -math.inf
    size = max(float(np.abs(error).max(initial=0.0)), float(np.abs(other).max(initial=0.0)), np.finfo(float).tiny)
    scaled = error / size, other / size
    powers = [max(Autoregression.of(each - each.mean()).power, np.finfo(float).tiny) for each in scaled]
    return 0.5 * error.size * (math.log(powers[1]) - math.log(powers[0]))


@quiet
def one_step(residual: FloatArray) -> FloatArray:
    """Return the innovations (K,) of a residual; samples without a complete past keep their residual."""
    error = innovations(residual)
    return np.where(np.isfinite(error), error, residual)


def innovations(residual: FloatArray, end: int | None = None) -> FloatArray:
    """Return the innovations (K,) of a residual, NaN without a complete past; fitted to samples before ``end``."""
    if residual.size <= LAGS:
        return residual
    known = np.isfinite(residual)
    filled = np.where(known, residual, 0.0)
    usable = np.convolve(~known, np.ones(LAGS + 1))[: known.size] == 0
    whole = usable.copy()
    whole[:LAGS] = False
    if end is not None:
        whole[end:] = False
    sums, count = sums_of(filled, np.where(whole, LAGS, 0))
    if count < LEAST:
        return residual  # too few samples for a model
    error = np.convolve(filled, Autoregression.of_sums(sums, count).coefficients)[: filled.size]
    return np.where(usable, error, np.nan)


def ahead(coefficients: FloatArray, residual: FloatArray, horizon: int) -> FloatArray:
    """Return the prediction (K,) of the residual ``horizon`` samples ahead, by the companion matrix."""
    order = coefficients.size - 1
    if order == 0 or horizon >= residual.size:
        return np.zeros(residual.size)
    companion = np.eye(order, k=-1)
    companion[0] = -coefficients[1:]
    weights = np.concatenate([np.zeros(horizon), np.linalg.matrix_power(companion, horizon)[0]])
    return np.convolve(weights, residual)[: residual.size]


def whiteness(error: FloatArray, spent: int = 0, level: float = WHITENESS_LEVEL) -> float:
    r"""Return the portmanteau statistic :math:`\sum_\tau N_\tau \hat r_e^2(\tau)` of a residual (K,) over its limit."""
    # N_tau pairs are known; a noise model of ``spent`` coefficients takes as many degrees of freedom
    known = np.isfinite(error)
    error, count = np.where(known, error, 0.0), int(known.sum())
    lags = min(WHITENESS_LAGS, count // 4)
    power = sum_of_squares(error) / max(count, 1)
    if lags - spent < 1 or not power > 0.0:
        return 0.0
    pairs = [(slice(lag, None), slice(0, error.size - lag)) for lag in range(1, lags + 1)]
    sums = np.array([inner(error[late], error[early]) for late, early in pairs]) / power
    numbers = np.array([np.count_nonzero(known[late] & known[early]) for late, early in pairs])
    return float(np.sum(sums**2 / np.maximum(numbers, 1)) / chi2_quantile(level, lags - spent))


def places_on_grid(intervals: FloatArray, dt: float) -> IntArray:
    """Return the place (K,) of each sample on a grid of step ``dt``; of samples lost in a row at most LAGS count."""
    lost = np.clip(np.rint(np.minimum(intervals / dt, LAGS + 1.0)) - 1.0, 0.0, LAGS).astype(np.int64)
    return np.asarray(np.arange(intervals.size) + np.cumsum(lost))


def one_step_with_lost(residual: FloatArray, t: FloatArray, dt: float) -> FloatArray:
    """Return `one_step` of a residual (K,) on an irregular clock, where lost samples interrupt the known past."""
    places = places_on_grid(np.diff(t, prepend=t[:1] - dt), dt)
    spread = np.full(places[-1] + 1 if places.size else 0, np.nan)
    spread[places] = residual
    return one_step(spread)[places]
