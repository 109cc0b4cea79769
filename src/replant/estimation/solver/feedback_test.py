r"""The test for feedback: whether a record's input answers the residual of a model.

The input is told by its own past, as far back as Akaike's criterion asks.  Of what that leaves the ranks are kept, as
normal scores :math:`v_k`: a few steps of the set-point would hide the answer else.  In open loop the whitened residuals
now and before, :math:`w_{k-j}` less what the same past tells of them, :math:`z_k`, explain nothing of it:

.. math:: s = \sum_k z_k v_k, \qquad s^T \left(\sum_k z_k z_k^T v_k^2\right)^{-1} s \sim \chi^2_{11},

whatever the distribution of the residual (White).  Samples whose past is broken do not count: by a lost row the input
is told badly there and nowhere else.  At j = 0 feedback cannot be told from a direct path of the plant.  A model with a
direct path has taken it up, and the test begins at j = 1.

Of several inputs what the others are and were tells as the past does: an input that follows them explains what a wrong
structure leaves of them, and answers nothing.

Akaike's criterion also tells how many residuals the answering part of the input is made of: a loop rings for longer
than the test looks.

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

# a digital controller answers at the next sample; what answers later alone hardly feeds back
ANSWERS = 10  # latest residual whose answer shows feedback, beside the present one [samples]

# Akaike chooses; of 42 recorded logs none needs more
LONGEST = 120  # own past values that tell the input at the most [samples]
DIGITS = 1e-8  # part of a column's square that the others leave, above which half of the digits are left [ratio]
SHORTEST = 15  # of them that are looked at first [samples]

PER_COLUMN = 12
"""Samples for each of them [samples].
Origin: of 250 random inputs of 200 to 600 samples with feedback, a tenth to four tenths of their amplitude, 80 % show
it at 0.1 %; without feedback none does, and 5 % at a level of 5 %.
Sensitivity: halved 78 %, doubled 65 %; the level stays.
"""

NEWEST = 20_000  # samples that they are fitted to at the most, for the time it takes [samples]
RANK = 1e-12  # of a singular value, below which it is none [part of the largest]
ROUNDING = 1e-6  # of an input or a residual that something else tells completely this is left [part of its amplitude]
LOUDEST = 3.0  # amplitude of an answer beside the input; a louder one comes of a filter that is nearly unstable [ratio]


@dataclass(frozen=True, eq=False)
class Feedback:
    """How an input answers a residual."""

    chance: float = 1.0  # of so much of it in open loop
    later: float = 1.0  # the same of residuals before alone
    at_once: float = 0.0  # correlation of input and residual of the same sample, in standard deviations
    part: float = 0.0  # what residuals tell of the input, of the power of what its past does not

    @property
    def found(self) -> bool:
        """Whether the input answers."""
        return self.chance < ALPHA

    @property
    def is_at_once(self) -> bool:
        """Whether it answers the residual of the same sample alone, as a direct path of the plant would seem to."""
        return self.found and not self.later < ALPHA

    def is_direct(self, structure: Structure, model: FloatArray) -> bool:
        """Return whether input and residual of the same sample move together as a plant's output follows its input."""
        from scipy import special  # slow to import

        # a controller opposes a disturbance; what the plant does faster than the model moves the residual along with
        # the input, by the sign of the model's first and last answer to a step, where these agree
        first, last = model[structure.poles], model[structure.coefficients - 1] * model[structure.poles - 1]
        return bool(first * last > 0.0) and float(special.ndtr(-self.at_once * np.sign(first))) < ALPHA


@quiet
def answering(
    u: FloatArray, w: FloatArray, before: IntArray, first: int = 0, others: Sequence[FloatArray] = ()
) -> Feedback:
    """Return how an input (K,), ``before`` (K,) told ones in a row, answers a whitened residual (K,), 0: unknown."""
    # what others (K,) are and were tells input and residual as its own past does: the input may follow them
    most = _most(before)
    rows = np.flatnonzero(before >= max(most, ANSWERS))[-NEWEST:]
    if rows.size < PER_COLUMN * (ANSWERS + 2):
        return Feedback()
    # the past of an input tells it beside that of others, whatever their units
    u, *others = (_near_one(signal) for signal in (u, *others))
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
    """Return the part (K,) of an input in feedback that answers a whitened residual, carried on by its own past."""
    most = _most(before)
    latest = max(most, ANSWERS)
    rows = np.flatnonzero(before >= latest)[-NEWEST:]
    now, told, own = _answers(u, w, rows, most, range(latest + 1))
    told = told[:, : max(_fewest(_triangle(np.column_stack([told, now])), rows.size), ANSWERS + 1)]
    gains = least_norm(told, now, RANK)[0]
    weights = combined(own[:, : gains.size + 1], np.append(1.0, -gains))
    return _carried(np.convolve(w, gains)[: u.size], weights[1:], u)


def _near_one(signal: FloatArray) -> FloatArray:
    """Return a signal (K,) scaled to about one by a power of two."""
    return np.asarray(np.ldexp(signal, -int(np.frexp(np.abs(signal).max(initial=0.0))[1])))


def _answers(
    u: FloatArray, w: FloatArray, rows: IntArray, most: int, lags: range, others: Sequence[FloatArray] = ()
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what an input's past does not tell of it (K,), of residuals (K, L), and the past's weights of either."""
    past, inverse = _known_past(u.tobytes(), most, rows.tobytes(), *(each.tobytes() for each in others))
    left, own = _untold(np.column_stack([u[rows], *(w[rows - lag] for lag in lags)]), past, inverse)
    return left[:, 0], left[:, 1:], own


def _chance(moments: FloatArray) -> float:
    """Return the chance of moments (K, C) so far from zero."""
    from scipy.special import chdtrc  # slow to import

    total = moments.sum(axis=0)
    return float(chdtrc(total.size, max(total @ pseudo_inverse(products(moments, moments), RANK) @ total, 0.0)))


def _most(before: IntArray) -> int:
    """Return how many past values may tell an input that has so many inputs ``before`` each (K,)."""
    longest = min(LONGEST, before.size // PER_COLUMN)
    whole = before.size - np.cumsum(np.bincount(np.minimum(before, longest), minlength=longest + 1))
    lags = np.arange(longest + 1)
    there = np.append(before.size, whole[:-1])  # samples with at least so many before them
    return int(lags[there >= (PER_COLUMN - 1) * lags][-1])


@lru_cache(maxsize=1)  # a search asks of one input, structure by structure
def _known_past(signal: bytes, most: int, samples: bytes, *others: bytes) -> tuple[FloatArray, FloatArray]:
    """Return the past (K, C) that tells an input at some samples, as Akaike has it, and the inverse of its R."""
    u, rows, beside = np.frombuffer(signal), np.frombuffer(samples, np.int64), [np.frombuffer(x) for x in others]
    told = [each for lag in range(1, most + 1) for each in ((u, lag), *((x, lag - 1) for x in beside))][:most]
    lags, best = -1, 0
    while lags < most and 2 * best > lags:  # twice as far back only where the farther half tells something
        lags = min(max(2 * lags, SHORTEST), most)
        past = np.column_stack([np.ones(rows.size), *(x[rows - lag] for x, lag in told[:lags]), u[rows]])
        upper = _triangle(past)
        best = _fewest(upper[1:, 1:], rows.size)
    return past[:, : best + 1], np.asarray(np.linalg.pinv(upper[: best + 1, : best + 1], RANK))


def _fewest(upper: FloatArray, samples: int) -> int:
    """Return by how many columns Akaike's criterion tells the last one, from R of all of them."""
    told = np.append(0.0, np.cumsum(upper[:-1, -1] ** 2))
    power = told[-1] + upper[-1, -1] ** 2
    left = np.maximum(power - told, 1e-14 * power)
    return int(np.argmin(samples * np.log(left) + 2.0 * np.arange(left.size)))


def _triangle(columns: FloatArray) -> FloatArray:
    """Return R of columns (K, C): of their products, which takes a third of the time, where the digits suffice."""
    squares = products(columns, columns)
    try:
        upper = np.asarray(np.linalg.cholesky(squares).T)
    except np.linalg.LinAlgError:
        return triangle_of(columns)
    return upper if (np.diag(upper) ** 2 > DIGITS * np.diag(squares)).all() else triangle_of(columns)


def _untold(signals: FloatArray, past: FloatArray, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a past (K, C), R inverted, does not tell of signals (K, S), and the weights (C, S) of the rest."""
    weights = np.zeros((past.shape[1], signals.shape[1]))
    for _ in range(2):  # once more, for what rounding left
        more = inverse @ (inverse.T @ products(past, signals))
        signals, weights = signals - combined(past, more), weights + more
    return signals, weights


def _carried(push: FloatArray, own: FloatArray, u: FloatArray) -> FloatArray:
    """Return what a push (K,) makes of an input (K,) that its own past carries on."""
    from replant.kernels.filters.autoregressions import all_pole

    answer = all_pole(np.append(1.0, -own), push[None])[0]
    held = bool(np.isfinite(answer).all()) and sum_of_squares(answer) <= LOUDEST**2 * sum_of_squares(u)
    return answer if held else push
