"""Tests of the estimate: its uncertainty, its movement, and its distance from the estimate of the samples."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replant.estimation.solver.resampled_scatter import resampled_scatter
from replant.estimation.solver.srivc_steps import FASTEST
from replant.model.structure import Structure
from replant.model.uncertainty import cancelled_pole
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import one_step
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import (
    chi2_quantile,
    combined,
    inverse_of,
    products,
    real_coefficients,
    roots,
    sum_of_squares,
)
from replant.numerics.projections import without
from replant.verdict.estimate_distance import Distance, gain_findings, output_frequency
from replant.verdict.estimate_distance import distance as distance_of
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.verdict import Assessment, Finding, figure, percent

MOST_UNCERTAIN = 0.15
"""Standard deviation of a coefficient of the denominator above which it is not known yet: the 95 % interval is then
wider than +-30 % [part of its size].
Origin: a choice of what a user may rely on.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_UNCERTAIN_IN_LOOP = 0.06
"""The same if the loop is closed, by the test for feedback or by a reference: a controller is tuned by the model, and
the disturbances that it rejects cause correlated errors of coefficients [part of its size].
Origin: in the loops of the accuracy family it is 0.07 and more where one coefficient in ten has an error of a tenth,
and 0.046 and less where the error is below 4 % at best.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_SCATTER = math.sqrt(MATTERS)  # largest rms of the output's error by the estimate's error [part of the output's]
# the same, up to which the model is known though a coefficient is not [part of the output's]
MINOR_SCATTER = math.sqrt(0.5 * MATTERS)
# on field records estimates scatter between 0.5 and 2.9 times as much
FIRST_ORDER = 3.0  # factor by which an estimate may scatter more, or less, than its covariance predicts [ratio]
MOST_MOVED = math.sqrt(MATTERS)  # movement of a coefficient below which the estimate stands still [part of its size]
MOVED_SIGMAS = 4.0  # significant movement of a coefficient: 6e-5 for a normal deviate [standard deviations]
SLOW = 3.0  # scatter of the path from which on slow noise is named as the reason [standard deviations by its colour]
MENTIONED = 0.01 * MOST_MOVED  # uncertainty below which slow noise is not named: rounding is slow [part of the size]
IMPROVED = 1.0 - MOST_MOVED  # residual power over that of an earlier estimate below which it is better [ratio]
FARTHEST = 0.5 * math.sqrt(MATTERS)  # largest negligible distance from the samples' estimate [part of the size]
SUSPECT = 0.05  # false-alarm level of the distance of an estimate without instruments, likely biased [probability]
INTEGRATOR_SIGMAS = 3.0  # distance from the origin below which a pole may be an integrator [standard deviations]

# steps that would cross the bound are halved ten times
AT_BOUND = 1e-3  # distance from the bound of the poles within which a pole counts as at the bound [part of the bound]

LEAST_LONGER = 1.1  # least factor by which a longer record is asked for; it is rounded to two digits [ratio]
LONGER = re.compile(r"(?:(?:record|repeat it) [\w. ]+? times(?: as long)?|take more samples), (?:or )?")  # see `longer`


def estimate_findings(
    evidence: Evidence, runs: Runs, figures: dict[str, Any], closed: bool, by_reference: FloatArray | None
) -> tuple[list[Finding], bool, float]:
    """Return the findings on the estimate, whether it moved and explains the newest samples better, and a difference.

    The difference is that of the modelled output from the one by the estimate with the noise model as a filter, from
    the same samples, as a part of the output's amplitude; 0 if it may be chance.  Figures are added to ``figures``.
    """
    size, speeds = evidence.coefficients, Speeds.of(evidence, closed, by_reference)
    rows, chance = evidence.known, ALPHA
    if not evidence.instruments:
        rows, chance = slice(0, evidence.samples), SUSPECT
    past, used = evidence.past_of(rows), evidence.used[rows]
    away = distance_of(runs.now, rows, past, used, chance, closed=closed, own=evidence.own)
    known = away.covariance if evidence.covariance is None else evidence.covariance[:size, :size]
    std = np.sqrt(np.maximum(np.diag(known), 0.0))
    uncertainty = runs.size(std[: evidence.structure.poles], speeds.poles)
    step = (evidence.estimate - evidence.earlier)[:size]
    moved = runs.size(step, speeds.poles)
    sigmas = float((np.abs(step) / np.maximum(std, np.finfo(float).tiny)).max())
    distance = runs.size(away.step, speeds.poles)
    errors = runs.now.error, runs.old.error
    if by_reference is not None:  # the rest comes from disturbances, which may drift
        errors = one_step(errors[0]), one_step(errors[1])
    left = float(np.var(errors[0][evidence.newest])), float(np.var(errors[1][evidence.newest]))
    improves = evidence.adapts and moved > MOST_MOVED and left[0] < IMPROVED * left[1]
    most = MOST_UNCERTAIN_IN_LOOP if closed else MOST_UNCERTAIN
    scatter = _scatter(evidence, runs, known, speeds, by_reference)
    if not closed and _is_in_doubt(evidence, scatter):
        structure, record, filtered = evidence.structure, evidence.record.joined, bool(evidence.filtered)
        scatter = resampled_scatter(structure, record, evidence.estimate, filtered=filtered)
    cancelled = cancelled_pole(evidence.structure, evidence.estimate, known)
    slow, surprise = slow_noise(evidence, uncertainty), _surprise(evidence, away, known)
    is_apart = evidence.is_solved and cancelled is None and surprise > 1.0
    figures["uncertainty"] = uncertainty if cancelled is None else math.inf
    figures |= {"movement": sigmas, "distance": distance}
    more = "" if evidence.finished else "take more samples"
    # if the input rests for most of the record, a longer rest does not help
    times = "repeat it {} times" if evidence.moving < evidence.samples / 2 else "record {} times as long"
    bound = math.inf if closed else scatter
    findings = uncertainty_findings(uncertainty, most, bound, cancelled, slow, more, times)
    if not scatter <= MOST_SCATTER:
        reason = f"the uncertainty of the estimate amounts to {percent(scatter)} of the modelled output"
        reason += f": {more or longer(scatter, MOST_SCATTER, times)}, or move the input more"
        findings.append(Finding("converging", reason))
    moves = float(np.std(runs.now.forced - runs.old.forced))  # effect of the movement on the modelled output
    if cancelled is None or moves > MINOR_SCATTER * float(np.std(runs.now.forced)):
        findings += movement_findings(moved, sigmas, evidence.span, improves=improves)
    if cancelled is None and surprise > 1.0 and distance > FARTHEST and not is_apart:
        findings.append(_of_distance(evidence, distance))
    findings += gain_findings(evidence, runs, known, away.covariance) + _fastest(evidence)
    output = float(runs.now.forced.std()) if is_apart else 0.0  # one of zero has a finding elsewhere
    disagreement = float(np.std(combined(runs.now.zeta, away.step))) / output if output > 0.0 else 0.0
    return findings, improves, disagreement


@dataclass(frozen=True, eq=False)
class Speeds:
    """The speeds of the poles, which scale errors of the denominator.

    A pole whose time constant exceeds the record's duration counts as one of that duration.  In a closed loop the
    controller, not a slow pole, determines the output.  If a pole may be an integrator, each pole counts by its
    distance from j ``output``: an error of A(s) is then scaled as one of A(j output).
    """

    poles: FloatArray  # (n,): speed at which each counts, in rad/s
    output: float = 0.0  # frequency of the output in rad/s: its rms by a reference, else the mean of the model's
    integrators: int = 0  # number of poles that count as ``output``

    @classmethod
    def of(cls, evidence: Evidence, closed: bool, by_reference: FloatArray | None = None) -> Speeds:
        """Return the speeds of the estimate's poles."""
        least = 1.0 / evidence.record.span
        if not (closed and evidence.modes):
            return cls(np.maximum(np.abs(evidence.poles), least))
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
        """Return signals (K, ...) without the drift of integrators: filtered by s/(s + output) for each of them."""
        if not self.integrators:
            return signals
        from replant.kernels.filters.autoregressions import all_pole

        decay = np.array([1.0, -math.exp(-self.output * dt)])
        channels = signals.reshape(len(signals), -1).T
        for _ in range(self.integrators):
            channels = all_pole(decay, np.diff(channels, axis=1, prepend=channels[:, :1]))
        return np.ascontiguousarray(channels.T).reshape(signals.shape)


def _fastest(evidence: Evidence) -> list[Finding]:
    """Return a finding if a pole lies at the bound of the search; it prevents trust only if all poles do."""
    beyond = np.abs(evidence.poles) * evidence.dt >= FASTEST * (1.0 - AT_BOUND)
    if not beyond.any():
        return []
    reason = "a pole is as fast as is looked for, 3 / dt, and may be faster: sample faster"
    return [Finding("inconsistent" if beyond.all() else "trusted", reason)]


def slow_noise(evidence: Evidence, uncertainty: float) -> str:
    """Return a remark, in brackets, if slow noise that no autoregression describes causes the uncertainty; else ""."""
    if evidence.slowness < SLOW or uncertainty < MENTIONED:
        return ""
    return " (because the residual varies slowly: the output drifts, or the plant is slightly nonlinear)"


def _scatter(
    evidence: Evidence, runs: Runs, covariance: np.ndarray, speeds: Speeds, by_reference: FloatArray | None
) -> float:
    """Return the standard deviation of the modelled output by the estimate's error, over that of the output."""
    slopes, output = runs.now.slopes, runs.now.forced
    if len(evidence.record.joined.parts) > 1:  # the states after gaps explain output that the input does not cause
        b = evidence.structure.numerator
        output = combined(slopes[:, b], evidence.estimate[b])
    if by_reference is not None and runs.now.instruments is not None:
        slopes, output = runs.now.instruments, by_reference
    signals = np.column_stack([slopes, output, runs.now.nuisances])
    moved = speeds.moved(signals, evidence.dt)[evidence.known][evidence.used[evidence.known]]
    count = slopes.shape[1] + 1  # the columns after these, offset and initial state, are estimated with each model
    left = without(moved[:, :count], np.column_stack([moved[:, count:], np.ones(len(moved))]))
    made = float(np.trace(covariance @ products(left[:, :-1], left[:, :-1])))
    size = sum_of_squares(left[:, -1])
    return math.sqrt(max(made, 0.0) / size) if size > 0.0 else math.inf


def _is_in_doubt(evidence: Evidence, scatter: float) -> bool:
    """Return whether the scatter of a solved record's estimate is too near to its limit for a first-order result."""
    # with feedback another noise would have made another input, which resampling does not reproduce
    if not evidence.is_solved or evidence.filtered is None or evidence.record.r is not None or evidence.diverging_pole:
        return False
    return MOST_SCATTER / FIRST_ORDER < scatter < MOST_SCATTER * FIRST_ORDER


def longer(uncertainty: float, most: float, times: str) -> str:
    """Return in words how much longer a record has to be: a standard deviation falls as 1/sqrt(N)."""
    return times.format(figure(max((uncertainty / most) ** 2, LEAST_LONGER)))


def without_longer(verdict: Assessment) -> Assessment:
    """Return a verdict without the advice to record longer, for cases where that would not help."""
    return replace(verdict, reasons=tuple(LONGER.sub("", reason) for reason in verdict.reasons))


def uncertainty_findings(
    uncertainty: float, most: float, scatter: float, cancelled: complex | None, slow: str, more: str,
    times: str = "",
) -> list[Finding]:  # fmt: skip
    """Return a finding if a coefficient is not known well; it does not prevent trust if the modelled output is."""
    if uncertainty <= most and cancelled is None:
        return []
    reason = f"a coefficient has a standard deviation of {percent(uncertainty)}{slow}"
    needed = min(uncertainty / most, scatter / MINOR_SCATTER)  # either makes it known
    advice = f"{more or longer(needed, 1.0, times)}, move the input more, or ask for fewer poles and zeros"
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


def are_known(structure: Structure, parameters: FloatArray, std: FloatArray, span: float) -> bool:
    """Return whether a trusted model's coefficients can be relied upon one by one, and not G(s) alone.

    ``std`` (P,) is that of `Uncertainty`, infinite if a zero may cancel a pole, and NaN if it is not known.
    """
    if not (np.isfinite(parameters).all() and np.isfinite(std).all()):
        return False
    denominator, numerator = structure.denominator, structure.numerator
    sizes = real_coefficients(parameters[denominator], 1.0 / span)
    # one of the numerator has no size of its own where the plant has no zero: its effect is compared with that of all,
    # at the lowest frequency of the record and at those of the poles, as the newest samples may show none
    poles = np.abs(roots(np.concatenate([[1.0], parameters[denominator]])))
    frequencies = np.maximum([0.0, *poles], 1.0 / span)
    powers = frequencies[:, np.newaxis] ** np.arange(parameters[numerator].size)[::-1]
    wholes = powers @ np.abs(parameters[numerator])
    effects = powers * std[numerator] / np.maximum(wholes, 1e-300)[:, np.newaxis]
    return bool((std[denominator] <= MOST_UNCERTAIN * sizes).all() and (effects <= MOST_UNCERTAIN).all())


def movement_findings(moved: float, sigmas: float, span: str, *, improves: bool = False) -> list[Finding]:
    """Return a finding if the estimate has moved by more than matters, and not by chance."""
    if not (moved > MOST_MOVED and (sigmas > MOVED_SIGMAS or improves)):
        return []
    reason = f"a coefficient has moved by {percent(moved)} over {span} ({figure(sigmas)} standard deviations)"
    return [Finding("converging", reason)]


def _surprise(evidence: Evidence, away: Distance, known: FloatArray) -> float:
    """Return the statistic of a distance over its limit."""
    if not (evidence.in_sample and evidence.instruments):
        return away.statistic
    # the difference of two estimates of the same samples, without noise model and with, scatters no more than the first
    square = float(away.step @ inverse_of(known) @ away.step)  # NaN where that is singular
    return min(away.statistic, square / chi2_quantile(1.0 - ALPHA, away.step.size))


def _of_distance(evidence: Evidence, distance: float) -> Finding:
    reason = f"the samples give a coefficient that differs by {percent(distance)}"
    if not evidence.adapts:
        known = "" if evidence.own is not None else ", or the model, whose uncertainty is not known, was not accurate"
        return Finding("inconsistent", f"{reason}: the plant has changed since, or is another one{known}")
    if not evidence.instruments:
        return Finding("inconsistent", f"{reason}: noise biases an estimate without instruments")
    return Finding("converging", f"{reason}: the estimate has not converged to them yet")
