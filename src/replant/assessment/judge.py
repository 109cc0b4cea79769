"""From the evidence to the verdict: what each test finds, in which words, and what the findings come to.

Trust needs that the newest samples excite the plant; that a model which has not seen them explains them from the
input alone; that it leaves nothing worth mentioning that the input could still explain, and no more than it left
before; and that the estimate is known well and stands still.  Source: Ljung (1999), "System Identification: Theory for
the User", chapter 16; Soderstrom and Stoica (1989), "System Identification", chapter 11.

Samples at a fixed rate, without time stamps, cannot tell a wrong sampling time: it is the same record in another unit
of time.  With stamps it is found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.assessment import sensor
from replant.assessment.changes import burst_finding, growth_finding
from replant.assessment.cross_test import unexplained
from replant.assessment.estimate import (
    MOST_UNCERTAIN,
    MOVED_SIGMAS,
    Certainty,
    slow_noise,
)
from replant.assessment.evidence import Evidence, Runs
from replant.assessment.excitation import LEAST_POWER, excitation
from replant.assessment.verdict import (
    Assessment,
    Finding,
    conclude,
    duration,
    percent,
)
from replant.engine.state import GAP
from replant.simulation.model_run import ModelRun
from replant.simulation.offset_fit import fit_percent
from replant.statistics.autoregression import whiteness
from replant.statistics.linear_algebra import quiet, roots

POOREST_FIT = 10.0
"""Simulated fit below which the input explains next to nothing [%].
Origin: at a fit of 10 the noise has four times the power of the model's output: a right model of such a plant is of
little use.
Sensitivity: halved or doubled, nothing changes on these records.
"""

WORST_FIT = -1000.0
"""Simulated fit below which fits are not told apart in words [%]."""

LARGEST_PART = (1.0 / 16.0) ** 2
"""What the input could still explain, up to which a model is trusted with a caveat: a sixteenth of the output's
amplitude. The surest of the tests must stay below it with its doubt added [part of the output's power].
Origin: real plants are never quite linear, nor of finite order.
Sensitivity: halved or doubled, nothing changes on these records.
"""

NEGLIGIBLE = 1e-4
"""What the input could still explain that is not worth a word: a hundredth of the amplitude [part of the output's
power].
Origin: a choice of what matters to a user.
Sensitivity: not measured.
"""

MEDIAN_TO_STD = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute values [ratio].
Derivation: 1 / 0.6745, the upper quartile of the standard normal distribution.
"""

RESTING = 1e-12
"""Movement of the input that is rounding [part of its largest magnitude].
Derivation: some thousand times the precision of float64.
"""

Figures = dict[str, Any]


@quiet
def judge(evidence: Evidence) -> Assessment:
    """Return the verdict on an estimate from the evidence."""
    evidence = evidence.in_own_units()
    figures: Figures = {"samples": evidence.samples, "held_out": evidence.held_out}
    findings = _of_samples(evidence)
    stop = any(finding.status != "converging" for finding in findings) or evidence.samples < evidence.enough
    runs = None if stop else Runs.of(evidence)
    if not stop and runs is None:
        pole = roots(np.concatenate([[1.0], evidence.estimate[: evidence.structure.poles]])).real.max()
        reason = f"run from the input alone the model leaves all bounds (a pole at {pole:+.3g} rad/s)"
        findings.append(Finding("inconsistent", reason))
    if runs is not None:
        found = excitation(runs.now, evidence.newest)
        figures |= {"condition": found.condition, "excitation": found.share}
        findings += _of_sensor(evidence, runs)
        if not _lacks_excitation(findings):
            findings += found.findings
        if not _lacks_excitation(findings):  # without it the model's tests say nothing
            findings += _of_model(evidence, runs, figures)
    findings += _of_guard(evidence)
    return Assessment(*conclude(findings, _in_favour(evidence, figures)), **figures)


def _lacks_excitation(findings: list[Finding]) -> bool:
    return any(finding.status == "not excited" for finding in findings)


def _rests(evidence: Evidence) -> bool:
    u = evidence.record.u
    return bool(np.ptp(u) <= RESTING * np.abs(u).max())


def _of_samples(evidence: Evidence) -> list[Finding]:
    """Return what the samples say by themselves, before any model."""
    findings = []
    if evidence.refused:
        reason = "updates left the range of float64 and were undone: lower the gain or step size, then reset"
        findings.append(Finding("diverged", reason))
    if evidence.usual_interval:
        findings += sensor.clock_finding(evidence.usual_interval, evidence.dt)
    u = evidence.record.u
    if _rests(evidence):
        findings.append(Finding("not excited", "the input stands still: move it"))
        return findings
    if evidence.samples < evidence.enough:
        reason = f"{evidence.samples} samples (since the last interruption) are too few to judge by"
        findings.append(Finding("converging", reason))
        return findings
    if np.var(u[evidence.newest]) < LEAST_POWER * evidence.largest_power:
        part = percent(float(np.var(u[evidence.newest])) / evidence.largest_power)
        reason = f"the input hardly moves any more: its variance over {evidence.span} is {part} of what it was"
        findings.append(Finding("not excited", reason))
    if evidence.is_young:
        unseen = f"{evidence.unseen} samples that the estimate has not seen are too few"
        reason = f"{unseen if evidence.unseen else 'every sample was learned from: none is left'} to judge it by"
        findings.append(Finding("converging", reason))
    return findings + sensor.level_finding(u, evidence.raw)


def _of_guard(evidence: Evidence) -> list[Finding]:
    """Return what was noticed as the samples came in."""
    findings = []
    if evidence.missing > GAP:
        reason = f"no output has come for {duration(evidence.seconds(evidence.missing))}, the input alone"
        findings.append(Finding("inconsistent", f"{reason}: sensor, or its cable"))
    elif evidence.stuck:
        reason = "the output stands, or just stood, still to the bit: a stuck or saturated sensor, or a cable off"
        findings.append(Finding("inconsistent", reason))
    elif evidence.grown:
        reason = f"what the model leaves began to grow {duration(evidence.seconds(evidence.grown))} ago"
        findings.append(Finding("inconsistent", f"{reason}: plant, sensor or disturbances have changed"))
    if evidence.unsettled > MOST_UNCERTAIN:
        reason = f"since the plant has changed a coefficient is known to {percent(min(evidence.unsettled, 1.0))} only"
        findings.append(Finding("converging", f"{reason}, as its slowest mode takes time to show"))
    return findings


def _of_sensor(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Return what the sensor does wrong, beside the model's output."""
    y, newest = evidence.raw, evidence.newest
    modelled = evidence.record.y - runs.old.error
    error = runs.old.error[evidence.used] if evidence.used.any() else runs.old.error
    noise = MEDIAN_TO_STD * float(np.median(np.abs(error)))  # stretches of failure do not count
    count = len(y[newest])
    intervals = evidence.record.intervals
    steps = np.full(count, intervals[0]) if intervals.size == 1 else intervals[newest]
    resolved = sensor.is_resolved(y, noise)
    return [
        *sensor.saturation_finding(y[newest], modelled[newest], resolved),
        *sensor.stuck_finding(y[newest], modelled[newest], noise, resolved, np.cumsum(steps), evidence.output_unit),
    ]


def _of_model(evidence: Evidence, runs: Runs, figures: Figures) -> list[Finding]:
    """Return what the tests of the model and of the estimate find."""
    certainty = Certainty.of(evidence, runs)
    figures |= certainty.figures
    model = [
        *_fit(evidence, runs, figures),
        *_unexplained(evidence, runs, figures),
        *growth_finding(evidence, runs, figures),
        *burst_finding(evidence, runs),
    ]
    if certainty.improves:  # what the earlier estimate could not explain, the present one may
        model = [Finding(max(found.status, "converging", key=_gravity), found.reason) for found in model]
    return model + certainty.findings


def _gravity(status: str) -> int:
    return ("inconsistent", "converging", "trusted").index(status)


def _fit(evidence: Evidence, runs: Runs, figures: Figures) -> list[Finding]:
    y = evidence.record.y[evidence.newest]
    used = evidence.used[evidence.newest]
    figures["fit"] = fit = fit_percent(np.where(used, y, np.nan), y - runs.error)
    figures["whiteness"] = whiteness(runs.error)
    if fit >= POOREST_FIT:
        return []
    if math.isnan(fit):
        return [Finding("inconsistent", f"the output stands still over {evidence.span} while the input moves")]
    seen = ", in sample," if evidence.in_sample else ""
    reason = f"run from the input alone over {evidence.span}{seen} the model explains next to nothing of the output"
    shown = f"{fit:.0f} %" if fit > WORST_FIT else f"below {WORST_FIT:.0f} %"
    return [Finding("inconsistent", f"{reason} (fit {shown})")]


def _unexplained(evidence: Evidence, runs: Runs, figures: Figures) -> list[Finding]:
    """Test both runs: the present estimate over all that it should know, the earlier one over the samples held out."""
    present = Part.of(evidence, runs.now, evidence.known, 0.0)
    parts = [present]
    if evidence.held_out:
        parts.append(Part.of(evidence, runs.old, evidence.newest, evidence.held_out / max(evidence.learned, 1)))
    surest = max(parts, key=lambda part: part.statistic)
    largest = max((part for part in parts if part.is_sure or part is surest), key=lambda part: part.size)
    figures |= {"explained": largest.size, "explained_limit": surest.statistic}
    if not surest.is_sure or largest.size < NEGLIGIBLE:
        return []
    reason = f"the input could explain another {percent(min(largest.size, 1.0))} of the output's power"
    if largest.size <= LARGEST_PART and surest.size + surest.doubt <= LARGEST_PART:
        return [Finding("trusted", f"{reason}, which the model leaves; small, but no chance")]
    if evidence.adapts and figures["movement"] > MOVED_SIGMAS and not (present.is_sure and present.is_large):
        return [Finding("converging", f"{reason}, which the estimate of {evidence.span} ago left, and the present not")]
    biased = "" if evidence.instruments else "noise, which biases an estimate without instruments, "
    causes = f"{biased}too few poles or zeros, a wrong dead time, or a plant that changes or is not linear"
    return [Finding("inconsistent", f"{reason}, which the model leaves: {causes}")]


@dataclass(frozen=True)
class Part:
    """What the input could still explain, as a part of the output's power, and how sure that is."""

    size: float
    doubt: float
    statistic: float

    @classmethod
    def of(cls, evidence: Evidence, run: ModelRun, rows: slice, surplus: float) -> Part:
        """Test a run over ``rows``."""
        found = unexplained(run, rows, evidence.dt, surplus)
        used = evidence.used[rows]
        if not used.any():
            return cls(0.0, 0.0, 0.0)
        output, error = float(np.var(evidence.record.y[rows][used])), float(np.var(run.error[rows][used]))
        power = max(output, float(np.finfo(float).tiny))
        # as Python's numbers, which become infinite without a warning where the output stands still
        share = float(used.mean())  # samples that were bridged leave nothing, and are counted by neither side
        return cls(min(float(found.power) / share, error) / power, float(found.doubt) / share / power, found.statistic)

    @property
    def is_sure(self) -> bool:
        """Whether it is no chance."""
        return self.statistic > 1.0

    @property
    def is_large(self) -> bool:
        """Whether it may be more than what a trusted model may leave."""
        return self.size + self.doubt > LARGEST_PART


def _in_favour(evidence: Evidence, figures: Figures) -> str:
    """Return what speaks for the model."""
    fit, uncertainty = figures.get("fit", math.nan), figures.get("uncertainty", math.nan)
    seen = "in sample" if evidence.in_sample else "which it had not seen"
    return (
        f"run from the input alone over {evidence.span}, {seen}, the model fits the output to {fit:.1f} %; "
        f"its coefficients are known to {percent(uncertainty)}{slow_noise(evidence, uncertainty)}"
    )
