r"""The loop in which a record was made: whether a controller closes it, and what a reference explains of it.

A reference r is applied from outside: a set-point, a dither.  It is independent of the noise, so that the part of a
residual that it explains is an error of the model, for any noise and also in feedback.  It is represented by the states
of its discrete Laguerre functions, as for the instruments.  The part of the whitened residual that the states explain,
over the residual's variance, is :math:`\chi^2`: Hansen's J of instrumental variables.  Its degrees of freedom are the
columns, minus the coefficients if the estimate was made from the same samples.

Whether a reference depends on the noise is tested as for the input: whether it answers the residual.  Only the
reference's own past is projected out: the input's past would correlate it with the noise, as both move the input.

Sources: Hansen (1982), "Large sample properties of generalized method of moments estimators", Econometrica 50; Van den
Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data", Automatica 29.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.estimation.solver.feedback_test import Feedback, answering
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.autoregression import Autoregression, whiteness
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import chi2_quantile, combined, products, sum_of_squares
from replant.numerics.projections import best_pole, explained_power, laguerre, orthogonal, weights_of, widening, without
from replant.verdict.evidence import RESTING, ROUNDING, Evidence, Runs, rounding_of
from replant.verdict.verdict import Finding

STILL = "the reference stands still"
COPIED = "the reference is a copy of the input"
IDLE = "the reference explains nothing of the input"
NO_USE = {  # the finding on each fault of a reference
    STILL: Finding("not excited", f"{STILL}: move it, or leave it out"),
    COPIED: Finding("trusted", f"{COPIED}, and says no more than the input does"),
    IDLE: Finding("not excited", f"{IDLE}: give the column that does, move it more, or leave it out"),
}
REMEDY = "give what is applied from outside, as a set-point or a dither, as the reference"
ALIKE = "noise of an input that is measured looks alike"
CLOSED = f"the loop is closed: the input answers the residual, which the noise model whitens ({ALIKE})"
AT_ONCE = (
    "the input answers the residual of the same sample: the loop is closed, the plant has a direct path (then ask for "
    "as many zeros as poles), or the output of a row is recorded after its input has acted"
)
COLOURED = (
    "the loop is closed, and either its disturbances have more colour than the noise model, or the model is wrong; to "
    f"learn which, {REMEDY} ({ALIKE}: record what was commanded)"
)


def answer(evidence: Evidence, run: ModelRun, signal: FloatArray, first: int = 0) -> Feedback:
    """Return how a signal (K,) answers a run's residual, from lag ``first`` on."""
    rows, used = evidence.known, evidence.used[evidence.known]
    error = run.error[rows] - run.error[rows][used].mean()
    w = np.zeros(signal.size)
    if error[used].std() > rounding_of(run.forced[rows], evidence.record.y[rows][used]):
        noise = Autoregression.of_residual(error, evidence.past, error.size)
        w[rows] = noise.whiten_whole(error, evidence.past, used)[0]
    moved = signal - signal.mean()
    return answering(np.ascontiguousarray(moved), w, evidence.record.inputs_before, first)


def colour_left(error: FloatArray, past: IntArray) -> float:
    """Return the portmanteau statistic of a residual (K,) whitened by its noise model, over its limit; NaN: unused."""
    used = np.isfinite(error)
    error = np.where(used, error - error[used].mean(), 0.0)
    model = Autoregression.of_residual(error, past, int(used.sum()))
    innovation, whole = model.whiten_whole(error, past, used)
    return whiteness(np.where(whole, innovation, np.nan), spent=model.order, level=1.0 - ALPHA)


def fault_of(r: FloatArray, u: FloatArray) -> str:
    """Return why a signal (K,) cannot be a reference of an input (K,): it is constant, or a copy; else "".

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

    states: FloatArray  # (K, 12): Laguerre functions of each signal from outside, means subtracted
    input: FloatArray  # (K,): u_r, the part of the input that they explain, its mean subtracted
    output: FloatArray  # (K,): y_r, the same of the output
    strength: float = math.inf  # statistic of the part of the input that they explain, over its limit

    @classmethod
    def of(cls, evidence: Evidence) -> tuple[Reference | None, list[Finding]]:
        """Return what the reference explains, None if there is none or it is unusable, and findings on the reason."""
        r, u = evidence.record.r, evidence.record.u
        if r is None:
            return None, []
        found, fault = cls.tried(r, u, evidence.record.y)
        return (None, [NO_USE[fault]]) if fault else (found, [])

    @classmethod
    def tried(cls, r: FloatArray, u: FloatArray, y: FloatArray) -> tuple[Reference | None, str]:
        """Return what a reference explains of input and output (K,), and why that is of no use; else ""."""
        if fault := fault_of(r, u):
            return None, fault
        found = cls.projected(r, u, y)
        return found, "" if found.strength > 1.0 else IDLE

    @classmethod
    def projected(cls, r: FloatArray, u: FloatArray, y: FloatArray) -> Reference:
        """Project input and output (K,) on the reference (K,)."""
        states = laguerre(r, best_pole(r, u, y))
        u, y, states = u - u.mean(), y - y.mean(), states - states.mean(axis=0)
        functions = np.column_stack([states, np.ones(u.size)])
        input_part, output_part = (combined(states, weights_of(functions, signal)[:-1]) for signal in (u, y))
        left = u - input_part
        noise = Autoregression.of(left)
        z, x = noise.whiten(states), noise.whiten(u)
        basis = combined(z, orthogonal(products(z, z)))
        amounts = products(basis, x)
        part = sum_of_squares(amounts)
        free = max(x.size - amounts.size, 1)
        variance = max((sum_of_squares(x) - part) / free, np.finfo(float).tiny)
        rest = variance * widening(basis, x - combined(basis, amounts), variance)
        limit = chi2_quantile(1.0 - ALPHA, states.shape[1] + 1)
        return cls(states, input_part, output_part, part / rest / limit)

    @property
    def explained(self) -> FloatArray:
        """The parts (K, 2) of input and output that the reference explains."""
        return np.column_stack([self.input, self.output])

    def fit(self, error: FloatArray, rows: slice) -> float:
        """Return the fit [%] to ``output``; of the error, the part that the reference explains counts."""
        functions = np.column_stack([self.states[rows], np.ones(error[rows].size)])
        left, made = math.sqrt(explained_power(functions, error[rows])), float(self.output[rows].std())
        return 100.0 * (1.0 - left / made) if made > 0.0 else float("nan")


@dataclass(frozen=True, eq=False)
class Loop:
    """The result of the tests for a controller that closes a loop."""

    feedback: Feedback = field(default_factory=Feedback)  # how the input answers the residual
    reference: Reference | None = None  # None where there is none, or it is of no use
    findings: tuple[Finding, ...] = ()
    is_direct: bool = False  # whether a direct path, or the recording, causes the answer at once, and no controller

    @property
    def colour(self) -> str:
        """What a poor model may be due to in a loop without a reference, unless a finding has said it; else empty."""
        is_said = any(found.reason == COLOURED for found in self.findings)
        return f": {COLOURED}" if self.feedback.found and not is_said else ""

    @property
    def is_closed(self) -> bool:
        """Whether a controller moves the input: it answers the residual, or a reference explains it."""
        return self.feedback.found or self.reference is not None

    @classmethod
    def of(cls, evidence: Evidence, runs: Runs, reference: Reference | None, doubts: list[Finding]) -> Loop:
        """Test for feedback, and the reference for dependence on noise; ``doubts``: the findings on it so far."""
        feedback = answer(evidence, runs.now, evidence.record.u, first=int(runs.now.is_direct))
        findings, left = list(doubts), evidence.tested(runs.now.error)[evidence.known]
        r = evidence.record.r
        follows = r is not None and answer(evidence, runs.now, r, first=int(runs.now.is_direct)).found
        if reference is not None and follows:
            findings.append(Finding("inconsistent", f"the reference follows the disturbances: {REMEDY}"))
            reference = None
        elif follows:  # a copy of the input
            findings = [Finding("inconsistent", f"{doubt.reason}: {REMEDY}") for doubt in findings]
        is_direct = feedback.is_at_once and feedback.is_direct(evidence.structure, evidence.estimate)
        if is_direct:
            feedback = Feedback()
        pole = evidence.unstable_pole if feedback.found else evidence.diverging_pole
        if pole > 0.0 and reference is None:
            run = f"simulated from the input alone, the model diverges (a pole at {pole:+.3g} rad/s)"
            reason = f"{run}, and only a reference can show that an unstable model is right: {REMEDY}"
            findings.append(Finding("inconsistent", reason))
        elif feedback.found and reference is None and colour_left(left, evidence.past) > 1.0:
            findings.append(Finding("inconsistent", AT_ONCE if feedback.is_at_once else COLOURED))
        elif feedback.found:
            findings.append(Finding("trusted", AT_ONCE if feedback.is_at_once else CLOSED))
        return cls(feedback, reference, tuple(findings), is_direct)
