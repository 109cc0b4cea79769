"""Test for an output that is held between reports: a slow sensor, or a logger that writes changes only.

Sensors slower than the clock, historians that write a value once it has moved by a deadband, and programs that repeat
the last message give rows that repeat an output though the plant has moved.  To the model this looks like a dead time
of about half the usual interval between reports, and like a stuck sensor.

A model is made of the reports alone, to first order.  If the output is held, its error contains the movement of the
plant since the report, and is largest in the last row that repeats it.  The ratio of its power there to that at the
reports has Snedecor's F distribution if there is no difference; the errors of a run are correlated, and one counts.

A coarse scale repeats values, too.  One that is new then lies half a step ahead of the plant, and half a step behind it
just before the next: a model of these alone is early, and the ratio large.  To the model of all rows, which is right
then, no error of rounding exceeds half a step; to that of a held output, early and late rows of a run are off by half
the movement between reports.  Less than a step of it is not told from rounding.

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
    rounding = rounding_of(run.forced[rows], y[used]) ** 2
    used = used & (y > y[used].min()) & (y < y[used].max())  # at the ends of its scale a sensor also repeats values
    repeated = np.concatenate([[False], used[1:] & used[:-1] & (y[1:] == y[:-1])])
    reports, last = used & ~repeated, repeated & ~np.append(repeated[1:], False)
    fresh, held = int(np.count_nonzero(reports)), int(np.count_nonzero(last))
    if 2 * held < fresh or fresh < evidence.enough:  # most reports are not repeated, or there are too few for a model
        return None
    error, columns = run.error[rows], np.hstack([run.zeta[rows], run.nuisances[rows]])
    step = amounts_of(columns[reports], error[reports])
    left, freedom = error - columns @ step, fresh - step.size
    usual = max(sum_of_squares(left[reports]) / freedom, rounding)
    ratio = min(sum_of_squares(left[last]) / usual, sum_of_squares(error[last]) / rounding) / held
    from scipy import special  # slow to import

    if not special.fdtrc(held, freedom, ratio) < ALPHA:
        return None
    size = runs.size(step[: evidence.coefficients], Speeds.of(evidence, closed=False).poles)
    return size, fresh / int(np.count_nonzero(used))
