"""What could still explain a model's residual: other dynamics, a nonlinear plant, a reference.

| alternative | columns of its score test |
|---|---|
| other dynamics | the input, the simulated output and their states, delayed by powers of two samples |
| a nonlinear plant | the square and the cube of the simulated output |
| the reference explains more | Laguerre functions of it, the square and the cube of what it makes of the output |

What the model's own slopes explain is taken away before, where the model was made from these samples.  Under feedback
the input answers the residual of a right model, too, at once and later: the columns of a sample hold only what was
known before it (of a model with a direct path they are one sample late).

Source: Ljung (1999), "System Identification: Theory for the User", sections 16.5 and 16.6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import PER_COEFFICIENT, Evidence, Runs
from replant.assessment.reference_test import Reference
from replant.assessment.score_test import MATTERS, Explained, Residual
from replant.simulation.model_run import ModelRun
from replant.statistics.linear_algebra import roots

LARGEST_PART = (1.0 / 16.0) ** 2
"""What an alternative could still explain, up to which a model is trusted with a caveat: a sixteenth of the output's
amplitude. With its doubt added it must stay below it [part of the output's power].
Origin: real plants are never quite linear, nor of finite order; an unknown dead time of half a time constant, which
moves the coefficients of three poles by a half, leaves .67 %.
Sensitivity: at 1 %, of 417 verdicts on right models of field records three more are "trusted", and that one.
"""

NEGLIGIBLE = 0.01 * MATTERS
"""What the input could still explain that is not worth a word [part of the output's power].
Derivation: a hundredth of what matters, a hundredth of the amplitude.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LONGEST = 3.0
"""Longest delay of the columns of other dynamics [slowest time constants].
Derivation: by then a response has decayed to a twentieth.
"""


@dataclass(frozen=True)
class Part:
    """The part of the output's power that an alternative could still explain.

    Attributes
    ----------
    size, std : float
        As a part of the output's power, and its standard deviation.
    statistic : float
        The test statistic over its limit.
    source : str
        Name of the signal that could explain it.
    """

    size: float
    std: float
    statistic: float
    source: str = "input"

    @classmethod
    def of(cls, evidence: Evidence, found: Explained, error: FloatArray, output: FloatArray, source: str) -> Part:
        """Return what was found of an error (K,) beside an output (K,), over the samples of ``evidence.known``."""
        used = evidence.used[evidence.known]
        power = power_of(evidence, output)
        # as Python's floats, which become infinite without a warning where the output is constant
        size = min(float(found.power), float(np.var(error[used]))) / power
        return cls(size, float(found.std) / power, found.statistic, source)

    @property
    def is_sure(self) -> bool:
        """Whether the part is no chance."""
        return self.statistic > 1.0

    @property
    def is_large(self) -> bool:
        """Whether the part may exceed what a trusted model may leave unexplained."""
        return self.size + self.std > LARGEST_PART


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


def unexplained(evidence: Evidence, runs: Runs, *, feedback: bool = False, known: FloatArray | None = None) -> Part:
    """Return what other dynamics could explain, beside further known columns (K, N).

    Under feedback by what was known before each sample alone.
    """
    run, rows = runs.now, evidence.known
    error, own = run.error[rows], known_columns(evidence, run)
    residual = residual_of(evidence, error, own if known is None else np.hstack([own, known]))
    output = run.forced - run.forced[rows].mean()
    powers = np.column_stack([output**2, output**3])[rows]
    columns = np.hstack([dynamics(evidence, run, feedback=feedback), powers])
    return Part.of(evidence, residual.explained(columns), error, evidence.record.y[rows], "input")


def unexplained_before(evidence: Evidence, runs: Runs) -> Part:
    """Return what the input could explain of what the earlier estimate leaves of the samples that it has not used.

    Other coefficients are no less a fault of it than other dynamics are, as they would be of an estimate of a plant
    that has changed.  Its own error counts as samples held out over samples learned.
    """
    newest, run = replace(evidence, follows=True), runs.old  # `known` is then what was held out
    rows = newest.known
    residual = residual_of(newest, run.error[rows], run.nuisances[rows])
    found = residual.explained(np.hstack([dynamics(newest, run), run.zeta[rows]]))
    part = Part.of(newest, found, run.error[rows], evidence.record.y[rows], "input")
    return replace(part, statistic=part.statistic / (1.0 + evidence.held_out / max(evidence.learned, 1)))


def unexplained_by_reference(evidence: Evidence, run: ModelRun, reference: Reference) -> Part:
    """Return what a reference could explain: a part of the power that it makes of the output."""
    rows = evidence.known
    error = run.error[rows]
    residual = residual_of(evidence, error, np.zeros((error.size, 0)))
    found = residual.explained(reference.columns[rows], evidence.coefficients if evidence.in_sample else 0)
    return Part.of(evidence, found, error, reference.output[rows], "reference")


def dynamics(evidence: Evidence, run: ModelRun, *, feedback: bool = False) -> FloatArray:
    """Return the columns (K, C) of other dynamics over the samples that the estimate should explain."""
    begin, end, _ = evidence.known.indices(run.error.size)
    index = np.arange(begin, end) - (1 if run.is_direct and feedback else 0)

    def late(signal: FloatArray, delay: int) -> FloatArray:
        return np.asarray(signal[np.maximum(index - delay, 0)])

    slowest = float(np.abs(roots(np.concatenate([[1.0], run.parameters[: run.structure.poles]])).real).min())
    longest = LONGEST / max(slowest, 1.0 / evidence.record.span) / evidence.dt
    columns, delay = [late(run.states, 0), late(run.zeta[:, : run.structure.poles], 0)], 1
    room = index.size // PER_COEFFICIENT - 2 * run.structure.poles - 4
    while delay == 1 or (delay <= min(longest, index.size / PER_COEFFICIENT) and room > 1):
        columns += [late(run.u, delay)[:, None], late(run.forced, delay)[:, None]]
        delay, room = 2 * delay, room - 2
    return np.hstack(columns)
