"""What is drawn over time: panels of curves, with their limits and what is left out, for pictures and pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.numerics.arguments import FloatArray
from replant.plotting.style import FARTHEST, MODEL, MUTED, SIGMAS, TRUE, label_time, say, tidy, title
from replant.plotting.thinning import thin

SHOWN = 3_000  # points of a curve; beyond it min and max of each stretch stand for the stretch [count]
SHOWN_SMALL = 1_000  # the same in a panel of half the width [count]


@dataclass(frozen=True, eq=False)
class Curve:
    """A signal over time."""

    t: FloatArray  # (V,): in s
    values: FloatArray  # (V,): NaN where there is nothing to show
    label: str
    colour: str = MODEL
    std: FloatArray | None = None  # (V,): NaN where it is not known; a band is drawn of it
    band: str = ""  # its label
    kind: str = "line"  # {"line", "step", "constant", "dot"}
    width: float = 1.4
    dashes: Any = "solid"


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves on common axes."""

    label: str
    curves: Sequence[Curve]
    ends: tuple[float, float] = (0.0, 1.0)  # of the time shown, in s
    limits: tuple[float, float] | None = None
    name: str = ""  # in a page
    words: str = ""  # in place of curves
    is_log: bool = False
    has_zero: bool = False  # whether a line is drawn at 0
    left_out: FloatArray | None = None  # (L, 2): stretches in s that are shaded
    gaps: FloatArray | None = None  # (G,): times in s through which no line runs


def constant(value: float, label: str, colour: str = MODEL, dashes: Any = "solid", width: float = 1.4) -> Curve:
    """Return a horizontal line."""
    return Curve(np.zeros(1), np.full(1, value), label, colour, kind="constant", width=width, dashes=dashes)


def true_value(value: float) -> Curve:
    """Return the line of a true value."""
    return constant(value, "true", TRUE["color"], TRUE["ls"], 1.1)


def draw_panels(axes: Sequence[Any], panels: Sequence[Panel], points: int = SHOWN, *, titled: bool = False) -> Any:
    """Draw each panel into its axes, labelled at the side or titled; the lowest show the time.  Return the axes."""
    for axis, panel in zip(axes, panels, strict=True):
        draw_panel(axis, panel, points)
        title(axis, panel.label) if titled else axis.set_ylabel(panel.label)
    label_time(axes)
    return np.array(axes, dtype=object)


def draw_panel(axis: Any, panel: Panel, points: int = SHOWN) -> None:
    """Draw a panel without its label."""
    if panel.is_log:
        axis.set_yscale("log")
    tidy(axis)
    axis.set_xlim(*panel.ends)
    if panel.words:
        say(axis, panel.words)
        return
    if panel.limits is not None:
        axis.set_ylim(*panel.limits)  # before a curve sets others
    _shade(axis, panel.left_out)
    for curve in panel.curves:
        _draw(axis, curve, panel.gaps, points)
    if panel.has_zero:
        axis.axhline(0.0, color=MUTED, lw=0.8)


def _draw(axis: Any, curve: Curve, gaps: FloatArray | None, points: int) -> None:
    look: Any = {"color": curve.colour, "ls": curve.dashes, "lw": curve.width, "label": curve.label or None}
    values = np.clip(curve.values, -FARTHEST, FARTHEST)
    if curve.kind == "constant":
        axis.axhline(float(values[0]), **look)
        return
    begin = int(np.isfinite(values).argmax()) if values.size else 0
    t, values = curve.t[begin:], values[begin:]
    if curve.std is not None and np.isfinite(curve.std).any():
        half = SIGMAS * np.minimum(np.where(np.isfinite(curve.std), curve.std, np.nan), FARTHEST)[begin:]
        low, high = (thin(values + sign * half, points // 2) for sign in (-1.0, 1.0))
        look_of_band: Any = {"alpha": 0.22, "label": curve.band} if curve.band else {"alpha": 0.13}
        axis.fill_between(low.among(t), low.values, high.values, color=curve.colour, lw=0, **look_of_band)
    if curve.kind == "dot":
        look |= {"marker": "o", "clip_on": False}
    drawn = thin(values, points)
    t, values = drawn.among(t), drawn.values
    if gaps is not None and gaps.size:
        places = np.searchsorted(t, gaps)
        t, values = np.insert(t, places, gaps), np.insert(values, places, np.nan)
    axis.plot(t, values, drawstyle="steps-post" if curve.kind == "step" else "default", **look)


def _shade(axis: Any, left_out: FloatArray | None) -> None:
    if left_out is not None and len(left_out):
        spans = [(begin, end - begin) for begin, end in left_out.tolist()]
        axis.broken_barh(spans, (0.0, 1.0), transform=axis.get_xaxis_transform(), color=MUTED, alpha=0.22, lw=0,
                         label="left out", zorder=0)  # fmt: skip


def within_reason(values: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """Return values clipped to a hundred times the height of their panel: a canvas cannot draw further."""
    span = 100.0 * (limits[1] - limits[0])
    return np.where(np.isfinite(values), np.clip(values, limits[0] - span, limits[1] + span), np.nan)
