"""The verdict on an identifier that keeps too few raw samples to test its estimate on: from what it sums up anyhow.

| question | from |
|---|---|
| does the input move | its moving variance, beside the largest that it has been |
| does it excite every coefficient | the information that the recursion keeps, nuisances eliminated |
| does the model follow the output | the moving mean square of the a-priori error, beside the variance of the output |
| is the estimate certain | its covariance, by power and colour of the residual |
| does it stand still | the past estimates that are kept |
| does the structure hold | the verdict on the start-up, whose samples were there |
| have residual or sensor changed | the CUSUM test, ties, missing outputs |

What only samples tell is not checked, and that is said.
"""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.estimate_tests import (
    MOST_MOVED,
    MOST_UNCERTAIN,
    MOST_UNCERTAIN_IN_LOOP,
    MOVED_SIGMAS,
)
from replant.assessment.evidence import FEWEST, LEAST_POWER, PER_COEFFICIENT
from replant.assessment.excitation import Excitation
from replant.assessment.judge import POOREST_FIT
from replant.assessment.verdict import Assessment, Finding, conclude, duration, figure, percent
from replant.engine.covariance import covariance
from replant.engine.state import GAP, State
from replant.kernels.schema import PAST
from replant.model.shared_root import cancelled_pole
from replant.settings import Settings
from replant.statistics.linear_algebra import compose, eigenvalues, inverse_of, quiet, roots

NOT_CHECKED = (
    "history={}: too few raw samples are kept to solve the record again, and to check what else the input explains, "
    "feedback, the dead time, actuator, sensor and slow noise"
)
NO_SUMS = (
    "history={}: too few raw samples are kept for a verdict, and this optimizer follows no sums: give history=1000"
)


@quiet
def assess_sums(state: State, settings: Settings, history: int) -> Assessment:
    """Return the verdict by sums."""
    if not (state.examines_output and settings.instruments):
        return Assessment("converging", (NO_SUMS.format(history),), samples=0)
    fit, known = _fit(state), covariance(state, settings)
    size = settings.structure.coefficients
    known = known[:size, :size]
    speeds = np.abs(roots(np.concatenate([[1.0], state.physical[: settings.structure.poles]])))
    sizes = np.asarray(np.poly(-np.maximum(speeds, 1.0 / max(state.elapsed, settings.dt)))[1:], float)
    std = np.sqrt(np.maximum(np.diag(known), 0.0))
    uncertainty = float((std[: sizes.size] / sizes).max())
    moved, sigmas, since = _movement(state, std, sizes)
    found = Excitation(_condition(state, size), 1.0)
    findings, seen = _of_guard(state, settings), state.samples - state.record_began
    enough = max(FEWEST, PER_COEFFICIENT * size)
    rests = _of_input(state)
    if state.sums.count < enough:
        findings.append(Finding("converging", f"{seen} samples are too few for a verdict: it takes {enough}"))
    elif state.largest_power > 0.0:
        findings += found.findings
        findings += _of_fit(fit)
        findings += _of_estimate(settings, state, known, uncertainty)
        if moved > MOST_MOVED and sigmas > MOVED_SIGMAS:
            span = duration(since * settings.dt)
            reason = f"a coefficient has moved by {percent(moved)} over the last {span} ({figure(sigmas)} standard"
            findings.append(Finding("converging", f"{reason} deviations)"))
    findings += [*rests, Finding("trusted", NOT_CHECKED.format(history))]
    excited = not rests and not found.findings
    favour = (
        f"run beside the plant, the model fits the output to {fit:.1f} %; its denominator's coefficients have standard "
    )
    favour += f"deviations up to {percent(uncertainty)}"
    status, reasons = conclude(findings, favour)
    return Assessment(
        status, reasons, excited, int(state.sums.count),
        fit=fit, condition=found.condition, movement=sigmas, uncertainty=uncertainty,
    )  # fmt: skip


def _fit(state: State) -> float:
    """Return the fit in percent over the last few thousand samples; with the refined filter that of a simulation."""
    sums = state.sums
    return 100.0 * (1.0 - math.sqrt(sums.error_power / sums.output_power)) if sums.output_power > 0.0 else math.nan


def _condition(state: State, size: int) -> float:
    """Return the condition number of the scaled instruments, as `assessment.excitation` does, by their information."""
    inverse = compose(*state.factors)[:size, :size]
    information = inverse_of(inverse)
    scale = np.sqrt(np.diag(information))
    values = eigenvalues(information / np.outer(scale, scale))
    return math.sqrt(values[-1] / values[0]) if np.isfinite(values).all() and values[0] > 0.0 else math.inf


def _movement(state: State, std: FloatArray, sizes: FloatArray) -> tuple[float, float, int]:
    """Return how far a coefficient has moved since the oldest estimate kept: of its size, in sigmas; and how long."""
    kept = state.past[: min(state.past_kept, PAST)]
    if not len(kept):
        return 0.0, 0.0, 0
    oldest = kept[np.argmin(kept[:, 0])]
    step = np.abs((oldest[1:] * state.unit - state.physical)[: std.size])
    moved = float((step[: sizes.size] / sizes).max())
    sigmas = float((step / np.maximum(std, np.finfo(float).tiny)).max())
    return moved, sigmas, state.samples - int(oldest[0])


def _of_input(state: State) -> list[Finding]:
    if not state.largest_power > 0.0:
        return [Finding("not excited", "the input is constant: move it")]
    if state.input_power < LEAST_POWER * state.largest_power:
        part = percent(state.input_power / state.largest_power)
        reason = f"the input hardly moves any more: its variance is {part} of its largest so far"
        return [Finding("trusted", reason)]  # the sums are those of when it moved
    return []


def _of_fit(fit: float) -> list[Finding]:
    if fit >= POOREST_FIT:
        return []
    reason = f"run beside the plant, the model explains almost nothing of the output (fit {fit:.0f} %)"
    return [Finding("inconsistent", f"{reason}: if a controller moves the input, give its reference")]


def _of_estimate(settings: Settings, state: State, known: FloatArray, uncertainty: float) -> list[Finding]:
    pole = cancelled_pole(settings.structure, state.physical, known)
    most = MOST_UNCERTAIN_IN_LOOP if settings.reference else MOST_UNCERTAIN
    if pole is not None:
        reason = f"a zero may cancel the pole near {pole.real:.3g} rad/s, so that the coefficients are not known"
        return [Finding("converging", f"{reason}: ask for fewer poles and zeros")]
    if uncertainty <= most:
        return []
    reason = f"a coefficient has a standard deviation of {percent(uncertainty)}"
    return [
        Finding("converging", f"{reason}: take more samples, move the input more, or ask for fewer poles and zeros")
    ]


def _of_guard(state: State, settings: Settings) -> list[Finding]:
    """Return what the monitoring says of updates, sensor and residual."""
    from replant.kernels.monitoring import outliers

    findings = []
    if state.refused:
        reason = "updates left the range of float64 and were undone: lower the gain or step size, then reset"
        findings.append(Finding("diverged", reason))
    if state.sums.missing > GAP:
        since = duration(state.sums.missing * settings.dt)
        reason = f"no output has arrived for {since}, only the input: check the sensor and its cable"
        findings.append(Finding("inconsistent", reason))
    elif state.stuck_outputs and state.samples - state.stuck_last < outliers.CALM:
        reason = "the output is constant to the bit, or was just now: a stuck or saturated sensor, or a cable off"
        findings.append(Finding("inconsistent", reason))
    elif state.alarm:
        since = duration((state.samples - state.change_began) * settings.dt)
        reason = f"the residual began to grow {since} ago: the plant, the sensor or the disturbances have changed"
        if not state.look_at:
            reason += "; nothing is learned until it is as before: reset begins anew"
        findings.append(Finding("inconsistent", reason))
    if state.sums.refuted:
        reason = (
            "the samples of the start-up spoke against the model that they gave: a plant of more poles, or not linear"
        )
        findings.append(Finding("inconsistent", f"{reason}; fit says more of them"))
    if state.undecided:
        reason = "the residual had grown, and the samples since do not tell yet whether a load or the plant has changed"
        findings.append(Finding("converging", f"{reason}: move the input"))
    return findings
