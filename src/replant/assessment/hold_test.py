"""The test of the input's hold: an input that ran straight between its samples, where it was taken as held.

A signal that was sampled, such as a measured voltage, runs on between its samples; one that a computer puts out is
held.  Taken as held, a smooth input acts half a sample late, and the coefficients make up for that.  So the model is
run with each hold, takes a few Gauss-Newton steps, and the likelihoods of what both leave are compared.

Source: Garnier and Wang (2008), "Identification of Continuous-time Models from Sampled Data", chapter 4 (intersample
behaviour).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.cross_test import FALSE_ALARM
from replant.assessment.estimate_tests import FARTHEST, MOVED_SIGMAS, Speeds
from replant.assessment.evidence import Evidence, Runs
from replant.assessment.newton_step import distance
from replant.assessment.verdict import Finding, percent
from replant.engine.record import Record
from replant.simulation.model_run import ModelRun, run_model
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import roots

SMOOTH = 1.5
"""Power of an input's second differences, over that of its first, below which the input is smooth [ratio of powers].
Derivation: 2 where single steps follow each other slowly, 3 for white noise, w^2 for a sine of w rad a sample.
"""

STEPS = 4
"""Gauss-Newton steps towards the other hold's model [count].
Origin: of smooth inputs on plants with poles up to half of the sampling rate the fourth no longer matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def hold_findings(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Say where an input that is taken as held ran straight between its samples, or may have, and what that changes."""
    if evidence.record.input_hold != "zoh" or not _is_smooth(evidence.record.u):
        return []
    # where rows are lost a straight line is nearer to what the input did than one step, whatever its hold is
    record, places = evidence.record.restored
    rows = slice(int(places[evidence.known.start]), record.u.size)
    held, straight = (_improved(evidence, replace(record, input_hold=hold), rows) for hold in ("zoh", "foh"))
    if held is None or straight is None:
        return []
    gain, sure = straight[1] - held[1], -math.log(FALSE_ALARM)
    step = straight[0].parameters[: evidence.coefficients] - evidence.estimate[: evidence.coefficients]
    size = runs.size(step, Speeds.of(evidence, closed=False).poles)
    if abs(gain) <= sure and _largest_change(evidence, step) > FARTHEST:
        reason = "the samples do not tell a held input from one that runs straight between its samples, on which"
        advice = 'if it is measured or analogue, use --input-hold foh, or RefinedFilter("foh")'
        return [Finding("trusted", f"{reason} coefficients depend: {advice}")]
    if not gain > sure:
        return []
    reason = "the input seems to run straight between its samples, not to be held: taken so, a coefficient differs by"
    status = "inconsistent" if size > FARTHEST else "trusted"
    return [Finding(status, f'{reason} {percent(size)}: use --input-hold foh, or RefinedFilter("foh")')]


def _largest_change(evidence: Evidence, step: FloatArray) -> float:
    """Return the largest part of its size by which a step changes a coefficient, of those that it changes surely."""
    if evidence.covariance is None:
        return 0.0
    std = np.sqrt(np.maximum(np.diag(evidence.covariance)[: step.size], 0.0))
    part = np.abs(step) / np.maximum(np.abs(evidence.estimate[: step.size]), np.finfo(float).tiny)
    return float(part[np.abs(step) > MOVED_SIGMAS * std].max(initial=0.0))


def _improved(evidence: Evidence, record: Record, rows: slice) -> tuple[ModelRun, float] | None:
    """Return the likeliest run over a record that a few Gauss-Newton steps from the estimate lead to.

    And its likelihood's logarithm; None where the estimate cannot be run.
    """
    parameters, found = evidence.estimate.copy(), None
    for _ in range(STEPS + 1):
        run = run_model(evidence.structure, parameters, record, evidence.dt)
        # the residual of an unstable model is predicted: its likelihood is another
        if run is None or _is_stable(evidence, parameters) != _is_stable(evidence, evidence.estimate):
            break
        likelihood = _likelihood(run, rows)
        if found is None or likelihood > found[1]:
            found = run, likelihood
        parameters = parameters.copy()
        parameters[: evidence.coefficients] += distance(run, rows, FALSE_ALARM).step
    return found


def _is_stable(evidence: Evidence, parameters: FloatArray) -> bool:
    return bool(roots(np.concatenate([[1.0], parameters[: evidence.structure.poles]])).real.max() < 0.0)


def _is_smooth(u: FloatArray) -> bool:
    first = np.diff(u)
    return float(np.mean(np.diff(first) ** 2)) < SMOOTH * float(np.mean(first**2))


def _likelihood(run: ModelRun, rows: slice) -> float:
    """Return the logarithm of the likelihood of a run, up to a constant."""
    error = run.error[rows] - run.error[rows].mean()
    left = Autoregression.of(error).whiten(error)
    return -0.5 * left.size * math.log(max(float(np.mean(left**2)), np.finfo(float).tiny))
