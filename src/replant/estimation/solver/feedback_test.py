r"""The test for feedback: whether a record's input responds to the residual of a model.

The input is regressed on its own past, with a number of lags by Akaike's criterion.  The remainder is replaced by the
normal scores :math:`v_k` of its ranks, as a few large steps of the set-point would hide the response.  The present and
past whitened residuals :math:`w_{k-j}`, minus their regression on the same past, are :math:`z_k`.  In open loop

.. math:: s = \sum_k z_k v_k, \qquad s^T \left(\sum_k z_k z_k^T v_k^2\right)^{-1} s \sim \chi^2_{11},

for any distribution of the residual (White).  Samples with a gap in their past are left out, as the regression is wrong
there.  At j = 0 feedback cannot be distinguished from a direct path of the plant.  A model with a direct path includes
it, and the test begins at j = 1.

With several inputs, the present and past of the other inputs join the regression: an input that follows the others
correlates with the error of a wrong structure without any feedback.

Akaike's criterion also chooses the number of residuals that form the responding part of the input: a loop rings for
longer than the lags of the test.

Sources: Soderstrom and Stoica (1989), "System Identification", section 11.2 and chapter 10; Sims (1972), "Money,
income, and causality", American Economic Review 62; White (1980), "A heteroskedasticity-consistent covariance matrix
estimator and a direct test for heteroskedasticity", Econometrica 48.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from replant.estimation.simulation.fitted_run import triangle_of
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import combined, inner, least_norm, products, pseudo_inverse, quiet, sum_of_squares
from replant.numerics.projections import orthogonal
from replant.numerics.robust import normal_scores

# a digital controller responds at the next sample; a response at later samples alone is hardly feedback
ANSWERS = 10  # largest lag of a residual in the test [samples]

# Akaike's criterion chooses; of 42 recorded logs none needs more
LONGEST = 120  # most past values in the regression of the input [samples]
DIGITS = 1e-8  # unexplained part of a column's square above which a Cholesky factor keeps half of the digits [ratio]
SHORTEST = 15  # past values tried first [samples]

PER_COLUMN = 12
"""Samples per past value in the regression [samples].
Origin: of 250 random inputs of 200 to 600 samples, feedback of a tenth to four tenths of their amplitude is found in
80 % at a level of 0.1 %; without feedback in none, and in 5 % at a level of 5 %.
Sensitivity: halved, it is found in 78 %, doubled, in 65 %; the level is kept.
"""

NEWEST = 20_000  # most samples of the regression, for its time [samples]
RANK = 1e-12  # singular value that counts as zero [part of the largest]
ROUNDING = 1e-6  # remainder of a signal that is explained completely [part of its amplitude]
LOUDEST = 3.0  # largest amplitude of a response over the input's; a larger one is a nearly unstable filter's [ratio]


@dataclass(frozen=True, eq=False)
class Feedback:
    """How an input responds to a residual."""

    chance: float = 1.0  # p-value of open loop
    later: float = 1.0  # the same by past residuals alone
    at_once: float = 0.0  # correlation of input and residual of the same sample, in standard deviations
    part: float = 0.0  # share of the input's power, as far as its past does not explain it, that residuals explain

    @property
    def found(self) -> bool:
        """Whether there is feedback."""
        return self.chance < ALPHA

    @property
    def is_at_once(self) -> bool:
        """Whether only the residual of the same sample shows feedback, as a direct path of the plant would."""
        return self.found and not self.later < ALPHA

    def is_direct(self, structure: Structure, model: FloatArray) -> bool:
        """Return whether the correlation at the same sample has the sign of the plant's response, unlike feedback."""
        from scipy import special  # slow to import

        # a controller opposes a disturbance; dynamics faster than the model correlate input and residual with the sign
        # of the model's step response, if its first and last values agree in sign
        first, last = model[structure.poles], model[structure.coefficients - 1] * model[structure.poles - 1]
        return bool(first * last > 0.0) and float(special.ndtr(-self.at_once * np.sign(first))) < ALPHA


@quiet
def answering(
    u: FloatArray, w: FloatArray, before: IntArray, first: int = 0, others: Sequence[FloatArray] = ()
) -> Feedback:
    """Return how an input (K,) responds to a white residual (K,), 0 if unknown; ``before`` (K,): known predecessors."""
    # present and past of ``others`` (K,) join the regression, as the input may follow them
    most = _most(before)
    rows = np.flatnonzero(before >= max(most, ANSWERS))[-NEWEST:]
    if rows.size < PER_COLUMN * (ANSWERS + 2):
        return Feedback()
    # scaled to about one by powers of two, as the inputs of one regression may differ in units
    u, *others = (np.ldexp(x, -int(np.frexp(np.abs(x).max(initial=0.0))[1])) for x in (u, *others))
    now, told, _ = _answers(u, w, rows, most, range(first, ANSWERS + 1), others)
    if not sum_of_squares(now) > ROUNDING**2 * sum_of_squares(u):
        return Feedback()  # the input is known from its past
    moments = normal_scores(now)[:, None] * told
    sizes = math.sqrt(sum_of_squares(now)) * math.sqrt(sum_of_squares(told[:, 0]))
    at_once = math.sqrt(rows.size) * inner(now, told[:, 0]) / sizes if sizes > 0.0 and not first else 0.0
    amounts = orthogonal(products(told, told)).T @ products(told, now[:, None])
    part = sum_of_squares(amounts[:, 0]) / sum_of_squares(now)
    return Feedback(_chance(moments), _chance(moments[:, 1 - first :]), at_once, part)


@quiet
def part_answering(u: FloatArray, w: FloatArray, before: IntArray) -> FloatArray:
    """Return the part (K,) of an input that responds to a whitened residual, propagated by the input's own past."""
    from replant.kernels.filters.autoregressions import all_pole

    most = _most(before)
    latest = max(most, ANSWERS)
    rows = np.flatnonzero(before >= latest)[-NEWEST:]
    now, told, own = _answers(u, w, rows, most, range(latest + 1))
    told = told[:, : max(_fewest(_triangle(np.column_stack([told, now])), rows.size), ANSWERS + 1)]
    gains = least_norm(told, now, RANK)[0]
    weights = combined(own[:, : gains.size + 1], np.append(1.0, -gains))
    push = np.convolve(w, gains)[: u.size]
    answer = all_pole(np.append(1.0, -weights[1:]), push[None])[0]
    held = bool(np.isfinite(answer).all()) and sum_of_squares(answer) <= LOUDEST**2 * sum_of_squares(u)
    return answer if held else push


def _answers(
    u: FloatArray, w: FloatArray, rows: IntArray, most: int, lags: range, others: Sequence[FloatArray] = ()
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return input (K,) and residuals (K, L) minus their regression on the input's past, and its weights."""
    past, inverse = _known_past(u.tobytes(), most, rows.tobytes(), *(each.tobytes() for each in others))
    left = np.column_stack([u[rows], *(w[rows - lag] for lag in lags)])
    own = np.zeros((past.shape[1], left.shape[1]))
    for _ in range(2):  # twice, to remove rounding
        more = inverse @ (inverse.T @ products(past, left))
        left, own = left - combined(past, more), own + more
    return left[:, 0], left[:, 1:], own


def _chance(moments: FloatArray) -> float:
    """Return the p-value of zero expectation for moments (K, C)."""
    from scipy.special import chdtrc  # slow to import

    total = moments.sum(axis=0)
    return float(chdtrc(total.size, max(total @ pseudo_inverse(products(moments, moments), RANK) @ total, 0.0)))


def _most(before: IntArray) -> int:
    """Return the most past values in the regression of an input with ``before`` (K,) known predecessors."""
    longest = min(LONGEST, before.size // PER_COLUMN)
    whole = before.size - np.cumsum(np.bincount(np.minimum(before, longest), minlength=longest + 1))
    lags = np.arange(longest + 1)
    there = np.append(before.size, whole[:-1])  # samples with at least so many before them
    return int(lags[there >= (PER_COLUMN - 1) * lags][-1])


@lru_cache(maxsize=1)  # a search tests one input with many structures
def _known_past(signal: bytes, most: int, samples: bytes, *others: bytes) -> tuple[FloatArray, FloatArray]:
    """Return the past (K, C) that explains an input at some samples, by Akaike's criterion, and its inverse R."""
    u, rows, beside = np.frombuffer(signal), np.frombuffer(samples, np.int64), [np.frombuffer(x) for x in others]
    told = [each for lag in range(1, most + 1) for each in ((u, lag), *((x, lag - 1) for x in beside))][:most]
    lags, best = -1, 0
    while lags < most and 2 * best > lags:  # twice as many lags only if the farther half explains something
        lags = min(max(2 * lags, SHORTEST), most)
        past = np.column_stack([np.ones(rows.size), *(x[rows - lag] for x, lag in told[:lags]), u[rows]])
        upper = _triangle(past)
        best = _fewest(upper[1:, 1:], rows.size)
    return past[:, : best + 1], np.asarray(np.linalg.pinv(upper[: best + 1, : best + 1], RANK))


def _fewest(upper: FloatArray, samples: int) -> int:
    """Return how many columns explain the last one by Akaike's criterion, from R of all."""
    told = np.append(0.0, np.cumsum(upper[:-1, -1] ** 2))
    power = told[-1] + upper[-1, -1] ** 2
    left = np.maximum(power - told, 1e-14 * power)
    return int(np.argmin(samples * np.log(left) + 2.0 * np.arange(left.size)))


def _triangle(columns: FloatArray) -> FloatArray:
    """Return R of columns (K, C), from their products in a third of the time if the digits suffice."""
    squares = products(columns, columns)
    try:
        upper = np.asarray(np.linalg.cholesky(squares).T)
    except np.linalg.LinAlgError:
        return triangle_of(columns)
    return upper if (np.diag(upper) ** 2 > DIGITS * np.diag(squares)).all() else triangle_of(columns)
