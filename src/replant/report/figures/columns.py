"""Figure of the columns of a log over time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from replant.data.inspection import Inspection
from replant.data.inspection.columns import Column
from replant.report.figures import style
from replant.runs.thinning import thin

MOST = 12  # columns that are drawn [count]


def draw_columns(found: Inspection) -> Any:
    """Draw the columns of numbers of a log over time, or over samples where the log has no time column."""
    drawn = columns_drawn(found)
    axes = style.new_axes(len(drawn), 1, (9, 0.8 + 1.5 * len(drawn)), sharex=True)[:, 0]
    known = found.clock is not None and not math.isnan(found.clock.dt)
    dt = found.clock.dt if known and found.clock is not None else 1.0
    for axis, column in zip(axes, drawn, strict=True):
        curve = thin(found.contents.values[column.number], style.SHOWN)
        axis.plot(curve.times(dt), curve.values, color=_colour(column, found), lw=1.0)
        axis.set_ylabel(column.name)
        style.tidy(axis)
        axis.set_xlim(0.0, dt * max(1, column.rows - 1))
    axes[-1].set_xlabel("time [s]" if known else "sample")
    return np.array(axes, dtype=object)


def columns_drawn(found: Inspection) -> list[Column]:
    """Return the columns that are drawn: input, output and reference, then the others in the order of the file."""
    roles = found.roles
    first = [role.column for role in (roles.input, roles.output, roles.reference) if role is not None]
    times = [found.clock.column] if found.clock is not None else []
    rest = [column for column in found.record if column.number in found.contents.values and column not in times]
    return [*first, *(column for column in rest if column not in first and not math.isnan(column.low))][:MOST]


def save_columns(folder: Path, found: Inspection) -> Path | None:
    """Draw the columns as ``columns.png`` and return its path; None if there is none to draw."""
    if not columns_drawn(found):
        return None
    path = folder / "columns.png"
    draw_columns(found)[0].figure.savefig(path, dpi=130)
    return path


def _colour(column: Column, found: Inspection) -> str:
    roles = found.roles
    named = ((roles.input, style.INPUT), (roles.output, style.MEASURED), (roles.reference, style.TRUTH))
    return next((colour for role, colour in named if role is not None and role.column == column), style.RESIDUAL)
