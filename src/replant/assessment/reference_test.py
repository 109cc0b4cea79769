r"""What a reference tells: its projections of input and output, whether it is one, and what the model leaves of it.

A reference r is applied from outside: a set-point, a dither.  It depends on no noise, so what it explains of a residual
is the model's fault whatever the noise is, in feedback as well.  It is represented by the states of discrete Laguerre
functions of it, as where the instruments are made.

The part of the whitened residual that the states explain, over the residual's variance, is :math:`\chi^2`: Hansen's J
of instrumental variables.  Its degrees of freedom are the columns; of samples that the estimate was made from, less the
coefficients.

Whether a reference depends on the noise is told as for the input, by whether it answers the residual.  What is taken
away before is the reference's past alone: the input's past joins it to the noise, as both move the input.  Of what is
new in either the ranks are kept, not the sizes: else one load that steps just before a set-point does decides, and
a few large set-points hide what is made from the output between them.

Sources: Hansen (1982), "Large sample properties of generalized method of moments estimators", Econometrica 50; Van den
Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data", Automatica 29.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import Evidence
from replant.assessment.feedback_test import answer
from replant.assessment.score_test import ALPHA
from replant.assessment.verdict import Finding
from replant.simulation.model_run import ModelRun
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import chi2_quantile
from replant.statistics.projections import (
    explained_power,
    laguerre_states,
    orthogonal,
    products,
    weights_of,
    widening,
    without,
)
from replant.statistics.robust import normal_scores

COPY = 1e-6
"""What is left of the reference once the input is taken from it, below which it is a copy of the input [part of its
standard deviation].
Derivation: numbers in a log have six digits and more.
Sensitivity: halved or doubled, nothing changes on these records.
"""

RESTING = 1e-12
"""Movement of the reference that is rounding [part of its largest magnitude].
Derivation: some thousand times the precision of float64.
"""

STILL = "the reference stands still"
COPIED = "the reference is a copy of the input"
IDLE = "the reference explains nothing of the input"
REMEDY = "give what is applied from outside, as a set-point or a dither, as the reference"


def fault_of(r: FloatArray, u: FloatArray) -> str:
    """Return why a signal (K,) can be no reference of an input (K,), before what it explains is looked at; else "".

    Examples
    --------
    >>> u = np.sin(np.arange(9.0))
    >>> fault_of(np.ones(9), u), fault_of(2.0 * u + 1.0, u), fault_of(np.arange(9.0), u)
    ('the reference stands still', 'the reference is a copy of the input', '')
    """
    if not (r.size and np.ptp(r) > RESTING * np.abs(r).max()):
        return STILL
    left = without(r[:, None], np.column_stack([u, np.ones(u.size)]))
    return COPIED if left.std() <= COPY * r.std() else ""


@dataclass(frozen=True, eq=False)
class Reference:
    """What a reference explains of a record of K samples.

    Attributes
    ----------
    states : (K, 12) array
        Laguerre functions of the reference, means subtracted.
    input, output : (K,) arrays
        u_r and y_r, the parts of input and output that they explain, means subtracted.
    strength : float
        The statistic of what they explain of the input, over its limit: above 1 they explain something.
    """

    states: FloatArray
    input: FloatArray
    output: FloatArray
    strength: float

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

    @property
    def columns(self) -> FloatArray:
        """What the residual is regressed on, (K, 14): the states, and powers of y_r, which a nonlinear plant leaves."""
        return np.column_stack([self.states, self.output**2, self.output**3])

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


def _ranked(signal: FloatArray) -> FloatArray:
    """Return a signal (K,) whose news, what its past does not tell, has the ranks that it had and normal sizes."""
    moved = signal - signal.mean()
    past = Autoregression.of(moved)
    news = past.whiten(moved)
    return past.colour(np.concatenate([np.zeros(signal.size - news.size), news.std() * normal_scores(news)]))
