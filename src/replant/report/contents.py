"""What a report is made from, and the tables and facts that it has of it."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import metadata

import numpy as np

from replant.errors import ReplantError
from replant.estimation.filters import StateVariableFilter
from replant.estimation.solver.least_squares import regressors
from replant.fitting.model import Model
from replant.logs.log import Log
from replant.logs.recording import digest
from replant.model.preprocess import Preprocess, rejected_in_words, screen
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import places_on_grid
from replant.numerics.residuals import Correlations, correlation_lags, correlations
from replant.online.runs.result import Clock, Result
from replant.plotting.numbers import MINUS, complex_number, duration, mapped_label, number, off_by, symbols, uncertain
from replant.plotting.over_time import Panel
from replant.report.findings import Excitation, excitation
from replant.report.page_frame import facts, table
from replant.report.panels import estimate_panels, excitation_panels, fit_panels, regions


@dataclass(frozen=True, eq=False)
class Material:
    """A result and its record, which a report is made from."""

    result: Result
    log: Log
    filter: StateVariableFilter | None  # the filter of the regressors; without it the excitation is not known
    preprocess: Preprocess
    truth: Sequence[float] | None = None  # (P,): true parameters, of a simulated plant

    @property
    def true_plant(self) -> TransferFunction | None:
        """The true plant, of a simulated record."""
        return None if self.truth is None else self.result.structure.transfer_function(np.array(self.truth))

    @property
    def clock(self) -> Clock:
        """When the samples were taken."""
        return self.result.clock_of(self.log.dt)

    @property
    def plant_label(self) -> str:
        """The name of the mapped input."""
        return mapped_label(self.log.input_name, self.preprocess.input_map)

    @property
    def labels(self) -> dict[str, str]:
        """The names for the figures, which apply the input map of an online run's settings themselves."""
        of_input = self.plant_label if self.result.settings is None else self.log.input_name
        return {"input_label": of_input, "output_label": self.log.output_name}

    @cached_property
    def panels(self) -> dict[str, list[Panel]]:
        """What is drawn over time, by section."""
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
        times = [mode.time_constant for mode in self.result.transfer_function.modes]
        lags = correlation_lags(times, self.log.output.size, self.log.dt)
        residual, u = (on_grid(x, self.log) for x in (self.residual, self.preprocess.map_input(self.log.input)))
        return correlations(residual, u, lags)

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
        except ReplantError:  # without a usable sample there is no working point
            return None
        found = excitation(phi)
        return found and replace(found, samples=found.samples + log.earlier)


def on_grid(signal: FloatArray, log: Log) -> FloatArray:
    """Return a signal (K,) as one of a regular clock: NaN stands for each sample that was lost, for up to a few."""
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


def coefficients(material: Material) -> str:
    """Return the table of coefficients with units, standard deviations and, if known, true values."""
    result, known = material.result, material.result.uncertainty
    stds: Sequence[float | None] = [None] * result.structure.size if known is None else known.std.tolist()
    labels = symbols(result.structure, material.plant_label, material.log.output_name)
    headings = ["coefficient", "estimate" if known is None else "estimate ± std"]
    rows = [
        [label, uncertain(value, std)]
        for label, value, std in zip(labels, result.parameters.tolist(), stds, strict=True)
    ]
    if material.truth is not None:
        headings += ["true", "off by"]
        for row, value, true in zip(rows, result.parameters.tolist(), material.truth, strict=True):
            row += [number(float(true)), off_by(value, float(true)).replace("-", MINUS)]
    note = NO_STD if known is None else UNCERTAIN
    return table(headings, rows, "Coefficients") + f'<p class="note">{note}</p>'


def gain_and_times(model: Model) -> tuple[str, list[str]]:
    """Return DC gain and time constants of a model, each with its standard deviation where that is known."""
    known, g = model.uncertainty, model.transfer_function
    stds: list[float | None] = (
        [None] * len(g.modes) if known is None else [each.time_constant_std for each in known.modes]
    )
    gain = uncertain(float(g.dc_gain), None if known is None else known.dc_gain_std)
    return gain, [uncertain(mode.time_constant, std) for mode, std in zip(g.modes, stds, strict=True)]


def poles(material: Material) -> str:
    """Return the tables of poles, with frequency, damping and time constant, and of zeros."""
    result, known = material.result, material.result.uncertainty
    modes = result.transfer_function.modes
    spreads: Sequence[tuple[float | None, ...]] = [(None, None, None)] * len(modes)
    if known is not None:
        spreads = [(each.frequency_std, each.damping_std, each.time_constant_std) for each in known.modes]
    rows = [
        [complex_number(mode.pole), *map(uncertain, (mode.frequency, mode.damping, mode.time_constant), spread)]
        for mode, spread in zip(modes, spreads, strict=True)
    ]
    headings = ("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    return table(headings, rows, "Poles") + _zeros(result)


def _zeros(result: Result) -> str:
    zeros = [zero for zero in result.transfer_function.zeros.tolist() if zero.imag >= 0]
    if not zeros:
        return '<p class="note">No zeros.</p>' if result.structure.zeros == 0 else ""
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
            ("used", f"{result.samples:,} samples"),
            ("rejected", rejected),
            *([("residual tests, excitation", f"of the newest {log.input.size:,} samples")] if log.earlier else []),
            ("computed in", f"{number(result.elapsed, 3)} s"),
            ("versions", versions()),
        ]
    )


def of_record(log: Log, *others: Log) -> list[tuple[str, str]]:
    """Return what is to be said of a record, as names and words; the others have its further outputs."""
    return [
        ("file", log.path.name or "none: the record is simulated"),
        ("SHA-256", digest(log.path) or "none: there is no file"),
        ("input, output", ", ".join([*log.input_names, *(each.output_name for each in (log, *others))])),
        *([("reference", ", ".join(log.reference_names))] if log.reference_name else []),
        ("record", f"{len(log):,} samples, {lasts(log)}"),
    ]


def lasts(log: Log) -> str:
    """Return in words how long a record lasts, and its sampling time."""
    clock = "at" if log.stamps is None else "on an irregular clock, usually at"
    return f"{duration(log.duration)} {clock} {number(log.dt, 6)} s"


def versions() -> str:
    """Return the versions of the software that computed the result."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join([*found, f"Python {platform.python_version()}"])
