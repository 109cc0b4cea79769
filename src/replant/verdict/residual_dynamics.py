"""What other dynamics could explain of a model's residual, by the score test (`numerics.score_test`).

| alternative | columns of its score test |
|---|---|
| other dynamics | the input, the simulated output and their states, delayed by powers of two samples |
| a nonlinear plant | the square and the cube of the simulated output |
| the reference explains more | Laguerre functions of it, the square and the cube of what it makes of the output |
| another column of the file | those of other dynamics, made of it (`other_columns`) |
| actuator, hold, dead time | see `input_faults` |

Under feedback the input answers the residual of a right model, too, at once and later: the columns of a sample hold
only what was known before it (of a model with a direct path one sample late).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.numerics.arguments import FloatArray
from replant.numerics.score_test import Explained, Residual
from replant.verdict.evidence import Evidence, Runs


def power_of(evidence: Evidence, output: FloatArray) -> float:
    """Return the variance of an output (K,) over the samples of ``evidence.known`` that are used; never zero."""
    return max(float(np.var(output[evidence.used[evidence.known]])), float(np.finfo(float).tiny))


def residual_of(evidence: Evidence, error: FloatArray, known: FloatArray) -> Residual:
    """Return the residual of an error (K,) and known columns (K, N) over the samples of ``evidence.known``."""
    return Residual.of(error, known, evidence.past, evidence.used[evidence.known])


def known_columns(evidence: Evidence, run: ModelRun) -> FloatArray:
    """Return what has had its part of the residual (K, N): the slopes only of an estimate made from the samples."""
    rows = evidence.known
    fitted = evidence.adapts and evidence.instruments
    return np.hstack([run.zeta[rows], run.nuisances[rows]]) if fitted else run.nuisances[rows]


def unexplained(
    evidence: Evidence, runs: Runs, *, feedback: bool = False, known: FloatArray | None = None
) -> Explained:
    """Return what other dynamics could explain, beside further known columns (K, N); under feedback by the past."""
    run, rows = runs.now, evidence.known
    error, own = run.error[rows], known_columns(evidence, run)
    residual = residual_of(evidence, error, own if known is None else np.hstack([own, known]))
    output = run.forced - run.forced[rows].mean()
    powers = np.column_stack([output**2, output**3])[rows]
    columns = np.hstack([dynamics(evidence, run, feedback=feedback), powers])
    return residual.explained(columns).of_output(evidence.record.y[rows], error, evidence.used[rows])


def unexplained_before(evidence: Evidence, runs: Runs) -> Explained:
    """Return what the input could explain of what the earlier estimate leaves of the samples that it has not used."""
    newest, run = replace(evidence, follows=True), runs.old  # `known` is then what was held out
    rows = newest.known
    residual = residual_of(newest, run.error[rows], run.nuisances[rows])
    # other coefficients are no less a fault of it than other dynamics are, as of a plant that has changed
    found = residual.explained(np.hstack([dynamics(newest, run), run.zeta[rows]]))
    part = found.of_output(evidence.record.y[rows], run.error[rows], newest.used[rows])
    # its own error counts as samples held out over samples learned
    return replace(part, statistic=part.statistic / (1.0 + evidence.held_out / max(evidence.learned, 1)))


def dynamics(evidence: Evidence, run: ModelRun, *, feedback: bool = False) -> FloatArray:
    """Return the columns (K, C) of other dynamics over the samples that the estimate should explain."""
    return run.dynamics(evidence.known, evidence.dt, evidence.record.span, feedback=feedback)
