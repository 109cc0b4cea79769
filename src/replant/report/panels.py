"""Results, excitation and logs as panels of curves over time; step responses and poles of several models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replant.fitting.log_inspection import Inspection
from replant.fitting.model import Model
from replant.fitting.responses import Bode, StepResponse, frequencies
from replant.model.interop import unit_of
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.online.runs.result import Clock, History, Result
from replant.plotting import diagrams, style
from replant.plotting.numbers import gain_unit, mapped_label, symbols, with_unit
from replant.plotting.over_time import POINTS, SHOWN, Curve, Panel, constant, thin
from replant.report.findings import Excitation
from replant.verdict import WORST_CONDITION

NO_EXCITATION, NO_CONDITION = 1e-12, 1e10  # least eigenvalue, largest condition number beyond round-off [number]
WIDEST = 1.5  # least reach of a panel around the reference [part of its size]
LAST = 10  # the last 1/N of a record gets its own panel [number]
MOST = 12  # most columns that are drawn [count]


def plant_input(result: Result, label: str) -> str:
    """Return the label of the mapped input, the input of G(s); the label of an offline fit is already mapped."""
    return mapped_label(label, result.settings.preprocess.input_map if result.settings else "identity")


def fit_panels(
    result: Result, inputs: Mapping[str, FloatArray], y: FloatArray, dt: float, label: str, number: str = ""
) -> tuple[list[Panel], list[Panel]]:
    """Return the inputs by their labels, and the measured and simulated output called ``label`` above the residual.

    If the signals are but the newest samples, those of the overview are drawn.  ``number`` distinguishes the outputs of
    a page.
    """
    clock, shown, samples = result.clock_of(dt), result.overview, result.simulation.output.size
    signals = [thin(each, POINTS) for each in (*inputs.values(), y, result.simulation.output, result.residual(y))]
    if shown is not None:
        signals, samples = [shown.input, shown.output, shown.model, shown.residual], shown.samples
    ends = (0.0, float(clock.at(max(1, samples - 1))))
    whole: Any = {"ends": ends, "left_out": result.left_out_over_time(dt), "gaps": clock.gaps.mean(axis=1)}
    kind, given = "line" if result.model.input_hold == "foh" else "step", []
    for name, u in zip(inputs, signals, strict=False):
        curve = Curve(clock.at(u.places), u.values, "input", style.INPUT, kind=kind, width=0.9)
        given.append(Panel(name, [curve], limits=style.output_limits(u.values), name="input", **whole))
    t, (measured, model, residual) = clock.at(signals[-3].places), (each.values for each in signals[-3:])
    outputs = [
        Curve(t, measured, "measured", style.MEASURED, width=2.2),
        Curve(t, model, "model, from the input alone", width=1.0),
    ]
    left = [Curve(t, residual, "measured − model", style.RESIDUAL, width=0.8)]
    limits, named = style.residual_limits(residual, measured), with_unit("residual", unit_of(label))
    return given, [
        Panel(label, outputs, limits=style.output_limits(measured, model), name=f"output{number}", **whole),
        Panel(named, left, limits=limits, name=f"residual{number}", has_zero=True, **whole),
    ]


def part_panel(output: Panel, parts: Mapping[str, FloatArray], number: str) -> Panel:
    """Return the contribution of each input to the output of a panel, by the names of the inputs."""
    curves = [
        Curve(output.curves[0].t, part, name, colour, width=1.1, dashes=dashes)
        for (name, part), (colour, dashes) in zip(parts.items(), style.LINES, strict=False)
    ]
    limits, named = style.output_limits(*parts.values()), with_unit("part of each input", unit_of(output.label))
    return replace(output, label=named, curves=curves, limits=limits, name=f"part{number}", has_zero=True)


def first_estimate(history: History) -> int:
    """Return the first row with an estimate: rows of the start-up are zero."""
    moved = (history.parameters != 0.0).any(axis=1)
    return int(moved.argmax()) if moved.any() else history.samples.size


def estimates(history: History) -> FloatArray:
    """Return the estimate over time (H, P), NaN before the first one."""
    values = history.parameters.copy()
    values[: first_estimate(history)] = np.nan
    return values


def estimate_panels(
    result: Result, dt: float, truth: Sequence[float] | None, input_label: str, output_label: str
) -> list[Panel]:
    """Return the estimate of each parameter over time; ``input_label`` is that of the mapped input."""
    labels = symbols(result.structure, input_label, output_label)
    names, history = [f"parameter-{name}" for name in result.structure.names], result.history
    if history is None or not history.samples.size:
        return [Panel(label, [], name=name, words="no history") for label, name in zip(labels, names, strict=True)]
    t, found = result.clock_of(dt).after(history.samples), []
    for i, values in enumerate(estimates(history).T):
        last, std = float(values[-1]), None if history.std is None else history.std[:, i]
        words = "" if np.isfinite(values).any() else "no estimate"
        if abs(last) > style.FARTHEST:
            words = "diverged: too large to draw"
        known = [float(truth[i])] if truth is not None and math.isfinite(truth[i]) else []
        shown = [*known]
        if std is not None and math.isfinite(std[-1]):
            half = style.SIGMAS * min(float(std[-1]), style.FARTHEST)
            shown += [last - half, last + half]
        curves = [Curve(t, values, "estimate", std=std, band="± 2σ")]
        curves += [constant(true, "true", style.TRUE["color"], style.TRUE["ls"], 1.1) for true in known]
        limits = style.settled_limits(values, shown)
        found.append(Panel(labels[i], curves, (0.0, float(t[-1])), limits, names[i], words))
    return found


def overlay_panels(
    results: Mapping[str, Result], dt: float, reference: str, input_label: str, output_label: str
) -> list[Panel]:
    """Return the estimates of several methods; the reference sets the limits."""
    chosen = results[reference]
    longest = max(result.simulation.output.size for result in results.values())
    end = float(chosen.clock_of(dt).at(max(1, longest - 1)))
    others = [result for result in results.values() if result is not chosen]
    found = []
    for i, label in enumerate(symbols(chosen.structure, input_label, output_label)):
        drawn = zip(results.items(), style.LINES, strict=False)
        curves = [_estimate(result, i, dt, end, name, *line) for (name, result), line in drawn]
        found.append(Panel(label, curves, (0.0, end), limits(others, chosen, i)))
    return found


def _estimate(result: Result, i: int, dt: float, end: float, name: str, colour: str, dashes: Any) -> Curve:
    history, last = result.history, float(result.parameters[i])
    look: Any = {"label": name, "colour": colour, "dashes": dashes}
    if history is None:
        return constant(last, **look)
    if first_estimate(history) == history.samples.size:  # only an estimate at the end
        return Curve(np.full(1, end), np.full(1, last), kind="dot", **look)
    std = None if history.std is None else history.std[:, i]
    return Curve(result.clock_of(dt).after(history.samples), estimates(history)[:, i], std=std, **look)


def limits(others: Sequence[Result], reference: Result, i: int) -> tuple[float, float]:
    """Return the limits of a panel: they show the reference completely, and the others as far as these stay near it."""
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


def output_panels(results: Mapping[str, Result], y: FloatArray, dt: float, output_label: str) -> list[Panel]:
    """Return the simulated outputs of several models over the measured one: the whole record, and its last tenth."""
    clock = next(iter(results.values())).clock_of(dt)
    found = []
    for begin in (0, max(y.size - max(y.size // LAST, 2), 0)):
        t = clock.at(np.arange(begin, y.size))
        outputs = [result.simulation.output[begin:] for result in results.values()]
        curves = [Curve(t, y[begin:], "measured", style.MEASURED, width=2.6)]
        for name, output, (colour, dashes) in zip(results, outputs, style.LINES, strict=False):
            curves.append(Curve(t, output, name, colour, width=1.1, dashes=dashes))
        ends = (float(clock.at(begin)), float(clock.at(max(1, y.size - 1))))
        found.append(Panel(output_label, curves, ends, style.output_limits(y[begin:], *outputs)))
    return found


def excitation_panels(found: Excitation | None, clock: Clock) -> list[Panel]:
    """Return smallest eigenvalue and condition number of each window of a record."""
    labels, names = ("smallest eigenvalue", "condition number"), ("eigenvalue", "condition")
    if found is None:
        return [Panel(label, [], words="no regressors") for label in labels]
    t = clock.after(found.samples)
    smallest, condition = np.maximum(found.smallest, NO_EXCITATION), np.minimum(found.condition, NO_CONDITION)
    kind, ends = "dot" if t.size == 1 else "line", (0.0, float(t[-1]))
    curves = [Curve(t, smallest, "1 at best", style.INPUT, kind=kind)]
    others = [Curve(t, condition, "1 at best", style.RESIDUAL, kind=kind)]
    if found.condition.max() > WORST_CONDITION / 100:
        others.append(constant(WORST_CONDITION, "limit for identification", style.MODEL, (0, (5, 3)), 1.1))
    return [
        Panel(labels[0], curves, ends, style.decades(smallest), names[0], is_log=True),
        Panel(labels[1], others, ends, style.decades(condition, 0.0), names[1], is_log=True),
    ]


def column_panels(found: Inspection) -> list[Panel]:
    """Return numeric columns over time, or over samples without a clock: input, output, reference, then others."""
    clock, roles = found.clock, found.roles
    dt = 1.0 if clock is None or math.isnan(clock.dt) else clock.dt
    named = ((roles.input, style.INPUT), (roles.output, style.MEASURED), (roles.reference, style.TRUTH))
    drawn = [(role.column, colour) for role, colour in named if role is not None]
    beside = [clock and clock.column, *(column for column, _ in drawn)]
    for column in found.record:
        if column.number in found.contents.values and column not in beside and not math.isnan(column.low):
            drawn.append((column, style.RESIDUAL))
    panels = []
    for column, colour in drawn[:MOST]:
        points = thin(found.contents.values[column.number], SHOWN)
        curve = Curve(dt * points.places, points.values, "", colour, width=1.0)
        panels.append(Panel(column.name, [curve], (0.0, dt * max(1, column.rows - 1))))
    return panels


def draw_bode_of(model: Model, axes: Any, truth: TransferFunction | None = None, *, dt: float) -> Any:
    """Draw magnitude and phase of a model up to the Nyquist frequency of ``dt`` into two axes; return them."""
    with np.errstate(all="ignore"):
        found = model.bode(frequencies(model.transfer_function, dt))
    true = None if truth is None else Bode.of(truth, None, dt, found.frequency)
    return diagrams.draw_bode({"model": found}, axes, truth=true, unit=unit_of_gain(model))


def draw_step_of(models: Model | Mapping[str, Model], ax: Any = None, truth: TransferFunction | None = None) -> Any:
    """Draw the response of a model, or of each by its name, to a unit step; return the axes."""
    named = models if isinstance(models, Mapping) else {"model": models}
    with np.errstate(all="ignore"):
        steps = {name: model.step() for name, model in named.items()}
        if len(steps) > 1:
            longest = max(float(step.time[-1]) for step in steps.values())
            steps = {name: model.step(longest) for name, model in named.items()}
    unit = unit_of_gain(next(iter(named.values())))
    true = None if truth is None else StepResponse.of(truth, None, steps["model"].time)
    return diagrams.draw_response(steps, with_unit("step response", unit), ax, truth=true)


def unit_of_gain(model: Model) -> str:
    """Return the unit of a model's gain; empty if unknown."""
    return gain_unit(model.input_name, model.output_name)


def draw_poles_of(models: Model | Mapping[str, Model], ax: Any = None, truth: TransferFunction | None = None) -> Any:
    """Draw the poles and zeros of a model, or of each by its name, with their 95 % regions; return the axes."""
    named = models if isinstance(models, Mapping) else {"model": models}
    plants = ((name, model.transfer_function, regions(model)) for name, model in named.items())
    return diagrams.draw_poles({name: (g.poles, g.zeros, known) for name, g, known in plants}, ax, truth=truth)


def regions(model: Model) -> list[tuple[complex, FloatArray]]:
    """Return each pole and zero with the covariance (2, 2) of its real and imaginary part; empty where unknown."""
    known, g = model.uncertainty, model.transfer_function
    if known is None:
        return []
    with np.errstate(all="ignore"):  # at a double root the region is unbounded
        modes = known.modes
    found = diagrams.with_conjugates([(mode.mode.pole, mode.covariance) for mode in modes])
    numerator = known.covariance[model.structure.numerator, model.structure.numerator]
    return [*found, *((zero, zero_covariance(g.num, numerator, zero)) for zero in g.zeros.tolist())]


def zero_covariance(num: FloatArray, covariance: FloatArray, zero: complex) -> FloatArray:
    """Return the covariance (2, 2) of a zero's real and imaginary part: N(z) = 0 gives dz/db_i = -z^i / N'(z)."""
    steepness = complex(np.polyval(np.polyder(num), zero))
    size = covariance.shape[0]
    if steepness == 0.0 or num.size != size:
        return np.full((2, 2), np.inf)
    slope = -(complex(zero) ** np.arange(size - 1, -1, -1)) / steepness
    parts = np.stack([slope.real, slope.imag])
    return np.asarray(parts @ covariance @ parts.T) + 0.0
