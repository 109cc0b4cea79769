"""Faults of sensor and clock, found in the raw samples: stuck, saturated, swapped columns, a wrong sampling time."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.verdict import Finding, duration

MOST_OFF = 0.2  # of the sampling time, that the usual interval may differ from it
# A sensor that has more than MANY values is not a switch.  One that has FEW_LEVELS while the input has many is most
# likely the input: two-level inputs are what identification is done with, two-level sensors are not.
FEW_LEVELS, MANY_LEVELS = 4, 20
# A value that a continuous signal takes exactly again and again, at one of its extremes, is the end of the scale: one
# sample in fifty there is far more than noise or a coarse scale (a bell curve over 20 steps) puts at its very end.
AT_THE_END = 0.02
# ... if the model says that the output was elsewhere meanwhile, by more than this part of its spread (a plant that
# comes to rest reaches one value again and again as well, but the model is there, too).
ELSEWHERE = 0.01
# Where noise lets two samples in a row be equal more seldom than so, in some part of the record at least (the sensor
# may fail in others), it resolves the scale: equal samples are then no chance.
SELDOM, SECTIONS = 0.005, 8
# So many at an extreme of the newest samples are enough then, over windows so long, so that a failure is found soon.
TIES, WINDOWS = 6, (64, 256, 1024)
# A sensor is stuck, or for a while at the end of its scale, if at least so many samples in a row are equal to the bit
STUCK_SAMPLES = 8
# ... while the model's output moved by so many standard deviations of the residual: a still output is no chance then
STUCK_MOVED = 4.0
# ... or at all, where noise resolves the scale,
MOVED_AT_ALL = 0.25
# ... and by more than so many of the sensor's steps: a coarse scale stands still by itself while a slow output passes.
STUCK_STEPS = 3.0
ROUNDING = 1e-6  # part of the output's spread below which a residual is no noise


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
    least = max((MOVED_AT_ALL if resolved else STUCK_MOVED) * noise, STUCK_STEPS * smallest_step(np.unique(y)))
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
    on_grid = np.abs(multiples - np.rint(multiples)) < 0.01 * multiples
    return least if bool(on_grid.all()) and multiples.max() < 1e6 else 0.0
