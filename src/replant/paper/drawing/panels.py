"""Panels: the estimates over time, drawn in the same way in every figure of the article."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from replant.paper.drawing.curves import Curve
from replant.plotting.diagrams import TRUE, open_frame


def draw_panel(axis: Any, curves: Iterable[tuple[str, Curve, Mapping[str, Any]]], true: float) -> None:
    """Draw labelled curves and the true value."""
    for label, curve, style in curves:
        axis.plot(curve.t, curve.values, label=label, **style)
    axis.axhline(true, label="true value", **TRUE)
    open_frame(axis)


def limit(axis: Any, curves: Sequence[Curve], true: float, begin: float) -> None:
    """Set the limits of an axis to the range of the curves from a time on, with a margin."""
    shown = np.concatenate([curve.values[curve.t >= begin] for curve in curves] + [[true]])
    low, high = float(shown.min()), float(shown.max())
    margin = 0.5 * (high - low) or 0.1 * abs(true)
    axis.set_ylim(low - margin, high + margin)


def legend_above(canvas: Any, title: str, columns: int) -> None:
    """Write a title above all panels, and below it one legend of all curves.

    The legend is filled column by column; blank entries at its end keep matplotlib from distributing them evenly.
    """
    from matplotlib.lines import Line2D

    entries: dict[str, Any] = {}
    for axis in canvas.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    handles, labels = list(entries.values()), list(entries)
    blanks = -len(handles) % columns
    handles += [Line2D([], [], ls="none")] * blanks
    labels += [""] * blanks
    canvas.legend(
        handles, labels, title=title, loc="outside upper left", ncols=columns, frameon=False, alignment="left"
    )
