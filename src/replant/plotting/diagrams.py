"""The diagrams of models, drawn with matplotlib when they are asked for, and their colours.

The colours are those of Okabe and Ito, which readers with a colour vision deficiency can distinguish.  Where two of
them are equally light, line styles must differ as well, so that a figure is readable in grey.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.errors import ArgumentTypeError, InvalidArgumentError, MissingDependencyError, shown
from replant.statistics.residuals import BAND_95


def over(values: Any, unit: str, digits: int = 4) -> str:
    """Return the first and last of some values, with their unit.

    Examples
    --------
    >>> over(np.linspace(0.0, 2.0, 5), "s"), over([], "s")
    ('0 to 2 s', 'none')
    """
    return f"{values[0]:.{digits}g} to {values[-1]:.{digits}g} {unit}" if len(values) else "none"


def with_std(value: float, std: float | None) -> str:
    """Return a value with its standard deviation, where that is known.

    Examples
    --------
    >>> with_std(2.2346, 0.069), with_std(2.2346, None)
    ('2.235 +- 0.069', '2.235')
    """
    return f"{value:.4g}" + ("" if std is None else f" +- {std:.2g}" if np.isfinite(std) else " +- unknown")


def picture(axes: Any) -> str:
    """Return the figure of axes, or of several, as an image of HTML."""
    drawn = np.ravel(np.asarray(axes, dtype=object))[0].figure._repr_png_()
    return f'<img src="data:image/png;base64,{base64.b64encode(drawn).decode()}">'


class Shown:
    """A result with `__repr__` and `plot`, which a notebook shows with its picture; without matplotlib in words."""

    def plot(self) -> Any:
        """Draw the result; return its axes."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        words = f"<p>{html.escape(repr(self))}</p>"
        try:
            return words + picture(self.plot())
        except MissingDependencyError:
            return words


BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
BLUE, VERMILION, PURPLE, GREY = "#0072b2", "#d55e00", "#cc79a7", "#7f8c95"
NAVY = "#00436b"  # blue, darkened: beside vermilion, which is as light as blue in grey

#: How a true value is drawn, in every figure.
TRUE = {"color": BLACK, "ls": (0, (5, 3)), "lw": 0.9, "zorder": 2.5}

FONT: Any = {"font.size": 9.0, "axes.titlesize": 9.0, "legend.fontsize": 8.5, "svg.hashsalt": "replant"}


def blank_figure(width: float, height: float) -> Any:
    """Return an empty `matplotlib.figure.Figure` of a width and height in inches, with constrained layout.

    The figure is independent of pyplot: it has no window and need not be closed.  A notebook shows it.

    >>> blank_figure(7.0, 4.0).get_size_inches().tolist()
    [7.0, 4.0]
    """
    try:
        from replant.plotting.figure import ShownFigure
    except ImportError as cause:
        raise MissingDependencyError("plots need matplotlib: pip install 'replant[report]'") from cause
    return ShownFigure(figsize=(width, height), layout="constrained")


def given_axes(name: str, axes: Any, count: int) -> list[Any]:
    """Return axes, one or any nesting of several, as a list of ``count``; ``name`` is the argument's in messages."""
    found = list(np.asarray(axes, dtype=object).ravel())
    if not all(hasattr(axis, "set_xlim") for axis in found):
        raise ArgumentTypeError(f"{name} must be axes of matplotlib, got {shown(axes)}")
    if len(found) != count:
        raise InvalidArgumentError(f"{name} must be {count} axes, got {len(found)}")
    return found


def font() -> Any:
    """Return a context in which figures are made and saved with the project's font sizes."""
    import matplotlib as mpl

    return mpl.rc_context(FONT)


def symbol(name: str) -> str:
    """Return a parameter's name as mathematical text of matplotlib.

    Examples
    --------
    >>> symbol("a0"), symbol("bias")
    ('$a_{0}$', 'bias')
    """
    return f"${name[0]}_{{{name[1:]}}}$" if name[1:].isdigit() else name


def open_frame(axis: Any) -> None:
    """Remove the top and right spine of an axis, and draw a faint grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#dddddd", lw=0.5)
    axis.set_axisbelow(True)


UNSTABLE = 1e12  # how far the right half-plane is shaded: as far as anybody may look [rad/s]
RADIUS_95 = 2.448
"""Radius of the 95 % ellipse of two normal variables [standard deviations].
Level: 95 %: the square root of the quantile of chi squared with two degrees of freedom.
"""
REACH_95 = 1.96
"""Half-width of the 95 % interval of a normal variable [standard deviations].
Level: 95 %.
"""

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class RootColours:
    """Colours of a plot of poles and zeros: its markers, the axes, and the unstable half-plane."""

    pole: str = BLUE
    zero: str = VERMILION
    line: str = GREY
    half: str = "#dddddd"


PLAIN = RootColours()


def draw_roots(
    axis: Any,
    poles: ComplexArray,
    zeros: ComplexArray,
    regions: Sequence[tuple[complex, FloatArray]],
    colours: RootColours = PLAIN,
) -> None:
    """Draw poles (crosses) and zeros (circles) in rad/s, with 95 % regions; the right half-plane is shaded."""
    axis.axvspan(0.0, UNSTABLE, color=colours.half, alpha=0.45, lw=0)
    axis.axhline(0.0, color=colours.line, lw=0.8)
    axis.axvline(0.0, color=colours.line, lw=0.8)
    _limits(axis, np.concatenate([poles, zeros]))
    drawn = False
    for root, covariance in regions:
        drawn |= _region(axis, root, covariance, colours.pole, label="" if drawn else "95 % region")
    marks = {"mfc": "none", "clip_on": False}
    axis.plot(poles.real, poles.imag, "x", color=colours.pole, ms=9, mew=2.0, label="poles", **marks)
    if zeros.size:
        axis.plot(zeros.real, zeros.imag, "o", color=colours.zero, ms=8, mew=1.8, label="zeros", **marks)


def mirrored(covariance: FloatArray) -> FloatArray:
    """Return the covariance (2, 2) of a root's conjugate.

    Examples
    --------
    >>> mirrored(np.array([[4.0, 1.0], [1.0, 2.0]]))
    array([[ 4., -1.],
           [-1.,  2.]])
    """
    return np.asarray(covariance * np.array([[1.0, -1.0], [-1.0, 1.0]]))


def _limits(axis: Any, roots: ComplexArray) -> None:
    """Show every root and the imaginary axis, with room around them."""
    roots = roots[np.isfinite(roots)]
    low, high = float(np.min(roots.real, initial=0.0)), float(np.max(roots.real, initial=0.0))
    width, height = high - low, 2.0 * float(np.max(np.abs(roots.imag), initial=0.0))
    width = max(width, 0.1 * height) or 1.0
    height = max(height, 0.5 * width)
    axis.set_xlim(low - 0.3 * width, high + 0.3 * width)
    axis.set_ylim(-0.65 * height, 0.65 * height)


def _region(axis: Any, root: complex, covariance: FloatArray, colour: str, label: str) -> bool:
    """Draw the 95 % ellipse, or the interval of a real root; return whether there is something to draw."""
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).any():
        return False
    if root.imag == 0.0:
        reach = REACH_95 * math.sqrt(max(float(covariance[0, 0]), 0.0))
        ends = [root.real - reach, root.real + reach]
        axis.plot(ends, [0.0, 0.0], color=colour, alpha=0.35, lw=7, solid_capstyle="butt", label=label or None)
        return True
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 181)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    axis.fill(root.real + outline[0], root.imag + outline[1], facecolor=colour, alpha=0.3, lw=0, label=label or None)
    return True


SIGMAS = 2.0  # half-width of every band [standard deviations]
WIDEST_DB, WIDEST_DEGREES = 60.0, 180.0
"""Half-width at which a band is cut: beyond it nothing is known anyway [dB, degrees]."""


def draw_over_time(time: FloatArray, output: FloatArray, std: FloatArray | None, what: str, ax: Any = None) -> Any:
    """Draw an output over time in s with a band of +-2 standard deviations; return the axes."""
    axis = blank_figure(6.2, 3.4).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    if std is not None:
        low, high = output - SIGMAS * std, output + SIGMAS * std
        axis.fill_between(time, low, high, color=BLUE, alpha=0.22, lw=0, label="± 2σ")
    axis.plot(time, output, color=BLUE, lw=1.6, label="model")
    axis.set_xlim(float(time[0]), float(time[-1]))
    axis.set_xlabel("time [s]")
    axis.set_ylabel(what)
    axis.legend(frameon=False)
    open_frame(axis)
    return axis


def draw_bode(
    frequency: FloatArray,
    magnitude: FloatArray,
    phase: FloatArray,
    relative_std: FloatArray | None,
    phase_std: FloatArray | None,
    ax: Any = None,
) -> Any:
    """Draw magnitude in dB and phase in degrees over frequency in rad/s, with bands of +-2 standard deviations."""
    axes = blank_figure(6.2, 4.8).subplots(2, 1, sharex=True) if ax is None else given_axes("ax", ax, 2)
    top, bottom = np.asarray(axes, dtype=object).ravel()
    drawn = frequency > 0.0  # no other has a place on a logarithmic axis
    frequency, magnitude, phase = frequency[drawn], magnitude[drawn], phase[drawn]
    relative_std, phase_std = (None if std is None else std[drawn] for std in (relative_std, phase_std))
    with np.errstate(divide="ignore"):
        decibels, degrees = 20.0 * np.log10(magnitude), np.degrees(phase)
    for axis, values, std, widest, unit in (
        (top, decibels, relative_std, WIDEST_DB, 20.0 / math.log(10.0)),
        (bottom, degrees, phase_std, WIDEST_DEGREES, 180.0 / math.pi),
    ):
        if std is not None:
            band = np.minimum(SIGMAS * unit * std, widest)
            axis.fill_between(frequency, values - band, values + band, color=BLUE, alpha=0.22, lw=0, label="± 2σ")
        axis.semilogx(frequency, values, color=BLUE, lw=1.6, label="model")
        open_frame(axis)
    top.set_ylabel("magnitude [dB]")
    top.legend(frameon=False)
    bottom.set_ylabel("phase [°]")
    bottom.set_xlabel("frequency [rad/s]")
    if frequency.size and frequency[0] != frequency[-1]:
        bottom.set_xlim(float(frequency[0]), float(frequency[-1]))
    return np.array([top, bottom], dtype=object)


def draw_nyquist(
    response: ComplexArray, relative_std: FloatArray | None, phase_std: FloatArray | None, ax: Any = None
) -> Any:
    """Draw a frequency response in the complex plane, with regions of 2 standard deviations; return the axes."""
    axis = blank_figure(5.0, 4.6).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    if relative_std is not None and phase_std is not None:
        angle = np.linspace(0.0, math.tau, 61)
        every = max(1, response.size // 60)
        chosen = zip(response[::every], relative_std[::every], phase_std[::every], strict=True)
        for number, (middle, relative, turn) in enumerate(chosen):
            # along the radius and across it; that the two errors are correlated is left out
            ellipse = middle * (1.0 + SIGMAS * (relative * np.cos(angle) + 1j * turn * np.sin(angle)))
            label = "" if number else "2σ"
            axis.fill(ellipse.real, ellipse.imag, color=BLUE, alpha=0.16, lw=0, label=label or None)
    axis.plot(response.real, response.imag, color=BLUE, lw=1.6, label="model")
    axis.plot([-1.0], [0.0], "+", color=VERMILION, ms=9, mew=1.6, label="-1")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.legend(frameon=False)
    open_frame(axis)
    return axis


def draw_poles(
    poles: ComplexArray, zeros: ComplexArray, regions: list[tuple[complex, FloatArray]], ax: Any = None
) -> Any:
    """Draw poles (crosses) and zeros (circles) in rad/s, with 95 % regions of the poles; return the axes."""
    axis = blank_figure(5.2, 4.6).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    both = [(pole.conjugate(), mirrored(covariance)) for pole, covariance in regions if pole.imag]
    draw_roots(axis, poles, zeros, [*regions, *both])
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    axis.legend(frameon=False)
    open_frame(axis)
    return axis


def draw_validation(validation: Any, axes: Any = None) -> Any:
    """Draw a validation; return four axes of matplotlib."""
    if axes is None:
        figure = blank_figure(9.0, 6.4)
        grid = figure.add_gridspec(2, 3)
        axes = [figure.add_subplot(grid[0, :]), *(figure.add_subplot(grid[1, column]) for column in range(3))]
    outputs, auto, cross, frequency = given_axes("axes", axes, 4)
    time = validation.time
    outputs.plot(time, validation.output + validation.residual, color=GREY, lw=2.4, alpha=0.7, label="measured")
    outputs.plot(time, validation.output, color=VERMILION, lw=1.2, label=f"model, fit {validation.fit:.1f} %")
    outputs.set_xlabel("time [s]")
    outputs.set_xlim(float(time[0]), float(time[-1]))
    outputs.legend(frameon=False)
    found = validation.correlations
    lags = 0 if found is None else found.auto.size - 1
    _stems(auto, np.arange(1, lags + 1), None if found is None else (found.auto[1:], found.auto_std))
    _stems(cross, np.arange(-lags, lags + 1), None if found is None else (found.cross, found.cross_std))
    auto.set_title("residual with itself", fontsize="medium")
    cross.set_title("input with later residual", fontsize="medium")
    frequency.set_title("error by frequency", fontsize="medium")
    frequency.set_xlabel("frequency [rad/s]")
    by_frequency = validation.by_frequency
    if by_frequency is None:
        frequency.text(0.5, 0.5, "not known", transform=frequency.transAxes, ha="center", va="center", color=GREY)
    else:
        frequency.plot(by_frequency.frequency, 100.0 * by_frequency.error, color=BLUE, lw=1.2, label="error")
        limit = 100.0 * by_frequency.limit
        frequency.plot(by_frequency.frequency, limit, color=GREY, lw=1.2, ls="--", label="95 % limit")
        frequency.set_ylabel("part of |G| [%]")
        frequency.legend(frameon=False)
    for axis in (outputs, auto, cross, frequency):
        open_frame(axis)
    return np.array([outputs, auto, cross, frequency], dtype=object)


def _stems(axis: Any, lags: Any, found: tuple[FloatArray, float] | None) -> None:
    axis.set_xlabel("lag [samples]")
    if found is None:
        axis.text(0.5, 0.5, "too few samples", transform=axis.transAxes, ha="center", va="center", color=GREY)
        return
    values, std = found
    axis.axhspan(-BAND_95 * std, BAND_95 * std, color=GREY, alpha=0.3, lw=0, label="95 %")
    axis.plot(lags, values, color=BLUE, lw=1.2)
    axis.legend(frameon=False)
