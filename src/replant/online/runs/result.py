"""The result of a run or of a fit, and the recorders of its clock and signals, which work batch by batch."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from replant.estimation.engine.record import gaps_of
from replant.estimation.filters import StateVariableFilter
from replant.estimation.settings import Settings
from replant.fitting.fit_result import FitResult
from replant.fitting.model import Model, in_lines, with_picture
from replant.logs.log import without_added
from replant.model.noise import NoiseModel
from replant.model.preprocess import screen
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.robust import NONE, flags_of, joined, stretches_of
from replant.online.estimate import COUNTED
from replant.plotting.over_time import POINTS, Thinned, Thinner
from replant.verdict import Assessment, Simulation
from replant.verdict.evidence import CONSTANT

if TYPE_CHECKING:
    from replant.online.bank_weights import Lead

KNOTS = 36_000  # stamps kept of a record that is too long for memory, as many as its overview has points [count]


@dataclass(frozen=True, eq=False)
class Clock:
    """The time of each sample of a record, in s since the first one."""

    dt: float  # sampling time in s; the usual interval of an irregular clock
    # places, times: (V,): numbers of samples, ascending, and their times in s; one knot for a regular clock
    places: FloatArray = field(default_factory=lambda: np.zeros(1))
    times: FloatArray = field(default_factory=lambda: np.zeros(1))
    # shortest, longest: least and greatest interval of an irregular clock in s; NaN for a regular one
    shortest: float = math.nan
    longest: float = math.nan

    @classmethod
    def of(cls, dt: float, stamps: FloatArray | None) -> Clock:
        """Return the clock of a record in memory; ``stamps`` (K,) in s, None for a regular clock."""
        if stamps is None or not stamps.size:
            return cls(dt)
        recorder = ClockRecorder(dt, stamps.size, stamps.size)
        recorder.take(stamps)
        return recorder.clock

    @property
    def gaps(self) -> FloatArray:
        """Begin and end of the gaps in s, (G, 2), see `gaps_of`."""
        ends = self._ends_of_gaps
        return np.column_stack([self.times[ends - 1], self.times[ends]])

    @cached_property
    def _ends_of_gaps(self) -> IntArray:
        """Indices (G,) of the first knots after a gap."""
        between = np.diff(self.times) - self.dt * (np.diff(self.places) - 1.0)
        return gaps_of(np.append(self.dt, between), self.dt)

    @property
    def irregular(self) -> bool:
        """Whether the clock is irregular."""
        return not math.isnan(self.shortest)

    def at(self, samples: npt.ArrayLike) -> FloatArray:
        """Return the time in s of samples (V,), numbered from 0; fractional numbers lie between two samples."""
        samples = np.asarray(samples, np.float64)
        beyond = self.dt * (np.minimum(samples, 0.0) + np.maximum(samples - self.places[-1], 0.0))
        found = np.interp(samples, self.places, self.times) + beyond
        after = np.searchsorted(self.places, samples)  # no fraction of a sample lies within a gap
        before = np.maximum(after - 1, 0)
        held = self.times[before] + self.dt * (samples - self.places[before])
        inside = np.isin(after, self._ends_of_gaps) & (samples < self.places[np.minimum(after, self.places.size - 1)])
        return np.where(inside, held, found)

    def after(self, counts: npt.ArrayLike) -> FloatArray:
        """Return the time in s after so many samples (V,): one sampling time after the last of them."""
        counts = np.asarray(counts, np.float64)
        if not self.irregular:
            return np.asarray(counts * self.dt)
        return np.asarray(self.at(counts - 1.0) + self.dt)

    def duration(self, samples: int) -> float:
        """Return how long a record of so many samples lasts, in s."""
        return float(self.after(samples)) if samples else 0.0


class ClockRecorder:
    """Collects the clock of a record whose stamps come batch by batch."""

    def __init__(self, dt: float, length: int, knots: int = KNOTS) -> None:
        self._dt, self._stride = dt, max(1, -(-length // max(knots, 1)))
        self._seen, self._first, self._last = 0, math.nan, math.nan
        self._shortest, self._longest = math.inf, 0.0
        self._kept: list[FloatArray] = []

    def take(self, stamps: FloatArray) -> None:
        """Take the stamps (K,) of the next samples, in s."""
        if not stamps.size:
            return
        if self._seen == 0:
            self._first = float(stamps[0])
        steps = np.diff(stamps, prepend=[self._last] if self._seen else [])
        self._shortest = float(steps.min(initial=self._shortest))
        self._longest = float(steps.max(initial=self._longest))
        self._kept.append(stamps[-self._seen % self._stride :: self._stride] - self._first)
        self._seen += stamps.size
        self._last = float(stamps[-1])

    @property
    def clock(self) -> Clock:
        """The clock so far; a regular one before the first stamp."""
        if self._seen == 0:
            return Clock(self._dt)
        times = np.concatenate(self._kept)
        places = self._stride * np.arange(times.size, dtype=np.float64)
        if places[-1] != self._seen - 1:
            places, times = np.append(places, self._seen - 1.0), np.append(times, self._last - self._first)
        return Clock(self._dt, places, times, self._shortest, self._longest)


@dataclass(frozen=True, eq=False)
class Overview:
    """The thinned signals and the newest samples of a record that is too long for memory."""

    # over the whole record: raw input, measured and simulated output, and their difference
    input: Thinned
    output: Thinned
    model: Thinned
    residual: Thinned
    newest_input: FloatArray  # newest_input, newest_output: (N,): the newest samples, unchanged
    newest_output: FloatArray
    samples: int  # samples of the record
    # (N,): times of the newest samples of an irregular clock, in s since the first sample of the record
    newest_times: FloatArray | None = None


class Recorder:
    """Collects the overview of a record and of its modelled output, batch by batch."""

    def __init__(self, length: int, newest: int | None = None) -> None:
        self.samples = 0
        self._newest = length if newest is None else newest
        self._kept: list[tuple[FloatArray, ...]] = []
        self._began: float | None = None
        self._thinners = [Thinner(length, POINTS) for _ in range(4)] if self._newest < length else []

    def take(
        self,
        u: FloatArray,
        y: FloatArray,
        modelled: FloatArray,
        used: BoolArray | np.bool_ = np.True_,
        t: FloatArray | None = None,
    ) -> None:
        """Take the next samples."""
        if t is not None and self._began is None and t.size:
            self._began = float(t[0])
        self._kept.append((u, y, modelled) if t is None else (u, y, modelled, t))
        self.samples += u.size
        while sum(part[0].size for part in self._kept[1:]) >= max(self._newest, 1):
            del self._kept[0]
        if self._thinners:
            with np.errstate(over="ignore", invalid="ignore"):
                signals = (u, y, modelled, np.where(used, y - modelled, np.nan))
            for thinner, signal in zip(self._thinners, signals, strict=True):
                thinner.take(signal)

    def output(self, shift: float) -> FloatArray:
        """Return the newest samples of the modelled output plus ``shift``."""
        return self._last(2) + shift

    def overview(self, shift: float) -> Overview | None:
        """Return the overview, with ``shift`` added to the modelled output; None if every sample is kept."""
        if not self._thinners:
            return None
        u, y, model, residual = (thinner.thinned for thinner in self._thinners)
        model = replace(model, values=model.values + shift)
        residual = replace(residual, values=residual.values - shift)
        times = None if self._began is None else self._last(3) - self._began
        return Overview(u, y, model, residual, self._last(0), self._last(1), self.samples, times)

    def _last(self, which: int) -> FloatArray:
        whole = np.concatenate([np.empty(0), *(part[which] for part in self._kept)])
        return whole[max(0, whole.size - self._newest) :]


MOST_SHADES = 1000  # most stretches left out that a plot shows separately [count]


@dataclass(frozen=True, eq=False)
class History:
    """The estimate over time, thinned.

    Attributes
    ----------
    samples : (H,) array of int
        Number of samples after which each row was taken.
    parameters : (H, P) array
    std : (H, P) array or None
        Standard deviation of each estimate, if the estimator gives it.
    """

    samples: np.ndarray[tuple[int], np.dtype[np.int64]]
    parameters: FloatArray
    std: FloatArray | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """An identified model with the record of its identification.

    Attributes
    ----------
    model : Model
        G(s) with its uncertainty and noise model.
    one_step : float
        Fit in percent, one step ahead.
    simulation : Simulation
        The model's simulated output over the record, with its fit in percent.
    samples : int
        Accepted samples.
    rejected : dict
        Number of rejected samples, by reason.
    verdict : Assessment
    elapsed : float
        Duration of the computation in s.
    settings : Settings or None
        Settings of an online run.
    history : History or None
        History of an online run.
    overview : Overview or None
        Overview of a record that is too long for memory; the simulation then has only its newest samples.
    left_out : (R, 2) array of int
        Samples left out of the fits, as rows [begin, end) of the record: bridged, rejected, or without an output.
    loads : (N,) array of int
        Samples of the record at which a new load begins to act: offset and initial state change.
    finished : bool
        Whether an online run ended with `Identifier.finish`.
    clock : Clock or None
        Times of the samples; None for a regular clock.
    weights : tuple
        Structures that learned side by side, each with its probability.
    leads : tuple of Lead
        The leading structures, each with the sample since which it led.
    """

    model: Model
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    verdict: Assessment
    elapsed: float
    settings: Settings | None = None
    history: History | None = None
    overview: Overview | None = None
    left_out: IntArray = field(default_factory=NONE.copy)
    loads: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    finished: bool = False
    clock: Clock | None = None
    weights: tuple[tuple[Structure, float], ...] = ()
    leads: tuple[Lead, ...] = ()

    @property
    def used(self) -> int:
        """Samples whose output the estimate is made from; an identifier accepts others for their input."""
        bridged = COUNTED - {"no reference"}  # a sample without its reference is learned with the one before
        return self.samples - (sum(self.rejected.get(each, 0) for each in bridged) if self.settings else 0)

    def without_added(self, added: int) -> Result:
        """Return the result with counts that do not include the samples without output that `Log.added` counts."""
        samples, rejected = self.samples - added, without_added(self.rejected, "no output", added)
        made = replace(self.model.provenance, samples=samples)
        model = replace(self.model, rejected=tuple(rejected.items()), provenance=made)
        return replace(self, model=model, samples=samples, rejected=rejected)

    def clock_of(self, dt: float) -> Clock:
        """Return the clock of the record, whose sampling time is ``dt`` s."""
        return self.clock if self.clock is not None and self.clock.irregular else Clock(dt)

    @property
    def has_model(self) -> bool:
        """Whether the record gave an estimate; a fit of a constant input gives none, see `FitResult`."""
        is_of_noise = self.settings is None and CONSTANT in self.verdict.reasons
        return bool(self.parameters.any()) and not is_of_noise

    def __repr__(self) -> str:
        reasons = self.verdict.reasons
        return in_lines("Result", self.model, self.samples, reasons, has_model=self.has_model)

    def _repr_html_(self) -> str:
        return with_picture(self.model)

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure

    @property
    def parameters(self) -> FloatArray:
        """The parameters (P,)."""
        return self.model.parameters

    @property
    def transfer_function(self) -> TransferFunction:
        """The model as G(s)."""
        return self.model.transfer_function

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of the parameters (P, P), in their units squared, if the estimator gives it."""
        return self.model.covariance

    @property
    def noise(self) -> NoiseModel | None:
        """The noise model, if the method has one."""
        return self.model.noise

    def left_out_over_time(self, dt: float) -> FloatArray:
        """Return begin and end of stretches left out and of gaps, (L, 2) in s; close stretches are joined."""
        samples = self.overview.samples if self.overview else self.simulation.output.size
        rows = joined(self.left_out, max(1, samples // MOST_SHADES)) - np.array([1.0, 0.0])
        clock = self.clock_of(dt)
        found = clock.at(np.maximum(rows, 0.0))
        return np.concatenate([found, clock.gaps]) if clock.irregular else found

    def residual(self, y: FloatArray) -> FloatArray:
        """Return the newest measured outputs (K,) minus the simulated ones; NaN for samples left out."""
        first = (self.overview.samples if self.overview else y.size) - y.size
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(flags_of(self.left_out, first, y.size), np.nan, y - self.simulation.output)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response, if the estimator gives them."""
        return self.model.uncertainty

    @property
    def fixed_filter(self) -> StateVariableFilter | None:
        """The filter of an online run; 1/A of the result for the refined filter."""
        if self.settings is None:
            return None
        return self.settings.filter.fixed_at(self.transfer_function.den, self.settings.dt)


def result_of_fit(fitted: FitResult, u: FloatArray, y: FloatArray, begun: float, t: FloatArray | None = None) -> Result:
    """Return the result of an offline fit."""
    if fitted.reference:
        y = np.where(np.isfinite(fitted.reference.signal), y, np.nan)
    used = screen(fitted.preprocess.map_input(u), y)[0]
    used[fitted.outliers] = used[fitted.stuck] = False
    return Result(
        fitted.model, fitted.one_step, fitted.simulation, fitted.samples, fitted.rejected, fitted.verdict,
        time.perf_counter() - begun, left_out=stretches_of(~used), loads=fitted.loads, clock=Clock.of(fitted.dt, t),
    )  # fmt: skip
