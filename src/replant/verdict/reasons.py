"""The judgement: run all tests on the evidence and combine their findings to a verdict.

A model is trusted if

* the newest samples excite the plant;
* an estimate that has not used them explains them from the input alone;
* the input cannot explain any more of the residual, and the residual is not larger than before;
* the estimate has a small uncertainty and has stopped moving.

Under a controller the input answers the residual.  A right model is then trusted if the noise model whitens the
residual, or if a reference explains nothing of it.  An unstable model is trusted only with a reference.

A wrong sampling time is found from time stamps only: without them the record fits another plant, with time in another
unit.

Source: Ljung (1999), "System Identification: Theory for the User", chapter 16; Soderstrom and Stoica (1989), "System
Identification", chapter 11.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from replant.estimation.engine.state import GAP
from replant.estimation.simulation.fitted_run import fit_percent
from replant.model.uncertainty import cancelled_pole
from replant.numerics.autoregression import one_step, whiteness
from replant.numerics.levels import MATTERS, NEGLIGIBLE
from replant.numerics.linear_algebra import quiet
from replant.numerics.robust import robust_std
from replant.verdict import sensor_and_excitation
from replant.verdict.alternatives import Acting, dynamics, residual_of, unexplained_by_reference
from replant.verdict.estimate_tests import estimate_findings, slow_noise, without_longer
from replant.verdict.evidence import (
    ALLOWED,
    CONSTANT,
    COPY,
    LEAST_POWER,
    RESTED,
    RESTING,
    STANDS_STILL,
    Evidence,
    Runs,
    is_constant,
    is_copy,
)
from replant.verdict.held_output import held_output_findings
from replant.verdict.input_faults import (
    bends_of,
    dead_time_findings,
    direct_findings,
    hold_findings,
    rhythm_findings,
    surest_of,
)
from replant.verdict.loop import Loop, Reference
from replant.verdict.plant_faults import plant_findings
from replant.verdict.sensor_and_excitation import LOADS_ACT, LOADS_MAY_ACT
from replant.verdict.verdict import STATUSES, Assessment, Finding, conclude, duration, percent

POOREST_FIT = 10.0  # simulated fit below which the input explains next to nothing: noise has four times its power [%]
WORST_FIT = -1000.0  # simulated fit below which fits are not told apart in words [%]
DISAGREES = 0.5 * math.sqrt(MATTERS)  # difference of estimates that a right structure makes equal [part of the output]
FEWEST_MOVING = 500  # samples before a rest for a verdict from all of them: those of a default start-up [samples]
MANY = 10  # samples from which on a model may be tested on those that it was made from [samples that a test needs]
BEFORE = "the model was trusted when the input came to rest, and the output has shown nothing against it since"

Figures = dict[str, Any]


@quiet
def judge(evidence: Evidence) -> Assessment:
    """Return the verdict on an estimate from the evidence."""
    evidence = evidence.in_own_units()
    # too few samples came since the estimate was made
    if evidence.is_young and (evidence.finished or evidence.samples >= MANY * evidence.enough):
        evidence = evidence.as_whole()
    verdict = _judged(evidence)
    if verdict.excited:
        # a solution of the whole record, as by `fit`, is better tested by all samples than by an earlier estimate
        if evidence.finished and not evidence.in_sample and verdict.status != "trusted":
            return _judged(evidence.as_whole())
        return verdict
    # the newest samples cannot decide whether the model is right: all samples may, or the verdict from before the rest
    objections = _of_samples(evidence) + _of_guard(evidence)
    rested = evidence.samples - evidence.moving
    was_trusted = evidence.trusted_before and (not evidence.moving or rested >= evidence.since_trusted + RESTED)
    if was_trusted and not any(found.status in ("diverged", "inconsistent") for found in objections):
        return replace(verdict, status="trusted", reasons=(BEFORE, verdict.reasons[0]))
    few = 0 if evidence.finished else FEWEST_MOVING
    before = verdict if evidence.in_sample or evidence.moving < few else _judged(evidence.as_whole())
    if before.excited:
        return replace(before, excited=False, reasons=(*before.reasons, verdict.reasons[0]))
    return verdict


def _judged(evidence: Evidence) -> Assessment:
    """Return the verdict by the samples held out, or by all if none is held out."""
    figures: Figures = {"samples": evidence.samples, "held_out": evidence.held_out}
    findings, in_favour = _of_samples(evidence), ""
    stop = any(finding.status != "converging" for finding in findings) or evidence.counted < evidence.enough
    stop = stop or not evidence.used[evidence.known].any()  # no output was measured
    reference, doubts = (None, []) if stop else Reference.of(evidence)
    runs = None if stop else Runs.of(evidence, None if reference is None else reference.explained)
    if not stop and runs is None:
        reason = f"the model's signals leave float64 (a pole at {evidence.poles.real.max():+.3g} rad/s)"
        findings.append(Finding("inconsistent", reason))
    if runs is not None:
        found = sensor_and_excitation.excitation(runs.now, evidence.newest)
        figures |= {"condition": found.condition, "excitation": found.share}
        # an output that is held between reports looks like a stuck sensor
        held = held_output_findings((evidence, runs))
        findings += held or _of_sensor(evidence, runs)
        # a fault that the comparison with the model has named is not named again
        named = bool(held) or any(each.status != "trusted" for each in findings)
        evidence = replace(evidence, stuck=evidence.stuck and not named)
        if not (_lacks_excitation(findings) or _shares_root(evidence, found.condition)):
            findings += found.findings
        if not _lacks_excitation(findings):  # without excitation the tests of the model are meaningless
            loop = Loop.of(evidence, runs, reference, doubts)
            findings += _of_model(evidence, runs, loop, figures)
            in_favour = _in_favour(evidence, loop, figures)
    findings += _of_guard(evidence)
    figures["excited"] = not _lacks_excitation(findings)
    verdict = Assessment(*conclude(findings, in_favour), **figures)
    # more samples do not make an inconsistent model right
    return without_longer(verdict) if verdict.status == "inconsistent" else verdict


def _shares_root(evidence: Evidence, condition: float) -> bool:
    """Return whether a pole that a zero may cancel explains too large a condition number, and not the input."""
    if evidence.covariance is None or condition < sensor_and_excitation.WORST_CONDITION:
        return False
    return cancelled_pole(evidence.structure, evidence.estimate, evidence.covariance) is not None


def _lacks_excitation(findings: list[Finding]) -> bool:
    return any(finding.status == "not excited" for finding in findings)


def _of_samples(evidence: Evidence) -> list[Finding]:
    """Return the findings that need no model."""
    findings = [Finding("diverged", sensor_and_excitation.REFUSED)] if evidence.refused else []
    clock = sensor_and_excitation.clock_finding(evidence.usual_interval or evidence.dt, evidence.dt)
    findings += clock + sensor_and_excitation.burst_of_stamps_finding(evidence.record)
    u, whole = evidence.record.u, evidence.record.joined.u
    if is_constant(whole) and clock:  # each interval may be a gap, and the record a single sample
        return findings
    if is_constant(whole):
        reason = CONSTANT
        if evidence.largest_power > (RESTING * float(np.abs(u).max())) ** 2:
            reason = sensor_and_excitation.RESTED.format(duration(evidence.seconds(evidence.samples)))
        return [*findings, Finding("not excited", reason)]
    known = evidence.raw[evidence.used]
    if known.size and known.min() == known.max():
        return [*findings, Finding("inconsistent", STANDS_STILL.format(evidence.span))]
    if is_copy(u[evidence.used], known):
        return [*findings, Finding("inconsistent", COPY)]
    if evidence.counted < evidence.enough:
        since = "" if evidence.in_sample else " (since the last interruption)"
        reason = f"{evidence.counted} samples{since} are too few for a verdict: it takes {evidence.enough}"
        return [*findings, Finding("converging", reason)]
    if np.var(u[evidence.newest]) < LEAST_POWER * evidence.largest_power:
        part = percent(float(np.var(u[evidence.newest])) / evidence.largest_power)
        reason = f"the input hardly moves any more: its variance over {evidence.span} is {part} of its largest so far"
        if is_constant(u[evidence.newest]):
            reason = sensor_and_excitation.RESTED.format(evidence.age)
        findings.append(Finding("not excited", reason))
    if evidence.is_young:
        few = f"{evidence.unseen} samples that the estimate has not used are too few"
        reason = f"{few if evidence.unseen else 'the estimate has used every sample: none is left'} to test it on"
        findings.append(Finding("converging", reason))
    return findings + sensor_and_excitation.level_finding(u, evidence.raw)


def _of_guard(evidence: Evidence) -> list[Finding]:
    findings = sensor_and_excitation.guard_findings(
        evidence.seconds(evidence.missing) if evidence.missing > GAP else 0.0,
        evidence.stuck,
        evidence.seconds(evidence.grown) if evidence.grown else 0.0,
        evidence.undecided and not evidence.loads,
    )
    change = evidence.plant_change
    if evidence.loads and not (evidence.undecided and change is not None):  # it takes the place of loads that may act
        status, reason = ("converging", LOADS_MAY_ACT) if evidence.undecided else ("trusted", LOADS_ACT)
        findings.append(Finding(status, reason.format(sensor_and_excitation.times_after(evidence.loads))))
    if evidence.begun_anew:
        since = duration(evidence.seconds(evidence.begun_anew))
        findings.append(Finding("trusted", sensor_and_excitation.FOLLOWED.format(since)))
    if change is not None and change.goes_on:
        findings.append(Finding("inconsistent", sensor_and_excitation.CHANGING))
    elif change is not None:
        since = duration(evidence.seconds(change.samples))
        findings.append(Finding("inconsistent", sensor_and_excitation.CHANGED.format(since)))
    return findings


def _of_sensor(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Return the faults of the sensor, found by comparison with the model's output."""
    y, newest = evidence.raw, np.arange(evidence.samples)[evidence.newest]
    newest = newest[evidence.record.is_measured[newest]]  # the others have the model's output
    if not newest.size:
        return []
    modelled = evidence.record.y - runs.old.error
    noise = robust_std(runs.old.error[evidence.used])
    resolved = sensor_and_excitation.is_resolved(y, noise)
    elapsed, unit = np.cumsum(np.broadcast_to(evidence.record.intervals, y.shape)[newest]), evidence.output_unit
    u, y, modelled = evidence.record.u[newest], y[newest], modelled[newest]
    found = sensor_and_excitation.end_finding(u, y, modelled, noise, elapsed)
    found = found or sensor_and_excitation.saturation_finding(y, modelled, unit)
    found = found or sensor_and_excitation.stuck_finding(y, modelled, noise, resolved, elapsed, unit)
    return found + sensor_and_excitation.left_out_finding(evidence.left_out)


def _of_model(evidence: Evidence, runs: Runs, loop: Loop, figures: Figures) -> list[Finding]:
    made = None if loop.reference is None else loop.reference.output
    known, improves, disagreement = estimate_findings(evidence, runs, figures, loop.is_closed, made)
    acting = Acting.of(evidence, runs, loop)
    bend = surest_of(bends_of(acting))
    model = [
        *_fit(evidence, runs, loop, figures),
        *([] if bend is None else bend.findings),
        *_unexplained(acting, figures),
        *plant_findings(acting)[0],
        *([] if loop.is_closed else _unexplained_before(evidence, runs)),
        *sensor_and_excitation.growth_finding(evidence, runs, figures, referenced=loop.reference is not None),
        *sensor_and_excitation.burst_finding(evidence, runs),
    ]
    apart = max(evidence.disagreement, disagreement)
    if apart > DISAGREES:
        reason = (
            f"filtered by its noise model the same record gives another model, whose output differs by {percent(apart)}"
        )
        reason += ": too few poles or zeros, a wrong dead time, or a plant that is not linear"
        model.append(Finding("inconsistent", reason))
    if improves:  # the present estimate may explain what the earlier one did not
        model = [Finding(max(found.status, "converging", key=STATUSES.index), found.reason) for found in model]
    held = [] if loop.reference is not None else hold_findings(acting)
    # an input with a wrong hold acts half a sample early, and then seems to answer the residual
    return (held or [*loop.findings, *direct_findings(acting)]) + model + known


def _fit(evidence: Evidence, runs: Runs, loop: Loop, figures: Figures) -> list[Finding]:
    y = evidence.record.y[evidence.newest]
    used = evidence.used[evidence.newest]
    figures["whiteness"] = whiteness(np.where(used, runs.error, np.nan))
    shown = np.where(used, y, np.nan)
    if loop.reference is not None:  # in feedback the rest comes from disturbances, and may be the larger part
        fit = loop.reference.fit(runs.old.error, evidence.newest)
    elif evidence.unstable_pole > 0.0:  # from the input alone it diverges
        fit = fit_percent(shown, y - one_step(np.where(used, runs.error, np.nan)))
    else:
        fit = fit_percent(shown, y - runs.error)
    figures["fit"] = fit
    if loop.reference is not None and not unexplained_by_reference(evidence, runs.old, loop.reference).is_sure:
        return []  # a poor fit may be chance
    if fit >= POOREST_FIT:
        if evidence.unstable_pole > 0.0 and loop.reference is None:
            reason = f"one step ahead over {evidence.span}, the model fits the output to {fit:.1f} %"
            return [Finding("trusted", reason)]
        return []
    if math.isnan(fit):
        return [Finding("inconsistent", STANDS_STILL.format(evidence.span))]
    run = f"{_how_run(evidence, loop)} over {evidence.span}{' (in sample)' if evidence.in_sample else ''}"
    figure = f"{fit:.0f} %" if fit > WORST_FIT else f"below {WORST_FIT:.0f} %"
    reason = f"{run}, the model explains almost nothing of the output (fit {figure})"
    if evidence.record.r is None:
        reason += loop.colour or (
            "" if loop.feedback.found else ": if a controller moves the input, give its reference"
        )
    return [Finding("inconsistent", reason)]


def _how_run(evidence: Evidence, loop: Loop) -> str:
    """Return how the model was run for its fit, in words."""
    if loop.reference is not None:
        return "in what the reference explains of the output"
    return "one step ahead" if evidence.unstable_pole > 0.0 else "simulated from the input alone"


def _unexplained(acting: Acting, figures: Figures) -> list[Finding]:
    """Return a finding on what other dynamics, or the reference, could still explain of the residual."""
    loop, part = acting.loop, acting.unexplained()
    figures |= {"explained": part.power, "explained_limit": part.statistic}
    named = rhythm_findings(acting, part) or dead_time_findings(acting, part)
    if named:
        return named
    if not part.exactly > 1.0 or part.power < NEGLIGIBLE:
        return []
    source = "input" if loop.reference is None else "reference"  # the input may explain what the noise model leaves
    reason = f"the {source} could explain another {percent(min(part.power, 1.0))} of the output's power"
    if not part.is_large:
        return [Finding("trusted", f"{reason}, unexplained by the model: small, but statistically significant")]
    if not part.is_sure:
        return [Finding("converging", f"{reason}, {ALLOWED}")]
    if loop.feedback.found and loop.reference is None:
        return [Finding("inconsistent", f"{reason}{loop.colour}")]
    biased = "" if acting.evidence.instruments else "noise, which biases an estimate without instruments, "
    causes = f"{biased}too few poles or zeros, a wrong dead time, or a plant that changes or is nonlinear"
    return [Finding("inconsistent", f"{reason}, unexplained by the model: {causes}")]


def _unexplained_before(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Return a finding if the input explains much of the earlier estimate's residual in samples it has not used."""
    # where all samples are held out, `_unexplained` has tested them
    if not (0 < evidence.held_out < evidence.samples and evidence.used[evidence.newest].any()):
        return []
    newest, run = replace(evidence, follows=True), runs.old  # `known` is then what was held out
    rows = newest.known
    residual = residual_of(newest, run.error[rows], run.nuisances[rows])
    # other coefficients count as other dynamics do: the plant may have changed
    found = residual.explained(np.hstack([dynamics(newest, run), run.zeta[rows]]))
    part = found.of_output(evidence.record.y[rows], run.error[rows], newest.used[rows])
    # the variance of the estimate adds as samples held out over samples learned
    part = replace(part, statistic=part.statistic / (1.0 + evidence.held_out / max(evidence.learned, 1)))
    if not (part.is_sure and part.is_large):
        return []
    part_of = f"{percent(min(part.power, 1.0))} of the output's power over {evidence.span}"
    past = f"unexplained by the estimate of {evidence.age} ago: it still converges, or the plant changes"
    return [Finding("converging", f"the input could explain another {part_of}, {past}")]


def _in_favour(evidence: Evidence, loop: Loop, figures: Figures) -> str:
    fit, uncertainty = figures.get("fit", math.nan), figures.get("uncertainty", math.nan)
    which = "in sample" if evidence.in_sample else "which the estimate had not used"
    std = f"; its denominator's coefficients have standard deviations up to {percent(uncertainty)}"
    std = "" if math.isinf(uncertainty) else std + slow_noise(evidence, uncertainty)
    explains = f"the model fits the output to {fit:.1f} %"
    if fit < POOREST_FIT:  # possible with a reference only, see `_fit`
        explains = "what the model leaves may be chance"
    return f"{_how_run(evidence, loop)} over {evidence.span} ({which}), {explains}{std}"
