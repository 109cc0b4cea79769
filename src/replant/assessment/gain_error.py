r"""How well |G| is known at the frequencies that the input excites, and whether the newest samples contradict it.

A coefficient may be known well and abs G badly, or the other way round; whoever uses the model uses G.  After a
change of the plant a new model is made from few samples.  It is trusted where three standard deviations of abs G fit
into the error that a trusted model may have.  The relative standard deviation of abs G at a frequency follows from the
covariance of the coefficients by the delta method.  Where an alarm ended and no other model was found, the samples
since must be able to tell such an error: the standard deviation is then that of an estimate from them alone.  The
excited frequencies are those at which :math:`|G|^2` times the input's power density, the power density of the model's
output, is at least a hundredth of its largest: a tenth of the amplitude.

The second test finds a change of the plant that the residual over a long record hides: one Gauss-Newton step
(`newton_step.newest_distances`) over the newest samples alone, for several lengths, and what it makes of abs G.

Source: Ljung (1999), "System Identification: Theory for the User", sections 9.4 and 6.4 (Welch's spectrum).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import Evidence, Runs
from replant.assessment.newton_step import newest_distances
from replant.assessment.score_test import ALPHA, MATTERS
from replant.assessment.verdict import Finding, duration, percent
from replant.model.uncertainty import Uncertainty
from replant.statistics.linear_algebra import roots

LARGEST_ERROR = math.sqrt(MATTERS)
"""Largest relative error of abs G with which a model is trusted after a change [part of abs G].
Derivation: the amplitude that matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SIGMAS = 3.0
"""Standard deviations of abs G that must fit into the largest error [standard deviations].
Level: 99.7 %: 0.3 % of right estimates are farther off at a frequency.
Sensitivity: halved or doubled, nothing changes on these records.
"""

EXCITED = MATTERS
"""Power density of the model's output below which a frequency is not excited [part of the largest].
Derivation: a tenth of the amplitude is what matters.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SEGMENT = 1024  # length of a segment of Welch's spectrum [samples]

SLOWEST = 0.1
"""Lowest of the frequencies that are added below the spectrum's [part of the slowest pole's magnitude].
Derivation: a decade below the slowest pole abs G is that at rest.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SLOW_FREQUENCIES = 8  # frequencies that are added below the spectrum's [count]

LENGTHS = (1, 2, 4, 8, 16)
"""Lengths of the newest samples over which a change is looked for [numbers of samples that say something].
Derivation: powers of two, as a change may be of any age.
Sensitivity: halved or doubled, nothing changes on these records.
"""

CONTRADICTS = 0.5 * LARGEST_ERROR
"""Part of abs G by which the newest samples must contradict it [part of abs G].
Derivation: half of the largest error.
Sensitivity: not measured.
"""

CONTRADICTS_SIGMAS = 2.0
"""The same in standard deviations at that frequency, where the test of all coefficients together is significant
[standard deviations].
Level: 95 %; that there is a difference at all is told by the test of all coefficients.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def gain_findings(evidence: Evidence, runs: Runs, covariance: FloatArray, alone: FloatArray) -> list[Finding]:
    """Say where abs G is not known well enough, and where the newest samples contradict it."""
    omega = excited_frequencies(evidence)
    std = _uncertainty(evidence, covariance).response(omega)[0]
    findings = [] if evidence.in_sample else _contradiction(evidence, runs, omega)
    worst = float(std.max()) if np.isfinite(std).all() else np.inf
    if evidence.after_change and not SIGMAS * worst <= LARGEST_ERROR:
        reason = f"since the plant has changed abs G is known to {percent(worst)} only (standard deviation)"
        findings.append(Finding("converging", f"{reason}, at a frequency that the input excites"))
    if evidence.after_alarm:  # what raised it may have been a change that the offset and initial state hide
        told = _uncertainty(evidence, alone).response(excited_frequencies(evidence, slowest=True))[0]
        worst = float(told.max()) if np.isfinite(told).all() else np.inf
        if not CONTRADICTS_SIGMAS * worst <= LARGEST_ERROR:
            reason = "the residual is as usual again, but the samples since tell abs G"
            findings.append(Finding("converging", f"{reason} to {percent(worst)} only (standard deviation)"))
    return findings


def excited_frequencies(evidence: Evidence, *, slowest: bool = False) -> FloatArray:
    """Return the frequencies (F,), in rad/s, that the input excites.

    A record shorter than the slowest mode does not resolve the lowest ones: the density there is taken for that of the
    lowest frequency that it resolves.  A pole slower than the record counts as one as slow, unless ``slowest``.
    """
    omega, density = _input_spectrum(evidence)
    poles = np.abs(roots(np.concatenate([[1.0], evidence.estimate[: evidence.structure.poles]])))
    lowest = SLOWEST * max(float(poles.min()), 0.0 if slowest else 1.0 / evidence.record.span)
    if 0.0 < lowest < omega[0]:
        below = np.geomspace(lowest, omega[0], SLOW_FREQUENCIES, endpoint=False)
        omega, density = np.concatenate([below, omega]), np.concatenate([np.full(below.size, density[0]), density])
    power = _magnitude(evidence, evidence.estimate, omega) ** 2 * density
    return np.asarray(omega[power >= EXCITED * power.max()])


def output_frequency(evidence: Evidence) -> float:
    """Return the mean frequency, in rad/s, of the power of the model's output, as far as the record resolves it."""
    omega, density = _input_spectrum(evidence)
    power = _magnitude(evidence, evidence.estimate, omega) ** 2 * density
    return float(omega @ power / power.sum())


def _input_spectrum(evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the frequencies (F,) that the record resolves, in rad/s, and the input's power density (F,) there."""
    u, dt = evidence.record.u, evidence.record.dt
    size = min(u.size, SEGMENT)
    return np.asarray(2.0 * np.pi * np.fft.rfftfreq(size, dt)[1:], float), _density(u, size)[1:]


def _density(u: FloatArray, size: int) -> FloatArray:
    """Return Welch's estimate of the power density of u (K,), at no particular scale, from segments of ``size``."""
    segments = np.lib.stride_tricks.sliding_window_view(u, size)[:: max(size // 2, 1)]
    segments = (segments - segments.mean(axis=1, keepdims=True)) * np.hanning(size + 1)[:size]
    return np.asarray((np.abs(np.fft.rfft(segments)) ** 2).mean(axis=0))


def _contradiction(evidence: Evidence, runs: Runs, omega: FloatArray) -> list[Finding]:
    """Say whether the newest samples alone would put abs G elsewhere, and over which length it is most."""
    present, surest, size, length = _magnitude(evidence, evidence.estimate, omega), 0.0, 0.0, 0
    counts = sorted({evidence.held_out, *(evidence.enough * times for times in LENGTHS)} - {0})
    for count, away in newest_distances(runs.now, counts, ALPHA):
        if not away.statistic > 1.0:
            continue
        there = _magnitude(evidence, evidence.estimate[: evidence.coefficients] + away.step, omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs(there / present - 1.0)
        margin = off - CONTRADICTS_SIGMAS * _uncertainty(evidence, away.covariance).response(omega)[0]
        margin[~(off > CONTRADICTS)] = 0.0
        k = int(np.argmax(np.nan_to_num(margin)))
        if margin[k] > surest:
            surest, size, length = float(margin[k]), float(off[k]), count
    if not surest > 0.0:
        return []
    span = duration(evidence.seconds(length))
    reason = f"the samples of the last {span} alone would put abs G {percent(size)} elsewhere"
    return [Finding("inconsistent", f"{reason}: the plant may have changed")]


def _magnitude(evidence: Evidence, coefficients: FloatArray, omega: FloatArray) -> FloatArray:
    """Return abs G (F,) of a model given by its coefficients."""
    n = evidence.structure.poles
    s = 1j * omega
    den = np.concatenate([[1.0], coefficients[:n]])
    return np.asarray(np.abs(np.polyval(coefficients[n : evidence.coefficients], s) / np.polyval(den, s)))


def _uncertainty(evidence: Evidence, covariance: FloatArray) -> Uncertainty:
    """Return the uncertainty of G(s) alone, without a bias."""
    structure = dataclasses.replace(evidence.structure, bias=False)
    return Uncertainty(structure, evidence.estimate[: evidence.coefficients], covariance)
