"""Faults of actuator and sensor that are not linear, and of the input: another hold or dead time than was given.

| fault | columns of its score test |
|---|---|
| the actuator saturates, or has a dead zone | B/A of v^3 and v^5, v the input on a scale from -1 to 1 |
| its gain is another one in the other direction | B/A of abs(v) |
| it has play or friction | B/A of the play of v, of two widths: it depends on where the input came from |
| the sensor saturates, has a dead zone or two gains | the same curves of the modelled output, behind the plant |
| the input runs straight between its samples | the output with such an input, less that with a held one |
| the input acts later or earlier | the derivative of the output by the dead time |
| the input acts on its own row | the input |
| a disturbance has its period | cosine and sine of its strongest line |

A linear model is right beside a curve only as far as that is straight.  What other dynamics could explain is taken away
first: it is then the model that is wrong.  An input of two levels cannot tell: all curves through two points are
straight lines.  Curves before and behind the plant compete: the one that explains most surely is named.  A signal that
was sampled, such as a measured voltage, runs on between its samples; one that a computer puts out is held.  Taken as
held, a smooth input acts half a sample late, and the coefficients make up for that.

With a reference all but the hold are made of what that explains of the input, beside the slopes made of the same: a
part of the residual that it explains is no answer of a controller.  In feedback without one dead time and direct path
are made of the past alone, and no actuator is asked for: what a load leaves of a biased model looks like its curves.

Sources: Davidson and MacKinnon (1981), "Several tests for model specification in the presence of alternative
hypotheses", Econometrica 49 (held or straight); Ljung (1999), "System Identification: Theory for the User", section 5.2
(Hammerstein models); Krasnosel'skii and Pokrovskii (1989), "Systems with Hysteresis" (the play operator); Garnier and
Wang (2008), "Identification of Continuous-time Models from Sampled Data", chapter 4 (intersample behaviour).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, responses, run_model
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ALPHA, LARGEST_PART, NEGLIGIBLE
from replant.numerics.linear_algebra import chi2_quantile, combined, inner
from replant.numerics.projections import without
from replant.numerics.score_test import Explained, Residual
from replant.verdict.estimate_tests import FARTHEST, MOVED_SIGMAS, Speeds
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.residual_tests import (
    Loop,
    dynamics,
    power_of,
    residual_of,
    unexplained,
    unexplained_by_reference,
)
from replant.verdict.verdict import Finding, duration, percent

WIDTHS = (0.2, 0.5)  # half widths of plays: two explain most of any between 0.1 and 0.7 [part of the largest input]
SMOOTH = 1.5  # of second over first differences: 2 of single steps, 3 of noise, w^2 of a sine of w [ratio of powers]

FINER = 4  # frequencies between two that the record resolves: a wave is then off by at most a twentieth [count]
CYCLES = 2  # periods within the record from which on a wave can be told from a drift [count]

# midway between half a sample, which an input that runs straight seems to act early, and a whole one
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
# of odd curves, of the magnitude and of plays: what they are if they grow less than a straight line, and if more
OF_ACTUATOR: Names = (SATURATES, DEAD), (LOPSIDED, LOPSIDED), (LOOSE, LOOSE)
OF_SENSOR: Names = (FLATTENS, DEAF), (SKEWED, SKEWED)  # no plays: they look like those of the actuator


@dataclass(frozen=True)
class Bend:
    """A curve before or behind the plant that explains a part of the residual beside linear columns."""

    fault: str
    of_sensor: bool
    part: float  # of the output's power
    least: float  # part from which on it is a fault: where linear columns explain more, it is the model that is wrong
    statistic: float  # over its limit

    @property
    def findings(self) -> list[Finding]:
        """What is said of it; nothing where it is too small."""
        if not self.part > self.least:
            return []
        place = "behind" if self.of_sensor else "before"
        reason = f"such a curve {place} the plant would explain another {percent(self.part)} of the output's power"
        return [Finding("inconsistent", f"{self.fault}: {reason}")]


def bend_findings(acting: Acting) -> list[Finding]:
    """Name the curve of actuator or sensor that explains a part of the residual most surely."""
    surest = surest_of(bends_of(acting))
    return [] if surest is None else surest.findings


def surest_of(bends: Iterable[Bend | None]) -> Bend | None:
    """Return the surest of some curves; None where there is none."""
    return max(filter(None, bends), key=lambda bend: bend.statistic, default=None)


def bends_of(acting: Acting) -> tuple[Bend | None, Bend | None]:
    """Return the curve of the actuator, and of the sensor, that explains most surely; None if it may be chance."""
    if acting.loop.feedback.found and acting.loop.reference is None:  # a load that it answers may look alike
        return None, None
    evidence, rows = acting.evidence, acting.evidence.known
    given, error, nuisances = acting.whole_input, acting.runs.now.error[rows], acting.runs.now.nuisances[rows]
    before = given.size - evidence.samples  # all that acts comes through
    linear = np.hstack([acting.slopes[rows], acting.linear])
    residual = residual_of(evidence, error, np.hstack([nuisances, linear]))
    by_linear = residual_of(evidence, error, nuisances).explained(linear).power

    def surest(signal: FloatArray, output: FloatArray, names: Names, *, of_sensor: bool) -> Bend | None:
        """Return the surest of the curves of a signal (K,) as a part of an output (J,)."""
        power, newest = power_of(evidence, output), signal[signal.size - evidence.samples :][rows]
        least, found = max(LARGEST_PART, by_linear / power), []
        for curves, (inward, outward) in zip(_curves(signal), names, strict=False):  # as many as there are names
            made = curves if of_sensor else _behind_the_plant(evidence, curves)[before:]
            told = residual.explained(made[rows])
            if told.is_sure:
                curve = combined(curves[signal.size - evidence.samples :][rows], told.weights)
                fault = outward if _grows_outward(newest, curve) else inward
                found.append(Bend(fault, of_sensor, min(told.power / power, 1.0), least, told.statistic))
        return surest_of(found)

    actuator = surest(_scaled(given - evidence.input_zero), acting.made[rows], OF_ACTUATOR, of_sensor=False)
    sensed = acting.sensed[rows]
    return actuator, surest(_scaled(acting.sensed - sensed.mean()), sensed, OF_SENSOR, of_sensor=True)


def hold_findings(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Say where an input that is taken as held ran straight between its samples, or may have, and what that changes."""
    steps = np.diff(evidence.record.u)
    is_smooth = float(np.mean(np.diff(steps) ** 2)) < SMOOTH * float(np.mean(steps**2))
    if evidence.record.input_hold != "zoh" or not is_smooth:
        return []
    told = _straight_input(evidence)
    if told is None:
        return []
    found, step = told
    # the weight of a straight input is 1, of a held one 0; `chance` is how far it may be off
    weight, chance = float(found.weights[0]), math.sqrt(chi2_quantile(1.0 - ALPHA, 1)) * found.spread
    if abs(weight) <= chance and abs(weight - 1.0) <= chance and _largest_change(evidence, step) > FARTHEST:
        reason = "the samples do not tell a held input from one that runs straight between its samples, on which"
        advice = 'if it is measured or analogue, use --input-hold foh, or RefinedFilter("foh")'
        return [Finding("trusted", f"{reason} coefficients depend: {advice}")]
    if not (found.is_sure and weight + chance > 0.5):  # surely not held, nor surely nearer to it
        return []
    size = runs.size(step, Speeds.of(evidence, closed=False).poles)
    reason = "the input seems to run straight between its samples, not to be held: taken so, a coefficient differs by"
    status = "inconsistent" if size > FARTHEST else "trusted"
    return [Finding(status, f'{reason} {percent(size)}: use --input-hold foh, or RefinedFilter("foh")')]


def dead_time_findings(acting: Acting, part: Explained) -> list[Finding]:
    """Say where another dead time would explain most of ``part``, what other dynamics could, and what that changes."""
    evidence, runs, loop = acting.evidence, acting.runs, acting.loop
    past = loop.feedback.found and loop.reference is None
    late = later(evidence.record, acting.output, evidence.dt, past=past)[evidence.known, None]
    told = acting.told(late)
    if told is None:
        return []
    off = told.weight * evidence.dt
    # a pole too few looks like a dead time, too, but leaves more for other dynamics to explain
    if loop.reference is None:
        left = unexplained(evidence, runs, feedback=loop.feedback.found, known=late)
    else:
        left = unexplained_by_reference(evidence, runs.now, loop.reference, np.hstack([acting.known, late]))
    if left.is_sure and (left.is_large or left.power > 0.5 * part.power):
        return []
    status = "inconsistent" if told.size > FARTHEST or (part.is_sure and part.is_large) else "trusted"
    return list(timing_finding("the input", evidence.structure.delay, off, evidence.dt, told.size, status))


def timing_finding(
    subject: str, given: float, off: float, dt: float, size: float, status: str, too_early: str = TOO_EARLY
) -> Iterator[Finding]:
    """Say that an input acts so many s later than by the dead time that was given, or earlier."""
    delay = given + off
    if delay <= -EARLY * dt:
        reason = f"{subject} seems to act {-delay:.2g} s before its row: a coefficient differs by {percent(size)}"
        yield Finding(status, f"{reason}: {too_early}")
        return
    # in as many digits as tell it from the one given
    wanted = round(max(delay, 0.0), max(1 - math.floor(math.log10(abs(off))), 0))
    if wanted == given:  # no dead time is shorter than none
        return
    reason = f"{subject} seems to act {abs(off):.2g} s {'later' if off > 0.0 else 'earlier'} than the model says"
    reason += f": with a dead time of {wanted:g} s a coefficient differs by {percent(size)}"
    yield Finding(status, reason)


def direct_findings(acting: Acting) -> list[Finding]:
    """Say where the input acts on the output of its own row, as no controller would, and what that changes."""
    if not acting.loop.is_direct:
        return []
    told = acting.told(acting.input[acting.evidence.known, None])
    if told is None:
        return [Finding("trusted", ALONG)]
    status = "inconsistent" if told.size > FARTHEST else "trusted"
    advice = "ask for as many zeros as poles, or move the output's column down by one"
    return [Finding(status, f"{ALONG}; with a direct path a coefficient differs by {percent(told.size)}: {advice}")]


def rhythm_findings(acting: Acting, part: Explained) -> list[Finding]:
    """Say where a disturbance with the input's period explains more surely than ``part``, and moves coefficients."""
    if acting.loop.reference is not None:
        return []
    period, waves = _waves(acting.evidence)
    told = acting.told(waves[acting.evidence.known]) if waves.size else None
    if told is None or not (told.statistic > part.statistic and told.size > FARTHEST):
        return []
    reason = f"a disturbance that has the input's period, {duration(period)}, would explain what the model leaves, and"
    reason += f" with it a coefficient differs by {percent(told.size)}"
    return [Finding("inconsistent", f"{reason}: move the input in another rhythm, or record the disturbance, too")]


def _waves(evidence: Evidence) -> tuple[float, FloatArray]:
    """Return the period in s of the strongest line of the input, and waves (K, 2) of it; none of a record too short."""
    record = evidence.record
    times = np.cumsum(record.intervals) if record.intervals.size > 1 else record.dt * np.arange(record.u.size)
    even = np.linspace(times[0], times[-1], times.size)
    lines = np.abs(np.fft.rfft(np.interp(even, times, record.u - record.u.mean()), FINER * times.size))
    first = FINER * CYCLES
    if lines.size <= first:
        return 0.0, np.zeros((times.size, 0))
    omega = 2.0 * math.pi * (first + int(np.argmax(lines[first:]))) / (FINER * (even[1] - even[0]) * times.size)
    return 2.0 * math.pi / omega, np.column_stack([np.cos(omega * times), np.sin(omega * times)])


@dataclass(frozen=True)
class Told:
    """A signal that acts on the output beside the model."""

    weight: float  # of it
    size: float  # by how much a coefficient differs, as a part of it
    statistic: float  # over its limit


@dataclass(frozen=True, eq=False)
class Acting:
    """What acts on the output, the input or, with a reference, what that explains of it, and the tests of it."""

    evidence: Evidence
    runs: Runs
    loop: Loop
    input: FloatArray  # (K,)
    output: FloatArray  # (K,): what the model makes of it
    slopes: FloatArray  # (K, n + m + 1)
    sensed: FloatArray  # (K,): what a sensor measures of all inputs

    @classmethod
    def of(cls, evidence: Evidence, runs: Runs, loop: Loop, sensed: FloatArray | None = None) -> Acting:
        """Return what acts; ``sensed`` where other inputs act, too."""
        run, reference = runs.now, loop.reference
        if reference is None or run.instruments is None:
            return cls(evidence, runs, loop, run.u, run.forced, run.zeta, run.forced if sensed is None else sensed)
        b = evidence.structure.numerator
        output = combined(run.instruments[:, b], evidence.estimate[b])
        return cls(evidence, runs, loop, reference.input, output, run.instruments, output)

    @property
    def known(self) -> FloatArray:
        """The known columns (J, N) of the samples that the estimate should explain."""
        rows = self.evidence.known
        return np.hstack([self.slopes[rows], self.runs.now.nuisances[rows]])

    @property
    def made(self) -> FloatArray:
        """The output (K,), or what a reference explains of it."""
        return self.evidence.record.y if self.loop.reference is None else self.loop.reference.output

    @property
    def whole_input(self) -> FloatArray:
        """What acts, with the samples before those of the evidence where these act, too."""
        record = self.evidence.record
        return record.joined.u if self.loop.reference is None else self.input + record.u.mean()

    @cached_property
    def linear(self) -> FloatArray:
        """The columns (J, C) of other dynamics of the samples that the estimate should explain."""
        reference, rows = self.loop.reference, self.evidence.known
        if reference is not None:
            return reference.states[rows]
        return dynamics(self.evidence, self.runs.now, feedback=self.loop.feedback.found)

    @cached_property
    def residual(self) -> Residual:
        """What the model leaves beside these."""
        return residual_of(self.evidence, self.runs.now.error[self.evidence.known], self.known)

    @property
    def speeds(self) -> FloatArray:
        """How fast the poles count as (n,), see `Speeds`."""
        reference = self.loop.reference
        return Speeds.of(self.evidence, self.loop.is_closed, None if reference is None else reference.output).poles

    def told(self, columns: FloatArray) -> Told | None:
        """Return what columns (J, C) beside the model change; None where they explain nothing to speak of."""
        found = self.residual.explained(columns)
        made = power_of(self.evidence, self.made[self.evidence.known])
        if not (found.is_sure and found.power > NEGLIGIBLE * made):
            return None
        return Told(float(found.weights[0]), self.size_of(columns, found.weights), found.statistic)

    def size_of(self, columns: FloatArray, weights: FloatArray) -> float:
        """Return by how much the largest coefficient differs beside columns (J, C) with weights (C,), as a part."""
        step = -self.residual.weights_of(columns)[: self.evidence.coefficients] @ weights
        return self.runs.size(step, self.speeds)


def later(record: Record, output: FloatArray, dt: float, *, past: bool) -> FloatArray:
    """Return by how much a model's output (K,) changes where it comes a sampling time later, to first order.

    In feedback what comes after a sample answers its noise: the change is then that since the sample before.
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
    """Return how much of a straight input the residual holds, and the step of the coefficients if it is one.

    None where the model cannot be run.  The coefficients make up for the hold, as a zero of little weight can: the
    column is the output by a straight input and the coefficients that go with it, less that by a held one and its own.
    """
    # where rows are lost a straight line is nearer to what the input did than one step, whatever its hold is
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


def _largest_change(evidence: Evidence, step: FloatArray) -> float:
    """Return the largest part of its size by which a step changes a coefficient, of those that it changes surely."""
    if evidence.covariance is None:
        return 0.0
    std = np.sqrt(np.maximum(np.diag(evidence.covariance)[: step.size], 0.0))
    part = np.abs(step) / np.maximum(np.abs(evidence.estimate[: step.size]), np.finfo(float).tiny)
    return float(part[np.abs(step) > MOVED_SIGMAS * std].max(initial=0.0))


def _scaled(u: FloatArray) -> FloatArray:
    """Return an input on a scale from -1 to 1; zero stays where it is if the input lies on both sides of it."""
    low, high = float(u.min()), float(u.max())
    middle = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    return np.asarray((u - middle) / max(high - middle, middle - low, float(np.finfo(float).tiny)))


def _curves(v: FloatArray) -> Iterator[FloatArray]:
    """Yield curves (K, C) of a signal on a scale from -1 to 1: odd ones, the magnitude, plays."""
    from replant.kernels.filters.autoregressions import play  # compiled: imported where it is used

    yield np.column_stack([v**3, v**5])
    yield np.abs(v)[:, None]
    yield np.column_stack([play(v, width) for width in WIDTHS])


def _grows_outward(v: FloatArray, curve: FloatArray) -> bool:
    """Return whether a curve's values (K,), beside the straight line through them, grow with the distance from zero."""
    straight = np.column_stack([v, np.ones(v.size)])
    return inner(without(curve[:, None], straight)[:, 0], without((v * np.abs(v))[:, None], straight)[:, 0]) > 0.0


def _behind_the_plant(evidence: Evidence, curves: FloatArray) -> FloatArray:
    """Return the model's outputs (K, C) where the input is replaced by each of the curves (K, C), from the first on."""
    model, whole = evidence.structure.transfer_function(evidence.estimate), evidence.record.joined
    whole = whole if len(curves) == whole.u.size else evidence.record
    outputs = responses(model, curves, whole, evidence.dt, whole.input_hold)
    return np.where(np.isfinite(outputs).all(axis=0), outputs, 0.0)
