"""The material of a report, and its contents: tables, facts and the captions of figures."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import metadata

import numpy as np

from replant.errors import ReplantError
from replant.estimation.filters import StateVariableFilter
from replant.estimation.solver.least_squares import regressors
from replant.fitting.model import Model
from replant.logs.log import Log, logs_in
from replant.logs.recording import digest
from replant.model.interop import unit_of
from replant.model.noise import NoiseModel
from replant.model.preprocess import Preprocess, rejected_in_words, screen
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import places_on_grid
from replant.numerics.residuals import Correlations, correlation_lags, correlations
from replant.online.runs.result import Clock, History, Result
from replant.plotting import style
from replant.plotting.diagrams import reach_of
from replant.plotting.numbers import (
    MINUS,
    complex_number,
    duration,
    gain_unit,
    mapped_label,
    number,
    off_by,
    percent,
    symbols,
    uncertain,
)
from replant.plotting.over_time import Panel
from replant.report.findings import Excitation, excitation
from replant.report.page_frame import facts, note, table
from replant.report.panels import estimate_panels, excitation_panels, first_estimate, fit_panels, regions
from replant.report.results_as_text import POLE, modes_of, stds_of


@dataclass(frozen=True, eq=False)
class Material:
    """A result and its record, from which a report is made."""

    result: Result
    log: Log
    filter: StateVariableFilter | None  # the filter of the regressors; None: the excitation is unknown
    preprocess: Preprocess
    truth: Sequence[float] | None = None  # (P,): true parameters, of a simulated plant

    @property
    def clock(self) -> Clock:
        """The times of the samples."""
        return self.result.clock_of(self.log.dt)

    @property
    def plant_label(self) -> str:
        """The name of the mapped input."""
        return mapped_label(self.log.input_name, self.preprocess.input_map)

    @property
    def labels(self) -> dict[str, str]:
        """The labels for the figures; these apply the input map of an online run themselves."""
        of_input = self.plant_label if self.result.settings is None else self.log.input_name
        return {"input_label": of_input, "output_label": self.log.output_name}

    @cached_property
    def panels(self) -> dict[str, list[Panel]]:
        """The panels over time, by section."""
        result, log = self.result, self.log
        known = result.history is not None and result.history.samples.size
        return {
            "fit": fit_panels(result, log.input, log.output, log.dt, log.input_name, log.output_name),
            "parameters": estimate_panels(result, log.dt, self.truth, **self.labels) if known else [],
            "excitation": excitation_panels(self.excitation, self.clock),
        }

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.log.output)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the residual with itself and with the mapped input."""
        mapped = self.preprocess.map_input(self.log.input)
        return correlated(self.residual, [mapped], self.log, [self.result.transfer_function])[0]

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        log, structure, preprocess = self.log, self.result.structure, self.preprocess
        if self.filter is None or not log.output.size:
            return None
        try:
            accepted, _ = screen(preprocess.map_input(log.input), log.output)
            y = np.where(accepted, log.output, np.nan)
            phi = regressors(structure, log.dt, self.filter, preprocess, log.input, y, log.stamps)[0]
        except ReplantError:  # no usable sample, and thus no working point
            return None
        found = excitation(phi)
        return found and replace(found, samples=found.samples + log.earlier)


def correlated(
    residual: FloatArray, inputs: Iterable[FloatArray], log: Log, plants: Sequence[TransferFunction]
) -> list[Correlations | None]:
    """Return the correlations of a residual (K,) with itself and each input (K,), at lags chosen for the plants."""
    times = [mode.time_constant for g in plants for mode in g.modes]
    lags = correlation_lags(times, residual.size, log.dt)
    residual = on_grid(residual, log)
    return [correlations(residual, on_grid(u, log), lags) for u in inputs]


def on_grid(signal: FloatArray, log: Log) -> FloatArray:
    """Return a signal (K,) on a regular clock: NaN for each lost sample, for at most a few in a gap."""
    stamps, dt = log.stamps, log.dt
    if stamps is None or not signal.size:
        return signal
    places = places_on_grid(np.diff(stamps, prepend=stamps[0] - dt), dt)
    spread = np.full(places[-1] + 1, np.nan)
    spread[places] = signal
    return spread


UNCERTAIN = "Estimate ± standard deviation."
NO_STD = "This estimator gives no standard deviations."
PACKAGES = ("replant", "numpy", "scipy", "matplotlib")


def coefficients(parts: Iterable[tuple[str, Model, str, str]], truth: Sequence[float] | None = None) -> str:
    """Return the table of coefficients with units, standard deviations and, if known, true values.

    A part is what stands before its coefficients' symbols, the model, and the labels of its input and output.
    """
    headings, rows, values, stds = ["coefficient", "estimate"], list[list[str]](), list[float](), list[float | None]()
    for before, model, *labels in parts:
        rows += [[before + symbol] for symbol in symbols(model.structure, *labels)]
        values, stds = values + model.parameters.tolist(), stds + stds_of(model)
    known = any(std is not None for std in stds)
    for row, value, std in zip(rows, values, stds, strict=True):
        row.append(uncertain(value, std))
    if truth is not None:
        headings += ["true", "off by"]
        for row, value, true in zip(rows, values, truth, strict=True):
            row += [number(float(true)), off_by(value, float(true)).replace("-", MINUS)]
    headings[1] += " ± std" if known else ""
    return table(headings, rows, "Coefficients") + note(UNCERTAIN if known else NO_STD)


def poles(material: Material) -> str:
    """Return the tables of poles, with frequency, damping and time constant, and of zeros."""
    model = material.result.model
    found = [complex_number(mode.pole) for mode in model.transfer_function.modes]
    rows = [[pole, *figures] for pole, figures in zip(found, modes_of(model, uncertain), strict=True)]
    return table(POLE, rows, "Poles") + _zeros(material.result)


def _zeros(result: Result) -> str:
    zeros = [zero for zero in result.transfer_function.zeros.tolist() if zero.imag >= 0]
    if not zeros:
        return note("No zeros.") if result.structure.zeros == 0 else ""
    spread = {root: covariance for root, covariance in regions(result.model) if np.isfinite(covariance).all()}
    rows = []
    for zero in sorted(zeros, key=abs):
        known = spread.get(zero)
        std = None if known is None else math.sqrt(max(float(np.trace(known)), 0.0))
        frequency = abs(zero) / math.tau
        rows.append([complex_number(zero), number(frequency) if std is None else uncertain(abs(zero), std)])
    return table(("zero [rad/s]", "frequency [Hz]" if not spread else "distance from 0 ± std [rad/s]"), rows, "Zeros")


def origin(material: Material) -> str:
    """Return facts about the record, the use of its samples, and the versions of the software."""
    log, result = material.log, material.result
    rejected = rejected_in_words(result.rejected) or "none"
    return facts(
        [
            *of_record(log),
            ("used", f"{result.used:,} samples"),
            ("rejected", rejected),
            *([("residual tests, excitation", f"of the newest {log.input.size:,} samples")] if log.earlier else []),
            ("computed in", f"{number(result.elapsed, 3)} s"),
            ("versions", versions()),
        ]
    )


def of_record(log: Log, *others: Log) -> list[tuple[str, str]]:
    """Return facts about a record, as terms and descriptions; ``others`` have its further outputs."""
    return [
        ("file", log.path.name or "none: the record is simulated"),
        ("SHA-256", ", ".join(filter(None, (digest(each.path) for each in logs_in(log)))) or "none: there is no file"),
        ("input, output", ", ".join([*log.input_names, *(each.output_name for each in (log, *others))])),
        *([("reference", ", ".join(log.reference_names))] if log.reference_name else []),
        ("record", f"{len(log):,} samples, {lasts(log)}"),
    ]


def lasts(log: Log) -> str:
    """Return the duration of a record and its sampling time as text."""
    logs = logs_in(log)
    clock = "on an irregular clock, usually at" if any(each.stamps is not None for each in logs) else "at"
    return f"{duration(log.duration)}{f' of {len(logs)} logs' if len(logs) > 1 else ''} {clock} {number(log.dt, 6)} s"


def versions() -> str:
    """Return the versions of the software that computed the result."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join([*found, f"Python {platform.python_version()}"])


SEEN = 0.01  # shortest stretch that is visible in a picture [part of the record]


def captions(material: Material) -> dict[str, str]:
    """Return the captions of the figures, by name."""
    result, log = material.result, material.log
    model, history, known = result.transfer_function, result.history, result.uncertainty is not None
    dashed = "" if material.truth is None else " Dashed: the true plant."
    bands = " with bands of two standard deviations" if known else ""
    gain = f"{number(model.dc_gain)} {gain_unit(material.plant_label, log.output_name)}".strip()
    clock = ""  # a remark on figures that need a regular clock
    if len(logs_in(log)) > 1:
        clock = f" Samples are taken as {number(log.dt, 4)} s apart, and lost ones and those between logs as unknown."
    elif material.clock.irregular:
        apart = f"samples are taken as {number(log.dt, 4)} s apart, and lost ones as unknown"
        clock = f" The clock is irregular: {apart}."
    return {
        "fit": _of_fit(material),
        "parameters": "" if history is None else _of_parameters(material, history),
        "excitation": _of_excitation(material),
        "poles": _of_poles(material),
        "bode": f"Bode diagram of G(s): magnitude and phase{bands}; the DC gain is {gain}.{dashed}",
        "step": (
            f"Step response of G(s){' with a band of two standard deviations' if known else ''}: the output for a unit "
            f"step of the input, from rest.{dashed}"
        ),
        "auto": correlation_in_words(material.correlations) + clock,
        "cross": correlation_in_words(material.correlations, "Input") + clock,
        "spectrum": _of_spectrum(result.noise) + clock,
    }


def _of_fit(material: Material) -> str:
    result, residual = material.result, material.residual[np.isfinite(material.residual)]
    if residual.size == 0:
        return "Input and measured output over time; the model's output is not finite."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    size = f"{size} {unit_of(material.log.output_name)}".strip()
    newest = f" over the newest {material.log.output.size:,} samples" if material.log.earlier else ""
    hidden = " Where the model's output is not visible, it lies outside the axes."
    return (
        f"The model, {result.simulation.how}, has a fit of {percent(result.simulation.fit)}; the root mean square of "
        f"the residual is {size}{newest}.{hidden if result.simulation.fit < 0 else ''}"
    )


def _of_parameters(material: Material, history: History) -> str:
    if (np.abs(material.result.parameters) > style.FARTHEST).any():
        return "Each parameter's estimate over time; estimates that diverged are not drawn."
    banded = history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", with the true values" if material.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The axes are scaled to the last 90 % of the record."
    begin, rows = first_estimate(history), history.samples.size
    if begin == rows or begin < SEEN * rows:
        return said
    held = number(float(material.clock.after(history.samples[begin])), 3)
    return f"{said} The first estimate is made from the first {held} s."


def _of_excitation(material: Material) -> str:
    found = material.excitation
    if found is None:
        return "Excitation over time: there are no regressors."
    window = number(found.window * material.log.dt, 3)
    poorest = int(np.argmin(found.smallest))
    when = number(float(material.clock.after(found.samples[poorest])), 3)
    is_regular = not material.clock.irregular
    windows = f"{window} s" if is_regular else f"{found.window:,} samples"
    # the clock of several logs counts the time between them
    place = f"{when} s" if len(logs_in(material.log)) == 1 else f"sample {found.samples[poorest] + 1:,}"
    return (
        f"Excitation in windows of {windows}: the smallest eigenvalue of the scaled information matrix is at most "
        f"{number(float(found.smallest.max()), 2)} and at least {number(float(found.smallest[poorest]), 2)}, in the "
        f"window up to {place}. Where it is small, the input does not excite every parameter."
    )


def _of_poles(material: Material) -> str:
    model = material.result.transfer_function
    poles = ", ".join(complex_number(mode.pole) for mode in model.modes)
    zeros = ", ".join(complex_number(zero) for zero in model.zeros.tolist() if zero.imag >= 0)
    tail = f"; zero{'s' if model.zeros.size > 1 else ''} at {zeros} rad/s" if zeros else ""
    region = " Coloured: 95 % confidence regions." if material.result.uncertainty is not None else ""
    diamonds = " Diamonds: the true poles." if material.truth is not None else ""
    heads = f"Pole{'s' if model.poles.size > 1 else ''} at {poles} rad/s{tail}"
    return f"{heads}. Grey: the right half-plane, in which poles are unstable.{region}{diamonds}"


def correlation_in_words(found: Correlations | None, name: str = "") -> str:
    """Return a text on the residual's correlation with itself, or with the named input."""
    what = f"{name} with the later residual" if name else "Residual with itself"
    if found is None:
        return f"{what}: too few samples, or a constant signal."
    lags = f"{number(100 * found.outside[bool(name)], 2)} % of the lags{' from 0 on' if name else ''}"
    more = "a part of the response is missing" if name else "the noise is coloured, or dynamics are missing"
    beyond = not name and reach_of(found.auto, found.auto_std)
    hidden = " The value 1 at lag 0 lies outside the axes." if beyond else ""
    return f"{what}: {lags} lie outside the limits, 5 % by chance. More: {more}.{hidden}"


def _of_spectrum(noise: NoiseModel | None) -> str:
    said = "Power spectral density of the residual"
    if noise is None:
        return f"{said}; this method has no model of the noise."
    if noise.is_white:
        return f"{said}: the noise is modelled as white."
    share = percent(noise.variance / noise.residual_variance) if noise.residual_variance > 0.0 else "0 %"
    return (
        f"{said} and of its model, an autoregression of order {noise.order}. The past does not predict {share} of the "
        "residual's power."
    )
