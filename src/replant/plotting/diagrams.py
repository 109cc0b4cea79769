"""The diagrams of models and residuals, one or several in common axes: arrays in, axes out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.numerics.arguments import FloatArray
from replant.numerics.residuals import BAND_95, BAND_99, Correlations, periodogram
from replant.plotting import style
from replant.plotting.over_time import POINTS, Curve, Panel, draw_panel, thin

ComplexArray = npt.NDArray[np.complex128]
Regions = Sequence[tuple[complex, FloatArray]]  # roots, each with the covariance (2, 2) of real and imaginary part

# 95 %: the square root of the quantile of chi squared with two degrees of freedom
RADIUS_95 = 2.448  # radius of the 95 % ellipse of two normal variables [standard deviations]
REACH_95 = 1.96  # half-width of the 95 % interval of a normal variable [standard deviations]
UNSTABLE = 1e12  # width of the shaded right half-plane: beyond any range of an axis [rad/s]
WIDE = 0.2  # smallest correlation that is visible on an axis that reaches to 1 [number]
ABOVE_LEGEND = 20.0  # distance of a title from a narrow axis, with the legend between: side by side they touch [points]
FEW = 60  # most lags that are drawn as stems; more would merge [count]


def true_curve(x: FloatArray, values: FloatArray) -> Curve:
    """Return the curve of true values."""
    return Curve(x, values, "true", style.TRUE["color"], width=style.TRUE["lw"], dashes=style.TRUE["ls"])


def draw_response(responses: Mapping[str, Any], what: str, ax: Any = None, *, truth: Any = None) -> Any:
    """Draw outputs over time in s with bands of +-2 standard deviations, and the true one; return the axes.

    ``responses``, by the name of the model, have time, output and std as `replant.fitting.responses.StepResponse`.
    """
    (axis,) = style.axes_for("ax", ax, 1, (6.2, 3.4))
    width, band = (1.8, "± 2σ") if len(responses) == 1 else (1.4, "")
    curves, shown, ends = list[Curve](), [np.zeros(1)], (0.0, 0.0)
    for (name, found), (colour, dashes) in zip(responses.items(), style.LINES, strict=False):
        ends = float(found.time[0]), max(ends[1], float(found.time[-1]))
        if style.is_drawable(found.output):
            curves.append(Curve(found.time, found.output, name, colour, found.std, band, "line", width, dashes))
            shown.append(found.output)
    reached = [
        each.values + sign * style.SIGMAS * each.std for each in curves if each.std is not None for sign in (-1, 1)
    ]
    limits = style.output_limits(np.concatenate(shown), *reached)
    words = "" if curves else "the response of G(s) is not finite"
    if truth is not None:
        curves.append(true_curve(truth.time, truth.output))
    draw_panel(axis, Panel(what, curves, ends, limits, words=words, has_zero=True))
    axis.set(xlabel="time [s]", ylabel=what)
    if len(responses) == 1:
        style.legend(axis)
    return axis


def draw_bode(
    responses: Mapping[str, Any],
    axes: Any = None,
    *,
    reference: str = "",
    truth: Any = None,
    unit: str = "",
    size: tuple[float, float] = (6.2, 4.8),
    argument: str = "axes",
) -> Any:
    """Draw magnitude in dB and phase in degrees over frequency in rad/s, with bands of +-2 standard deviations.

    ``responses``, by the name of the model, have frequency, magnitude, phase, relative_std and phase_std as
    `replant.fitting.responses.Bode`.  The response of the ``reference`` sets the limits.
    """
    top, bottom = style.axes_for(argument, axes, 2, size, sharex=True, height_ratios=(3, 2))
    for axis, draw in ((top, draw_magnitude), (bottom, draw_phase)):
        draw(axis, responses, reference=reference, truth=truth)
    top.set_ylabel(f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    if top.get_shared_x_axes().joined(top, bottom):
        top.set_xlabel("")
    if len(responses) == 1:
        style.legend(top)
    return np.array([top, bottom], dtype=object)


def draw_magnitude(axis: Any, responses: Mapping[str, Any], *, reference: str = "", truth: Any = None) -> None:
    """Draw magnitudes in dB over frequency in rad/s."""
    shown = _draw_over_frequency(axis, responses, reference, truth, _MAGNITUDE)
    if shown is not None:
        room = max(0.1 * (shown[1] - shown[0]), 3.0)
        axis.set_ylim(shown[0] - room, shown[1] + room)


def draw_phase(axis: Any, responses: Mapping[str, Any], *, reference: str = "", truth: Any = None) -> None:
    """Draw phases in degrees over frequency in rad/s."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator

    shown = _draw_over_frequency(axis, responses, reference, truth, _PHASE)
    if shown is not None:
        span = shown[1] - shown[0]
        axis.yaxis.set_major_locator(MultipleLocator(45 if span < 200 else 90) if span < 700 else MaxNLocator(5))
        axis.set_ylim(min(shown[0], 0.0) - 25.0, max(shown[1], 0.0) + 25.0)


@dataclass(frozen=True)
class _Quantity:
    """Magnitude or phase of a frequency response, as it is drawn."""

    label: str
    values: Callable[[Any], FloatArray]
    std: str  # the name of its standard deviation, in nepers or radians
    unit: float  # factor from nepers or radians to the drawn unit
    widest: float  # half-width at which a band is cut: the value is then unknown
    around: float  # largest reach of the axes beyond the reference


_DECIBELS = 20.0 / math.log(10.0)
_MAGNITUDE = _Quantity(
    "magnitude [dB]", lambda found: _DECIBELS * np.log(found.magnitude), "relative_std", _DECIBELS, 60.0, 20.0
)
_PHASE = _Quantity("phase [°]", lambda found: np.degrees(found.phase), "phase_std", 180.0 / math.pi, 180.0, 90.0)


def _draw_over_frequency(
    axis: Any, responses: Mapping[str, Any], reference: str, truth: Any, what: _Quantity
) -> tuple[float, float] | None:
    """Draw curves over frequency with their bands, and return the range to show; None if no curve is finite."""
    axis.set_xscale("log")
    width, band = (1.8, "± 2σ") if len(responses) == 1 else (1.4, "")
    curves: dict[str, Curve] = {}
    with np.errstate(all="ignore"):
        for (name, found), (colour, dashes) in zip(responses.items(), style.LINES, strict=False):
            values, std = what.values(found), getattr(found, what.std)
            shown = (found.frequency > 0.0) & np.isfinite(values)  # a logarithmic axis has no place for others
            known = std is not None and np.isfinite(std[shown]).all()
            half = np.minimum(what.unit * std[shown], what.widest / style.SIGMAS) if known else None
            if shown.any():
                curves[name] = Curve(
                    found.frequency[shown], values[shown], name, colour, half, band, "line", width, dashes
                )
        drawn = [*curves.values(), *([] if truth is None else [true_curve(truth.frequency, what.values(truth))])]
    first = reference if reference in curves else next(iter(curves), "")
    omega = responses[first].frequency if first else np.ones(1)
    omega = omega[omega > 0.0]
    draw_panel(axis, Panel("", drawn, (float(omega[0]), float(omega[-1]))), POINTS)
    axis.set(xlabel="frequency [rad/s]", ylabel=what.label)
    if not first:
        style.say(axis, "the response of G(s) is not finite")
        return None
    return style.near([each.values for each in curves.values()], curves[first].values, what.around)


def draw_nyquist(
    response: ComplexArray, relative_std: FloatArray | None, phase_std: FloatArray | None, ax: Any = None
) -> Any:
    """Draw a frequency response in the complex plane, with regions of 2 standard deviations; return the axes."""
    (axis,) = style.axes_for("ax", ax, 1, (5.0, 4.6))
    style.tidy(axis)
    if relative_std is not None and phase_std is not None:
        angle = np.linspace(0.0, math.tau, 61)
        every = max(1, response.size // 60)
        chosen = zip(response[::every], relative_std[::every], phase_std[::every], strict=True)
        for number, (middle, relative, turn) in enumerate(chosen):
            # axes along the radius and across it; the correlation of the two errors is neglected
            ellipse = middle * (1.0 + style.SIGMAS * (relative * np.cos(angle) + 1j * turn * np.sin(angle)))
            axis.fill(ellipse.real, ellipse.imag, color=style.MODEL, alpha=0.16, lw=0, label=None if number else "2σ")
    axis.plot(response.real, response.imag, color=style.MODEL, lw=1.8, label="model")
    axis.plot([-1.0], [0.0], "+", color=style.INK, ms=9, mew=1.6, label="-1")
    axis.set(xlabel="real part", ylabel="imaginary part")
    style.legend(axis)
    return axis


def draw_poles(
    models: Mapping[str, tuple[ComplexArray, ComplexArray, Regions]], ax: Any = None, *, truth: Any = None
) -> Any:
    """Draw poles (crosses) and zeros (circles) in rad/s, with 95 % regions; the right half-plane is shaded.

    ``models``, by name, are tuples of poles, zeros, and roots with known covariance.
    """
    (axis,) = style.axes_for("ax", ax, 1, (5.2, 4.6))
    style.tidy(axis)
    axis.set(xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]")
    roots = np.concatenate([part for poles, zeros, _ in models.values() for part in (poles, zeros)])
    if not style.is_drawable(roots):
        style.say(axis, "not finite, or too large to draw")
        return axis
    axis.axvspan(0.0, UNSTABLE, color=style.GRID, alpha=0.45, lw=0)
    axis.axhline(0.0, color=style.MUTED, lw=0.8)
    axis.axvline(0.0, color=style.MUTED, lw=0.8)
    _show_roots(axis, roots)
    alone = len(models) == 1
    marks: Any = {"ls": "none", "mfc": "none", "clip_on": False}
    for (name, (poles, zeros, regions)), (colour, _) in zip(models.items(), style.LINES, strict=False):
        drawn = [_region(axis, root, covariance, colour) for root, covariance in regions]
        if alone and (first := next(filter(None, drawn), None)):
            first.set_label("95 % region")
        label = "poles" if alone else name
        axis.plot(poles.real, poles.imag, marker="x", color=colour, ms=9, mew=2.0, label=label, **marks)
        if zeros.size:
            colour, label = (style.RESIDUAL, "zeros") if alone else (colour, "")
            axis.plot(zeros.real, zeros.imag, marker="o", color=colour, ms=8, mew=1.8, label=label or None, **marks)
    if truth is not None:
        diamond: Any = {"ls": "none", "marker": "D", "ms": 11, "mfc": "none", "mew": 0.9, "color": style.TRUE["color"]}
        axis.plot(truth.poles.real, truth.poles.imag, label="true poles", **diamond)
    if alone:
        style.legend(axis)
    return axis


def with_conjugates(regions: Regions) -> Regions:
    """Return regions; each region of a complex root is followed by that of the conjugate root."""
    found, mirrored = [], np.array([[1.0, -1.0], [-1.0, 1.0]])  # signs of a covariance (2, 2)
    for root, covariance in regions:
        found.append((root, covariance))
        if root.imag:
            found.append((root.conjugate(), np.asarray(covariance * mirrored)))
    return found


def _show_roots(axis: Any, roots: ComplexArray) -> None:
    """Show every root and the imaginary axis, with room around them."""
    low, high = float(np.min(roots.real, initial=0.0)), float(np.max(roots.real, initial=0.0))
    width, height = high - low, 2.0 * float(np.max(np.abs(roots.imag), initial=0.0))
    width = max(width, 0.1 * height) or 1.0
    height = max(height, 0.5 * width)
    axis.set_xlim(low - 0.3 * width, high + 0.3 * width)
    axis.set_ylim(-0.65 * height, 0.65 * height)


def _region(axis: Any, root: complex, covariance: FloatArray, colour: str) -> Any:
    """Draw the 95 % ellipse, or the interval of a real root, and return it; None if there is nothing to draw."""
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).any():
        return None
    if root.imag == 0.0:
        reach = REACH_95 * math.sqrt(max(float(covariance[0, 0]), 0.0))
        ends = [root.real - reach, root.real + reach]
        return axis.plot(ends, [0.0, 0.0], color=colour, alpha=0.35, lw=7, solid_capstyle="butt")[0]
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 181)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    return axis.fill(root.real + outline[0], root.imag + outline[1], facecolor=colour, alpha=0.3, lw=0)[0]


def draw_correlations(found: Correlations | None, dt: float, axes: Any = None) -> Any:
    """Draw the residual's correlation with itself and with the input over the lag, with 95 and 99 % limits."""
    left, right = style.axes_for("axes", axes, 2, (9.6, 3.4), nrows=1, ncols=2)
    draw_correlation(found, dt, left)
    draw_correlation(found, dt, right, "input")
    return np.array([left, right], dtype=object)


def reach_of(auto: FloatArray, std: float) -> float | None:
    """Return half the height of an autocorrelation's axis if the 1 at lag 0 would make its limits too small, else None.

    >>> reach_of(np.array([1.0, 0.5]), 0.01), reach_of(np.array([1.0, -0.02]), 0.01)
    (None, 0.0412...)
    """
    near = max(float(np.abs(auto[1:]).max(initial=0.0)), BAND_99 * std)
    return 1.6 * near if near < WIDE else None


def draw_correlation(found: Correlations | None, dt: float, axis: Any, name: str = "") -> None:
    """Draw the residual's autocorrelation over the lag, or its cross-correlation with the input called ``name``."""
    style.title(axis, f"{name} with later residual" if name else "residual with itself")
    style.tidy(axis)
    axis.set(xlabel="lag [s]", ylabel="correlation")
    if found is None:
        style.say(axis, "too few samples, or a constant signal")
        return
    values, first, std = found.auto, 0, found.auto_std
    if name:
        values, first, std = found.cross, 1 - found.auto.size, found.cross_std
    axis.axhspan(-BAND_99 * std, BAND_99 * std, color=style.MEASURED, alpha=0.22, lw=0, label="99 %")
    axis.axhspan(-BAND_95 * std, BAND_95 * std, color=style.MEASURED, alpha=0.35, lw=0, label="95 %")
    axis.axhline(0.0, color=style.MUTED, lw=0.8)
    lags = np.asarray(dt * (first + np.arange(values.size)), np.float64)
    if values.size <= FEW:
        axis.vlines(lags, 0.0, values, color=style.RESIDUAL, lw=1.6)
        axis.plot(lags, values, "o", color=style.RESIDUAL, ms=3.5)
    else:
        drawn = thin(values, 1200)
        axis.plot(drawn.among(lags), drawn.values, color=style.RESIDUAL, lw=1.2)
        for limit in (-BAND_95 * std, BAND_95 * std):  # drawn again, as the curve may cover the bands
            axis.axhline(limit, color=style.INK, lw=0.8, ls=(0, (4, 3)))
    axis.set_xlim(dt * (first - 0.5), dt * (first + values.size - 0.5))
    style.legend(axis)
    if not name and (reach := reach_of(values, std)) is not None:
        axis.set_ylim(-reach, reach)


def draw_spectrum(noise: Any, residual: FloatArray, dt: float, ax: Any = None) -> Any:
    """Draw power spectral densities per Hz over angular frequency: the residual's, and that of a `NoiseModel`."""
    (axis,) = style.axes_for("ax", ax, 1, (4.8, 3.4))
    style.title(axis, "spectrum of the noise", ABOVE_LEGEND)
    axis.set(xlabel="angular frequency [rad/s]", ylabel="power per Hz")
    style.tidy(axis)
    found = periodogram(residual, dt)
    if found is None or not (found[1] > 0.0).any():
        style.say(axis, "too few samples, or no residual")
        return axis
    axis.set(
        xscale="log", yscale="log"
    )  # after `tidy`, whose formatter would hide the minor labels that less than a decade needs
    axis.plot(*found, color=style.MEASURED, lw=1.6, label="residual")
    if noise is not None and noise.variance > 0.0:
        highest = math.pi / dt
        omega = np.geomspace(max(found[0][0], 1e-3 * highest), highest, 300)
        label = "white noise" if noise.is_white else f"model of order {noise.order}"
        axis.plot(omega, noise.spectrum(omega), color=style.MODEL, lw=1.4, label=label)
    style.legend(axis)
    return axis


def draw_validation(found: Any, axes: Any = None, size: tuple[float, float] = (9.0, 6.4)) -> Any:
    """Draw a `replant.fitting.validation.Validation`: outputs, residual, error by frequency; return four axes."""
    if axes is None:
        figure = style.blank_figure(*size)
        grid = figure.add_gridspec(2, 3)
        axes = [figure.add_subplot(grid[0, :]), *(figure.add_subplot(grid[1, column]) for column in range(3))]
    outputs, auto, cross, frequency = style.given_axes("axes", axes, 4)
    time, measured = found.time, found.output + found.residual
    curves = [
        Curve(time, measured, "measured", style.MEASURED, width=2.4),
        Curve(time, found.output, f"model, fit {found.fit:.1f} %", style.VERMILION, width=1.2),
    ]
    ends = (float(time[0]), float(time[-1]))
    draw_panel(outputs, Panel("", curves, ends, style.output_limits(measured, found.output)))
    outputs.set_xlabel("time [s]")
    style.legend(outputs)
    draw_correlations(found.correlations, float(np.median(np.diff(time))) if time.size > 1 else 1.0, (auto, cross))
    error = found.by_frequency
    style.tidy(frequency)
    frequency.set_xlabel("frequency [rad/s]")
    if error is None:
        style.say(frequency, "not known")
    else:
        frequency.plot(error.frequency, 100.0 * error.error, color=style.BLUE, lw=1.2, label="error")
        frequency.plot(error.frequency, 100.0 * error.limit, color=style.MUTED, lw=1.2, ls="--", label="95 % limit")
        frequency.set_ylabel("part of |G| [%]")
        style.legend(frequency)
    titles = auto.get_title("left"), cross.get_title("left"), "error by frequency"
    for axis, title in zip((auto, cross, frequency), titles, strict=True):
        style.title(axis, title, ABOVE_LEGEND)
    return np.array([outputs, auto, cross, frequency], dtype=object)
