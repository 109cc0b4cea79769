r"""The feedback test: whether a signal answers the residual, as the input does where a controller closes a loop.

The residual of a right model, whitened, is independent of the input's past.  In open loop it is independent of the
input's future as well; under feedback the input answers it.  The test correlates the whitened residual w with the
signal x now and later, x whitened too, so that one answer does not count twice:

.. math:: K \sum_{j=0}^{10} \hat\rho^2(w_k, x_{k+j}) \sim \chi^2_{11}.

What the signal's past tells of either is taken away before: a wrong model, whose residual follows the past input, is
then not taken for feedback; and what is left of the eleven correlations is made independent by their own covariance.
The same test tells whether a reference is applied from outside: then it answers nothing.

At j = 0 feedback cannot be told from a direct path of the plant.  A model with a direct path has taken it up, and the
sum begins at j = 1.

Source: Soderstrom and Stoica (1989), "System Identification", section 11.2 and chapter 10; Sims (1972), "Money, income,
and causality", American Economic Review 62.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import PER_COEFFICIENT
from replant.assessment.score_test import ALPHA
from replant.kernels.schema import LAGS
from replant.simulation.model_run import ModelRun
from replant.statistics.autoregression import WHITENESS_LAGS, Autoregression
from replant.statistics.linear_algebra import chi2_quantile
from replant.statistics.projections import TAKEN_AWAY, lengths_of, orthogonal, products, without

LATEST = 10
"""Latest answer that is looked for [samples].
Origin: a digital controller answers at the next sample; what answers later alone hardly feeds back.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PAST = 2 * LATEST
"""Past values of the signal that are taken away from residual and signal [samples].
Derivation: twice the latest answer.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEFT = 1e-6
"""Length of the whitened signal's future that its past does not tell, below which the future is known from the past
and no answer can be told [part of its length before].
Derivation: the square root of what rounding leaves of a smooth signal's prediction from float64.
"""

ROUNDING = 1e-6
"""Residual that is rounding, which nothing answers [part of the modelled output].
Derivation: numbers in a log have six digits and more.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@dataclass(frozen=True)
class Answer:
    """How a signal answers a residual.

    Attributes
    ----------
    statistic : float
        The test statistic over its limit: above 1 the signal answers the residual.
    at_once : bool
        Whether it does so at the same sample alone, as a direct path of the plant would make it seem.
    """

    statistic: float
    at_once: bool

    @property
    def found(self) -> bool:
        """Whether the signal answers the residual."""
        return self.statistic > 1.0


NONE = Answer(0.0, False)


def answer(run: ModelRun, rows: slice, signal: FloatArray, first: int = 0, past: FloatArray | None = None) -> Answer:
    """Return how a signal answers a run's residual."""
    error, x = run.error[rows] - run.error[rows].mean(), signal[rows] - signal[rows].mean()
    states = run.states[rows] - run.states[rows].mean(axis=0)
    count = error.size - PAST - LATEST - LAGS
    if (
        count < PER_COEFFICIENT * (PAST + LATEST + 1 + states.shape[1])
        or not np.ptp(x) > 0.0
        or not np.ptp(error) > 0.0
    ):
        return NONE
    if not error.std() > ROUNDING * run.forced[rows].std():
        return NONE
    w = _aligned(Autoregression.of(error), error)
    white = _aligned(Autoregression.of(x), x)
    index = np.arange(x.size - LATEST - count, x.size - LATEST)
    now = 1 if run.is_direct else 0  # the states of such a model hold the input of the same sample
    known = [*(x[index - lag] for lag in range(1, PAST + 1)), states[index - now], np.ones(count)]
    known += [] if past is None else [past[rows][index - 1]]
    told = np.column_stack(known)
    future = np.column_stack([white[index + later] for later in range(first, LATEST + 1)])
    left = without(np.column_stack([w[index], future]), told)
    residual, later = left[:, 0], left[:, 1:]
    lengths = lengths_of(later)
    free = lengths > LEFT * lengths_of(future)
    power = float(residual @ residual) / count
    if not free.any() or not power > TAKEN_AWAY**2 * float(error @ error) / count:
        return NONE
    later = later[:, free] / lengths[free]
    basis = orthogonal(products(later, later))
    amounts = basis.T @ products(later, residual[:, None])[:, 0]
    statistic = _over_limit(float(amounts @ amounts) / power, amounts.size)
    rest = later[:, 1:] if first == 0 and free[0] else later
    along = products(rest, residual[:, None])[:, 0]
    others = orthogonal(products(rest, rest)).T @ along
    return Answer(statistic, rest.shape[1] < later.shape[1] and _over_limit(others @ others / power, others.size) < 1.0)


def colour_left(error: FloatArray) -> float:
    """Return the portmanteau statistic of a residual (K,) after its noise model, over its limit; above 1 it has colour.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(5000)
    >>> echo = noise[10:] + 0.5 * noise[:-10]
    >>> colour_left(noise) < 1.0 < colour_left(echo)
    True
    """
    error = error - error.mean()
    model = Autoregression.of(error)
    white = model.whiten(error)
    lags, power = min(WHITENESS_LAGS, white.size // 4), float(white @ white)
    degrees = lags - (model.coefficients.size - 1)
    if degrees < 1 or not power > 0.0:
        return 0.0
    correlations = np.array([white[lag:] @ white[:-lag] for lag in range(1, lags + 1)]) / power
    return _over_limit(white.size * float(correlations @ correlations), degrees)


def _aligned(model: Autoregression, signal: FloatArray) -> FloatArray:
    """Return the whitened signal (K,), its first samples, which have no past of full length, zero."""
    white = model.whiten(signal)
    return np.concatenate([np.zeros(signal.size - white.size), white])


def _over_limit(statistic: float, degrees: int) -> float:
    return float(statistic) / chi2_quantile(1.0 - ALPHA, degrees) if degrees else 0.0
