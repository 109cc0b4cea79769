"""What a sensor and a clock may do wrong, told from the raw samples: stuck, saturated, swapped, another rate."""

from __future__ import annotations

import numpy as np

from replant.assessment.verdict import Finding
from replant.validation import FloatArray

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
# A sensor is stuck, or for a while at the end of its scale, if at least so many samples in a row are equal to the bit
STUCK_SAMPLES = 8
# ... while the model's output moved by so many standard deviations of the residual: a still output is no chance then
STUCK_MOVED = 4.0
# ... and by more than so many of the sensor's steps: a coarse scale stands still by itself while a slow output passes.
STUCK_STEPS = 3.0
# Where the noise is so many steps of the sensor or more, and more than rounding, no two samples are equal but by rare
# chance: it is enough then that the model's output moved at all.
RESOLVED_STEPS, ROUNDING, MOVED_AT_ALL = 3.0, 1e-6, 0.25


def clock_finding(usual: float, dt: float) -> list[Finding]:
    """Say whether time stamps that are ``usual`` s apart contradict the sampling time that was given.

    Without stamps nothing can: the same samples at a tenth of the rate are those of a plant ten times as slow.
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
    """Say whether the output looks like an input: a few levels only, while the input has many."""
    levels, others = np.unique(y).size, np.unique(u).size
    if not (1 < levels <= FEW_LEVELS and others > MANY_LEVELS):
        return []
    return [
        Finding(
            "inconsistent",
            f"the output has only {levels} different values while the input has {others}: are the columns swapped?",
        )
    ]


def saturation_finding(y: FloatArray, modelled: FloatArray) -> list[Finding]:
    """Say whether the output sits at the end of its scale while the modelled output (K,) is elsewhere."""
    values = np.unique(y)
    if values.size <= MANY_LEVELS:
        return []
    step = smallest_step(values)
    for end, words in ((values[-1], "largest"), (values[0], "smallest")):
        there = y == end
        share = float(there.mean())
        elsewhere = float(np.sqrt(np.mean((modelled[there] - end) ** 2)))
        if share > AT_THE_END and elsewhere > max(ELSEWHERE * float(y.std()), step):
            reason = f"{100 * share:.0f} % of the samples lie exactly at the {words} output: a sensor at its limit"
            return [Finding("inconsistent", reason)]
    return []


def stuck_finding(y: FloatArray, modelled: FloatArray, noise: float, seconds: FloatArray) -> list[Finding]:
    """Say whether the output lately stood still to the bit while it should have moved.

    Parameters
    ----------
    y, modelled : (K,) arrays
        Measured and modelled output, of the recent past.
    noise : float
        Standard deviation of the residual as it was before.
    seconds : (K,) array
        Time of each sample, in s.
    """
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    ends = np.append(begins[1:], y.size)
    step = smallest_step(np.unique(y))
    resolved = noise > max(RESOLVED_STEPS * step, ROUNDING * float(y.std()))
    least = max((MOVED_AT_ALL if resolved else STUCK_MOVED) * noise, STUCK_STEPS * step)
    for run in np.flatnonzero(ends - begins >= STUCK_SAMPLES)[::-1]:
        begin, end = int(begins[run]), int(ends[run])
        moved = float(np.ptp(modelled[begin:end]))
        if moved > least:
            duration = seconds[end - 1] - seconds[begin]
            now = "stands" if end == y.size else "stood"
            reason = f"the output {now} still to the bit for {duration:.3g} s while it should have moved by {moved:.3g}"
            return [Finding("inconsistent", f"{reason}: a stuck or saturated sensor, or a cable off")]
    return []


def smallest_step(values: FloatArray) -> float:
    """Return the least distance between the sorted ``values``, which a scale with steps shows again and again.

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
