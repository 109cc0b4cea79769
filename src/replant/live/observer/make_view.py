"""Make a view of an identifier from its state and the session's info.  It takes tens of milliseconds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.assessment import Verdict, simulate
from replant.identified.model_json import as_object
from replant.live.observer.history import EstimateHistory
from replant.live.observer.view import (
    Bode,
    SessionInfo,
    View,
    Window,
)
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.online.identifier import Identifier
from replant.online.model_of import model_of
from replant.runs.thinning import thin
from replant.simulation.stretches import joined, stretches_of

POINTS = 1000
"""Points of the window: more than its picture has columns [count]."""
FREQUENCIES = 200
"""Frequencies of a Bode plot [count]."""
LONGEST_IRREGULAR = 3000
"""Samples simulated where each interval costs a discretisation of its own [samples]."""
SIGMAS = 2.0
"""Half-width of a band [standard deviations]."""
WIDEST = 60.0
"""Half-width at which a band is cut: beyond it nothing is known anyway [dB]."""


def make_view(identifier: Identifier, info: SessionInfo, history: EstimateHistory) -> View:
    """Return the view of an identifier, and append its row to ``history``.

    Parameters
    ----------
    identifier : Identifier
        It is not changed.
    info : SessionInfo
    history : EstimateHistory
        The rows of earlier views.

    Examples
    --------
    >>> from replant.model.structure import Structure
    >>> make_view(Identifier(Structure(1), dt=0.1), SessionInfo(source="demo"), EstimateHistory(2)).status
    'starting'
    """
    known = identifier.has_model
    unknown = np.full(identifier.structure.size, np.nan)
    parameters = identifier.parameters if known else unknown
    uncertainty = identifier.uncertainty
    std = uncertainty.std
    model = identifier.transfer_function
    finite = known and bool(np.isfinite(parameters).all())
    window, simulated = _window(identifier, model if finite else None, info.at)
    verdict = identifier.assess()
    history.append(info.at, parameters, std)
    return View(
        at=info.at,
        samples=identifier.samples,
        rejected=identifier.rejected,
        counters=dict(info.counters),
        source=info.source,
        source_state=info.source_state,
        rate=info.rate,
        lag=info.lag,
        silence=info.silence,
        status=identifier.status,
        adapting=identifier.adapting,
        names=identifier.names,
        parameters=parameters,
        std=std,
        num=model.num if finite else np.zeros(0),
        den=model.den if finite else np.zeros(0),
        delay=model.delay,
        **_roots(model, uncertainty if finite else None),
        verdict=verdict.status,
        excited=verdict.excited,
        reasons=verdict.reasons,
        simulated=simulated,
        window=window,
        bode=_bode(model if finite else None, uncertainty, identifier.dt),
        history=history.rows(),
        model=_kept(identifier, verdict) if finite else {},
    )


def _kept(identifier: Identifier, verdict: Verdict) -> dict[str, Any]:
    """Return the model to be kept as an object of JSON; empty where its input map is a Python function."""
    if callable(identifier.request.preprocess.input_map):
        return {}
    return as_object(model_of(identifier, verdict=verdict))


def _roots(model: TransferFunction, uncertainty: Uncertainty | None) -> dict[str, Any]:
    """Return poles with their covariances, zeros and static gain; empty arrays and NaN while there is no model."""
    if uncertainty is None:
        nothing = np.zeros(0, np.complex128)
        covariance = np.zeros((0, 2, 2))
        gain = math.nan
        return {
            "poles": nothing, "pole_covariance": covariance, "zeros": nothing, "dc_gain": gain, "dc_gain_std": gain
        }  # fmt: skip
    poles, covariances = [], []
    with np.errstate(all="ignore"):
        for uncertain in uncertainty.modes:
            poles.append(uncertain.mode.pole)
            covariances.append(uncertain.covariance)
            if uncertain.mode.pole.imag:  # a complex mode stands for a pair of poles
                mirrored = uncertain.covariance * np.array([[1.0, -1.0], [-1.0, 1.0]])
                poles.append(uncertain.mode.pole.conjugate())
                covariances.append(mirrored)
        gain_std = uncertainty.dc_gain_std
    return {
        "poles": np.array(poles, np.complex128),
        "pole_covariance": np.array(covariances).reshape(-1, 2, 2),
        "zeros": model.zeros,
        "dc_gain": float(model.dc_gain),
        "dc_gain_std": gain_std,
    }


def _window(identifier: Identifier, model: TransferFunction | None, at: float) -> tuple[Window, float]:
    """Return the newest samples with the model's output, and its fit in percent."""
    u, y, intervals = identifier.recent.T
    kept = identifier.recent_reference
    r = np.zeros(0) if kept is None else kept
    judged = identifier.judged
    regular = bool((np.abs(intervals[1:] - identifier.dt) <= 1e-6 * identifier.dt).all())
    if not regular:
        u, y, intervals, r = (signal[-LONGEST_IRREGULAR:] for signal in (u, y, intervals, r))
        judged = judged[-LONGEST_IRREGULAR:]
    t = at - (intervals.sum() - np.cumsum(intervals))
    output, fit = np.full(u.size, np.nan), math.nan
    if model is not None and judged.any():
        stamps = None if regular else t
        known = np.where(judged, y, np.nan)
        with np.errstate(all="ignore"):
            run = simulate(model, u, known, identifier.dt, input_hold=identifier.input_hold, t=stamps)
        output, fit = run.output, run.fit
    left_out = _left_out(t, judged)
    if u.size > POINTS:
        drawn = [thin(signal, POINTS) for signal in (u, y, output)]
        t, (u, y, output) = t[drawn[0].indices(t.size)], (signal.values for signal in drawn)
        r = thin(r, POINTS).values if r.size else r
    return Window(t, u, y, output, left_out, r), fit


def _left_out(t: FloatArray, judged: BoolArray) -> FloatArray:
    """Return begin and end (L, 2) of the stretches left out, in rig time; each begins at the sample before it."""
    rows = joined(stretches_of(~judged), max(1, t.size // POINTS))
    return np.column_stack([t[np.maximum(rows[:, 0] - 1, 0)], t[np.minimum(rows[:, 1], t.size) - 1]])


def _bode(model: TransferFunction | None, uncertainty: Uncertainty, dt: float) -> Bode:
    """Return the frequency response, from well below the slowest root to well above the fastest, at most to Nyquist."""
    nothing = np.zeros(0)
    if model is None:
        return Bode(nothing, nothing, nothing, nothing, nothing)
    nyquist = math.pi / dt
    sizes = np.abs(np.concatenate([model.poles, model.zeros]))
    sizes = sizes[np.isfinite(sizes) & (sizes > 1e-9 * nyquist) & (sizes < 1e3 * nyquist)]
    low, high = (float(sizes.min()) / 30, float(sizes.max()) * 30) if sizes.size else (nyquist / 1e4, nyquist)
    omega = np.geomspace(low, max(min(high, nyquist), 10 * low), FREQUENCIES)
    with np.errstate(all="ignore"):
        response = model.response(omega)
        magnitude = 20.0 * np.log10(np.abs(response))
        if not np.isfinite(magnitude).all():
            return Bode(nothing, nothing, nothing, nothing, nothing)
        phase = np.degrees(np.unwrap(np.angle(response)))
        phase -= 360.0 * round(float(phase[0]) / 360.0)
        half = _half_band(uncertainty, omega)
    return Bode(omega, magnitude, phase, magnitude - half, magnitude + half)


def _half_band(uncertainty: Uncertainty, omega: FloatArray) -> FloatArray:
    if not np.isfinite(uncertainty.covariance).all():
        return np.full(omega.size, np.nan)
    relative, _ = uncertainty.response(omega)
    return np.minimum(SIGMAS * 20.0 / math.log(10.0) * relative, WIDEST)
