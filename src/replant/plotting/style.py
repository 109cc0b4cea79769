"""The style of figures: colours, axes, ticks, legends and limits; and results that a notebook shows with a picture.

The colours are those of Okabe and Ito, which readers with a colour vision deficiency can distinguish.  If two of them
are equally light, line styles or widths differ as well, so that a figure is readable in grey.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, MissingDependencyError, needs, shown
from replant.numerics.arguments import FloatArray
from replant.plotting.numbers import number, power_of_ten

BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
BLUE, VERMILION, GREY = "#0072b2", "#d55e00", "#7f8c95"
NAVY = "#00436b"  # a darker blue, for use with vermilion, which is as light as blue in grey
# measured signals are wide and pale, the model thin and dark: they can be distinguished in grey, too
MEASURED, MODEL, RESIDUAL, INPUT, TRUTH = "#8d99a3", VERMILION, BLUE, "#00785a", BLACK
INK, MUTED, GRID = "#20262b", "#56616b", "#dfe4e7"
COLOURS = (MODEL, RESIDUAL, INPUT, "#98489b", "#8f6200", INK)  # of several curves in common axes
DASHES: tuple[Any, ...] = (
    "solid", (0, (7, 2)), (0, (7, 2, 1.5, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2, 1.5, 2)), (0, (12, 3))
)  # fmt: skip
#: Colour and dashes of each of many curves; the dashes distinguish them in grey.
LINES = tuple((COLOURS[i % 6], DASHES[(i + (0, 3, 1, 4, 2, 5)[i // 6]) % 6]) for i in range(36))
#: Line style of true values in every figure.
TRUE: Any = {"color": TRUTH, "ls": (0, (5, 3)), "lw": 0.9, "zorder": 2.5}
FONT: Any = {"font.size": 9.0, "axes.titlesize": 9.0, "legend.fontsize": 8.5, "svg.hashsalt": "replant"}

SIGMAS = 2.0  # half-width of every band [standard deviations]
FARTHEST = 1e30  # largest value of an axis; only diverged values are larger [number]
LEVEL = 1e-9  # range below which a signal is constant apart from rounding [part of its size]


def picture(axes: Any) -> str:
    """Return the figure of one or several axes as an HTML image."""
    drawn = np.ravel(np.asarray(axes, dtype=object))[0].figure._repr_png_()
    return f'<img src="data:image/png;base64,{base64.b64encode(drawn).decode()}">'


class Shown:
    """A result with `__repr__` and `plot`, which a notebook shows as text and, with matplotlib, as a picture."""

    def plot(self) -> Any:
        """Draw the result; return its axes."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        words = f"<p>{html.escape(repr(self))}</p>"
        try:
            return words + picture(self.plot())
        except MissingDependencyError:
            return words


def blank_figure(width: float, height: float) -> Any:
    """Return a `matplotlib.figure.Figure` of a size in inches, made without pyplot, so that it need not be closed.

    >>> blank_figure(7.0, 4.0).get_size_inches().tolist()
    [7.0, 4.0]
    """
    with needs("plots need matplotlib", "report"):
        from matplotlib.figure import Figure
    figure: Any = Figure(figsize=(width, height), layout="constrained")
    figure._repr_png_ = partial(_as_png, figure)  # notebooks call this method
    return figure


def saved(folder: Path, drawn: Mapping[str, Any]) -> list[Path]:
    """Save the figures of axes as PNG files into a folder, by name, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.png" for name in drawn]
    for path, axis in zip(paths, drawn.values(), strict=True):
        axis.figure.savefig(path, dpi=130)
    return paths


def _as_png(figure: Any) -> bytes:
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    return drawn.getvalue()


def given_axes(name: str, axes: Any, count: int) -> list[Any]:
    """Return axes, given in any nesting, as a list of ``count``; ``name`` is the argument's name in messages."""
    found = list(np.asarray(axes, dtype=object).ravel())
    if not all(hasattr(axis, "set_xlim") for axis in found):
        raise ArgumentTypeError(f"{name} must be axes of matplotlib, got {shown(axes)}")
    if len(found) != count:
        raise InvalidArgumentError(f"{name} must be {count} axes, got {len(found)}")
    return found


def axes_for(name: str, axes: Any, count: int, size: tuple[float, float], **layout: Any) -> list[Any]:
    """Return the user's ``count`` axes, or those of a new figure, by default below each other."""
    if axes is not None:
        return given_axes(name, axes, count)
    return list(blank_figure(*size).subplots(**({"nrows": count, "squeeze": False} | layout)).ravel())


def in_two_columns(count: int, width: float, rest: float, height: float) -> list[Any]:
    """Return axes of a new figure in two columns; ``height`` is that of a row, ``rest`` that of all else [inches]."""
    columns = min(count, 2)
    rows = -(-count // columns)
    grid = blank_figure(width, rest + height * rows).subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis in grid[count:]:
        axis.set_axis_off()
    for axis in grid[:count][-columns:]:
        axis.tick_params(labelbottom=True)
    return list(grid[:count])


def tidy(axis: Any) -> None:
    """Remove the top and right spine of an axis, set its colours and tick labels, and draw a grid."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(MUTED)
    axis.tick_params(colors=MUTED, which="both")
    for each in (axis.xaxis, axis.yaxis):
        if each.get_scale() == "linear":  # without matplotlib's common offset
            each.set_major_formatter(FuncFormatter(lambda value, _: number(value, 8)))
        else:
            each.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
            each.set_minor_formatter(NullFormatter())
        each.label.set_color(INK)
    axis.grid(color=GRID, linewidth=0.8)
    axis.set_axisbelow(True)


def label_time(axes: Sequence[Any]) -> None:
    """Label the time axis of the lowest axis in each column."""
    places = [axis.get_subplotspec() for axis in axes]
    for axis, place in zip(axes, places, strict=True):
        beneath = place is not None and any(
            other is not None and other.colspan == place.colspan and other.rowspan.start >= place.rowspan.stop
            for other in places
        )
        if not beneath:
            axis.set_xlabel("time [s]")


def title(axis: Any, words: str, room: float | None = None) -> None:
    """Write a title flush left above an axis, with room below it in points."""
    axis.set_title(words, loc="left", color=INK, fontsize="medium", pad=room)


def legend(axis: Any, columns: int = 4) -> None:
    """Put a legend above the axis, outside of the plot, if a curve has a label."""
    if axis.get_legend_handles_labels()[0]:
        axis.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.1,
            labelcolor=INK, handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip


def say(axis: Any, words: str) -> None:
    """Write ``words`` in the middle of an axis without curves."""
    axis.text(0.5, 0.5, words, transform=axis.transAxes, ha="center", va="center", color=MUTED)
    axis.set_xticks([])
    axis.set_yticks([])


def settled_limits(values: FloatArray, extra: Sequence[float] = ()) -> tuple[float, float]:
    """Return limits that show the last nine tenths of an estimate, and the values ``extra``."""
    shown = _known(np.concatenate([values[values.size // 10 :], np.asarray(extra, np.float64)]))
    if shown.size == 0:
        return -1.0, 1.0
    low, high = float(shown.min()), float(shown.max())
    margin = max(0.25 * (high - low), 0.05 * abs(high)) or 1.0
    return low - margin, high + margin


def residual_limits(residual: FloatArray, measured: FloatArray) -> tuple[float, float]:
    """Return limits symmetric about zero that show the residual, at most twice the range of the measured signal."""
    finite, known = _known(residual), _known(measured)
    span = float(np.abs(finite).max()) if finite.size else 0.0
    if span == 0.0:
        return -1.0, 1.0
    reach = min(1.05 * span, 2.0 * ((float(np.ptp(known)) if known.size else 0.0) or span))
    return -reach, reach


def output_limits(measured: FloatArray, *others: FloatArray) -> tuple[float, float]:
    """Return limits that show the measured signal completely, and others up to one range of it beyond."""
    finite = _known(measured)
    if finite.size == 0:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    span = (high - low) or abs(high) or 1.0
    shown = np.concatenate([finite, *(_known(other) for other in others)])
    bottom, top = max(float(shown.min()), low - span), min(float(shown.max()), high + span)
    if top - bottom <= LEVEL * max(abs(low), abs(high)):  # the signal moves by rounding only
        bottom, top = bottom - 0.5 * (abs(high) or 1.0), top + 0.5 * (abs(high) or 1.0)
    return bottom - 0.05 * (top - bottom), top + 0.05 * (top - bottom)


def near(curves: Sequence[FloatArray], reference: FloatArray, reach: float) -> tuple[float, float]:
    """Return the range of a reference and of other curves, cut off at ``reach`` beyond the reference."""
    low, high = float(reference.min()), float(reference.max())
    shown = np.clip(np.concatenate([reference, *curves]), low - reach, high + reach)
    return float(shown.min()), float(shown.max())


def _known(values: FloatArray) -> FloatArray:
    return np.clip(values[np.isfinite(values)], -FARTHEST, FARTHEST)


def is_drawable(values: Any) -> bool:
    """Return whether all values are finite and none is too large for an axis."""
    return bool(np.isfinite(values).all() and np.abs(values).max(initial=0.0) < FARTHEST)


def decades(values: FloatArray, lowest: float = -math.inf) -> tuple[float, float]:
    """Return the powers of ten that enclose some values; the lower one is at least 10^``lowest``."""
    low, high = math.floor(math.log10(values.min()) - 0.05), math.ceil(math.log10(values.max()) + 0.05)
    return 10.0 ** max(low, lowest), 10.0**high
