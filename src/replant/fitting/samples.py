"""Samples: the data given to `fit`, `search` and `run`, as logs, arrays or a table; and the checked record of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.estimation.engine.record import Record, ready_record
from replant.estimation.simulation.fitted_run import FittedRun
from replant.fitting.model import reference_of
from replant.logs.log import Log, unused, without_added
from replant.logs.read import in_python, log_of_frame
from replant.logs.sampling_time import clock_of
from replant.model.interop import unit_of, without_unit
from replant.model.preprocess import Preprocess, accepted, check_moves, rejected_in_words, screen
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import BoolArray, FloatArray, is_frame, record
from replant.numerics.autoregression import one_step, one_step_with_lost
from replant.numerics.limits import increasing
from replant.verdict import Simulation, fit_percent, simulate

# a gap of any length begins a new part; the estimate does not depend on its length
BETWEEN = 10.0  # gap between two logs that are fitted together [longest interval beside it]
SAME_CLOCK = 1e-3  # difference of two logs' sampling times up to which they are the same [part]


@dataclass(frozen=True, eq=False)
class Samples:
    """Signals as they were given, not checked yet, and the names of a log."""

    u: Any
    y: Any
    dt: float
    t: Any  # time stamps in s, or None
    reference: Any  # set-point or dither, or None
    input_name: str = "u"
    output_name: str = "y"
    source: str = ""  # name of the log's file
    is_log: bool = False
    input_hold: str = "zoh"
    sha256: str = ""
    others: Mapping[str, FloatArray] = field(default_factory=dict)  # further columns of the same rows
    begins: tuple[int, ...] = ()  # samples at which another log begins: its offset and initial state are its own
    reference_name: str = ""
    more_inputs: tuple[str, ...] = ()  # names of those of ``others`` that are inputs too
    more_references: tuple[str, ...] = ()  # those that are references too
    rest: int = 0  # samples that `from_rest` has put before the logs
    added: int = 0  # these, and the outputs that `leave_out` has left out

    @classmethod
    def of(
        cls,
        u: Any,
        y: Any,
        dt: float | None,
        t: Any,
        reference: Any,
        input: Any = None,  # noqa: A002 - the word of `fit`
        output: Any = None,
    ) -> Samples:
        """Return the samples of a log, given as ``u`` alone, or those of arrays, or of columns of a table."""
        if isinstance(u, str) or hasattr(u, "__fspath__"):
            raise ArgumentTypeError("give a Log in place of a file's name: rp.read_log(path, input=..., output=...)")
        if is_frame(u):
            if y is not None:
                raise InvalidArgumentError("a table has its own output: name its column, output=..., and leave out y")
            with in_python(clock="t"):
                u = log_of_frame(u, input=input, output=output, time=t, dt=dt, reference=reference)
            t = dt = reference = None
        elif input is not None or output is not None:
            raise InvalidArgumentError("input and output name columns of a table, which is to be given in place of u")
        is_given = any(given is not None for given in (y, dt, t, reference))
        if isinstance(u, list | tuple) and u and all(isinstance(each, Log) for each in u):
            if is_given:
                raise InvalidArgumentError("logs have their own outputs, clocks and references: give them alone")
            return cls.of_several(list(u))
        if isinstance(u, Log):
            if is_given:
                why = "a log has its own output, clock and reference: leave out y, dt, t, reference"
                raise InvalidArgumentError(why)
            return cls(
                u.input, u.output, u.dt, u.stamps, u.reference, u.input_name, u.output_name, u.path.name, True,
                u.input_hold, u.sha256, u.others, reference_name=u.reference_name, more_inputs=u.more_inputs,
                more_references=u.more_references, rest=u.rest, added=u.added,
            )  # fmt: skip
        if y is None or (dt is None and t is None):
            raise ArgumentTypeError(
                "give a Log, or input u, output y and sampling time dt: fit(u, y, dt, poles=2), or stamps: t=..."
            )
        if dt is None:
            dt, t = _clock_of(t, np.size(y))
        return cls(u, y, dt, t, reference)

    @classmethod
    def of_several(cls, logs: list[Log]) -> Samples:
        """Return the samples of several logs of one rig, divided by gaps, after which state and offset begin anew."""
        first, origin, last = logs[0], 0.0, 0.0
        stamps: list[FloatArray] = []
        _check_alike(logs)
        for log in logs:
            t = first.dt * np.arange(log.input.size) if log.stamps is None else log.stamps - log.stamps[0]
            beside = max(first.dt, float(t[1] - t[0]), last) if t.size > 1 else first.dt
            stamps.append(np.asarray(origin + BETWEEN * beside * bool(stamps) + t, np.float64))
            origin, last = float(stamps[-1][-1]), float(t[-1] - t[-2]) if t.size > 1 else first.dt
        one = cls.of(first, None, None, None, None)
        if len(logs) == 1:
            return one
        u, y = (np.concatenate([getattr(log, name) for log in logs]) for name in ("input", "output"))
        references = [log.reference for log in logs if log.reference is not None]
        r = np.concatenate(references) if references else None
        further, *_ = names = [(*log.more_inputs, *log.more_references) for log in logs]
        columns = [  # further inputs and references have the first log's names
            {**log.others, **{name: log.others[own] for name, own in zip(further, each, strict=True)}}
            for log, each in zip(logs, names, strict=True)
        ]
        named = [name for name in first.others if all(name in each for each in columns)]
        others = {name: np.concatenate([each[name] for each in columns]) for name in named}
        return replace(
            one, u=u, y=y, t=np.concatenate(stamps), reference=r, sha256="", others=others,
            source=", ".join(log.path.name for log in logs),
            begins=tuple(np.cumsum([log.input.size for log in logs[:-1]]).tolist()),
            rest=sum(log.rest for log in logs),
            added=sum(log.added for log in logs),
        )  # fmt: skip

    @property
    def inputs(self) -> Any:
        """Raw inputs: columns (K, q) of a log, others as given."""
        return np.column_stack([self.u, *(self.others[name] for name in self.more_inputs)]) if self.is_log else self.u

    @property
    def references(self) -> Any:
        """One reference (K,), or columns (K, p) of several; None without any."""
        if not self.more_references:
            return self.reference
        return np.column_stack([self.reference, *(self.others[name] for name in self.more_references)])

    @property
    def unused(self) -> dict[str, FloatArray]:
        """Further columns that are neither inputs nor references."""
        return unused(self.others, self.more_inputs, self.more_references)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs of a log; none of arrays."""
        return (self.input_name, *self.more_inputs) if self.is_log else ()

    @property
    def preprocess(self) -> Preprocess:
        """Working point by default: the means of a log, as a rig rarely rests at zero; 0 for arrays."""
        return Preprocess("identity", "mean", "mean") if self.is_log else Preprocess()

    def checked(
        self, structure: Structure, dt: float, input_hold: str, preprocess: Preprocess
    ) -> tuple[RawRecord, FloatArray | None, dict[str, int]]:
        """Return the checked record of one input and its reference, and the number of rejected samples by reason."""
        u, y = record(self.u, self.y)
        stamps = None if self.t is None else increasing(self.t, u.size)
        r = None if self.reference is None else accepted(reference_of(self.reference, u.size))[0]
        y = y if r is None else np.where(np.isfinite(r), y, np.nan)
        usable, rejected = screen(preprocess.map_input(u), y)
        rejected = without_added(rejected, "not finite", self.added)
        check_enough(int(usable.sum()), rejected, structure)
        for name, signal in (("the input", preprocess.map_input(u)), ("the output", y)):
            check_moves(name, signal)
        lasts = dt * (u.size - 1) if stamps is None else float(stamps[-1] - stamps[0])
        if not structure.delay < lasts:
            raise InvalidArgumentError(
                f"the dead time of {structure.delay:g} s is no shorter than the record, which lasts {lasts:.6g} s"
            )
        raw = RawRecord(structure, dt, preprocess.resolve(u, y), u, y, stamps, input_hold, self.begins)
        return raw, r, rejected


def check_enough(usable: int, rejected: Mapping[str, int], structure: Structure) -> None:
    """Check that a record with so many usable samples has more of them than a structure has parameters."""
    if usable < structure.size + 1:
        others = rejected_in_words(rejected)
        beside = f" ({others})" if others else ""
        raise InvalidArgumentError(
            f"the record has {usable} usable samples, fewer than the {structure.size + 1} that "
            f"{structure.size} parameters need{beside}: record more, or ask for fewer poles and zeros"
        )


def _clock_of(t: Any, samples: int) -> tuple[float, FloatArray | None]:
    """Return the sampling time of stamps, and those of an irregular clock, as a log has them."""
    stamps = increasing(t, samples)
    if samples < 2:
        raise InvalidArgumentError("t needs two stamps or more for a sampling time: record more, or give dt")
    dt, is_regular = clock_of(stamps)
    return dt, None if is_regular else stamps


def _check_alike(logs: list[Log]) -> None:
    """Raise InvalidArgumentError unless all logs have samples, the signals of the first one, and its sampling time."""
    names = [str(log.path) if log.path.name else f"log {number} of {len(logs)}" for number, log in enumerate(logs, 1)]
    first = logs[0]
    for name, log in zip(names, logs, strict=True):
        if not log.input.size:
            raise InvalidArgumentError(f"{name} has no samples; leave it out")
        for what in ("input_names", "output_name", "reference_names", "input_hold"):
            ours, theirs = ((each,) if isinstance(each := getattr(one, what), str) else each for one in (log, first))
            if not _are_alike(ours, theirs):
                differ = f"{what.replace('_', ' ')}: {', '.join(ours) or 'none'}, not {', '.join(theirs) or 'none'}"
                raise InvalidArgumentError(f"{name} and {names[0]} differ in {differ}; give logs of the same signals")
        if not abs(log.dt / first.dt - 1.0) < SAME_CLOCK:
            raise InvalidArgumentError(
                f"{name} has the sampling time {log.dt:g} s, {names[0]} {first.dt:g} s; resample one of them"
            )


def _are_alike(ours: tuple[str, ...], theirs: tuple[str, ...]) -> bool:
    """Return whether names are equal, apart from a unit that one of two leaves out."""
    return len(ours) == len(theirs) and all(
        own == name or (without_unit(own) == without_unit(name) and "" in (unit_of(own), unit_of(name)))
        for own, name in zip(ours, theirs, strict=True)
    )


@dataclass(frozen=True, eq=False)
class RawRecord:
    """A record as it was given, checked, and a structure to fit to it."""

    structure: Structure
    dt: float
    preprocess: Preprocess  # with numbers for the working point
    u: FloatArray  # (K,)
    y: FloatArray  # (K,)
    stamps: FloatArray | None  # time stamps in s; None for a regular clock
    input_hold: str
    begins: tuple[int, ...] = ()  # samples at which another record begins, with its own offset and initial state
    loads: tuple[int, ...] = ()  # samples at which another load begins: the same, within one record

    @cached_property
    def mapped(self) -> FloatArray:
        """The mapped input (K,)."""
        return self.preprocess.map_input(self.u)

    @cached_property
    def known(self) -> BoolArray:
        """Which inputs (K,) can be used."""
        return screen(self.mapped, np.zeros(self.u.size))[0]

    @cached_property
    def made_use_of(self) -> BoolArray:
        """Which samples (K,) the prepared record has: usable inputs, from the first usable output to the last."""
        usable = self.usable
        return self.known & np.logical_or.accumulate(usable) & np.logical_or.accumulate(usable[::-1])[::-1]

    @cached_property
    def usable(self) -> BoolArray:
        """Which samples (K,) can be used."""
        return screen(self.mapped, self.y)[0]

    def made_ready(self, r: FloatArray | None) -> Record:
        """Return the record that an estimator takes, with a reference (K,) or None."""
        ready = ready_record(self.structure, self.dt, self.preprocess, self.u, self.y, self.stamps, self.input_hold, r)
        if not self._parts[1:]:
            return ready
        places = np.searchsorted(np.flatnonzero(self.made_use_of), [part.start for part in self._parts])
        begins = tuple(sorted({int(place) for place in places if 0 < place < ready.u.size}))
        return replace(ready, begins=begins).levelled

    def input_level(self, record: Record) -> float:
        """Return the mapped input that is zero in a prepared record, which has its own level."""
        return float(self.mapped[self.made_use_of][0] - record.u[0]) if record.u.size else 0.0

    @property
    def _parts(self) -> list[slice]:
        """The rows of each part with its own offset and initial state."""
        return [slice(*rows) for rows in pairwise([0, *sorted({*self.begins, *self.loads}), self.u.size])]

    def simulated(self, model: TransferFunction, y: FloatArray) -> Simulation:
        """Return a model run from the input, offset and initial state fitted to the outputs (K,) that are not NaN."""
        linear_input = np.where(self.known, self.mapped - float(self.preprocess.input_offset), np.nan)
        begins = [part.start for part in self._parts[1:]]
        if not self.begins:
            return simulate(model, linear_input, y, self.dt, input_hold=self.input_hold, t=self.stamps, begins=begins)
        run = FittedRun(model, self.dt, self.input_hold, begins)
        output, known = run.take(linear_input, y, self.stamps)
        return Simulation(output, run.offset, self.fit(known, known - output))

    def fit(self, y: FloatArray, error: FloatArray) -> float:
        """Return the fit in percent of an output (K,) with an error (K,), each record around its own level."""
        if self.begins:
            records = [y[begin:end] for begin, end in pairwise([0, *self.begins, self.u.size])]
            levels = [each[np.isfinite(each)].mean() if np.isfinite(each).any() else 0.0 for each in records]
            y = np.concatenate([each - level for each, level in zip(records, levels, strict=True)])
        return fit_percent(y, y - error)

    def one_step(self, residual: FloatArray) -> FloatArray:
        """Return the one-step prediction error (K,) of a free run's residual (K,)."""
        return one_step(residual) if self.stamps is None else one_step_with_lost(residual, self.stamps, self.dt)
