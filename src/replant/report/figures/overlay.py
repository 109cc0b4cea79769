"""The estimates of several methods over time, in common axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from replant.plotting.diagrams import given_axes
from replant.report.figures import style
from replant.runs.result import Result
from replant.runs.thinning import thin

WIDEST = 1.5  # how far a panel reaches about the reference at the least [part of its size]
DEFAULT_SIZE = (9.0, 1.9, 1.7)  # width, height of a row, height of the rest [inches]


def draw_overlay(
    results: Mapping[str, Result],
    dt: float,
    *,
    reference: str | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw each parameter's estimate over time by several methods, with its band of +-2 sigma if known.

    A fit of the whole record is a horizontal line; a method with an estimate only at the end is a dot.

    Parameters
    ----------
    results : dict of Result
        By the name of the method; all of the same structure.
    dt : float
        Sampling time in s.
    reference : str, optional
        The method whose last estimate sets the limits of the panels, by default the first: curves far beyond it are
        cut off.
    axes : P matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known; of the input after its map.

    Returns
    -------
    array of P axes
    """
    chosen = results[reference] if reference else next(iter(results.values()))
    structure = chosen.structure
    if axes is None:
        columns = 2 if structure.size > 1 else 1
        rows = -(-structure.size // columns)
        width, row, rest = DEFAULT_SIZE
        grid = style.new_axes(rows, columns, (width, rest + row * rows), sharex=True)
        for axis in grid.flat[structure.size :]:
            axis.set_axis_off()
        for axis in grid.flat[: structure.size][-columns:]:
            axis.tick_params(labelbottom=True)
        axes = grid.flat[: structure.size]
    axes = given_axes("axes", axes, structure.size)
    end = float(chosen.clock_of(dt).at(max(1, max(result.simulation.output.size for result in results.values()) - 1)))
    for i, (axis, label) in enumerate(zip(axes, style.symbols(structure, input_label, output_label), strict=True)):
        axis.set_title(label, loc="left", color=style.INK, fontsize="medium")
        style.tidy(axis)
        for number, (name, result) in enumerate(results.items()):
            _draw(axis, result, i, dt, end, name, *style.LINES[number % len(style.LINES)])
        axis.set_xlim(0.0, end)
        axis.set_ylim(*limits([result for result in results.values() if result is not chosen], chosen, i))
    style.label_time(axes)
    return np.array(axes, dtype=object)


def _draw(axis: Any, result: Result, i: int, dt: float, end: float, name: str, colour: str, dashes: Any) -> None:
    history, last = result.history, float(result.parameters[i])
    look: Any = {"color": colour, "ls": dashes, "lw": 1.4, "label": name}
    if history is None:
        if abs(last) <= style.FARTHEST:
            axis.plot([0.0, end], [last, last], **look)
        return
    begin = style.first_estimate(history)
    if begin == history.samples.size:  # only the solution at the end
        axis.plot([end], [last], marker="o", clip_on=False, **look)
        return
    t = result.clock_of(dt).after(history.samples[begin:])
    values = np.clip(history.parameters[begin:, i], -style.FARTHEST, style.FARTHEST)
    if (half := style.band(None if history.std is None else history.std[begin:, i])) is not None:
        low, high = (thin(values + sign * half, style.SHOWN_SMALL // 4) for sign in (-1.0, 1.0))
        axis.fill_between(low.among(t), low.values, high.values, color=colour, alpha=0.13, lw=0)
    drawn = thin(values, style.SHOWN_SMALL)
    axis.plot(drawn.among(t), drawn.values, **look)


def limits(others: Sequence[Result], reference: Result, i: int) -> tuple[float, float]:
    """Return the limits of a panel: the reference is shown completely, the others as far as they stay near it."""
    low, high = _settled(reference, i)
    middle = float(reference.parameters[i])
    ends = [abs(float(other.parameters[i]) - middle) for other in others]
    reach = max(WIDEST * abs(middle), high - low, 3.0 * float(np.median(ends)) if ends else 0.0)
    reach = min(reach, style.FARTHEST)
    for other in others:
        bottom, top = _settled(other, i)
        low, high = min(low, max(bottom, middle - reach)), max(high, min(top, middle + reach))
    return low, high


def _settled(result: Result, i: int) -> tuple[float, float]:
    last = float(result.parameters[i])
    values = np.full(1, last) if result.history is None else result.history.parameters[:, i]
    return style.settled_limits(values, [last])


def legend_columns(count: int, most: int) -> int:
    """Return how many columns, at most ``most``, give a legend of ``count`` entries rows of about equal length.

    Examples
    --------
    >>> legend_columns(5, 4), legend_columns(8, 4)
    (3, 4)
    """
    return -(-count // -(-count // most))
