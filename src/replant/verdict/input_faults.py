"""Nonlinear faults of actuator and sensor, and faults of the input: another hold or dead time than specified.

| fault | columns of its score test |
|---|---|
| the actuator saturates, or has a dead zone | B/A of v^3 and v^5, v the input scaled to -1 .. 1 |
| its gain depends on the direction | B/A of abs(v) |
| it has play or friction | B/A of the play operator of v, for two widths |
| the sensor saturates, has a dead zone or two gains | the same curves (without play) of the modelled output |
| the input is linear between its samples | the output with such an input, minus that with a held one |
| the input acts later or earlier | the derivative of the output with respect to the dead time |
| the input acts on the output of the same row | the input |
| a disturbance has the input's period | cosine and sine of the input's strongest spectral line |

A linear model explains a curve only by its linear part.  What other dynamics could explain is projected out first: then
the model is wrong, and no curve.  An input of two levels shows no curve, as a straight line passes through any two
points; recorded with noise, it explains nothing beside these levels, where a true curve does.  Curves before and behind
the plant compete: the most significant one is named.  A sampled signal, such as a measured voltage, varies between its
samples; the output of a computer is held.  If a smooth input is taken as held, it acts half a sample late, and the
coefficients compensate for that.  It then answers the residual of the same sample, as if the plant had a direct path:
of the two the straight input is named where a direct path explains nothing beside it.

With a reference all columns except the hold's are made of the input that the reference explains, as are the slopes: the
part of the residual that a reference explains is no answer of a controller.  In feedback without a reference, the
column of the dead time uses the past alone, and curves are not tested: the effect of a load on a biased model resembles
them.

Sources: Davidson and MacKinnon (1981), "Several tests for model specification in the presence of alternative
hypotheses", Econometrica 49 (held or straight); Ljung (1999), "System Identification: Theory for the User", section 5.2
(Hammerstein models); Krasnosel'skii and Pokrovskii (1989), "Systems with Hysteresis" (the play operator); Garnier and
Wang (2008), "Identification of Continuous-time Models from Sampled Data", chapter 4 (intersample behaviour).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, responses, run_model
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ALPHA, LARGEST_PART, NEGLIGIBLE
from replant.numerics.linear_algebra import chi2_quantile, combined, inner
from replant.numerics.projections import without
from replant.numerics.score_test import Explained
from replant.verdict.alternatives import Acting, power_of, residual_of
from replant.verdict.estimate_tests import FARTHEST, MOVED_SIGMAS, Speeds
from replant.verdict.evidence import ROUNDING, Evidence
from replant.verdict.verdict import Finding, duration, percent

WIDTHS = (0.2, 0.5)  # half widths of plays: two explain most of any between 0.1 and 0.7 [part of the largest input]
# it is 2 for single steps, 3 for white noise, w^2 for a sine of w rad per sample
SMOOTH = 1.5  # power of second over first differences below which an input is smooth [ratio of powers]
FINER = 4  # frequencies per one that the record resolves: a wave then has an error of at most a twentieth [count]
CYCLES = 2  # periods within the record from which on a wave differs from a drift [count]
OF_TWO_LEVELS = 0.75  # power that two levels explain of a uniform input; of one with a peak less [part]
GAUSS_NEWTON = 3  # steps to the model of a straight input: they vanish after two [count]

# between half a sample, by which an input that is linear between samples seems early, and a whole one
EARLY = 0.75  # time before its row from which on an input acts too early for any model [sampling times]
TOO_EARLY = "move the output's column down by as much, or ask for as many zeros as poles and a direct path"
ALONG = (
    "the input answers the residual of the same sample, along with it, where a controller opposes it: the plant has a "
    "direct path, or the output of a row is recorded after its input has acted"
)
ADVICE = "stay where it is straight, or map the input by its curve"
SATURATES, DEAD = f"the actuator seems to saturate ({ADVICE})", f"the actuator seems to have a dead zone ({ADVICE})"
LOPSIDED = f"the actuator seems to have another gain in the other direction ({ADVICE})"
LOOSE = "the actuator seems to have play or friction (move it by more, or so that it comes from one side)"
REMEDY = "stay where it is straight, or map the output by its curve"
FLATTENS, DEAF = f"the sensor seems to saturate ({REMEDY})", f"the sensor seems to have a dead zone ({REMEDY})"
SKEWED = f"the sensor seems to have another gain in the other direction ({REMEDY})"

Names = tuple[tuple[str, str], ...]
# for odd curves, the magnitude and plays: the fault if the curve grows less than a straight line, and if more
OF_ACTUATOR: Names = (SATURATES, DEAD), (LOPSIDED, LOPSIDED), (LOOSE, LOOSE)
OF_SENSOR: Names = (FLATTENS, DEAF), (SKEWED, SKEWED)  # no plays: they look like those of the actuator


@dataclass(frozen=True)
class Bend:
    """A curve before or behind the plant that explains a part of the residual beside linear columns."""

    acting: Acting
    fault: str
    of_sensor: bool
    part: float  # of the output's power
    statistic: float  # over its limit
    power: float  # of the output

    @property
    def findings(self) -> list[Finding]:
        """The finding on it; none if its part is small, or if linear columns explain more: the model is wrong then."""
        acting = self.acting
        if not self.part > LARGEST_PART:
            return []
        alone = residual_of(acting.evidence, acting.error, acting.nuisances)
        linear = np.hstack([acting.slopes[acting.rows], acting.linear])
        if not self.part > alone.explained(linear, measures_chance=True).power / self.power:
            return []
        place = "behind" if self.of_sensor else "before"
        reason = f"such a curve {place} the plant would explain another {percent(self.part)} of the output's power"
        return [Finding("inconsistent", f"{self.fault}: {reason}")]


def surest_of(bends: Iterable[Bend | None]) -> Bend | None:
    """Return the most significant of some curves; None if there is none."""
    return max(filter(None, bends), key=lambda bend: bend.statistic, default=None)


def bends_of(acting: Acting) -> tuple[Bend | None, Bend | None]:
    """Return the most significant curve of the actuator, and of the sensor; None if not significant or in feedback."""
    if acting.loop.feedback.found and acting.loop.reference is None:  # a load that the input answers looks similar
        return None, None
    evidence, rows, sensed = acting.evidence, acting.rows, acting.sensed

    def surest(signal: FloatArray, power: float, names: Names, *, of_sensor: bool) -> Bend | None:
        """Return the most significant curve of a signal (K,), as a part of an output with this power."""
        newest, found = slice(signal.size - evidence.samples, None), []  # earlier inputs act on the samples, too
        for curves, (inward, outward) in zip(_curves(signal), names, strict=False):  # as many as there are names
            made = curves if of_sensor else _behind_the_plant(evidence, curves)
            told = acting.beyond_dynamics.explained(made[newest][rows])
            # in noise of the input itself, the two levels that reached the plant look like a curve, and leave none
            if told.is_sure and (of_sensor or beside_levels.explained(made[newest][rows]).is_sure):
                curve = combined(curves[newest][rows], told.weights)
                fault = outward if _grows_outward(signal[newest][rows], curve) else inward
                found.append(Bend(acting, fault, of_sensor, min(told.power / power, 1.0), told.statistic, power))
        return surest_of(found)

    record, is_known = evidence.record, acting.loop.reference is None  # without a reference earlier inputs act, too
    whole = record.joined.u if is_known else acting.input + record.u.mean()
    v, z = _scaled(whole - evidence.input_zero), _scaled(sensed - sensed[rows].mean())
    beside_levels, levels = acting.beyond_dynamics, _two_levels(v)
    if levels.any():
        effect = _behind_the_plant(evidence, levels[:, None])
        beside_levels = beside_levels.knowing(effect[effect.shape[0] - evidence.samples :][rows])
    actuator = surest(v, acting.power, OF_ACTUATOR, of_sensor=False)
    return actuator, surest(z, power_of(evidence, sensed[rows]), OF_SENSOR, of_sensor=True)


def hold_findings(acting: Acting) -> list[Finding]:
    """Return a finding if an input taken as held is linear between its samples, or may be, with the effect of that."""
    evidence, runs = acting.evidence, acting.runs
    steps = np.diff(evidence.record.u)
    is_smooth = float(np.mean(np.diff(steps) ** 2)) < SMOOTH * float(np.mean(steps**2))
    may_run = is_smooth or (acting.loop.is_direct and float(np.median(np.abs(steps))) > 0.0)  # one that rests is held
    if evidence.record.input_hold != "zoh" or not may_run:
        return []
    told = _straight_input(evidence)
    if told is None:
        return []
    found, step = told
    # the weight is 1 for a straight input and 0 for a held one, within +-`chance`
    weight, chance = float(found.weights[0]), math.sqrt(chi2_quantile(1.0 - ALPHA, 1)) * found.spread
    if abs(weight) <= chance and abs(weight - 1.0) <= chance and _largest_change(evidence, step) > FARTHEST:
        reason = "the samples do not tell a held input from one that runs straight between its samples, on which"
        advice = 'if it is measured or analogue, use --input-hold foh, or RefinedFilter("foh")'
        return [Finding("trusted", f"{reason} coefficients depend: {advice}")]
    # significantly not held, and not significantly nearer to held, nor to an output that is a row late, of weight 2
    if not (found.is_sure and weight + chance > 0.5 and weight - chance < 1.5):
        return []
    if acting.loop.is_direct and _acts_beside_straight(evidence, step):
        return []
    size, part = runs.size(step, Speeds.of(evidence, closed=False).poles), acting.unexplained()
    reason = "the input seems to run straight between its samples, not to be held: taken so, a coefficient differs by"
    status = "inconsistent" if size > FARTHEST or (part.is_sure and part.is_large) else "trusted"
    return [Finding(status, f'{reason} {percent(size)}: use --input-hold foh, or RefinedFilter("foh")')]


def dead_time_findings(acting: Acting, part: Explained) -> list[Finding]:
    """Return a finding if another dead time explains most of ``part``, which other dynamics could explain."""
    evidence, loop = acting.evidence, acting.loop
    past = loop.feedback.found and loop.reference is None
    late = later(evidence.record, acting.output, evidence.dt, past=past)[acting.rows, None]
    effect = acting.effect_of(late)
    if effect is None:
        return []
    off = effect.weight * evidence.dt
    # a missing pole also looks like a dead time, but leaves more for other dynamics to explain
    left = acting.unexplained(late)
    if left.is_sure and (left.is_large or left.power > 0.5 * part.power):
        return []
    status = "inconsistent" if effect.size > FARTHEST or (part.is_sure and part.is_large) else "trusted"
    return list(timing_finding("the input", evidence.structure.delay, off, evidence.dt, effect.size, status))


def timing_finding(
    subject: str, given: float, off: float, dt: float, size: float, status: str, too_early: str = TOO_EARLY
) -> Iterator[Finding]:
    """Yield a finding that an input acts by ``off`` s later than the dead time ``given``, or earlier if negative."""
    delay = given + off
    if delay <= -EARLY * dt:
        reason = f"{subject} seems to act {-delay:.2g} s before its row: a coefficient differs by {percent(size)}"
        yield Finding(status, f"{reason}: {too_early}")
        return
    # with the digits needed to distinguish it from the one given
    wanted = round(max(delay, 0.0), max(1 - math.floor(math.log10(abs(off))), 0))
    if wanted == given:  # a dead time of zero cannot be shorter
        return
    reason = f"{subject} seems to act {abs(off):.2g} s {'later' if off > 0.0 else 'earlier'} than the model says"
    reason += f": with a dead time of {wanted:g} s a coefficient differs by {percent(size)}"
    yield Finding(status, reason)


def direct_findings(acting: Acting) -> list[Finding]:
    """Return a finding if the input acts on the output of the same row, with the sign of a direct path."""
    if not acting.loop.is_direct:
        return []
    effect = acting.effect_of(acting.input[acting.rows, None])
    if effect is None:
        return [Finding("trusted", ALONG)]
    status = "inconsistent" if effect.size > FARTHEST else "trusted"
    advice = "ask for as many zeros as poles, or move the output's column down by one"
    return [Finding(status, f"{ALONG}; with a direct path a coefficient differs by {percent(effect.size)}: {advice}")]


def rhythm_findings(acting: Acting, part: Explained) -> list[Finding]:
    """Return a finding if a disturbance with the input's period is more significant than ``part`` and changes G(s)."""
    if acting.loop.reference is not None:
        return []
    period, waves = _waves(acting.evidence)
    effect = acting.effect_of(waves[acting.rows]) if waves.size else None
    if effect is None or not (effect.statistic > part.statistic and effect.size > FARTHEST):
        return []
    reason = f"a disturbance that has the input's period, {duration(period)}, would explain what the model leaves, and"
    reason += f" with it a coefficient differs by {percent(effect.size)}"
    return [Finding("inconsistent", f"{reason}: move the input in another rhythm, or record the disturbance, too")]


def _waves(evidence: Evidence) -> tuple[float, FloatArray]:
    """Return the period in s of the input's strongest line, and its waves (K, 2); no column if the record is short."""
    record = evidence.record
    times = np.cumsum(record.intervals) if record.intervals.size > 1 else record.dt * np.arange(record.u.size)
    even = np.linspace(times[0], times[-1], times.size)
    lines = np.abs(np.fft.rfft(np.interp(even, times, record.u - record.u.mean()), FINER * times.size))
    first = FINER * CYCLES
    if lines.size <= first:
        return 0.0, np.zeros((times.size, 0))
    omega = 2.0 * math.pi * (first + int(np.argmax(lines[first:]))) / (FINER * (even[1] - even[0]) * times.size)
    return 2.0 * math.pi / omega, np.column_stack([np.cos(omega * times), np.sin(omega * times)])


def later(record: Record, output: FloatArray, dt: float, *, past: bool) -> FloatArray:
    """Return the change of a model's output (K,) if it is delayed by a sampling time, to first order.

    In feedback later outputs depend on the noise of a sample: ``past`` takes the difference to the sample before.
    """
    times = np.cumsum(record.intervals) if record.intervals.size > 1 else record.dt * np.arange(output.size)
    late = np.zeros(output.size)
    for rows in record.parts:
        if len(range(*rows.indices(output.size))) > 1:
            steps = np.gradient(output[rows], times[rows])
            if past:
                steps[1:] = np.diff(output[rows]) / np.diff(times[rows])
                steps[0] = 0.0
            late[rows] = -dt * steps
    return late


def _straight_input(evidence: Evidence) -> tuple[Explained, FloatArray] | None:
    """Return what a straight input explains of the residual, and the step of the coefficients if the input is straight.

    None if the model cannot be run.  The coefficients compensate for the hold, as a zero of little weight can: the
    column is the output by a straight input and adapted coefficients, minus that by a held one and the estimate.
    """
    # where rows are lost a straight line is nearer to the input than one step, for any hold
    record, places = evidence.record.restored
    rows = places[evidence.known]

    def run(hold: str, parameters: FloatArray) -> ModelRun | None:
        return run_model(evidence.structure, parameters, replace(record, input_hold=hold), evidence.dt)

    held, straight = run("zoh", evidence.estimate), run("foh", evidence.estimate)
    if held is None or straight is None:
        return None
    own = np.hstack([held.zeta[rows], held.nuisances[rows]])
    residual = residual_of(evidence, held.error[rows], own)
    step = -residual.weights_of((straight.forced - held.forced)[rows, None])[: evidence.coefficients, 0]
    moved = np.concatenate([evidence.estimate[: step.size] + step, evidence.estimate[step.size :]])
    straight = run("foh", moved) or straight
    return residual.explained((straight.forced - held.forced)[rows, None]), step


def _acts_beside_straight(evidence: Evidence, step: FloatArray) -> bool:
    """Return whether the input acts on the same row beside a straight one, too, which needs no coefficient more."""
    record, places = evidence.record.restored
    rows, straight, parameters = places[evidence.known], replace(record, input_hold="foh"), evidence.estimate.copy()
    for _ in range(GAUSS_NEWTON):
        parameters[: step.size] += step
        run = run_model(evidence.structure, parameters, straight, evidence.dt)
        if run is None:
            return True
        residual = residual_of(evidence, run.error[rows], np.hstack([run.zeta[rows], run.nuisances[rows]]))
        step = residual.weights_of(run.error[rows, None])[: step.size, 0]
    found = residual.explained(record.u[rows, None])
    return found.is_sure and found.power > NEGLIGIBLE * power_of(evidence, evidence.record.y[evidence.known])


def _largest_change(evidence: Evidence, step: FloatArray) -> float:
    """Return the largest relative change of a coefficient by a step, of those that it changes significantly."""
    if evidence.covariance is None:
        return 0.0
    std = np.sqrt(np.maximum(np.diag(evidence.covariance)[: step.size], 0.0))
    part = np.abs(step) / np.maximum(np.abs(evidence.estimate[: step.size]), np.finfo(float).tiny)
    return float(part[np.abs(step) > MOVED_SIGMAS * std].max(initial=0.0))


def _scaled(u: FloatArray) -> FloatArray:
    """Return an input scaled to -1 .. 1; zero stays zero if the input takes both signs."""
    low, high = float(u.min()), float(u.max())
    middle = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    return np.asarray((u - middle) / max(high - middle, middle - low, float(np.finfo(float).tiny)))


def _curves(v: FloatArray) -> Iterator[FloatArray]:
    """Yield curves (K, C) of a signal in -1 .. 1: odd powers, the magnitude, plays."""
    from replant.kernels.filters.autoregressions import play  # compiled: imported where it is used

    yield np.column_stack([v**3, v**5])
    yield np.abs(v)[:, None]
    yield np.column_stack([play(v, width) for width in WIDTHS])


def _two_levels(v: FloatArray) -> FloatArray:
    """Return -1 and 1 (K,) for a signal with noise about two levels; zero where it has no noise, or other levels."""
    if v.size < 2:
        return np.zeros(v.size)
    ordered, count = np.sort(v - v.mean()), np.arange(1, v.size)
    shares = np.cumsum(ordered)[:-1] ** 2 / (count * count[::-1] * max(float(np.var(v)), float(np.finfo(float).tiny)))
    split = int(np.argmax(shares))
    level = np.where(v - v.mean() > ordered[split], 1.0, -1.0)
    scatter = without(v[:, None], np.column_stack([level, np.ones(v.size)]))[:, 0]
    # the value before predicts noise no better than its mean does, and other levels, which last, much better
    is_noise = float(np.mean(np.diff(scatter) ** 2)) > float(np.var(scatter)) > ROUNDING**2 * float(np.var(v))
    return level if shares[split] > OF_TWO_LEVELS and is_noise else np.zeros(v.size)


def _grows_outward(v: FloatArray, curve: FloatArray) -> bool:
    """Return whether a curve (K,) of a signal (K,), less its linear part, grows outward as v abs(v) does."""
    straight = np.column_stack([v, np.ones(v.size)])
    return inner(without(curve[:, None], straight)[:, 0], without((v * np.abs(v))[:, None], straight)[:, 0]) > 0.0


def _behind_the_plant(evidence: Evidence, curves: FloatArray) -> FloatArray:
    """Return the model's outputs (K, C) with the input replaced by each of the curves (K, C); zero if not finite."""
    model, whole = evidence.structure.transfer_function(evidence.estimate), evidence.record.joined
    whole = whole if len(curves) == whole.u.size else evidence.record
    outputs = responses(model, curves, whole, evidence.dt, whole.input_hold)
    return np.where(np.isfinite(outputs).all(axis=0), outputs, 0.0)
