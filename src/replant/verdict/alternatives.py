"""The residual of a model, computed once for a verdict, and what named alternatives could explain of it.

Each alternative is a function that makes its columns; the score test (`numerics.score_test`) says what they explain:

| alternative | columns of its score test | from |
|---|---|---|
| other dynamics | the input, the simulated output and their states, delayed by powers of two samples | here |
| the reference explains more | Laguerre functions of it | here |
| another column of the file | those of other dynamics, by this column | `other_columns` |
| actuator, sensor, hold, dead time, rhythm | see there | `input_faults` |
| a plant that is not linear, or changes | see there | `plant_faults` |

Two residuals serve all but the first: one with the slopes of the coefficients projected out, and one with other
dynamics and a drift projected out, too, so that a model of too low an order is not taken for a curve or a change.

Under feedback the input answers the residual of a right model, too, at once and later; this is tested by
`replant.estimation.solver.feedback_test`.  The columns of a sample then use only what was known before it (for a model
with a direct path they are one sample late).  With a reference they use the part of the input that it explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import NEGLIGIBLE
from replant.numerics.linear_algebra import combined
from replant.numerics.score_test import Explained, Residual
from replant.verdict.estimate_tests import Speeds
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.loop import Loop, Reference

# each takes as many columns as G has coefficients
WAVES = 8  # half periods within a record of the fastest drift, and change of G, that is told from noise [count]


def power_of(evidence: Evidence, output: FloatArray) -> float:
    """Return the variance of an output (K,) over the used samples of ``evidence.known``; never zero."""
    return max(float(np.var(output[evidence.used[evidence.known]])), float(np.finfo(float).tiny))


def residual_of(evidence: Evidence, error: FloatArray, known: FloatArray) -> Residual:
    """Return the residual of an error (K,) and known columns (K, N) over the samples of ``evidence.known``."""
    used = evidence.used[evidence.known]
    return Residual.of(error, known, evidence.past, used, unbroken=evidence.past_of(evidence.known, unbroken=True))


def half_periods(part: FloatArray) -> FloatArray:
    """Return cosines (K, WAVES) of one, two and more half periods in a record, of which a ``part`` (K,) has passed."""
    return np.cos(np.pi * part[:, None] * np.arange(1, WAVES + 1))


def dynamics(evidence: Evidence, run: ModelRun, *, feedback: bool = False) -> FloatArray:
    """Return the columns (K, C) of other dynamics over the samples that the estimate should explain."""
    return run.dynamics(evidence.known, evidence.dt, evidence.record.span, feedback=feedback)


def unexplained_by_reference(evidence: Evidence, run: ModelRun, reference: Reference) -> Explained:
    """Return what the states of a reference could explain, as part of the output power by the reference."""
    rows = evidence.known
    error = run.error[rows]
    residual = residual_of(evidence, error, np.zeros((error.size, 0)))
    spent = evidence.coefficients if evidence.in_sample else 0
    own = None if evidence.own is None else (run.slopes[rows], evidence.own)
    found = residual.explained(reference.states[rows], spent, measures_chance=True, own=own)
    return found.of_output(reference.output[rows], error, evidence.used[rows])


@dataclass(frozen=True)
class Effect:
    """The effect of a signal that acts on the output in addition to the model."""

    weight: float  # of its first column
    size: float  # largest relative change of a coefficient
    statistic: float  # over its limit


@dataclass(frozen=True, eq=False)
class Acting:
    """The acting input, with a reference the part that this explains, and the tests of its effect on the output.

    The tests use the J samples that the estimate should explain.
    """

    evidence: Evidence
    runs: Runs
    loop: Loop
    input: FloatArray  # (K,)
    output: FloatArray  # (K,): the model's output by ``input``
    slopes: FloatArray  # (K, n + m + 1)
    sensed: FloatArray  # (K,): the modelled output of all inputs, which the sensor measures

    @classmethod
    def of(cls, evidence: Evidence, runs: Runs, loop: Loop, sensed: FloatArray | None = None) -> Acting:
        """Return the acting input; give ``sensed`` if other inputs act, too."""
        run, reference = runs.now, loop.reference
        if reference is None or run.instruments is None:
            return cls(evidence, runs, loop, run.u, run.forced, run.zeta, run.forced if sensed is None else sensed)
        b = evidence.structure.numerator
        output = combined(run.instruments[:, b], evidence.estimate[b])
        return cls(evidence, runs, loop, reference.input, output, run.instruments, output if sensed is None else sensed)

    @property
    def rows(self) -> slice:
        """The samples that the estimate should explain."""
        return self.evidence.known

    @property
    def error(self) -> FloatArray:
        """The model's error (J,)."""
        return self.runs.now.error[self.rows]

    @property
    def nuisances(self) -> FloatArray:
        """The outputs (J, N) by a unit offset and by unit initial states."""
        return self.runs.now.nuisances[self.rows]

    @property
    def made(self) -> FloatArray:
        """The output (J,), or the part that a reference explains."""
        reference = self.loop.reference
        return (self.evidence.record.y if reference is None else reference.output)[self.rows]

    @property
    def power(self) -> float:
        """The variance of ``made``."""
        return power_of(self.evidence, self.made)

    @cached_property
    def linear(self) -> FloatArray:
        """The columns (J, C) of other dynamics."""
        if self.loop.reference is not None:
            return self.loop.reference.states[self.rows]
        return dynamics(self.evidence, self.runs.now, feedback=self.loop.feedback.found)

    @cached_property
    def residual(self) -> Residual:
        """The residual, with slopes and nuisances projected out."""
        return residual_of(self.evidence, self.error, np.hstack([self.slopes[self.rows], self.nuisances]))

    @cached_property
    def beyond_dynamics(self) -> Residual:
        """The residual, with other dynamics and a drift (or the rest of a subtracted one) projected out, too."""
        part = (np.arange(len(self.linear)) + 0.5) / len(self.linear)
        # in a loop the noise model does not explain the slowest disturbances, which the controller answers
        waves = half_periods(part) if self.loop.is_closed else half_periods(part)[:, :1]
        return self.residual.knowing(np.hstack([self.linear, waves]))

    def unexplained(self, *known: FloatArray) -> Explained:
        """Return what other dynamics, or the reference, could explain beside columns (J, C), as part of the output."""
        evidence, reference = self.evidence, self.loop.reference
        if reference is not None and not known:
            return unexplained_by_reference(evidence, self.runs.now, reference)
        residual, own = self.residual, None
        if reference is None and not (evidence.adapts and evidence.instruments):  # slopes had no part of the samples
            residual = residual_of(evidence, self.error, self.nuisances)
            own = None if evidence.own is None else (self.runs.now.slopes[self.rows], evidence.own)
        residual = residual.knowing(np.hstack(known)) if known else residual
        found = residual.explained(self.linear, measures_chance=True, own=own)
        return found.of_output(self.made, self.error, evidence.used[self.rows])

    def effect_of(self, columns: FloatArray) -> Effect | None:
        """Return the effect of columns (J, C) beside the model; None if not significant, or negligible."""
        found = self.residual.explained(columns)
        if not (found.is_sure and found.power > NEGLIGIBLE * self.power):
            return None
        return Effect(float(found.weights[0]), self.size_of(columns, found.weights), found.statistic)

    def size_of(self, columns: FloatArray, weights: FloatArray) -> float:
        """Return the largest relative change of a coefficient beside columns (J, C) with weights (C,)."""
        reference = self.loop.reference
        made = None if reference is None else reference.output
        step = -self.residual.weights_of(columns)[: self.evidence.coefficients] @ weights
        return self.runs.size(step, Speeds.of(self.evidence, self.loop.is_closed, made).poles)
