"""Tests for a change of plant, sensor or disturbances: the power of the residual now, over what it was before."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import FEWEST, Evidence, Runs
from replant.assessment.score_test import MATTERS
from replant.assessment.verdict import Finding, duration, figure
from replant.statistics.autoregression import one_step

SURE = 4.0
"""Growth of the residual's power beyond which it is no chance [standard deviations of the logarithm of the power].
Level: a normal deviate beyond 4 has the chance 3e-5, and the verdict is asked many times.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BLOCKS = (32, 64, 128, 256, 512)
"""Lengths of the newest stretch over which a sudden failure is looked for, so that it is found whether it is violent
or mild [samples].
Derivation: powers of two, from what a failure needs to show to half of the samples held out.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FEWEST_BLOCKS = 8
"""Least number of earlier stretches of the same length [count].
Level: with BURST, of normal noise the chance is 3e-5 in the shortest stretches.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BURST = 2.0
"""Power of the newest stretch, over the largest of an earlier one, beyond which it is a sudden failure [ratio of
powers].
Level: twice the largest of FEWEST_BLOCKS stretches has the chance 3e-5 in the shortest ones, of normal noise.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BURST_MATTERS = 0.05
"""Growth over the usual power of a stretch below which it does not matter [part of the output's power].
Origin: a choice of what matters to a user, above MATTERS as one stretch is short.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PARTS = 25
"""Parts of a residual whose scatter tells how sure its power is [count].
Derivation: batch means: 24 degrees of freedom know a standard deviation to a seventh.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def growth_finding(
    evidence: Evidence, runs: Runs, figures: dict[str, Any], *, referenced: bool = False
) -> list[Finding]:
    """Return a finding if the residual grew: over the samples held out, or the last quarter of a whole record.

    In a loop a load that drifts makes the residual large at times.  With a reference it must have grown once it is
    whitened, too: a change of the plant shows in what the reference explains of it.
    """
    if evidence.follows:
        return []
    count = evidence.held_out or evidence.samples // 4
    begin, used = evidence.samples - count, evidence.used
    before, after = runs.old.error[:begin][used[:begin]], runs.old.error[begin:][used[begin:]]
    if min(before.size, after.size) < FEWEST:
        return []
    figures["growth"], sigmas = growth(before, after)
    if referenced:
        white = one_step(runs.old.error)
        sigmas = min(sigmas, growth(white[:begin][used[:begin]], white[begin:][used[begin:]])[1])
    more = float(np.var(after) - np.var(before))
    if sigmas < SURE or not more > MATTERS * runs.power:
        return []
    span = f"the last {duration(evidence.seconds(count))}"
    reason = f"the power of the residual has grown {figure(figures['growth'])}-fold over {span}"
    return [Finding("inconsistent", f"{reason}: the plant, the sensor or the disturbances have changed")]


def growth(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Return the ratio of a residual's power after to that before, and its logarithm in standard deviations.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal((2, 2000))
    >>> ratio, sigmas = growth(noise[0], 1.5 * noise[1])
    >>> round(ratio, 1), sigmas > 4.0, abs(growth(*noise)[1]) < 3.0
    (2.2, True, True)
    """
    first, second = before - before.mean(), after - after.mean()
    p, q = float(np.mean(first**2)), float(np.mean(second**2))
    if not (p > 0.0 and q > 0.0):
        return (1.0, 0.0) if p == q else (math.inf if q > p else 0.0, math.inf if q > p else -math.inf)
    return q / p, math.log(q / p) / math.hypot(_relative_std(first), _relative_std(second))


def _relative_std(error: FloatArray) -> float:
    r"""Return the relative standard deviation of the mean of e^2.

    It is the larger of two estimates: Bartlett's formula, :math:`\sqrt{2 \sum_\tau r^2(\tau) / N}`, which allows for
    coloured normal noise, and the scatter of the means over `PARTS` parts, which allows for outliers.
    """
    lags = min(error.size // 4, BLOCKS[-1])
    padded = 1 << (2 * error.size - 1).bit_length()  # so that no lag wraps around
    whole = np.fft.irfft(np.abs(np.fft.rfft(error, padded)) ** 2, padded)[: lags + 1]
    memory = float(2.0 * np.sum((whole / whole[0]) ** 2) - 1.0)
    means = (error[: error.size // PARTS * PARTS] ** 2).reshape(PARTS, -1).mean(axis=1)
    scatter = float(means.std(ddof=1)) / math.sqrt(PARTS) / float(means.mean())
    return max(math.sqrt(2.0 * memory / error.size), scatter)


def burst_finding(evidence: Evidence, runs: Runs, *, referenced: bool = False) -> list[Finding]:
    """Return a finding if the residual's power over the newest block exceeds that over every block before.

    With a reference that of the whitened residual must do so as well, see `growth_finding`.
    """
    first = evidence.newest.start if evidence.follows else 0
    error = runs.old.error[first:]
    white = one_step(error) if referenced else error
    for count in BLOCKS:
        if error.size // count <= FEWEST_BLOCKS:
            return []
        last, largest, usual = _powers(error, count)
        newest, before_it, _ = _powers(white, count)
        if last > BURST * largest and newest > BURST * before_it and last - usual > BURST_MATTERS * runs.power:
            span = f"the last {duration(evidence.seconds(count))}"
            before = f"{figure(last / largest)} times its largest power over any earlier stretch as long"
            reason = f"the residual over {span} has {before}"
            return [Finding("inconsistent", f"{reason}: the plant, the sensor or the load has changed")]
    return []


def _powers(error: FloatArray, count: int) -> tuple[float, float, float]:
    """Return the power of an error (K,) over its newest block, the largest over an earlier block, the median."""
    blocks = error.size // count
    squares = (error - np.median(error)) ** 2
    powers = squares[squares.size - blocks * count :].reshape(blocks, count).mean(axis=1)
    return float(powers[-1]), float(powers[:-1].max()), float(np.median(powers))
