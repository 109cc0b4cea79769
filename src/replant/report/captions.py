"""The captions of the figures of a report: what is to be seen in each."""

from __future__ import annotations

import numpy as np

from replant.interop import unit_of
from replant.plotting.diagrams import reach_of
from replant.plotting.numbers import complex_number, gain_unit, number, percent
from replant.plotting.style import FARTHEST
from replant.report.material import Material
from replant.report.panels import first_estimate

SEEN = 0.01  # part of the record below which a stretch cannot be seen in a picture [part of the record]


def of_fit(material: Material) -> str:
    """Return the caption of input, output and residual over time."""
    residual = material.residual[np.isfinite(material.residual)]
    fit = percent(material.result.simulation.fit)
    if residual.size == 0:
        return "Input and measured output over time; the model's output is not finite."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    unit = unit_of(material.log.output_name)
    hidden = " Where the model's output is not visible, it lies outside the axes."
    beyond = hidden if material.result.simulation.fit < 0 else ""
    return (
        f"The model, {material.result.simulation.how}, has a fit of {fit}; the "
        f"root mean square of the residual is {size}{' ' + unit if unit else ''}{_newest(material)}.{beyond}"
    )


def _newest(material: Material) -> str:
    """Return which samples the figures are of, if not of the whole record."""
    return f" over the newest {material.log.output.size:,} samples" if material.log.earlier else ""


def of_transients(material: Material) -> str:
    """Return the caption of the parameter estimates over time."""
    if beyond_scale(material):
        return "Each parameter's estimate over time; estimates that diverged are not drawn."
    history = material.result.history
    banded = history is not None and history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", with the true values" if material.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The axes are scaled to the last 90 % of the record."
    begin, rows = (0, 0) if history is None else (first_estimate(history), history.samples.size)
    if history is None or begin == rows or begin < SEEN * rows:
        return said
    held = number(float(material.clock.after(history.samples[begin])), 3)
    return f"{said} The first estimate is made from the first {held} s."


def beyond_scale(material: Material) -> bool:
    """Return whether the last estimate of a parameter is too large for a plot."""
    return bool((np.abs(material.result.parameters) > FARTHEST).any())


def of_excitation(material: Material) -> str:
    """Return the caption of the excitation over time."""
    found = material.excitation
    if found is None:
        return "Excitation over time: there are no regressors."
    window = number(found.window * material.log.dt, 3)
    poorest = int(np.argmin(found.smallest))
    when = number(float(material.clock.after(found.samples[poorest])), 3)
    windows = f"{found.window:,} samples" if material.clock.irregular else f"{window} s"
    return (
        f"Excitation in windows of {windows}: the smallest eigenvalue of the scaled information matrix is at most "
        f"{number(float(found.smallest.max()), 2)} and at least {number(float(found.smallest[poorest]), 2)}, in the "
        f"window up to {when} s. Where it is small, the input does not excite every parameter."
    )


def of_poles(material: Material) -> str:
    """Return the caption of poles and zeros."""
    model = material.result.transfer_function
    poles = ", ".join(complex_number(mode.pole) for mode in model.modes)
    zeros = ", ".join(complex_number(zero) for zero in model.zeros.tolist() if zero.imag >= 0)
    tail = f"; zero{'s' if model.zeros.size > 1 else ''} at {zeros} rad/s" if zeros else ""
    region = " Coloured: 95 % confidence regions." if material.uncertainty is not None else ""
    diamonds = " Diamonds: the true poles." if material.truth is not None else ""
    heads = f"Pole{'s' if model.poles.size > 1 else ''} at {poles} rad/s{tail}"
    return f"{heads}. Grey: the right half-plane, in which poles are unstable.{region}{diamonds}"


def of_bode(material: Material) -> str:
    """Return the caption of the Bode diagram."""
    band = " with bands of two standard deviations" if material.uncertainty is not None else ""
    gain = number(material.result.transfer_function.dc_gain)
    unit = gain_unit(material.plant_label, material.log.output_name)
    gain += f" {unit}" if unit else ""
    return f"Bode diagram of G(s): magnitude and phase{band}; the DC gain is {gain}.{_dashed(material)}"


def _dashed(material: Material) -> str:
    return " Dashed: the true plant." if material.truth is not None else ""


def of_step(material: Material) -> str:
    """Return the caption of the step response."""
    band = " with a band of two standard deviations" if material.uncertainty is not None else ""
    return (
        f"Step response of G(s){band}: what the output makes of a unit step of the input, from rest.{_dashed(material)}"
    )


def of_auto(material: Material) -> str:
    """Return the caption of the residual's autocorrelation."""
    found = material.correlations
    if found is None:
        return "Autocorrelation of the residual: too few samples, or a constant signal."
    return (
        f"Residual with itself: {number(100 * found.outside[0], 2)} % of the lags lie outside the limits, 5 % by "
        "chance. More: the noise is coloured, or dynamics are missing."
        + (" The value 1 at lag 0 lies outside the axes." if reach_of(found.auto, found.auto_std) else "")
        + _of_samples(material)
    )


def _of_samples(material: Material) -> str:
    """Return how samples of an irregular clock are taken where a figure needs a regular one."""
    if not material.clock.irregular:
        return ""
    dt = number(material.log.dt, 4)
    return f" The clock is irregular: samples are taken as {dt} s apart, and lost ones as unknown."


def of_cross(material: Material) -> str:
    """Return the caption of the cross-correlation of input and residual."""
    found = material.correlations
    if found is None:
        return "Correlation of the input with the residual: too few samples, or a constant signal."
    return (
        f"Input with the later residual: {number(100 * found.outside[1], 2)} % of the lags from 0 on lie outside the "
        "limits, 5 % by chance. More: a part of the response is missing." + _of_samples(material)
    )


def of_spectrum(material: Material) -> str:
    """Return the caption of the noise's spectrum."""
    noise = material.result.noise
    if noise is None:
        return "Power spectral density of the residual; this method has no model of the noise." + _of_samples(material)
    if noise.is_white:
        return "Power spectral density of the residual: the noise is modelled as white." + _of_samples(material)
    share = percent(noise.variance / noise.residual_variance) if noise.residual_variance > 0.0 else "0 %"
    return (
        f"Power spectral density of the residual and of its model, an autoregression of order {noise.order}. Once the "
        f"past is known {share} of the residual's power is left." + _of_samples(material)
    )
