"""The model's responses in a view, Bode and step, and those of the true plant beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.identified.responses import SETTLED, Bode, StepResponse, frequencies, time_of
from replant.live.observer import view
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.report.terminal.summary import true_parameters

FREQUENCIES = 160  # equally spaced frequencies of a Bode plot; each resonance adds some [count]
TIMES = 120  # times of a step response, and of its beginning where a mode settles early [count]
MOST_TIMES, PER_PERIOD = 480, 8
"""Times of the beginning where a mode oscillates, at the most, and for each period [count]."""
FASTER = 0.25
"""Part of the step response within which the fastest mode settles, below which its beginning gets times of its own
[share].
"""
GROWN = 3.0  # time constants of an unstable mode that are shown: later it hides all others [time constants]
SIGMAS = 2.0  # half-width of a band [standard deviations]
WIDEST = 60.0  # half-width at which a band is cut: beyond it nothing is known anyway [dB]

NOTHING = np.zeros(0)


def bode_of(model: TransferFunction | None, uncertainty: Uncertainty, dt: float) -> view.Bode:
    """Return the frequency response, empty where it is not known or not finite.

    >>> unknown = Uncertainty(Structure(1), np.array([2.0, 4.0]), np.full((2, 2), np.nan))
    >>> found = bode_of(TransferFunction([4.0], [1.0, 2.0]), unknown, dt=0.01)
    >>> found.magnitude_db[0].round(1), found.magnitude_low[0]
    (np.float64(6.0), np.float64(nan))
    """
    empty = view.Bode(NOTHING, NOTHING, NOTHING, NOTHING, NOTHING)
    if model is None:
        return empty
    with np.errstate(all="ignore"):
        found = Bode.of(model, _usable(uncertainty), dt, frequencies(model, dt, FREQUENCIES))
        magnitude = 20.0 * np.log10(found.magnitude)
        if not np.isfinite(magnitude).all():
            return empty
        half = np.full(magnitude.size, np.nan)
        if found.relative_std is not None:
            half = np.minimum(SIGMAS * 20.0 / math.log(10.0) * found.relative_std, WIDEST)
    return view.Bode(found.frequency, magnitude, np.degrees(found.phase), magnitude - half, magnitude + half)


def step_of(model: TransferFunction | None, uncertainty: Uncertainty) -> view.Step:
    """Return the step response, empty where it is not known or not finite.

    Examples
    --------
    >>> unknown = Uncertainty(Structure(1), np.array([2.0, 4.0]), np.full((2, 2), np.nan))
    >>> found = step_of(TransferFunction([4.0], [1.0, 2.0]), unknown)
    >>> found.t[-1], found.y[-1].round(2)
    (np.float64(3.0), np.float64(2.0))
    """
    empty = view.Step(NOTHING, NOTHING, NOTHING, NOTHING)
    if model is None:
        return empty
    t, output, std = _steps(model, _usable(uncertainty), _stretches(model))
    if not np.isfinite(output).all():
        return empty
    half = np.full(t.size, np.nan) if std is None else SIGMAS * std
    return view.Step(t, output, output - half, output + half)


def _stretches(model: TransferFunction) -> list[FloatArray]:
    """Return the times (S,) of the whole response, and those of its beginning where its fastest mode needs more."""
    end = float(time_of(model)[-1])
    growth = float(np.max(model.poles.real, initial=0.0))
    if growth > 0.0:
        end = min(end, model.delay + GROWN / growth)
    whole = np.linspace(0.0, end, TIMES)
    poles = model.poles[np.isfinite(model.poles)]
    if not poles.size:
        return [whole]
    fastest = complex(poles[np.argmax(np.abs(poles))])
    settled = min(model.delay + SETTLED / abs(fastest.real), end) if fastest.real else end
    periods = settled * abs(fastest.imag) / math.tau
    if settled >= FASTER * end and PER_PERIOD * periods <= TIMES:
        return [whole]
    return [whole, np.linspace(0.0, settled, int(min(max(PER_PERIOD * periods, TIMES), MOST_TIMES)))]


def _steps(
    model: TransferFunction, known: Uncertainty | None, stretches: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return times (S,), the output by a unit step, and its standard deviation where it is known."""
    parts = [StepResponse.of(model, known, t) for t in stretches]
    t, first = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
    stds = [part.std for part in parts if part.std is not None]
    return t, np.concatenate([part.output for part in parts])[first], np.concatenate(stds)[first] if stds else None


def _usable(uncertainty: Uncertainty) -> Uncertainty | None:
    return uncertainty if np.isfinite(uncertainty.covariance).all() else None


def truth_of(
    truth: TransferFunction | None, structure: Structure, model: TransferFunction | None, bode: view.Bode
) -> view.Truth | None:
    """Return the true plant at the frequencies and times of the model's responses; None if it is not known.

    >>> plant = TransferFunction([4.0], [1.0, 2.0])
    >>> found = truth_of(plant, Structure(1, bias=True), plant, view.Bode(np.ones(1), *[NOTHING] * 4))
    >>> found.parameters, found.step[-1].round(2)
    (array([ 2.,  4., nan]), np.float64(2.0))
    """
    if truth is None:
        return None
    parameters = np.full(structure.size, np.nan)
    if (structure.poles, structure.zeros) == (truth.den.size - 1, truth.num.size - 1):
        known = true_parameters(truth)
        parameters[: len(known)] = known
    with np.errstate(all="ignore"):
        found = Bode.of(truth, None, 1.0, bode.omega)
        magnitude = 20.0 * np.log10(found.magnitude)
        step = NOTHING if model is None else _steps(truth, None, _stretches(model))[1]
    return view.Truth(parameters, truth.poles, truth.zeros, magnitude, np.degrees(found.phase), step)
