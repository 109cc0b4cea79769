"""Faults of sensor and clock, found in the raw samples: stuck, saturated, swapped columns, a wrong sampling time."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.estimate_tests import MOST_UNCERTAIN, MOVED_SIGMAS
from replant.assessment.verdict import Finding, duration, percent
from replant.kernels.monitoring.outliers import MANY, MOVED_RESOLVED, STEPS
from replant.statistics.robust import never_ties, robust_std, still_runs, usual_step

BINARY = 3  # values of a binary input that rests between its moves [count]

RESTS_TIED = math.sqrt(MOVED_RESOLVED)  # as in the recursion [standard deviations of the residual]

ROUNDING = 1e-6
"""Residual below which it is no noise, and movement below which it is none [part of the output's spread].
Derivation: sixteen roundings of single precision, in which many a record is stored.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def clock_finding(usual: float, dt: float) -> list[Finding]:
    """Return a finding if time stamps that are ``usual`` s apart contradict the sampling time ``dt``.

    Without time stamps a wrong sampling time cannot be found: the record is that of a plant on another time scale.
    """
    if abs(usual / dt - 1.0) <= MOST_UNCERTAIN:  # the coefficients are off by as much
        return []
    return [
        Finding(
            "inconsistent",
            f"the time stamps are {usual:.3g} s apart where dt says {dt:.3g} s: one of them is wrong",
        )
    ]


def level_finding(u: FloatArray, y: FloatArray) -> list[Finding]:
    """Return a finding if the output looks like an input: it has a few levels only, while the input has many."""
    levels, others = np.unique(y).size, np.unique(u).size
    if not 1 < levels <= BINARY < others:
        return []
    return [
        Finding(
            "inconsistent",
            f"the output has only {levels} different values while the input has {others}: are the columns swapped?",
        )
    ]


def is_resolved(y: FloatArray, noise: float) -> bool:
    """Return whether noise of standard deviation ``noise`` keeps two samples in a row from being equal."""
    return noise > ROUNDING * float(y.std()) and never_ties(y)


def saturation_finding(y: FloatArray, modelled: FloatArray, unit: float = 1.0) -> list[Finding]:
    """Return a finding if the output stays at an end of its scale while the model's output goes beyond.

    How far the model should be there follows from how it goes with the output elsewhere.  Where an output turns round,
    however coarse its scale, the model is as far; where it is cut off, the model is farther out than rounding explains.
    """
    values, counts = np.unique(y, return_counts=True)
    tied = values[counts >= MANY]
    for end, outwards in ((tied[:1], -1.0), (tied[-1:], 1.0)):
        if not end.size or np.count_nonzero(outwards * (y - end[0]) > 0.0) >= MANY:
            continue
        there, inside = y == end[0], outwards * (y - end[0]) < 0.0
        power = min(2, np.unique(y[inside]).size - 1)
        if power < 1:
            continue
        # by the output, not the other way round: what is cut off then changes nothing of what is left
        usual = np.polynomial.Polynomial.fit(y[inside], modelled[inside], power)
        beyond = outwards * float(np.mean(modelled[there]) - usual(end[0]))
        visits = int(np.count_nonzero(np.diff(there, prepend=False) & there))
        chance = MOVED_SIGMAS * robust_std(modelled[inside] - usual(y[inside])) / math.sqrt(visits)
        if beyond > max(chance, 0.5 * usual_step(y), ROUNDING * float(y.std())):  # a rounded output is half a step off
            share = (
                f"{percent(float(there.mean()))} of the newest {y.size} samples lie exactly at an extreme of the output"
            )
            reason = f"{share}, and the model's output {beyond * unit:.3g} beyond: a sensor at its limit"
            return [Finding("inconsistent", reason)]
    return []


def end_finding(u: FloatArray, y: FloatArray, modelled: FloatArray, noise: float, seconds: FloatArray) -> list[Finding]:
    """Return a finding if the end of a record is filled up with a constant.

    The constant is none that the output takes elsewhere.  The output jumps there, other than the model's, or the input
    rests for longer than ever before.
    """
    begin = int(still_runs(y)[-1, 0])
    if begin < 1 or y.size - begin < MANY or np.count_nonzero(y[:begin] == y[-1]) >= MANY:
        return []
    least = max(MOVED_SIGMAS * noise, STEPS * usual_step(y), ROUNDING * float(y.std()))
    jump = abs(float(y[begin] - y[begin - 1] - (modelled[begin] - modelled[begin - 1])))
    rests = np.diff(still_runs(u))[:, 0]
    held = rests[-1] > rests[:-1].max(initial=0)
    if not (jump > least or (held and float(np.ptp(modelled[begin:])) > least)):
        return []
    lasted = duration(float(seconds[-1] - seconds[begin - 1]))
    which = "input and output" if not np.ptp(u[begin:]) else "the output"
    reason = (
        f"the last {lasted} of {which} are constant to the bit: the end of the record is filled up, or a cable is off"
    )
    return [Finding("inconsistent", f"{reason}: cut them")]


def stuck_finding(
    y: FloatArray, modelled: FloatArray, noise: float, resolved: bool, seconds: FloatArray, unit: float = 1.0
) -> list[Finding]:
    """Return a finding if the output was lately constant to the bit while the model's output moved."""
    rounding = ROUNDING * float(y.std())
    least = max((RESTS_TIED if resolved else MOVED_SIGMAS) * noise, STEPS * usual_step(y), rounding)
    for begin, end in still_runs(y)[::-1]:
        if end - begin < MANY:
            continue
        moved = float(np.ptp(modelled[begin:end]))
        if moved > least:
            lasted = float(seconds[end - 1] - seconds[begin])
            now = "is" if end == y.size else "was"
            reason = f"the output {now} constant to the bit for {duration(lasted)} while the model's output"
            return [
                Finding(
                    "inconsistent",
                    f"{reason} moved by {moved * unit:.3g}: a stuck or saturated sensor, a cable off, or friction",
                )
            ]
    return []


def left_out_finding(samples: int) -> list[Finding]:
    """Return what a solution says of so many outputs that it was made without, because the sensor gave none."""
    if not samples:
        return []
    reason = f"{samples} outputs were left out: the sensor was stuck or at its limit, or they are filled up"
    return [Finding("trusted", f"{reason}: look at the sensor, or cut them")]
