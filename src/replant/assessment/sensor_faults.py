"""Faults of sensor and clock, found in the raw samples: stuck, saturated, swapped columns, a wrong sampling time."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.verdict import Finding, duration, percent
from replant.statistics.robust import robust_std
from replant.statistics.still_outputs import still_runs, usual_step

MOST_OFF = 0.2
"""Difference of the usual interval from the sampling time beyond which one of them is wrong [part of the sampling
time].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FEW_LEVELS = 4
"""Values of an output up to which it is most likely the input: two-level inputs are what identification is done with,
two-level sensors are not [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MANY_LEVELS = 20
"""Values of a signal beyond which it is no switch [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SELDOM = 0.005
"""Share of equal neighbours below which noise resolves the sensor's scale, so that equal samples are no chance [share
of samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SECTIONS = 8
"""Parts of the record of which one at least must be resolved: the sensor may fail in others [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

TIES = 6
"""Samples at an extreme that may be the end of the scale; fewer beyond it are outliers [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STUCK_SAMPLES = 8
"""Samples in a row equal to the bit from which on a sensor may be stuck, or at the end of its scale [samples].
Origin: as MANY of the recursion, kernels/monitoring/outliers.py.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STUCK_MOVED = 4.0
"""Movement of the modelled output meanwhile below which a still output may be chance [standard deviations of the
residual].
Origin: a normal deviate beyond 4 has the chance 6e-5.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOVED_AT_ALL = 0.25
"""The same where noise resolves the scale, and a tie is no chance by itself [standard deviations of the residual].
Origin: the square root of MOVED_RESOLVED of the recursion, kernels/monitoring/outliers.py.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STUCK_STEPS = 3.0
"""The same in steps of the sensor's scale: a coarse scale stands still by itself while a slow output passes [steps of
the scale].
Origin: tests/online/test_quantised_sensor.py: an output that settles stands still between two steps.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ROUNDING = 1e-6
"""Residual below which it is no noise, and movement below which it is none [part of the output's spread].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def clock_finding(usual: float, dt: float) -> list[Finding]:
    """Return a finding if time stamps that are ``usual`` s apart contradict the sampling time ``dt``.

    Without time stamps a wrong sampling time cannot be found: the record is that of a plant on another time scale.
    """
    if abs(usual / dt - 1.0) <= MOST_OFF:
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
    if not (1 < levels <= FEW_LEVELS and others > MANY_LEVELS):
        return []
    return [
        Finding(
            "inconsistent",
            f"the output has only {levels} different values while the input has {others}: are the columns swapped?",
        )
    ]


def is_resolved(y: FloatArray, noise: float) -> bool:
    """Return whether noise of standard deviation ``noise`` keeps two samples in a row from being equal."""
    if y.size < 2 * SECTIONS or noise <= ROUNDING * float(y.std()):
        return False
    equal = y[1:] == y[:-1]
    return bool(min(part.mean() for part in np.array_split(equal, SECTIONS)) < SELDOM)


def saturation_finding(y: FloatArray, modelled: FloatArray, unit: float = 1.0) -> list[Finding]:
    """Return a finding if the output stays at an end of its scale while the model's output goes beyond.

    How far the model should be there follows from how it goes with the output elsewhere.  Where an output turns round,
    however coarse its scale, the model is as far; where it is cut off, the model is farther out than rounding explains.
    """
    values, counts = np.unique(y, return_counts=True)
    tied = values[counts >= TIES]
    for end, outwards in ((tied[:1], -1.0), (tied[-1:], 1.0)):
        if not end.size or np.count_nonzero(outwards * (y - end[0]) > 0.0) >= TIES:
            continue
        there, inside = y == end[0], outwards * (y - end[0]) < 0.0
        power = min(2, np.unique(y[inside]).size - 1)
        if power < 1:
            continue
        # by the output, not the other way round: what is cut off then changes nothing of what is left
        usual = np.polynomial.Polynomial.fit(y[inside], modelled[inside], power)
        beyond = outwards * float(np.mean(modelled[there]) - usual(end[0]))
        visits = int(np.count_nonzero(np.diff(there, prepend=False) & there))
        chance = STUCK_MOVED * robust_std(modelled[inside] - usual(y[inside])) / math.sqrt(visits)
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
    if begin < 1 or y.size - begin < STUCK_SAMPLES or np.count_nonzero(y[:begin] == y[-1]) >= TIES:
        return []
    least = max(STUCK_MOVED * noise, STUCK_STEPS * usual_step(y), ROUNDING * float(y.std()))
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
    least = max((MOVED_AT_ALL if resolved else STUCK_MOVED) * noise, STUCK_STEPS * usual_step(y), rounding)
    for begin, end in still_runs(y)[::-1]:
        if end - begin < STUCK_SAMPLES:
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
