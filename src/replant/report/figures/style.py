"""Style of the figures: colours, axes, tick labels, limits, and the symbols and units of parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.interop import unit_of as unit_of
from replant.interop import without_unit
from replant.model.structure import Structure
from replant.plotting.diagrams import BLUE, VERMILION, blank_figure
from replant.plotting.numbers import number
from replant.runs.result import History, Result

# what was measured is wide and pale, the model thin and dark: told apart in grey as well
MEASURED, MODEL, RESIDUAL, INPUT, TRUTH = "#8d99a3", VERMILION, BLUE, "#00785a", "#000000"
INK, MUTED, GRID = "#20262b", "#56616b", "#dfe4e7"
COLOURS = (MODEL, RESIDUAL, INPUT, "#98489b", "#8f6200", INK)  # of curves that stand side by side
DASHES: tuple[Any, ...] = (
    "solid", (0, (7, 2)), (0, (7, 2, 1.5, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2, 1.5, 2)), (0, (12, 3))
)  # fmt: skip
#: Colour and dashes of each of many curves; dashes, because in grey colours are not enough.
LINES = tuple((COLOURS[i % 6], DASHES[(i + (0, 3, 1, 4, 2, 5)[i // 6]) % 6]) for i in range(36))
SIGMAS = 2.0  # half-width of every band [standard deviations]
NO_EXCITATION, NO_CONDITION = 1e-12, 1e10
"""Eigenvalue below which, and condition number beyond which, figures are round-off [number]."""
SHOWN = 3_000  # points of a curve; beyond it min and max of each stretch stand for the stretch [count]
SHOWN_SMALL = 1_000  # the same in a panel of half the width [count]
LEVEL = 1e-9  # movement below which a signal stands still [part of its size]
FARTHEST = 1e30  # farthest that an axis reaches: what diverged is not worth more [number]

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def new_axes(rows: int, columns: int, size: tuple[float, float], **options: Any) -> Any:
    """Return an array (rows, columns) of axes on a new figure."""
    return blank_figure(*size).subplots(rows, columns, squeeze=False, **options)


def tidy(axis: Any, *, grid: bool = True) -> None:
    """Remove the top and right spine of an axis, set its colours and tick labels, and draw a grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(MUTED)
    axis.tick_params(colors=MUTED, which="both")
    for each in (axis.xaxis, axis.yaxis):
        if each.get_scale() == "linear":
            _plain(each)
    axis.xaxis.label.set_color(INK)
    axis.yaxis.label.set_color(INK)
    if grid:
        axis.grid(color=GRID, linewidth=0.8)
        axis.set_axisbelow(True)


def _plain(axis: Any) -> None:
    """Label a linear axis with complete numbers, not with differences from an offset."""
    from matplotlib.ticker import FuncFormatter

    axis.set_major_formatter(FuncFormatter(lambda value, _: number(value, 8)))


def label_time(axes: list[Any]) -> None:
    """Label the time axis of the lowest axis in each column."""
    places = [axis.get_subplotspec() for axis in axes]
    for axis, place in zip(axes, places, strict=True):
        beneath = place is not None and any(
            other is not None and other.colspan == place.colspan and other.rowspan.start >= place.rowspan.stop
            for other in places
        )
        if not beneath:
            axis.set_xlabel("time [s]")


def legend(axis: Any, columns: int) -> None:
    """Put the legend above the axis, outside of the plot."""
    axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.1, labelcolor=INK,
        handlelength=1.6, columnspacing=1.4,
    )  # fmt: skip


def say(axis: Any, words: str) -> None:
    """Write ``words`` in the middle of an axis that has no curve to show."""
    axis.text(0.5, 0.5, words, transform=axis.transAxes, ha="center", va="center", color=MUTED)
    axis.set_xticks([])
    axis.set_yticks([])


def logarithmic(axis: Any) -> None:
    """Label the decades of a logarithmic axis, an x- or y-axis of matplotlib."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
    axis.set_minor_formatter(NullFormatter())


def power_of_ten(value: float) -> str:
    """Return a short label of a decade.

    Examples
    --------
    >>> power_of_ten(0.01), power_of_ten(1e5)
    ('0.01', '10⁵')
    """
    if value <= 0:
        return ""
    exponent = round(math.log10(value))
    return f"{value:g}" if -3 < exponent < 4 else "10" + str(exponent).translate(_SUPERSCRIPT)


def symbol(name: str) -> str:
    """Return a parameter's name with its index as subscript.

    Examples
    --------
    >>> symbol("a10"), symbol("bias")
    ('a₁₀', 'bias')
    """
    return name if name == "bias" else name[0] + name[1:].translate(_SUBSCRIPT)


def symbols(structure: Structure, input_label: str, output_label: str) -> list[str]:
    """Return each parameter's symbol with its unit, in the order of the names.

    >>> symbols(Structure(poles=2), "voltage [V]", "speed [rpm]")
    ['a₁ [1/s]', 'a₀ [1/s²]', 'b₀ [rpm/V/s²]']
    """
    per = gain_unit(input_label, output_label)
    labels = []
    for name in structure.names:
        if name == "bias":
            unit = unit_of(output_label)
        else:
            order = structure.poles - int(name[1:])
            seconds = "s" + (str(order).translate(_SUPERSCRIPT) if order > 1 else "")
            unit = f"1/{seconds}" if name[0] == "a" else f"{per}/{seconds}" if per else ""
        labels.append(f"{symbol(name)} [{unit}]" if unit else symbol(name))
    return labels


def gain_unit(input_label: str, output_label: str) -> str:
    """Return the unit of output per input; empty where either is unknown."""
    numerator, denominator = unit_of(output_label), unit_of(input_label)
    if not (numerator and denominator):
        return ""
    compound = any(sign in denominator for sign in "/* ·")
    return f"{numerator}/({denominator})" if compound else f"{numerator}/{denominator}"


def plant_input(result: Result, label: str) -> str:
    """Return the label of the mapped input, which is the input of G(s).

    The map of an offline fit is not known: the label is taken to be that of the mapped input.
    """
    return mapped_label(label, result.settings.preprocess.input_map if result.settings else "identity")


def mapped_label(label: str, input_map: object) -> str:
    """Return the label of a mapped input; after a map of the user's own it has no unit.

    Examples
    --------
    >>> mapped_label("voltage [kV]", "square"), mapped_label("u", "identity")
    ('voltage² [kV²]', 'u')
    """
    if input_map == "identity":
        return label
    unit = unit_of(label)
    name = without_unit(label)
    return f"{name}² [{unit}²]" if input_map == "square" and unit else f"{name}²" if input_map == "square" else name


def first_estimate(history: History) -> int:
    """Return the first row with an estimate: during start-up, rows are zero."""
    moved = (history.parameters != 0.0).any(axis=1)
    return int(moved.argmax()) if moved.any() else history.samples.size


def estimates(history: History) -> FloatArray:
    """Return the estimate over time (H, P), NaN before the first one."""
    values = history.parameters.copy()
    values[: first_estimate(history)] = np.nan
    return values


def band(std: FloatArray | None) -> FloatArray | None:
    """Return the half-width of a band, NaN where the standard deviation is unknown; None where it is so everywhere."""
    if std is None or not np.isfinite(std).any():
        return None
    return np.where(np.isfinite(std), SIGMAS * np.minimum(std, FARTHEST), np.nan)


def settled_limits(values: FloatArray, extra: Sequence[float] = ()) -> tuple[float, float]:
    """Return limits that show the last nine tenths of an estimate, and the values ``extra``."""
    shown = np.concatenate([values[values.size // 10 :], np.asarray(extra, np.float64)])
    shown = np.clip(shown[np.isfinite(shown)], -FARTHEST, FARTHEST)
    if shown.size == 0:
        return -1.0, 1.0
    low, high = float(shown.min()), float(shown.max())
    margin = max(0.25 * (high - low), 0.05 * abs(high)) or 1.0
    return low - margin, high + margin


def near_the_end(values: FloatArray, std: FloatArray | None, true: float | None) -> list[float]:
    """Return the values that the limits must show besides the estimate: its last band, and the true value."""
    shown = [] if true is None else [true]
    if std is not None and values.size and math.isfinite(std[-1]):
        last, half = float(values[-1]), SIGMAS * min(float(std[-1]), FARTHEST)
        shown += [last - half, last + half]
    return shown


def residual_limits(residual: FloatArray, measured: FloatArray) -> tuple[float, float]:
    """Return limits symmetric about zero that show the residual, at most twice the range of the measured signal."""
    finite, known = (np.clip(each[np.isfinite(each)], -FARTHEST, FARTHEST) for each in (residual, measured))
    span = float(np.abs(finite).max()) if finite.size else 0.0
    if span == 0.0:
        return -1.0, 1.0
    reach = min(1.05 * span, 2.0 * ((float(np.ptp(known)) if known.size else 0.0) or span))
    return -reach, reach


def output_limits(measured: FloatArray, *others: FloatArray) -> tuple[float, float]:
    """Return limits that show the measured signal completely, and others up to its range beyond it."""
    finite = np.clip(measured[np.isfinite(measured)], -FARTHEST, FARTHEST)
    if finite.size == 0:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    span = (high - low) or abs(high) or 1.0
    bottom, top = low, high
    for other in others:
        known = np.clip(other[np.isfinite(other)], -FARTHEST, FARTHEST)
        if known.size:
            bottom, top = min(bottom, float(known.min())), max(top, float(known.max()))
    bottom, top = max(bottom, low - span), min(top, high + span)
    if top - bottom <= LEVEL * max(abs(low), abs(high)):  # the signal moves by rounding only
        bottom, top = bottom - 0.5 * (abs(high) or 1.0), top + 0.5 * (abs(high) or 1.0)
    return bottom - 0.05 * (top - bottom), top + 0.05 * (top - bottom)
