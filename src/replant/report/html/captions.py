"""The pictures in words: for those who do not see them, and as captions for those who do."""

from __future__ import annotations

import numpy as np

from replant.report.figures import style
from replant.report.figures.correlation import reach
from replant.report.html.material import Material
from replant.report.numbers import complex_number, number, percent

SEEN = 0.01
"""Part of the record below which a stretch cannot be seen in a picture [part of the record]."""


def of_fit(material: Material) -> str:
    """Return what the plots of input, output and residual show."""
    residual = material.residual[np.isfinite(material.residual)]
    fit = percent(material.result.simulation.fit)
    if residual.size == 0:
        return "Input and measured output over time; the model gives no finite output to compare with."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    unit = style.unit_of(material.output_label)
    beyond = (
        " Where the model is not to be seen, it lies beyond the scale." if material.result.simulation.fit < 0 else ""
    )
    return (
        f"Input, output and residual over time: the model, run from the input alone, has a fit of {fit}; the residual "
        f"is {size}{' ' + unit if unit else ''} in the root mean square{_newest(material)}.{beyond}"
    )


def _newest(material: Material) -> str:
    """Return over what the figures are, where it is not the whole record."""
    return f" over the newest {material.y.size:,} samples" if material.log.earlier else ""


def of_transients(material: Material) -> str:
    """Return what the plots of the parameters show."""
    if beyond_scale(material):
        return "Each parameter's estimate over time; what left every scale is not drawn."
    history = material.result.history
    banded = history is not None and history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", beside the true values" if material.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The scale follows the last nine tenths of the record."
    begin, rows = (0, 0) if history is None else (style.first_estimate(history), history.samples.size)
    if history is None or begin == rows or begin < SEEN * rows:
        return said
    held = number(float(history.samples[begin]) * material.dt, 3)
    return f"{said} The first {held} s went into the first estimate."


def beyond_scale(material: Material) -> bool:
    """Return whether a parameter ends where no plot can show it."""
    return bool((np.abs(material.result.parameters) > style.FARTHEST).any())


def of_excitation(material: Material) -> str:
    """Return what the plots of the excitation show."""
    found = material.excitation
    if found is None:
        return "Excitation over time: no regressors to judge."
    window = number(found.window * material.dt, 3)
    poorest = int(np.argmin(found.smallest))
    when = number(float(found.samples[poorest]) * material.dt, 3)
    return (
        f"How well windows of {window} s tell the parameters apart: the smallest eigenvalue of the scaled information "
        f"matrix is {number(float(found.smallest.max()), 2)} at best and {number(float(found.smallest[poorest]), 2)} "
        f"in the window up to {when} s. Where it falls, the plant was not moved enough to learn from."
    )


def of_poles(material: Material) -> str:
    """Return what the plot of poles and zeros shows."""
    model = material.result.transfer_function
    poles = ", ".join(complex_number(mode.pole) for mode in model.modes)
    zeros = ", ".join(complex_number(zero) for zero in model.zeros.tolist() if zero.imag >= 0)
    tail = f"; zero{'s' if model.zeros.size > 1 else ''} at {zeros} rad/s" if zeros else ""
    region = " Coloured: 95 % regions." if material.uncertainty is not None else ""
    heads = f"Pole{'s' if model.poles.size > 1 else ''} at {poles} rad/s{tail}"
    return f"{heads}. Grey: the right half-plane, where a pole is unstable.{region}"


def of_bode(material: Material) -> str:
    """Return what the Bode diagram shows."""
    band = " with bands of two standard deviations" if material.uncertainty is not None else ""
    gain = number(material.result.transfer_function.dc_gain)
    unit = style.gain_unit(material.plant_label, material.output_label)
    gain += f" {unit}" if unit else ""
    return f"Magnitude and phase of G(s){band}; the gain at rest is {gain}."


def of_auto(material: Material) -> str:
    """Return what the residual's autocorrelation shows."""
    found = material.correlations
    if found is None:
        return "Autocorrelation of the residual: there is nothing to correlate."
    return (
        f"Autocorrelation of the residual: {number(100 * found.outside[0], 2)} % of the lags lie outside the 95 % "
        "limits of white noise. Much more than 5 % means coloured noise, or dynamics that the model lacks."
        + (" At lag 0 it is 1, beyond the picture." if reach(found.auto, found.auto_std) else "")
    )


def of_cross(material: Material) -> str:
    """Return what the cross-correlation of input and residual shows."""
    found = material.correlations
    if found is None:
        return "Correlation of the input with the residual: there is nothing to correlate."
    return (
        f"Correlation of the input with the later residual: {number(100 * found.outside[1], 2)} % of the lags from 0 "
        "on lie outside the 95 % limits. Much more than 5 % means that the model misses part of the response."
    )
