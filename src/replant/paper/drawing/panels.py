"""Panels: how transients are drawn, the same in every figure of the article."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from replant.paper.drawing.curves import Curve
from replant.report.palette import TRUE, open_frame


def draw_panel(axis: Any, curves: Iterable[tuple[str, Curve, Mapping[str, Any]]], true: float) -> None:
    """Draw labelled curves, each in its style, over the true value."""
    for label, curve, style in curves:
        axis.plot(curve.t, curve.values, label=label, **style)
    axis.axhline(true, label="true value", **TRUE)
    open_frame(axis)


def limit(axis: Any, curves: Sequence[Curve], true: float, begin: float) -> None:
    """Set an axis' limits by what the curves show from ``begin`` s on, with room to either side."""
    shown = np.concatenate([curve.values[curve.t >= begin] for curve in curves] + [[true]])
    low, high = float(shown.min()), float(shown.max())
    margin = 0.5 * (high - low) or 0.1 * abs(true)
    axis.set_ylim(low - margin, high + margin)


def legend_above(canvas: Any, title: str, columns: int) -> None:
    """Write the title, and below it one legend of what any panel shows, outside of all.

    It is filled column by column; blanks at its end keep matplotlib from spreading the entries evenly.
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
