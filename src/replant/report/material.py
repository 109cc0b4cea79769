"""What a report is made from, and the Python program that makes its model again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs import Log
from replant.errors import ReplantError
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.fit_result import FitResult
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.regressor.scaling import Scaling
from replant.report.figures import style
from replant.report.figures.responses import usable_uncertainty
from replant.report.findings import Excitation, excitation, regressors_of
from replant.runs.result import Clock, Result
from replant.settings import Settings
from replant.statistics.autoregression import places_on_grid
from replant.statistics.residuals import Correlations, correlation_lags, correlations


class OverTime(NamedTuple):
    """Signals for drawing, (V,) each, the record or its overview.

    Of a regular clock from ``start`` s on and ``step`` s apart; of an irregular one at ``times`` (V,) in s.
    """

    input: FloatArray
    output: FloatArray
    model: FloatArray
    residual: FloatArray
    start: float
    step: float
    times: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Material:
    """A result and its record, which a report is made from."""

    result: Result
    log: Log
    filter: StateVariableFilter | None  # the filter of the regressors; without it the excitation is not known
    preprocess: Preprocess
    # (P,): true parameters, of a simulated plant
    truth: Sequence[float] | None = None

    @property
    def true_plant(self) -> TransferFunction | None:
        """The true plant, of a simulated record."""
        return None if self.truth is None else self.result.structure.transfer_function(np.array(self.truth))

    @property
    def u(self) -> FloatArray:
        """Raw input (K,)."""
        return self.log.input

    @property
    def y(self) -> FloatArray:
        """Raw output (K,)."""
        return self.log.output

    @property
    def dt(self) -> float:
        """Sampling time in s."""
        return self.log.dt

    @property
    def clock(self) -> Clock:
        """When the samples were taken."""
        return self.result.clock_of(self.dt)

    @property
    def input_label(self) -> str:
        """The input's name."""
        return self.log.input_name

    @property
    def output_label(self) -> str:
        """The output's name."""
        return self.log.output_name

    @property
    def plant_label(self) -> str:
        """The name of the mapped input."""
        return style.mapped_label(self.log.input_name, self.preprocess.input_map)

    @property
    def figure_label(self) -> str:
        """The name of the input for the figures, which apply the input map of an online run's settings themselves."""
        return self.input_label if self.result.settings is not None else self.plant_label

    @cached_property
    def uncertainty(self) -> Uncertainty | None:
        """Uncertainty of the result; None without a usable covariance."""
        return usable_uncertainty(self.result)

    @cached_property
    def over_time(self) -> OverTime:
        """The signals that are drawn over time."""
        shown = self.result.overview
        if shown is None:
            times = self.clock.at(np.arange(self.y.size)) if self.clock.irregular else None
            return OverTime(self.u, self.y, self.result.simulation.output, self.residual, 0.0, self.dt, times)
        u, y, model, residual = (each.values for each in (shown.input, shown.output, shown.model, shown.residual))
        times = self.clock.at(shown.output.places) if self.clock.irregular else None
        return OverTime(u, y, model, residual, self.dt * shown.output.first, self.dt * shown.output.step, times)

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.y)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the residual with itself and with the mapped input."""
        times = [mode.time_constant for mode in self.result.transfer_function.modes]
        lags = correlation_lags(times, self.y.size, self.dt)
        return correlations(self.on_grid(self.residual), self.on_grid(self.preprocess.map_input(self.u)), lags)

    def on_grid(self, signal: FloatArray) -> FloatArray:
        """Return a signal (K,) as one of a regular clock: NaN stands for each sample that was lost, for up to a few."""
        if self.log.stamps is None or not signal.size:
            return signal
        places = places_on_grid(np.diff(self.log.stamps, prepend=self.log.stamps[0] - self.dt), self.dt)
        spread = np.full(places[-1] + 1, np.nan)
        spread[places] = signal
        return spread

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        if self.filter is None or not self.y.size:
            return None
        try:
            t = self.log.stamps
            found = excitation(regressors_of(self.result, self.filter, self.preprocess, self.u, self.y, self.dt, t))
            return found and replace(found, samples=found.samples + self.log.earlier)
        except ReplantError:  # without a usable sample there is no working point
            return None


WIDEST = 88  # width of a line [characters]


def identifier_as_python(settings: Settings) -> str:
    """Return the Python code that makes an identifier with these settings."""
    is_plain = settings.scaling == Scaling.none(settings.structure)
    parts = [
        f"    rp.{_call(settings.structure)}, dt={settings.dt!r},",
        f"    filter=rp.{_call(settings.filter)},",
        *(["    scaling=None,"] if is_plain else _broken("scaling", settings.scaling)),
        f"    optimizer=rp.{_call(settings.optimizer)},",
        f"    replay={'rp.' + _call(settings.replay) if settings.replay else None},",
        *(["    instruments=True,"] if settings.instruments else []),
        *([] if settings.normalize else ["    normalize=False,"]),
        *_broken("preprocess", settings.preprocess),
        *([f"    startup={settings.startup},"] if settings.instruments else []),
    ]
    return "\n".join(["ident = rp.Identifier(", *parts, ")"])


def run_as_python(result: Result, log: Log) -> str:
    """Return the Python program that repeats an online run over ``log``."""
    assert result.settings is not None
    lines = [
        identifier_as_python(result.settings),
        f"trace = ident.update_many({_signals(log)}{_stamps(log)}{_reference(log, 'r')})",
        *(["ident.finish()"] if result.finished else []),
        "print(ident.transfer_function)",
    ]
    return "\n".join([_open(log), *lines])


def fit_as_python(fitted: FitResult, logs: Sequence[Log]) -> str:
    """Return the Python program that repeats an offline fit of logs."""
    log, several = logs[0], len(logs) > 1
    state_filter = f"    filter=rp.{_call(fitted.filter.fixed)}," if fitted.filter.fixed else ""
    signals = "logs" if several else f"{_signals(log)}, dt={log.dt!r}"
    others = [] if several else [_stamps(log), _reference(log, "reference")]
    lines = [
        "fitted = rp.fit(",
        f"    {signals}, structure=rp.{_call(fitted.structure)}, method={fitted.method!r},",
        *(f"    {argument[2:]}," for argument in others if argument),
        *([state_filter] if state_filter else []),
        f"    preprocess=rp.{_call(fitted.preprocess)},",
        ")",
        "print(fitted.transfer_function)",
    ]
    return "\n".join([_open_several(logs) if several else _open(log), *lines])


def _signals(log: Log) -> str:
    return "log.input, log.output" if log.path.name else "u, y"


def _stamps(log: Log) -> str:
    """Return the argument that hands over the time stamps of an irregular clock; nothing for a regular one."""
    if log.stamps is None:
        return ""
    return f", t={'log.stamps' if log.path.name else 't'}"


def _reference(log: Log, argument: str) -> str:
    """Return the argument that hands over the reference, where there is one."""
    if not log.reference_name:
        return ""
    return f", {argument}={'log.reference' if log.path.name else 'r'}"


def _open(log: Log) -> str:
    if not log.path.name:
        arrays = ["u", "y", *(["t"] if log.stamps is not None else []), *(["r"] if log.reference_name else [])]
        signals = f"{', '.join(arrays)}: the record, {('two', 'three', 'four')[len(arrays) - 2]} arrays"
        return f"import replant as rp\n\n# {signals}"
    sampling = "" if log.time is not None else f", dt={log.dt!r}"
    names = f"input={log.input_name!r}, output={log.output_name!r}"
    if log.reference_name:
        names += f", reference={log.reference_name!r}"
    ends = (("begin", log.begin), ("end", log.end))
    part = "".join(f", {name}={value!r}" for name, value in ends if value is not None)
    return f"import replant as rp\n\nlog = rp.read_log({str(log.path)!r}, {names}{sampling}{part})"


def _open_several(logs: Sequence[Log]) -> str:
    """Return the program that reads several logs, a line each."""
    begin, *others = _open(logs[0]).split("log = ")
    rest = [_open(log).split("log = ")[1] for log in logs[1:]]
    return "\n".join([f"{begin}logs = [", *(f"    {each}," for each in [*others, *rest]), "]"])


def _broken(name: str, value: Any) -> list[str]:
    """Return an argument as one line, or one line for each of its own arguments if that is too long."""
    line = f"    {name}=rp.{_call(value)},"
    if len(line) <= WIDEST:
        return [line]
    return [f"    {name}=rp.{type(value).__name__}(", *(f"        {part}," for part in _arguments(value)), "    ),"]


def _call(value: Any) -> str:
    """Return a frozen dataclass as the call that makes it, defaults left out."""
    return f"{type(value).__name__}({', '.join(_arguments(value))})"


def _arguments(value: Any) -> list[str]:
    return [
        f"{field.name}={_argument(getattr(value, field.name))}"
        for field in dataclasses.fields(value)
        if getattr(value, field.name) != field.default
    ]


def _argument(value: Any) -> str:
    """Return a value as Python code, floats with six digits."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_argument(entry) for entry in value) + "]"
    return getattr(value, "__name__", "") or repr(value) if callable(value) else repr(value)
