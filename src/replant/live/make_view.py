"""Make a view of an identifier: history of the estimate, responses of the model, newest samples, verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from replant.fitting.model_json import as_object
from replant.fitting.responses import SETTLED, Bode, StepResponse, frequencies, time_of
from replant.live import view
from replant.live.progress import Identification
from replant.live.streams import Signals
from replant.live.view import UNNAMED, Rows, SessionInfo, View, Window
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import FloatArray
from replant.numerics.robust import joined, stretches_of
from replant.online.identifier import Identifier
from replant.online.miso_identifier import RowIdentifier
from replant.online.running_model import NewestSamples, model_of, newest_run, newest_samples
from replant.plotting.diagrams import with_conjugates
from replant.plotting.numbers import mapped_label, true_parameters
from replant.plotting.over_time import thin
from replant.verdict import Verdict, simulate
from replant.verdict.estimate_tests import are_known

MOST_ROWS = 1000  # rows of history kept [rows]


class EstimateHistory:
    """Rows of (t, parameters, std), one for each view; when there are too many, every other row is dropped."""

    def __init__(self, size: int) -> None:
        self._size = size
        self.clear()

    @classmethod
    def of(cls, rows: Rows) -> EstimateHistory:
        """Return a history that continues an earlier one."""
        history = cls(rows.parameters.shape[1])
        for t, parameters, std in zip(rows.t.tolist(), rows.parameters, rows.std, strict=True):
            history.append(t, parameters, std)
        return history

    def clear(self) -> None:
        """Drop every row."""
        self._rows: list[FloatArray] = []
        self._appended, self._stride = 0, 1  # every stride-th appended row is kept

    def append(self, t: float, parameters: FloatArray, std: FloatArray) -> None:
        """Append the newest row; the next one replaces it unless its number is a multiple of the stride."""
        if (self._appended - 1) % self._stride:
            self._rows.pop()
        if len(self._rows) == MOST_ROWS:
            self._rows = self._rows[::2]
            self._stride *= 2
        self._rows.append(np.concatenate([[t], parameters, std]))
        self._appended += 1

    def rows(self) -> Rows:
        """Return the rows, the newest among them."""
        rows = np.reshape(self._rows, (-1, 1 + 2 * self._size))
        return Rows(rows[:, 0], rows[:, 1 : 1 + self._size], rows[:, 1 + self._size :])


FREQUENCIES = 160  # evenly spaced frequencies of a Bode plot; each resonance adds some [count]
TIMES = 120  # times of a step response, and of its beginning if a mode settles early [count]
MOST_TIMES, PER_PERIOD = 480, 8  # most times of an oscillating beginning, and times per period [count]
FASTER = 0.25  # a mode that settles within this part of the response gets additional times [share]
GROWN = 3.0  # duration that is shown of an unstable mode: later it hides all others [time constants]
SIGMAS = 2.0  # half-width of a band [standard deviations]
WIDEST = 60.0  # half-width at which a band is cut: the magnitude is then unknown [dB]
NOTHING, NO_ROOTS = np.zeros(0), np.zeros(0, np.complex128)
NO_BODE, NO_STEP = view.Bode(*[NOTHING] * 5), view.Step(*[NOTHING] * 4)
#: Fields of an input while there is no finite model.
NO_MODEL: dict[str, Any] = {
    "num": NOTHING, "den": NOTHING, "poles": NO_ROOTS, "pole_covariance": np.zeros((0, 2, 2)), "zeros": NO_ROOTS,
    "dc_gain": math.nan, "dc_gain_std": math.nan, "bode": NO_BODE, "step": NO_STEP,
}  # fmt: skip


def bode_of(model: TransferFunction, uncertainty: Uncertainty, dt: float) -> view.Bode:
    """Return the frequency response; empty if it is not finite."""
    with np.errstate(all="ignore"):
        found = Bode.of(model, _usable(uncertainty), dt, frequencies(model, dt, FREQUENCIES))
        magnitude = 20.0 * np.log10(found.magnitude)
        if not np.isfinite(magnitude).all():
            return NO_BODE
        half = np.full(magnitude.size, np.nan)
        if found.relative_std is not None:
            half = np.minimum(SIGMAS * 20.0 / math.log(10.0) * found.relative_std, WIDEST)
    return view.Bode(found.frequency, magnitude, np.degrees(found.phase), magnitude - half, magnitude + half)


def step_of(model: TransferFunction, uncertainty: Uncertainty) -> view.Step:
    """Return the step response; empty if it is not finite."""
    t, output, std = _steps(model, _usable(uncertainty), _stretches(model))
    if not np.isfinite(output).all():
        return NO_STEP
    half = np.full(t.size, np.nan) if std is None else SIGMAS * std
    return view.Step(t, output, output - half, output + half)


def _stretches(model: TransferFunction) -> list[FloatArray]:
    """Return the times (S,) of the whole response, and denser times of its beginning if the fastest mode needs them."""
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
    """Return times (S,), the step response, and its standard deviation if known."""
    parts = [StepResponse.of(model, known, t) for t in stretches]
    t, first = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
    stds = [part.std for part in parts if part.std is not None]
    return t, np.concatenate([part.output for part in parts])[first], np.concatenate(stds)[first] if stds else None


def _usable(uncertainty: Uncertainty) -> Uncertainty | None:
    return uncertainty if np.isfinite(uncertainty.covariance).all() else None


def truth_of(
    truth: TransferFunction | None, structure: Structure, model: TransferFunction | None, bode: view.Bode
) -> view.Truth | None:
    """Return the true plant at the frequencies and times of the model's responses; None if the plant is unknown."""
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


POINTS = 1200  # points of the window: more than its chart has columns of pixels [count]
NEWEST = 10.0  # end of a long window that gets a third of the points, as the page can show it alone [s]


# The part of a view that depends on the kind of identifier: the branch of each input, which is its label, structure,
# transfer function and uncertainty; the newest samples; the output (K,) simulated over them, NaN where unknown; its
# fit; the verdict; the model to be kept, as JSON.
_Branch = tuple[str, Structure, TransferFunction, Uncertainty]
_Seen = tuple[Sequence[_Branch], NewestSamples, FloatArray, float, Verdict, dict[str, Any]]


def _seen(identifier: Identifier, finite: bool, at: float, signals: Signals) -> _Seen:
    model, newest, verdict = identifier.transfer_function, newest_samples(identifier), identifier.assess()
    preprocess, kept = identifier.request.preprocess, {}
    output, fit = np.full(newest.output.size, np.nan), math.nan
    if finite:
        run, ahead = newest_run(identifier, newest)
        if not callable(preprocess.input_map):  # JSON cannot hold a function
            kept = as_object(model_of(identifier, run, ahead, verdict))
        if run.is_prediction:  # the window shows the output simulated from the input alone
            with np.errstate(all="ignore"):
                run = simulate(
                    model, newest.input, newest.known_output, identifier.dt, input_hold=identifier.input_hold,
                    t=None if newest.regular else _times(newest, at),
                )  # fmt: skip
        if newest.judged.any():
            output, fit = run.output, run.fit
    label = mapped_label(signals.inputs[0], preprocess.input_map)
    return [(label, identifier.structure, model, identifier.uncertainty)], newest, output, fit, verdict, kept


def _seen_row(identifier: RowIdentifier, finite: bool, signals: Signals) -> _Seen:
    found, labels = identifier.fit_of_newest() if finite else None, identifier.request.input_names
    newest, models = identifier.newest_samples(found), identifier.transfer_functions
    branches = tuple(zip(labels, identifier.structures, models, identifier.uncertainty, strict=True))
    if found is None:
        return branches, newest, np.full(newest.output.size, np.nan), math.nan, identifier.assess(), {}
    model = found.model.of_log(labels, signals.output, "")
    return branches, newest, found.output, found.fit, found.verdict, as_object(model)


def make_view(
    identifier: Identification,
    info: SessionInfo,
    history: EstimateHistory,
    *,
    truth: TransferFunction | None = None,
    signals: Signals = UNNAMED,
) -> View:
    """Return the view of an identifier, and append its row to ``history``."""
    known = identifier.has_model
    parameters = identifier.parameters if known else np.full(len(identifier.names), np.nan)
    finite = known and bool(np.isfinite(parameters).all())
    if isinstance(identifier, RowIdentifier):
        seen = _seen_row(identifier, finite, signals)
    else:
        seen = _seen(identifier, finite, info.at, signals)
    branches, newest, output, fit, verdict, model = seen
    noise, std = identifier.noise, np.concatenate([uncertainty.std for *_, uncertainty in branches])
    history.append(info.at, parameters, std)
    first, *others = (_from_input(branch, truth, identifier.dt, finite=finite) for branch in branches)
    (window, inputs), span = _window(newest, output, info.at), identifier.samples * identifier.dt
    return View(
        **vars(first),
        **vars(info),
        samples=identifier.samples,
        rejected=identifier.rejected,
        status=identifier.status,
        adapting=identifier.adapting,
        names=identifier.names,
        parameters=parameters,
        std=std,
        verdict=verdict.status,
        excited=verdict.excited,
        coefficients=all(are_known(shape, known.parameters, known.std, span) for _, shape, _, known in branches),
        reasons=verdict.reasons,
        simulated=fit,
        residual_std=math.nan if noise is None else math.sqrt(noise.residual_variance or math.nan),
        output_label=signals.output,
        window=window,
        history=history.rows(),
        model=model,
        more_inputs=tuple(view.FurtherInput(**vars(one), u=u) for one, u in zip(others, inputs, strict=True)),
    )


def _from_input(branch: _Branch, truth: TransferFunction | None, dt: float, *, finite: bool) -> view.FromInput:
    """Return the part of a view about one input."""
    label, structure, model, uncertainty = branch
    bode = bode_of(model, uncertainty, dt) if finite else NO_BODE
    beside = truth_of(truth, structure, model if finite else None, bode)
    if not finite:
        return view.FromInput(input_label=label, delay=model.delay, truth=beside, **NO_MODEL)
    with np.errstate(all="ignore"):
        roots = with_conjugates([(each.mode.pole, each.covariance) for each in uncertainty.modes])
        gain_std = uncertainty.dc_gain_std
    return view.FromInput(
        input_label=label,
        num=model.num,
        den=model.den,
        delay=model.delay,
        poles=np.array([pole for pole, _ in roots], np.complex128),
        pole_covariance=np.array([covariance for _, covariance in roots]).reshape(-1, 2, 2),
        zeros=model.zeros,
        dc_gain=float(model.dc_gain),
        dc_gain_std=gain_std,
        bode=bode,
        step=step_of(model, uncertainty),
        truth=beside,
    )


def _times(newest: NewestSamples, at: float) -> FloatArray:
    """Return the rig times (K,) of the newest samples, the last of which was taken ``at`` s."""
    return np.asarray(at - (newest.intervals.sum() - np.cumsum(newest.intervals)))


def _window(newest: NewestSamples, output: FloatArray, at: float) -> tuple[Window, list[FloatArray]]:
    """Return the newest samples with the model's output, and the inputs (V,) after the first."""
    y, r, judged, t = newest.output, newest.reference, newest.judged, _times(newest, at)
    residual, inputs = np.where(judged, y - output, np.nan), np.atleast_2d(newest.input.T)
    drawn_t, drawn = _thinned(t, [*inputs, y, output, residual, *([r] if r.size else [])])
    (u, *more), (y, output, residual) = drawn[: len(inputs)], drawn[len(inputs) : len(inputs) + 3]
    rows = joined(stretches_of(~judged), max(1, t.size // POINTS))  # each begins at the sample before it
    left_out = np.column_stack([t[np.maximum(rows[:, 0] - 1, 0)], t[np.minimum(rows[:, 1], t.size) - 1]])
    return Window(drawn_t, u, y, output, residual, left_out, drawn[-1] if r.size else r), more


def _thinned(t: FloatArray, signals: Sequence[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
    """Return times and signals (V,) thinned for drawing; the newest part of a long window is thinned less."""
    if t.size <= POINTS:
        return t, list(signals)
    begin = int(np.searchsorted(t, t[-1] - NEWEST))
    parts = [(slice(0, t.size), POINTS)]
    if begin > t.size // 2:
        parts = [(slice(0, begin), 2 * POINTS // 3), (slice(begin, t.size), POINTS // 3)]
    times, drawn = [], []
    for part, count in parts:
        thinned = [thin(signal[part], count) for signal in signals]
        times.append(t[part][thinned[0].indices(t[part].size)])
        drawn.append([signal.values for signal in thinned])
    return np.concatenate(times), [np.concatenate(pieces) for pieces in zip(*drawn, strict=True)]
