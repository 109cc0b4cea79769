"""Make a view of an identifier from its state and the session's info.  It takes tens of milliseconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.assessment import Verdict, simulate
from replant.identified.model_json import as_object
from replant.live.observer.history import EstimateHistory
from replant.live.observer.make_responses import bode_of, step_of, truth_of
from replant.live.observer.view import UNNAMED, SessionInfo, SignalNames, View, Window
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.online.identifier import Identifier
from replant.online.kept_model import model_of
from replant.online.newest_samples import newest_samples
from replant.plotting.diagrams import mirrored
from replant.report.figures.style import mapped_label
from replant.runs.thinning import thin
from replant.simulation.stretches import joined, stretches_of

POINTS = 1200  # points of the window: more than its picture has columns [count]
NEWEST = 10.0  # time at the end of a long window that may be looked at alone, and gets a third of the points [s]


def make_view(
    identifier: Identifier,
    info: SessionInfo,
    history: EstimateHistory,
    *,
    truth: TransferFunction | None = None,
    signals: SignalNames = UNNAMED,
) -> View:
    """Return the view of an identifier, and append its row to ``history``.

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
    shown = model if finite else None
    bode = bode_of(shown, uncertainty, identifier.dt)
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
        residual_std=_residual_std(identifier),
        input_label=mapped_label(signals.input, identifier.request.preprocess.input_map),
        output_label=signals.output,
        window=window,
        bode=bode,
        step=step_of(shown, uncertainty),
        truth=truth_of(truth, identifier.structure, shown, bode),
        history=history.rows(),
        model=_kept(identifier, verdict) if finite else {},
    )


def _residual_std(identifier: Identifier) -> float:
    """Return the standard deviation of the residual by the noise model; NaN where there is none."""
    noise = identifier.noise
    return math.nan if noise is None or noise.residual_variance == 0.0 else math.sqrt(noise.residual_variance)


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
                poles.append(uncertain.mode.pole.conjugate())
                covariances.append(mirrored(uncertain.covariance))
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
    newest = newest_samples(identifier)
    u, y, r, judged = newest.input, newest.output, newest.reference, newest.judged
    t = at - (newest.intervals.sum() - np.cumsum(newest.intervals))
    output, fit = np.full(u.size, np.nan), math.nan
    if model is not None and judged.any():
        stamps = None if newest.regular else t
        with np.errstate(all="ignore"):
            run = simulate(model, u, newest.known_output, identifier.dt, input_hold=identifier.input_hold, t=stamps)
        output, fit = run.output, run.fit
    residual = np.where(judged, y - output, np.nan)
    drawn_t, drawn = _thinned(t, [u, y, output, residual, *([r] if r.size else [])])
    u, y, output, residual, *others = drawn
    return Window(drawn_t, u, y, output, residual, _left_out(t, judged), others[0] if others else r), fit


def _thinned(t: FloatArray, signals: Sequence[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
    """Return times and signals (V,) as they are drawn: of a long window, the newest part is thinned less."""
    if t.size <= POINTS:
        return t, list(signals)
    begin = int(np.searchsorted(t, t[-1] - NEWEST))
    parts = [slice(0, t.size)]
    if begin > t.size // 2:
        parts = [slice(0, begin), slice(begin, t.size)]
    points = [POINTS] if len(parts) == 1 else [2 * POINTS // 3, POINTS // 3]
    times, drawn = [], []
    for part, count in zip(parts, points, strict=True):
        thinned = [thin(signal[part], count) for signal in signals]
        times.append(t[part][thinned[0].indices(t[part].size)])
        drawn.append([signal.values for signal in thinned])
    return np.concatenate(times), [np.concatenate(pieces) for pieces in zip(*drawn, strict=True)]


def _left_out(t: FloatArray, judged: BoolArray) -> FloatArray:
    """Return begin and end (L, 2) of the stretches left out, in rig time; each begins at the sample before it."""
    rows = joined(stretches_of(~judged), max(1, t.size // POINTS))
    return np.column_stack([t[np.maximum(rows[:, 0] - 1, 0)], t[np.minimum(rows[:, 1], t.size) - 1]])
