r"""Tests of the record: excitation of the plant, faults of sensor and clock, and growth of the residual.

The information matrix of the coefficients is :math:`\sum \zeta\zeta^T` over the instruments (the slopes of the
simulated output along a and b), offset and initial state eliminated, each entry scaled by its size over all samples.

Sources: Ljung (1999), "System Identification: Theory for the User", sections 13.2 and 14.4; Soderstrom and Stoica
(1989), "System Identification", section 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import PER_COEFFICIENT, ModelRun
from replant.kernels.monitoring.outliers import MANY, STEPS
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import innovations
from replant.numerics.levels import MATTERS
from replant.numerics.linear_algebra import eigenvalues, products
from replant.numerics.projections import TAKEN_AWAY, without
from replant.numerics.robust import never_ties, robust_std, still_runs, usual_step
from replant.verdict.estimate_tests import MOST_UNCERTAIN, MOVED_SIGMAS
from replant.verdict.evidence import FEWEST, ROUNDING, Evidence, Runs
from replant.verdict.verdict import Finding, duration, figure, percent

WORST_CONDITION = 1e7  # condition of the scaled instruments: its square leaves 2 digits of float64's 16 [ratio]
LEAST_SHARE = MATTERS  # information of the newest samples: less makes deviations ten times as large [part of usual]
SURE = 4.0  # significant growth of the residual's power: by chance 3e-5 [standard deviations of its logarithm]
BLOCKS = (32, 64, 128, 256, 512)  # newest stretches in which a failure is searched, strong or weak [samples]
FEWEST_BLOCKS, BURST = 8, 2.0  # earlier stretches as long, and ratio to the largest: by chance 3e-5 [count; ratio]
FEW = 4  # of a block's samples one in so many must be known [count]
BURST_MATTERS = 0.05
"""Growth over the usual power of a stretch below which it does not matter [part of the output's power].
Origin: a choice of what matters to a user, above MATTERS as one stretch is short.
Sensitivity: halved or doubled, nothing changes on these records.
"""
PARTS = 25  # parts of a residual, whose scatter gives the uncertainty of its power to a seventh [count]
BINARY = 3  # values of a binary input that rests between its moves [count]
CHANGING = "the plant seems to change all along, or not to be linear: identify shorter parts by themselves"
LOADS_ACT = "another load acts since {}: offset and initial state are new there"  # {}: `times_after`
LOADS_MAY_ACT = (
    "another load may act since {}, and G(s) would be another one then: cut the record there, or record longer"
)
FROM_REST = (
    "the initial state takes a part of the response to the first move of the input: from rest the gain is {:.3g}, not "
    "{:.3g}: if it began at rest, say so"
)
RESTED = "the input has rested for the last {} and more: move it to learn more"
CHANGED = "the plant seems to have changed {} before the end: identify the parts before and since by themselves"
FOLLOWED = "the plant changed {} ago: the estimate is that of the samples since"
REFUSED = "updates left the range of float64 and were undone: lower the gain or step size, then reset"


@dataclass(frozen=True)
class Excitation:
    """How well the samples determine the coefficients; `Assessment` describes the two figures."""

    condition: float
    share: float

    @property
    def findings(self) -> list[Finding]:
        """The finding if the input lacks excitation."""
        if not self.condition < WORST_CONDITION:
            figure = "infinite" if math.isinf(self.condition) else f"{self.condition:.1e}"
            reason = f"the input does not excite every coefficient (condition number {figure}): move it more"
            return [Finding("not excited", f"{reason}, or ask for fewer poles and zeros")]
        if not self.share >= LEAST_SHARE:
            part = percent(max(self.share, 0.0))
            reason = f"the newest samples hold {part} of the information that as many others hold"
            return [Finding("not excited", f"the input hardly moves any more: {reason}")]
        return []


def excitation(run: ModelRun, newest: slice) -> Excitation:
    """Return the excitation over a run, and that of its ``newest`` samples relative to all."""
    zeta = without(run.zeta, run.nuisances)
    lengths = np.linalg.norm(zeta, axis=0)
    # only rounding is left of a column that the nuisances explain completely
    if not (lengths > TAKEN_AWAY * np.linalg.norm(run.zeta, axis=0)).all():
        return Excitation(math.inf, 0.0)
    scaled = zeta / lengths * math.sqrt(len(zeta))
    values = eigenvalues(products(scaled, scaled) / len(zeta))
    condition = math.sqrt(values[-1] / values[0]) if values[0] > 0.0 else math.inf
    if not condition < WORST_CONDITION:
        return Excitation(condition, 0.0)
    recent = run.zeta[newest] / lengths * math.sqrt(len(zeta))
    recent = recent - recent.mean(axis=0)
    least = float(eigenvalues(products(recent, recent) / len(recent))[0])
    return Excitation(condition, least / float(values[0]))


def guard_findings(missing: float, stuck: bool, grown: float, undecided: bool, then: str = "") -> list[Finding]:
    """Return the findings of the monitoring; ``missing``, ``grown``: s without output, with a grown residual, or 0."""
    reason = ""
    if missing:
        reason = f"no output has arrived for {duration(missing)}, only the input: check the sensor and its cable"
    elif stuck:
        reason = "the output is constant to the bit, or was just now: a stuck or saturated sensor, or a cable off"
    elif grown:
        reason = f"the residual began to grow {duration(grown)} ago: the plant, the sensor or the disturbances have"
        reason += f" changed{then}"
    findings = [Finding("inconsistent", reason)] if reason else []
    if undecided:
        reason = "the residual had grown, and the samples since do not tell yet whether a load or the plant has changed"
        findings.append(Finding("converging", f"{reason}: move the input"))
    return findings


def clock_finding(usual: float, dt: float) -> list[Finding]:
    """Return a finding if time stamps that are ``usual`` s apart contradict the sampling time ``dt``."""
    if abs(usual / dt - 1.0) <= MOST_UNCERTAIN:  # the coefficients have errors of this size
        return []
    reason = f"the time stamps are {usual:.3g} s apart where dt says {dt:.3g} s: one of them is wrong"
    return [Finding("inconsistent", reason)]


def burst_of_stamps_finding(record: Record) -> list[Finding]:
    """Return a finding if a record has so many gaps that its parts are too short for initial states of their own."""
    parts, samples = len(record.parts), record.u.size
    if parts == 1 or samples >= PER_COEFFICIENT * parts:
        return []
    reason = f"the time stamps have a gap every {figure(samples / parts)} samples: if they say when samples were stored"
    advice = f"and not when they were taken, give the sampling time in their place, dt = {record.span / samples:.3g} s"
    return [Finding("inconsistent", f"{reason}, {advice}")]


def level_finding(u: FloatArray, y: FloatArray) -> list[Finding]:
    """Return a finding if the output has two or three values only while the input has more, as an input would."""
    levels, others = np.unique(y).size, np.unique(u).size
    if not 1 < levels <= BINARY < others:
        return []
    reason = f"the output has only {levels} different values while the input has {others}: are the columns swapped?"
    return [Finding("inconsistent", reason)]


def is_resolved(y: FloatArray, noise: float) -> bool:
    """Return whether noise of standard deviation ``noise`` prevents equal outputs in a row."""
    return noise > ROUNDING * float(y.std()) and never_ties(y)


def saturation_finding(y: FloatArray, modelled: FloatArray, unit: float = 1.0) -> list[Finding]:
    """Return a finding if the output stays at an end of its scale while the model's output goes beyond."""
    # at a turning point the model's output is as far out, for any coarse scale; where the output is cut off, the model
    # is farther out than rounding explains, and leaves the scale
    values, counts = np.unique(y, return_counts=True)
    tied = values[counts >= MANY]
    for end, outwards in ((tied[:1], -1.0), (tied[-1:], 1.0)):
        if not end.size or np.count_nonzero(outwards * (y - end[0]) > 0.0) >= MANY:
            continue
        there, inside = y == end[0], outwards * (y - end[0]) < 0.0
        nearest = outwards * float((outwards * y[inside]).max(initial=-math.inf))
        if not np.count_nonzero(there) > np.count_nonzero(y == nearest):  # a cut-off piles up; a tail thins out
            continue
        power = min(2, np.unique(y[inside]).size - 1)
        if power < 1:
            continue
        # the model as a function of the output, not the other way round: the cut-off then does not bias the curve
        usual = np.polynomial.Polynomial.fit(y[inside], modelled[inside], power)
        # no extrapolation: at the end of the scale the model's error is taken from the nearest value inside
        past_end = outwards * (modelled[there] - end[0])
        beyond, farthest = float(past_end.mean()) - outwards * (float(usual(nearest)) - nearest), float(past_end.max())
        visits = int(np.count_nonzero(np.diff(there, prepend=False) & there))
        chance = MOVED_SIGMAS * robust_std(modelled[inside] - usual(y[inside])) / math.sqrt(visits)
        least = max(chance, 0.5 * usual_step(y), ROUNDING * float(y.std()))  # rounding has errors of half a step
        # a model with errors inside the scale, as by a wrong dead time, does not leave it
        if min(beyond, farthest) > least:
            share = f"{percent(float(there.mean()))} of the newest {y.size} samples"
            reason = f"{share} lie exactly at an extreme of the output, and the model's output goes up to"
            return [Finding("inconsistent", f"{reason} {farthest * unit:.3g} beyond: a sensor at its limit")]
    return []


def end_finding(u: FloatArray, y: FloatArray, modelled: FloatArray, noise: float, seconds: FloatArray) -> list[Finding]:
    """Return a finding if the end of a record is filled up with a constant that the output hardly takes before."""
    begin = int(still_runs(y)[-1, 0])
    if begin < 1 or y.size - begin < MANY or np.count_nonzero(y[:begin] == y[-1]) >= MANY:
        return []
    least = max(MOVED_SIGMAS * noise, STEPS * usual_step(y), ROUNDING * float(y.std()))
    jump = abs(float(y[begin] - y[begin - 1] - (modelled[begin] - modelled[begin - 1])))
    rests = np.diff(still_runs(u))[:, 0]
    held = rests[-1] > rests[:-1].max(initial=0)  # longer than ever before
    if not (jump > least or (held and float(np.ptp(modelled[begin:])) > least)):
        return []
    lasted = duration(float(seconds[-1] - seconds[begin - 1]))
    which = "input and output" if not np.ptp(u[begin:]) else "the output"
    reason = f"the last {lasted} of {which} are constant to the bit: the end of the record is filled up"
    return [Finding("inconsistent", f"{reason}, or a cable is off: cut them")]


def stuck_finding(
    y: FloatArray, modelled: FloatArray, noise: float, resolved: bool, seconds: FloatArray, unit: float = 1.0
) -> list[Finding]:
    """Return a finding if the output was constant to the bit for a while in which the model's output moved."""
    rounding = ROUNDING * float(y.std())
    # on a fine scale ties are no chance, and one standard deviation is enough, as in the recursion
    least = max((1.0 if resolved else MOVED_SIGMAS) * noise, STEPS * usual_step(y), rounding)
    runs = still_runs(y)
    for begin, end in runs[runs[:, 1] - runs[:, 0] >= MANY][::-1]:
        moved = float(np.ptp(modelled[begin:end]))
        if moved > least:
            lasted = float(seconds[end - 1] - seconds[begin])
            now = "is" if end == y.size else "was"
            reason = f"the output {now} constant to the bit for {duration(lasted)} while the model's output moved by"
            size = f"{moved * unit:.3g}: a stuck or saturated sensor, a cable off, or friction"
            return [Finding("inconsistent", f"{reason} {size}")]
    return []


def times_after(seconds: Sequence[float]) -> str:
    """Return the times of one or more events after the first sample, in words."""
    return f"{', '.join(duration(each) for each in seconds)} after the first sample"


def left_out_finding(samples: int) -> list[Finding]:
    """Return a finding on the number of outputs that were left out, as the sensor was stuck or at its limit."""
    if not samples:
        return []
    reason = f"{samples} outputs were left out: the sensor was stuck or at its limit, they are filled up, or"
    return [Finding("trusted", f"{reason} the plant rests and nothing is noisy: look at the sensor, or cut them")]


def growth_finding(
    evidence: Evidence, runs: Runs, figures: dict[str, Any], *, referenced: bool = False
) -> list[Finding]:
    """Return a finding if the residual has grown over the samples held out, or else over the last quarter."""
    if evidence.follows:
        return []
    count = evidence.held_out or evidence.samples // 4
    begin, used = evidence.samples - count, evidence.used
    before, after = runs.old.error[:begin][used[:begin]], runs.old.error[begin:][used[begin:]]
    if min(before.size, after.size) < FEWEST:
        return []
    figures["growth"], sigmas = growth(before, after, evidence.usual_power)
    more = float(np.var(after)) - max(float(np.var(before)), evidence.usual_power)
    if referenced:  # in a loop a drifting load may enlarge the residual; a change also enlarges the whitened one
        white = innovations(evidence.tested(runs.old.error))
        before, after = (part[np.isfinite(part)] for part in (white[:begin], white[begin:]))
        sigmas = min(sigmas, growth(before, after)[1]) if min(before.size, after.size) >= FEWEST else 0.0
    # for a record that has ended, comparing models of its parts is the better test for a change
    if evidence.finished or sigmas < SURE or not more > MATTERS * runs.power:
        return []
    span = f"the last {duration(evidence.seconds(count))}"
    reason = f"the power of the residual has grown {figure(figures['growth'])}-fold over {span}"
    return [Finding("inconsistent", f"{reason}: the plant, the sensor or the disturbances have changed")]


def growth(before: FloatArray, after: FloatArray, usual: float = 0.0) -> tuple[float, float]:
    """Return the ratio of a residual's powers after and before (at least ``usual``), and its log in deviations."""
    first, second = before - before.mean(), after - after.mean()
    p, q = max(float(np.mean(first**2)), usual), float(np.mean(second**2))
    if not (p > 0.0 and q > 0.0):
        return (1.0, 0.0) if p == q else (math.inf if q > p else 0.0, math.inf if q > p else -math.inf)
    return q / p, math.log(q / p) / math.hypot(_relative_std(first), _relative_std(second))


def _relative_std(error: FloatArray) -> float:
    r"""Return the relative standard deviation of the mean of e^2.

    The larger of Bartlett's formula, :math:`\sqrt{2 \sum_\tau r^2(\tau) / N}`, which allows for coloured normal noise,
    and the scatter of the means over `PARTS` parts, which allows for outliers.
    """
    lags = min(error.size // 4, BLOCKS[-1])
    padded = 1 << (2 * error.size - 1).bit_length()  # so that no lag wraps around
    whole = np.fft.irfft(np.abs(np.fft.rfft(error, padded)) ** 2, padded)[: lags + 1]
    memory = float(2.0 * np.sum((whole / whole[0]) ** 2) - 1.0)
    means = (error[: error.size // PARTS * PARTS] ** 2).reshape(PARTS, -1).mean(axis=1)
    scatter = float(means.std(ddof=1)) / math.sqrt(PARTS) / float(means.mean())
    return max(math.sqrt(2.0 * memory / error.size), scatter)


def burst_finding(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Return a finding if the residual's power over the newest block exceeds that over every block before."""
    first = evidence.newest.start if evidence.follows else 0
    error = evidence.tested(runs.old.error)[first:]
    for count in BLOCKS:
        if error.size // count <= FEWEST_BLOCKS:
            return []
        last, largest, usual = _powers(error, count)
        # earlier blocks may have too few outputs
        if not (last > BURST * largest > 0.0 and last - usual > BURST_MATTERS * runs.power):
            continue
        # it must be larger also after whitening by earlier samples: any block of a drifting residual may be the largest
        newest, before, _ = _powers(innovations(error, error.size - count), count)
        if newest > BURST * before:
            span = f"the last {duration(evidence.seconds(count))}"
            grown = f"{figure(last / largest)} times its largest power over any earlier stretch as long"
            reason = f"the residual over {span} has {grown}"
            return [Finding("inconsistent", f"{reason}: the plant, the sensor or the load has changed")]
    return []


def _powers(error: FloatArray, count: int) -> tuple[float, float, float]:
    """Return the power of an error (K,) over its newest block, the largest earlier one, and the median; skip NaN."""
    blocks = error.size // count
    known = np.isfinite(error)
    squares = np.where(known, (error - np.median(error[known])) ** 2, 0.0) if known.any() else np.zeros(error.size)
    sums, counts = (each[each.size - blocks * count :].reshape(blocks, count).sum(axis=1) for each in (squares, known))
    powers = sums / np.where(counts >= count // FEW, counts, np.inf)
    return float(powers[-1]), float(powers[:-1].max()), float(np.median(powers))
