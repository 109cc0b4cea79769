"""Test of an output that is held from report to report: a slow sensor, or a logger that writes what has changed.

A sensor slower than the clock, a historian that writes a value once it has moved by a deadband, a program that repeats
the last message: the rows between two reports repeat an output, though the plant has gone on.  To the model that is
about half of a dead time as long as the usual interval between reports, and a stuck sensor.

A model is made of the reports alone, to first order.  Where the output is held, its error at a row that repeats a
report is what the plant has moved since, and larger than that at a report; where a coarse scale gives equal outputs by
chance it is no larger, as the model is then nearest in the middle of a run.  The ratio of both powers has Snedecor's F
distribution if there is no difference; the errors of a run, which go together, count as one.

Source: Ljung (1999), "System Identification: Theory for the User", section 14.2 (missing outputs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import sum_of_squares
from replant.numerics.projections import amounts_of
from replant.verdict.estimate_tests import FARTHEST, Speeds
from replant.verdict.evidence import Evidence, Runs, rounding_of
from replant.verdict.verdict import Finding, percent


class Held(NamedTuple):
    """What a model of the reports alone changes."""

    size: float  # by how much a coefficient differs, as a part of it
    fresh: float  # part of the rows that are new


def held_output_findings(*views: tuple[Evidence, Runs]) -> list[Finding]:
    """Say where the output is held from report to report, as a model or each input of a row sees it."""
    found = [each for each in (_held(*view) for view in views) if each is not None]
    if not found:
        return []
    size, fresh = max(found)
    reason = f"the output is held from report to report, and new in {percent(fresh)} of its rows"
    advice = f"made of these alone, a coefficient differs by {percent(size)}: make the cells that repeat the one before"
    return [Finding("inconsistent" if size > FARTHEST else "trusted", f"{reason}: {advice} empty")]


def _held(evidence: Evidence, runs: Runs) -> Held | None:
    """Return what a model of the reports alone changes of an output that is held; None of another."""
    rows, run = evidence.known, runs.now
    y, used = evidence.raw[rows], evidence.used[rows]
    used = used & (y > y[used].min()) & (y < y[used].max())  # at the end of a scale a sensor repeats itself, too
    repeated = np.concatenate([[False], used[1:] & used[:-1] & (y[1:] == y[:-1])])
    reports = used & ~repeated
    fresh, held = int(np.count_nonzero(reports)), int(np.count_nonzero(repeated[1:] & ~repeated[:-1]))
    if 2 * held < fresh or fresh < evidence.enough:  # most reports are not repeated, or there are too few for a model
        return None
    columns = np.hstack([run.zeta[rows], run.nuisances[rows]])
    step = amounts_of(columns[reports], run.error[rows][reports])
    left = run.error[rows] - columns @ step
    rounding = rounding_of(run.forced[rows], y[used])
    if not _is_larger(left, repeated, reports, held, fresh - step.size, rounding):
        return None
    size = runs.size(step[: evidence.coefficients], Speeds.of(evidence, closed=False).poles)
    return Held(size, fresh / np.count_nonzero(used))


def _is_larger(
    error: FloatArray, repeated: BoolArray, reports: BoolArray, held: int, freedom: int, rounding: float
) -> bool:
    """Return whether an error (K,) is larger in the rows of ``held`` runs that repeat reports, beyond chance."""
    from scipy import special  # slow to import

    at_reports = max(sum_of_squares(error[reports]) / freedom, rounding**2)
    ratio = sum_of_squares(error[repeated]) / np.count_nonzero(repeated) / at_reports
    return bool(special.fdtrc(held, freedom, ratio) < ALPHA)
