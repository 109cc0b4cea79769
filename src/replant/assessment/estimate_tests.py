"""Tests of the estimate: its uncertainty, its movement, and its distance from the estimate that the samples give."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import Evidence, Runs
from replant.assessment.gain_error import gain_findings, output_frequency
from replant.assessment.newton_step import Distance
from replant.assessment.newton_step import distance as distance_of
from replant.assessment.score_test import ALPHA, MATTERS
from replant.assessment.verdict import Finding, figure, percent
from replant.model.shared_root import cancelled_pole
from replant.statistics.autoregression import one_step
from replant.statistics.linear_algebra import chi2_quantile, inverse_of, roots

MOST_UNCERTAIN = 0.15
"""Standard deviation of a coefficient of the denominator beyond which it is not known yet: the 95 % interval is then
wider than a third either way [part of its size].
Origin: a choice of what a user may rely on.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_UNCERTAIN_IN_LOOP = 0.06
"""The same where the loop is closed, as it is found or as a reference says: a controller is tuned by the model, and
disturbances that it fights make errors of coefficients that go together [part of its size].
Origin: of the loops of the accuracy family those in which one coefficient in ten is a tenth off have 0.07 and more,
those whose error is below 4 % at the best have 0.046 and less.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_SCATTER = math.sqrt(MATTERS)
"""Effect of the estimate's own error on the simulated output beyond which the estimate is not known yet [root mean
square, part of the output's].
Derivation: the amplitude that matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MINOR_SCATTER = 0.5 * MOST_SCATTER
"""The same up to which the model is known, whatever a single coefficient is [root mean square, part of the output's].
Derivation: two standard deviations are then no more than MOST_SCATTER.
Sensitivity: not measured.
"""

MOST_MOVED = math.sqrt(MATTERS)
"""Movement of a coefficient below which the estimate stands still [part of its size].
Derivation: the amplitude that matters.
Sensitivity: halved, right estimates no longer trusted: 'noise of 1 s'; doubled, nothing changes on these records.
"""

MOVED_SIGMAS = 4.0
"""Movement of a coefficient beyond which it is no chance [standard deviations].
Level: a normal deviate beyond 4 has the chance 6e-5.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SLOW = 3.0
"""Scatter of the estimate along its path beyond which slow noise is named as the reason [standard deviations that the
residual's power and colour make].
Level: a normal deviate beyond 3 has the chance 0.3 %; it adds a reason, and decides nothing.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MENTIONED = 1e-3
"""Uncertainty below which slow noise is not named: what rounding leaves may be slow, too [part of a coefficient's
size].
Origin: a choice of what a user would ask the reason of.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FARTHEST = 0.5 * math.sqrt(MATTERS)
"""Distance from where the samples would put the coefficients that is of no account [part of their size].
Derivation: half of the amplitude that matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SUSPECT = 0.05
"""Chance that the distance is taken for real where it is not, of an estimate without instruments: noise does bias it,
and the only question is how much [probability].
Level: 5 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""

IMPROVED = 0.9
"""Power left by the present estimate, over that left by the earlier one, below which an estimate that moved improves
[ratio of powers].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

INTEGRATOR_SIGMAS = 3.0
"""Distance from the origin below which a pole may be an integrator's [standard deviations].
Level: 99.7 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""


LONGER = re.compile(r"(?:record [\d.]+ times as long|take more samples), (?:or )?")  # as `_more` says it


@dataclass(frozen=True)
class Certainty:
    """The figures of the estimate, by their names in `Assessment`, and the findings from them.

    Attributes
    ----------
    figures : dict
        "uncertainty", "movement" and "distance".
    improves : bool
        Whether the estimate moved, and explains the newest samples better than the earlier estimate.
    findings : list of Finding
    disagreement : float
        By how much the output of the estimate that the noise model gives differs, of the samples that this one was
        solved for, where that is no chance; as a part of the output's amplitude.
    """

    figures: dict[str, float]
    improves: bool
    findings: list[Finding]
    disagreement: float = 0.0

    @classmethod
    def of(
        cls, evidence: Evidence, runs: Runs, closed: bool = False, by_reference: FloatArray | None = None
    ) -> Certainty:
        """Test the estimate."""
        size, speeds = evidence.coefficients, Speeds.of(evidence, closed, by_reference)
        if evidence.instruments:
            away = distance_of(runs.now, evidence.known, ALPHA)
        else:
            away = distance_of(runs.now, slice(0, evidence.samples), SUSPECT)
        known = away.covariance if evidence.covariance is None else evidence.covariance[:size, :size]
        std = np.sqrt(np.maximum(np.diag(known), 0.0))
        uncertainty = runs.size(std[: evidence.structure.poles], speeds.poles)
        step = (evidence.estimate - evidence.earlier)[:size]
        moved, sigmas = (
            runs.size(step, speeds.poles),
            float((np.abs(step) / np.maximum(std, np.finfo(float).tiny)).max()),
        )
        distance = runs.size(away.step, speeds.poles)
        figures = {"uncertainty": uncertainty, "movement": sigmas, "distance": distance}
        errors = runs.now.error, runs.old.error
        if by_reference is not None:  # the rest is the disturbances', which may drift
            errors = one_step(errors[0]), one_step(errors[1])
        left = float(np.var(errors[0][evidence.newest])), float(np.var(errors[1][evidence.newest]))
        improves = evidence.adapts and moved > MOST_MOVED and left[0] < IMPROVED * left[1]
        most = MOST_UNCERTAIN_IN_LOOP if closed else MOST_UNCERTAIN
        scatter = _scatter(evidence, runs, known, speeds, by_reference)
        cancelled = cancelled_pole(evidence.structure, evidence.estimate, known)
        slow, surprise = slow_noise(evidence, uncertainty), _surprise(evidence, away, known)
        is_apart = evidence.is_solved and cancelled is None and surprise > 1.0
        figures["uncertainty"] = uncertainty if cancelled is None else math.inf
        findings = [
            *_of_uncertainty(evidence, uncertainty, most, math.inf if closed else scatter, cancelled, slow),
            *_of_scatter(evidence, scatter),
            *(_of_movement(evidence, moved, sigmas, improves) if cancelled is None or _shows(runs) else []),
            *(_of_distance(evidence, distance, surprise) if cancelled is None else []),
            *gain_findings(evidence, runs, known, away.covariance),
        ]
        return cls(figures, improves, findings, _apart(runs, away.step) if is_apart else 0.0)


@dataclass(frozen=True, eq=False)
class Speeds:
    """How fast the poles are, by which errors of the denominator are judged.

    Attributes
    ----------
    poles : (n,) array
        What each pole counts as, in rad/s: its magnitude.  A pole slower than the record is long counts as one just as
        long.  Where the loop is closed, the controller and not a slow pole decides what the output does: where a pole
        may as well lie in the origin, as an integrator's does, every pole counts by its distance from where the
        output moves, j output, which makes of an error of A(s) that of A(j output).
    output : float
        How fast the output moves: its root mean square frequency in rad/s where a reference tells it from the noise,
        else the mean frequency of the model's output.
    integrators : int
        How many poles count as that fast.
    """

    poles: FloatArray
    output: float = 0.0
    integrators: int = 0

    @classmethod
    def of(cls, evidence: Evidence, closed: bool, by_reference: FloatArray | None = None) -> Speeds:
        """Return the speeds of the estimate's poles."""
        least = 1.0 / evidence.record.span
        if not (closed and evidence.modes):
            poles = np.abs(roots(np.concatenate([[1.0], evidence.estimate[: evidence.structure.poles]])))
            return cls(np.maximum(poles, least))
        if by_reference is None or not np.ptp(by_reference) > 0.0:
            output = output_frequency(evidence)
        else:
            output = float(np.diff(by_reference).std() / by_reference.std()) / evidence.dt
        pairs = [mode for mode in evidence.modes for _ in range(2 if mode.mode.pole.imag else 1)]
        sizes = np.array([abs(mode.mode.pole) for mode in pairs])
        squares = np.array([float(np.trace(mode.covariance)) for mode in pairs])
        may = ~(sizes**2 > INTEGRATOR_SIGMAS**2 * squares) & (sizes < output)
        if may.any():
            sizes = np.where(may, output, np.hypot(sizes, output))
        return cls(np.maximum(sizes, least), output, int(may.sum()))

    def moved(self, signals: FloatArray, dt: float) -> FloatArray:
        """Return signals (K, ...) without what integrators make drift: each is filtered by s/(s + output)."""
        if not self.integrators:
            return signals
        from replant.kernels.filters.series import all_pole

        decay = np.array([1.0, -math.exp(-self.output * dt)])
        channels = signals.reshape(len(signals), -1).T
        for _ in range(self.integrators):
            channels = all_pole(decay, np.diff(channels, axis=1, prepend=channels[:, :1]))
        return np.ascontiguousarray(channels.T).reshape(signals.shape)


def slow_noise(evidence: Evidence, uncertainty: float) -> str:
    """Return the reason for the estimate's uncertainty where it is slow noise, as words in brackets; else nothing.

    Slow noise is noise that the autoregression of the residual does not describe, see `statistics.robust`.
    """
    if evidence.slowness < SLOW or uncertainty < MENTIONED:
        return ""
    return " (because the residual varies slowly: the output drifts, or the plant is slightly nonlinear)"


def _scatter(
    evidence: Evidence, runs: Runs, covariance: np.ndarray, speeds: Speeds, by_reference: FloatArray | None
) -> float:
    """Return the standard deviation of the modelled output by the estimate's error, over that of the output.

    What counts is the output that is simulated from the input, or with a reference what that makes of it.
    """
    slopes, output = runs.now.zeta, runs.now.forced
    if by_reference is not None and runs.now.instruments is not None:
        slopes, output = runs.now.instruments, by_reference
    moved, size = speeds.moved(slopes, evidence.dt)[evidence.known], speeds.moved(output, evidence.dt)[evidence.known]
    made = float(np.trace(covariance @ np.atleast_2d(np.cov(moved.T))))
    return math.sqrt(max(made, 0.0)) / float(size.std()) if size.std() > 0.0 else math.inf


def _more(evidence: Evidence, uncertainty: float, most: float) -> str:
    """Return in words what makes an uncertainty smaller; of a record that has ended, how long another one has to be."""
    if not evidence.finished:
        return "take more samples"
    return f"record {figure((uncertainty / most) ** 2)} times as long"  # a standard deviation falls as 1/sqrt(N)


def _of_uncertainty(
    evidence: Evidence, uncertainty: float, most: float, scatter: float, cancelled: complex | None, slow: str
) -> list[Finding]:  # fmt: skip
    """Say where a coefficient is not known well; no obstacle to trust where what the model does is known."""
    if uncertainty <= most and cancelled is None:
        return []
    reason = f"a coefficient has a standard deviation of {percent(uncertainty)}{slow}"
    advice = f"{_more(evidence, uncertainty, most)}, move the input more, or ask for fewer poles and zeros"
    if cancelled is not None:
        real = cancelled.real + 0.0  # not -0
        pole = f"a zero may cancel the pole near {real:.3g}"
        if cancelled.imag:
            pole = f"zeros may cancel the poles near {real:.3g} +- {cancelled.imag:.3g}j"
        reason, advice = f"{pole} rad/s, so that the coefficients are not known", "ask for fewer poles and zeros"
    if scatter <= MINOR_SCATTER:
        known = f"but the uncertainty of the estimate amounts to {percent(scatter)} of the modelled output only"
        trust = "rely on G(s) where the input excites it, not on coefficients"
        return [Finding("trusted", f"{reason}, {known}: {trust}{'' if cancelled is None else ', or ' + advice}")]
    return [Finding("converging", f"{reason}: {advice}")]


def _of_scatter(evidence: Evidence, scatter: float) -> list[Finding]:
    if scatter <= MOST_SCATTER:
        return []
    reason = f"the uncertainty of the estimate amounts to {percent(scatter)} of the modelled output"
    return [Finding("converging", f"{reason}: {_more(evidence, scatter, MOST_SCATTER)}, or move the input more")]


def _shows(runs: Runs) -> bool:
    """Return whether the movement of the estimate shows in the modelled output."""
    return float(np.std(runs.now.forced - runs.old.forced)) > MINOR_SCATTER * float(np.std(runs.now.forced))


def _of_movement(evidence: Evidence, moved: float, sigmas: float, improves: bool) -> list[Finding]:
    if not (moved > MOST_MOVED and (sigmas > MOVED_SIGMAS or improves)):
        return []
    reason = f"a coefficient has moved by {percent(moved)} over {evidence.span} ({figure(sigmas)} standard deviations)"
    return [Finding("converging", reason)]


def _surprise(evidence: Evidence, away: Distance, known: FloatArray) -> float:
    """Return the statistic of a distance over its limit.

    Of two estimates of the same samples, the one without the noise model and the one with it, the difference scatters
    no more than the first.
    """
    if not (evidence.in_sample and evidence.instruments):
        return away.statistic
    square = float(away.step @ inverse_of(known) @ away.step)  # NaN where that is singular
    return min(away.statistic, square / chi2_quantile(1.0 - ALPHA, away.step.size))


def _apart(runs: Runs, step: FloatArray) -> float:
    """Return by how much a step of the coefficients changes the modelled output, as a part of its amplitude."""
    output = float(runs.now.forced.std())
    return float(np.std(runs.now.zeta @ step)) / output if output > 0.0 else 0.0  # nothing explained: said elsewhere


def _of_distance(evidence: Evidence, distance: float, statistic: float) -> list[Finding]:
    if not (statistic > 1.0 and distance > FARTHEST) or evidence.is_solved:
        return []
    reason = f"the samples give a coefficient that differs by {percent(distance)}"
    if not evidence.adapts:
        return [Finding("inconsistent", f"{reason}: the plant has changed since, or is another one")]
    if not evidence.instruments:
        return [Finding("inconsistent", f"{reason}: noise biases an estimate without instruments")]
    return [Finding("converging", f"{reason}: the estimate has not converged to them yet")]
