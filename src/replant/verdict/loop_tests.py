r"""The loop: whether a controller moves the input, and what a reference that moves it from outside tells.

The residual of a right model, whitened, is independent of the input's past.  In open loop it is independent of the
input's future as well; under feedback the input answers it.  The test correlates the whitened residual w with the
signal x now and later, x whitened too, so that one answer does not count twice:

.. math:: K \sum_{j=0}^{10} \hat\rho^2(w_k, x_{k+j}) \sim \chi^2_{11}.

What the signal's past tells of either is taken away before: a wrong model, whose residual follows the past input, is
then not taken for feedback; and what is left of the eleven correlations is made independent by their own covariance.
At j = 0 feedback cannot be told from a direct path of the plant.  A model with a direct path has taken it up, and the
sum begins at j = 1.

A reference r is applied from outside: a set-point, a dither.  It depends on no noise, so what it explains of a residual
is the model's fault whatever the noise is, in feedback as well.  It is represented by the states of discrete Laguerre
functions of it, as where the instruments are made.  The part of the whitened residual that the states explain, over the
residual's variance, is :math:`\chi^2`: Hansen's J of instrumental variables.  Its degrees of freedom are the columns;
of samples that the estimate was made from, less the coefficients.

Whether a reference depends on the noise is told as for the input, by whether it answers the residual.  What is taken
away before is the reference's past alone: the input's past joins it to the noise, as both move the input.  Of what is
new in either the ranks are kept, not the sizes: else one load that steps just before a set-point does decides, and
a few large set-points hide what is made from the output between them.

Sources: Soderstrom and Stoica (1989), "System Identification", section 11.2 and chapter 10; Sims (1972), "Money,
income, and causality", American Economic Review 62; Hansen (1982), "Large sample properties of generalized method of
moments estimators", Econometrica 50; Van den Hof and Schrama (1993), "An indirect method for transfer function
estimation from closed loop data", Automatica 29.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.kernels.schema import LAGS
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression, whiteness
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import chi2_quantile
from replant.numerics.projections import (
    TAKEN_AWAY,
    explained_power,
    laguerre_states,
    lengths_of,
    orthogonal,
    products,
    weights_of,
    widening,
    without,
)
from replant.numerics.robust import normal_scores
from replant.verdict.evidence import PER_COEFFICIENT, RESTING, ROUNDING, Evidence, Runs
from replant.verdict.score_test import Explained, residual_of
from replant.verdict.verdict import Finding

LATEST = 10
"""Latest answer that is looked for [samples].
Origin: a digital controller answers at the next sample; what answers later alone hardly feeds back.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PAST = 2 * LATEST  # past values of the signal that are taken away from residual and signal [samples]
LEFT = 1e-6  # length of a whitened future, its past taken off, below which only rounding is left [part of it before]

STILL = "the reference stands still"
COPIED = "the reference is a copy of the input"
IDLE = "the reference explains nothing of the input"
REMEDY = "give what is applied from outside, as a set-point or a dither, as the reference"
CLOSED = "the loop is closed: the input answers the residual, which the noise model whitens"
AT_ONCE = (
    "the input answers the residual of the same sample: the loop is closed, or the plant has a direct path (then ask "
    "for as many zeros as poles)"
)
COLOURED = (
    "the loop is closed, and either its disturbances have more colour than the noise model, or the model is wrong; to "
    f"learn which, {REMEDY}"
)


@dataclass(frozen=True)
class Answer:
    """How a signal answers a residual."""

    statistic: float  # over its limit
    at_once: bool  # whether at the same sample alone, as a direct path of the plant would make it seem

    @property
    def found(self) -> bool:
        """Whether the signal answers the residual."""
        return self.statistic > 1.0


NONE = Answer(0.0, False)


def answer(run: ModelRun, rows: slice, signal: FloatArray, first: int = 0) -> Answer:
    """Return how a signal answers a run's residual."""
    error, x = run.error[rows] - run.error[rows].mean(), signal[rows] - signal[rows].mean()
    states = run.states[rows] - run.states[rows].mean(axis=0)
    count = error.size - PAST - LATEST - LAGS
    few = count < PER_COEFFICIENT * (PAST + LATEST + 1 + states.shape[1])
    if few or not np.ptp(x) > 0.0 or not error.std() > ROUNDING * run.forced[rows].std():
        return NONE
    w = _aligned(Autoregression.of(error), error)
    white = _aligned(Autoregression.of(x), x)
    index = np.arange(x.size - LATEST - count, x.size - LATEST)
    now = 1 if run.is_direct else 0  # the states of such a model hold the input of the same sample
    told = np.column_stack([*(x[index - lag] for lag in range(1, PAST + 1)), states[index - now], np.ones(count)])
    future = np.column_stack([white[index + later] for later in range(first, LATEST + 1)])
    left = without(np.column_stack([w[index], future]), told)
    residual, later = left[:, 0], left[:, 1:]
    lengths = lengths_of(later)
    free = lengths > LEFT * lengths_of(future)
    power = float(residual @ residual) / count
    if not free.any() or not power > TAKEN_AWAY**2 * float(error @ error) / count:
        return NONE
    later = later[:, free] / lengths[free]

    def statistic(columns: FloatArray) -> float:
        amounts = orthogonal(products(columns, columns)).T @ products(columns, residual[:, None])[:, 0]
        degrees = amounts.size
        return float(amounts @ amounts) / power / chi2_quantile(1.0 - ALPHA, degrees) if degrees else 0.0

    rest = later[:, 1:] if first == 0 and free[0] else later
    return Answer(statistic(later), rest.shape[1] < later.shape[1] and statistic(rest) < 1.0)


def colour_left(error: FloatArray) -> float:
    """Return the portmanteau statistic of a residual (K,) after its noise model, over its limit.

    >>> noise = np.random.default_rng(0).standard_normal(5000)
    >>> echo = noise[10:] + 0.5 * noise[:-10]
    >>> colour_left(noise) < 1.0 < colour_left(echo)
    True
    """
    error = error - error.mean()
    model = Autoregression.of(error)
    return whiteness(model.whiten(error), spent=model.order, level=1.0 - ALPHA)


def _aligned(model: Autoregression, signal: FloatArray) -> FloatArray:
    """Return the whitened signal (K,), its first samples, which have no past of full length, zero."""
    white = model.whiten(signal)
    return np.concatenate([np.zeros(signal.size - white.size), white])


def fault_of(r: FloatArray, u: FloatArray) -> str:
    """Return why a signal (K,) can be no reference of an input (K,), before what it explains is looked at; else "".

    >>> u = np.sin(np.arange(9.0))
    >>> fault_of(np.ones(9), u), fault_of(2.0 * u + 1.0, u), fault_of(np.arange(9.0), u)
    ('the reference stands still', 'the reference is a copy of the input', '')
    """
    if not (r.size and np.ptp(r) > RESTING * np.abs(r).max()):
        return STILL
    left = without(r[:, None], np.column_stack([u, np.ones(u.size)]))
    return COPIED if left.std() <= ROUNDING * r.std() else ""


@dataclass(frozen=True, eq=False)
class Reference:
    """What a reference explains of a record of K samples."""

    states: FloatArray  # (K, 12): Laguerre functions of the reference, means subtracted
    input: FloatArray  # (K,): u_r, the part of the input that they explain, its mean subtracted
    output: FloatArray  # (K,): y_r
    strength: float  # statistic of what they explain of the input, over its limit

    @classmethod
    def of(cls, evidence: Evidence) -> tuple[Reference | None, list[Finding]]:
        """Return what the reference explains, None where there is none or it is of no use, and why it is of none."""
        r, u = evidence.record.r, evidence.record.u
        if r is None:
            return None, []
        fault = fault_of(r, u)
        if fault == COPIED:
            return None, [Finding("trusted", f"{COPIED}, and says no more than the input does")]
        if fault:
            return None, [Finding("not excited", f"{fault}: move it, or leave it out")]
        found = cls.projected(r, u, evidence.record.y)
        if not found.strength > 1.0:
            return None, [Finding("not excited", f"{IDLE}: give the column that does, move it more, or leave it out")]
        return found, []

    @classmethod
    def projected(cls, r: FloatArray, u: FloatArray, y: FloatArray) -> Reference:
        """Project input and output (K,) on the reference (K,)."""
        states = laguerre_states(r, u, y)
        u, y, states = u - u.mean(), y - y.mean(), states - states.mean(axis=0)
        functions = np.column_stack([states, np.ones(u.size)])
        input_part, output_part = (states @ weights_of(functions, signal)[:-1] for signal in (u, y))
        left = u - input_part
        noise = Autoregression.of(left)
        z, x = noise.whiten(states), noise.whiten(u)
        basis = z @ orthogonal(products(z, z))
        amounts = basis.T @ x
        part = float(amounts @ amounts)
        free = max(x.size - amounts.size, 1)
        rest = max((float(x @ x) - part) / free, np.finfo(float).tiny) * widening(basis, x - basis @ amounts)
        limit = chi2_quantile(1.0 - ALPHA, states.shape[1] + 1)
        return cls(states, input_part, output_part, part / rest / limit)

    @property
    def explained(self) -> FloatArray:
        """What the reference explains of input and output, (K, 2)."""
        return np.column_stack([self.input, self.output])

    def follows(self, r: FloatArray, run: ModelRun, rows: slice) -> bool:
        """Return whether the reference (K,) answers a model's residual over the samples ``rows``."""
        # the states of the functions hold the reference of the same sample
        ranked = replace(run, error=_ranked(run.error), states=self.states, is_direct=True)
        return answer(ranked, rows, _ranked(r), first=int(run.is_direct)).found

    def fit(self, error: FloatArray, rows: slice) -> float:
        """Return the fit [%] of what the reference makes of the output: what it explains of the error spoils it."""
        functions = np.column_stack([self.states[rows], np.ones(error[rows].size)])
        left, made = math.sqrt(explained_power(functions, error[rows])), float(self.output[rows].std())
        return 100.0 * (1.0 - left / made) if made > 0.0 else float("nan")


def unexplained_by_reference(evidence: Evidence, run: ModelRun, reference: Reference) -> Explained:
    """Return what a reference could explain by its states and powers: a part of the power that it makes of the output.

    The powers are what a nonlinear plant leaves.
    """
    rows = evidence.known
    error = run.error[rows]
    columns = np.column_stack([reference.states, reference.output**2, reference.output**3])[rows]
    residual = residual_of(evidence, error, np.zeros((error.size, 0)))
    found = residual.explained(columns, evidence.coefficients if evidence.in_sample else 0)
    return found.beside(evidence, error, reference.output[rows])


def _ranked(signal: FloatArray) -> FloatArray:
    """Return a signal (K,) whose news, what its past does not tell, has the ranks that it had and normal sizes."""
    moved = signal - signal.mean()
    past = Autoregression.of(moved)
    news = past.whiten(moved)
    return past.colour(np.concatenate([np.zeros(signal.size - news.size), news.std() * normal_scores(news)]))


@dataclass(frozen=True, eq=False)
class Loop:
    """What the samples tell of a controller that closes a loop."""

    feedback: Answer  # how the input answers the residual
    reference: Reference | None  # None where there is none, or it is of no use
    findings: list[Finding]

    @property
    def is_closed(self) -> bool:
        """Whether a controller moves the input: it answers the residual, or a reference explains it."""
        return self.feedback.found or self.reference is not None

    @classmethod
    def of(cls, evidence: Evidence, runs: Runs, reference: Reference | None, doubts: list[Finding]) -> Loop:
        """Test for feedback, and whether the reference is one; ``doubts`` are the findings on it so far."""
        feedback = answer(runs.now, evidence.known, evidence.record.u, first=int(runs.now.is_direct))
        findings = list(doubts)
        r = evidence.record.r
        if reference is not None and r is not None and reference.follows(r, runs.now, evidence.known):
            findings.append(Finding("inconsistent", f"the reference follows the disturbances: {REMEDY}"))
            reference = None
        elif reference is None and r is not None and answer(runs.now, evidence.known, r).found:  # a copy of the input
            findings = [Finding("inconsistent", f"{doubt.reason}: {REMEDY}") for doubt in findings]
        pole = evidence.unstable_pole
        if pole > 0.0 and reference is None:
            run = f"simulated from the input alone, the model diverges (a pole at {pole:+.3g} rad/s)"
            reason = f"{run}, and only a reference can show that an unstable model is right: {REMEDY}"
            findings.append(Finding("inconsistent", reason))
        elif feedback.found and reference is None and colour_left(runs.now.error[evidence.known]) > 1.0:
            findings.append(Finding("inconsistent", COLOURED))
        elif feedback.found:
            findings.append(Finding("trusted", AT_ONCE if feedback.at_once else CLOSED))
        return cls(feedback, reference, findings)
