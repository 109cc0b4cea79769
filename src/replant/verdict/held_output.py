"""Test for an output that is held between reports: a slow sensor, or a logger that writes changes only.

Sensors slower than the clock, historians that write a value once it has moved by a deadband, and programs that repeat
the last message give rows that repeat an output though the plant has moved.  To the model this looks like a dead time
of about half the usual interval between reports, and like a stuck sensor.

A model is made of the reports alone, to first order.  If the output is held, its error in a row that repeats a report
contains the movement of the plant since then, and is larger than at a report.  If a coarse scale gives equal outputs by
chance, the error is no larger, as the model is then nearest in the middle of a run.  The ratio of both powers has
Snedecor's F distribution if there is no difference; the errors of a run are correlated and count as one.

Source: Ljung (1999), "System Identification: Theory for the User", section 14.2 (missing outputs).
"""

from __future__ import annotations

import numpy as np

from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import sum_of_squares
from replant.numerics.projections import amounts_of
from replant.verdict.estimate_tests import FARTHEST, Speeds
from replant.verdict.evidence import Evidence, Runs, rounding_of
from replant.verdict.verdict import Finding, percent


def held_output_findings(*views: tuple[Evidence, Runs]) -> list[Finding]:
    """Return a finding if the output is held between reports, by the view with the largest change of a coefficient."""
    found = [each for each in (_held(*view) for view in views) if each is not None]
    if not found:
        return []
    size, fresh = max(found)
    reason = f"the output is held from report to report, and new in {percent(fresh)} of its rows"
    advice = f"made of these alone, a coefficient differs by {percent(size)}: make the cells that repeat the one before"
    return [Finding("inconsistent" if size > FARTHEST else "trusted", f"{reason}: {advice} empty")]


def _held(evidence: Evidence, runs: Runs) -> tuple[float, float] | None:
    """Return the largest relative change of a coefficient by a model of the reports alone, and their part of the rows.

    None if the output is not held.
    """
    rows, run = evidence.known, runs.now
    y, used = evidence.raw[rows], evidence.used[rows]
    used = used & (y > y[used].min()) & (y < y[used].max())  # at the ends of its scale a sensor also repeats values
    repeated = np.concatenate([[False], used[1:] & used[:-1] & (y[1:] == y[:-1])])
    reports = used & ~repeated
    fresh, held = int(np.count_nonzero(reports)), int(np.count_nonzero(repeated[1:] & ~repeated[:-1]))
    if 2 * held < fresh or fresh < evidence.enough:  # most reports are not repeated, or there are too few for a model
        return None
    columns = np.hstack([run.zeta[rows], run.nuisances[rows]])
    step = amounts_of(columns[reports], run.error[rows][reports])
    left = run.error[rows] - columns @ step
    power = sum_of_squares(left[repeated]) / np.count_nonzero(repeated)
    freedom = fresh - step.size
    ratio = power / max(sum_of_squares(left[reports]) / freedom, rounding_of(run.forced[rows], y[used]) ** 2)
    from scipy import special  # slow to import

    if not special.fdtrc(held, freedom, ratio) < ALPHA:
        return None
    size = runs.size(step[: evidence.coefficients], Speeds.of(evidence, closed=False).poles)
    return size, fresh / int(np.count_nonzero(used))
