"""Curves and panels that all figures of the article share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.online.trace import Trace
from replant.plotting.diagrams import TRUE, open_frame

POINTS = 2000  # points of a curve: more than a panel has pixels, few enough for a small SVG [count]


@dataclass(frozen=True, eq=False)
class Curve:
    """Points of a signal."""

    t: FloatArray  # t, values: (N,): time in s, and the signal there
    values: FloatArray


def thin(values: FloatArray, points: int = POINTS) -> npt.NDArray[np.intp]:
    """Return the indices, in order, at which a signal (K,) is drawn: of each stretch the lowest and the highest.

    First and last are always among them; at most ``points`` + 2 are returned, all of them if there are no more.
    """
    if values.size <= points:
        return np.arange(values.size)
    stretch = -(-values.size // (points // 2))
    whole = values.size // stretch * stretch
    blocks = values[:whole].reshape(-1, stretch)
    starts = np.arange(0, whole, stretch)
    chosen = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1), [0, values.size - 1]]
    if whole < values.size:
        chosen.append([whole + int(values[whole:].argmin()), whole + int(values[whole:].argmax())])
    return np.unique(np.concatenate(chosen))


def curve(values: FloatArray, dt: float, points: int = POINTS) -> Curve:
    """Return a signal as a curve."""
    kept = thin(values, points)
    return Curve(np.asarray(kept * dt, np.float64), values[kept])


def transients(trace: Trace, dt: float, points: int = POINTS) -> dict[str, Curve]:
    """Return each parameter's estimate over time, by name; at t_k that of (21), before the update of sample k."""
    before = trace.before()
    return {name: curve(before[:, i], dt, points) for i, name in enumerate(trace.names)}


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
