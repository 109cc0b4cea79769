"""Faults of sensor and clock, found in the raw samples: stuck, saturated, swapped columns, a wrong sampling time."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.verdict import Finding, duration

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

AT_THE_END = 0.02
"""Share of samples exactly at an extreme beyond which it is the end of the sensor's scale [share of samples].
Origin: far more than a normal distribution over 20 steps puts at its very end.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ELSEWHERE = 0.01
"""Distance of the modelled output from the extreme, on the mean, below which the output rests there by right [part of
the output's spread].
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
"""Samples at an extreme that are the end of the scale where noise resolves it [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

WINDOWS = (64, 256, 1024)
"""Newest samples that are searched for them, so that a failure is found soon [samples].
Origin: powers of four.
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

ON_GRID = 0.01
"""Distance of a difference between two values from a whole number of steps, up to which the scale has steps [part of
the difference].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_STEPS = 1e6
"""Steps between two neighbouring values beyond which the scale counts as having none [steps].
Origin: not recorded; kept, see sensitivity.
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


def saturation_finding(y: FloatArray, modelled: FloatArray, resolved: bool) -> list[Finding]:
    """Return a finding if the output lies at an end of the sensor's scale while the model's output does not.

    Parameters
    ----------
    y, modelled : (K,) arrays
        Measured and modelled output, of the recent past.
    resolved : bool
        See `is_resolved`.
    """
    values = np.unique(y)
    if resolved:
        for window in (*WINDOWS, y.size):
            newest = y[-window:]
            for end in (newest.min(), newest.max()):
                there = newest == end
                # an output at rest between two steps of the scale repeats one of them without a fault
                away = float(np.sqrt(np.mean((modelled[-window:][there] - end) ** 2)))
                if np.count_nonzero(there) >= TIES and away > STUCK_STEPS * smallest_step(values):
                    return [_saturated(newest)]
    if values.size <= MANY_LEVELS:
        return []
    least = max(ELSEWHERE * float(y.std()), smallest_step(values))
    for end in (values[0], values[-1]):
        there = y == end
        elsewhere = float(np.sqrt(np.mean((modelled[there] - end) ** 2)))
        if float(there.mean()) > AT_THE_END and elsewhere > least:
            return [_saturated(y)]
    return []


def _saturated(y: FloatArray) -> Finding:
    share = 100.0 * max(float((y == y.max()).mean()), float((y == y.min()).mean()))
    reason = f"{share:.0f} % of the newest {y.size} samples lie exactly at an extreme of the output"
    return Finding("inconsistent", f"{reason}: a sensor at its limit, or stuck")


def stuck_finding(
    y: FloatArray, modelled: FloatArray, noise: float, resolved: bool, seconds: FloatArray, unit: float = 1.0
) -> list[Finding]:
    """Return a finding if the output was lately constant to the bit while the model's output moved.

    Parameters
    ----------
    y, modelled : (K,) arrays
        Measured and modelled output, of the recent past.
    noise : float
        Standard deviation of the residual.
    resolved : bool
        See `is_resolved`.
    seconds : (K,) array
        Time of each sample, in s.
    unit : float
        Unit of the outputs, in the user's unit.
    """
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    ends = np.append(begins[1:], y.size)
    rounding = ROUNDING * float(y.std())
    least = max(
        (MOVED_AT_ALL if resolved else STUCK_MOVED) * noise, STUCK_STEPS * smallest_step(np.unique(y)), rounding
    )
    for run in np.flatnonzero(ends - begins >= STUCK_SAMPLES)[::-1]:
        begin, end = int(begins[run]), int(ends[run])
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


def smallest_step(values: FloatArray) -> float:
    """Return the step of a scale: the least distance between the sorted ``values``, if all others are multiples of it.

    Zero for a signal without steps.

    Examples
    --------
    >>> smallest_step(np.array([0.0, 0.5, 1.0, 3.0])), smallest_step(np.array([0.0, 0.1, 0.25]))
    (0.5, 0.0)
    """
    if values.size < 2:
        return 0.0
    distances = np.diff(values)
    least = float(distances.min())
    multiples = distances / least
    on_grid = np.abs(multiples - np.rint(multiples)) < ON_GRID * multiples
    return least if bool(on_grid.all()) and multiples.max() < MOST_STEPS else 0.0
