"""Log: inputs, one output, optional references, and the sampling time, read from a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.errors import InvalidArgumentError
from replant.model import interop
from replant.numerics.arguments import finite, keep, one_of, text, truth, vector, whole
from replant.numerics.limits import duration, file_path
from replant.numerics.time_stamps import is_regular


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """A record of inputs, one output and optional references, on a regular or an irregular clock.

    Missing samples are NaN; no sample is dropped or repaired.

    Parameters
    ----------
    input, output : float64 array, shape (K,)
        The samples, in the units of the file.
    dt : float
        Sampling time in seconds; the usual interval if the clock is irregular.
    time : float64 array, shape (K,), or None
        Time stamps in seconds, if the file has them.
    input_name, output_name : str
        The columns' names in the file.
    path : Path
        The file; empty if there is none.
    earlier : int
        Number of samples before these: only the newest samples of a log that is too long for memory are held.
    reference : float64 array, shape (K,), or None
        The set-point or dither, if its column was requested.
    reference_name : str
        Name of that column.
    begin, end : float or None
        The part of the file that was read, in s from its first row; None: from the first row, or to the last.
        `decimate` leaves out samples at the begin, and adds their time to ``begin``.
    irregular : bool or None
        Whether the clock is irregular, so that the time stamps are used; None: decided from `time`.
    input_hold : {"zoh", "foh"}
        The input between two samples: held, or on a straight line.
    sha256 : str
        Digest of the file, which a model keeps; empty if unknown.
    others : mapping of str to float64 array, shape (K,)
        Further columns of the same rows.  The verdict of `fit` names a column that explains the residual.
    more_inputs, more_references : tuple of str
        Names of the columns in ``others`` that are further inputs or references, see `inputs` and `references`.
    rest : int
        Number of samples that `from_rest` put before the record; `duration` and the counts of samples in a result
        leave them out.
    withheld : int
        Number of outputs that `leave_out` has left out; a result counts them neither as samples nor as rejected.  Leave
        out last: `decimate`, `resample` and `bandpass` make new outputs, and those that are missing count as rejected.

    Examples
    --------
    >>> log = Log(np.array([0.0, 1.0]), np.array([0.0, 0.1]), 0.5)
    >>> len(log), log.dt
    (2, 0.5)
    """

    input: NDArray[np.float64]
    output: NDArray[np.float64]
    dt: float
    time: NDArray[np.float64] | None = None
    input_name: str = "u"
    output_name: str = "y"
    path: Path = Path()
    earlier: int = 0
    reference: NDArray[np.float64] | None = None
    reference_name: str = ""
    begin: float | None = None
    end: float | None = None
    irregular: bool | None = None
    input_hold: str = "zoh"
    sha256: str = ""
    others: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    more_inputs: tuple[str, ...] = ()
    more_references: tuple[str, ...] = ()
    rest: int = 0
    withheld: int = 0

    def __post_init__(self) -> None:
        optional = {"time": vector, "reference": vector, "begin": finite, "end": finite, "irregular": truth}
        for name, check in {"input": vector, "output": vector, **optional}.items():
            if name not in optional or getattr(self, name) is not None:
                keep(self, name, check)
        keep(self, "dt", duration)
        for name in ("input_name", "output_name", "reference_name", "sha256"):
            keep(self, name, text)
        others = {text("others", name): vector(name, each) for name, each in self.others.items()}
        object.__setattr__(self, "others", others)
        for role in ("more_inputs", "more_references"):
            object.__setattr__(self, role, tuple(text(role, name) for name in getattr(self, role)))
            for name in getattr(self, role):
                if name not in others or (*self.more_inputs, *self.more_references).count(name) > 1:
                    raise InvalidArgumentError(f"{role} must be different names of others, got {name!r}")
        if self.more_references and self.reference is None:
            raise InvalidArgumentError("more_references need a reference: give reference too")
        signals = (self.output, self.time, self.reference, *self.others.values())
        sizes = [self.input.size, *(each.size for each in signals if each is not None)]
        if min(sizes) != max(sizes):
            raise InvalidArgumentError(
                f"input, output, time, reference and others must have the same length, got {sizes}"
            )
        object.__setattr__(self, "path", Path(file_path("path", self.path)))
        keep(self, "earlier", whole, 0, 2**62)
        for name in ("rest", "withheld"):
            keep(self, name, whole, 0, self.input.size)
        keep(self, "input_hold", one_of, ("zoh", "foh"))

    def __len__(self) -> int:
        return self.earlier + int(self.input.shape[0])

    def __repr__(self) -> str:
        clock = "irregular, usually " if self.stamps is not None else ""
        signals = f"{', '.join(self.input_names)} -> {self.output_name}"
        rest = unused(self.others, self.more_inputs, self.more_references)
        others = f", beside {', '.join(rest)}" if rest else ""
        name = " ".join(filter(None, ("Log", self.path.name)))
        return f"<{name}: {signals}, {len(self):,} samples, {clock}dt {self.dt:g} s{others}>"

    @property
    def added(self) -> int:
        """Number of samples without an output that `from_rest` and `leave_out` have made."""
        return self.rest + self.withheld

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of all inputs: `input_name`, then `more_inputs`."""
        return self.input_name, *self.more_inputs

    @property
    def inputs(self) -> NDArray[np.float64]:
        """All inputs, a column (K, q) each.

        Examples
        --------
        >>> Log([0.0, 1.0], [0.0, 0.1], 0.5, others={"fan": [2.0, 3.0]}, more_inputs=("fan",)).inputs
        array([[0., 2.],
               [1., 3.]])
        """
        return np.column_stack([self.input, *(self.others[name] for name in self.more_inputs)])

    @property
    def reference_names(self) -> tuple[str, ...]:
        """Names of all references: `reference_name`, then `more_references`; empty without a reference."""
        return () if self.reference is None else (self.reference_name, *self.more_references)

    @property
    def references(self) -> NDArray[np.float64] | None:
        """All references, a column (K, p) each; None without one."""
        if self.reference is None:
            return None
        return np.column_stack([self.reference, *(self.others[name] for name in self.more_references)])

    @cached_property
    def stamps(self) -> NDArray[np.float64] | None:
        """Time stamps (K,) of an irregular clock in s, for `fit` and `update_many`; None for a regular clock.

        Without stamps both use the exact interval ``dt``, which removes the rounding of a regular clock's stamps.

        Examples
        --------
        >>> from pathlib import Path
        >>> signal, late = np.zeros(4), np.array([0.0, 1.0, 2.0, 3.5])
        >>> Log(signal, signal, 1.0, late, "u", "y", Path("log.csv")).stamps
        array([0. , 1. , 2. , 3.5])
        >>> Log(signal, signal, 1.0, np.arange(4.0), "u", "y", Path("log.csv")).stamps is None
        True
        """
        if self.time is None:
            return None
        irregular = not is_regular(self.time) if self.irregular is None else self.irregular
        return self.time if irregular else None

    @property
    def duration(self) -> float:
        """Duration in s: from the first sample to the last, plus one sampling time."""
        if self.stamps is None:
            return (len(self) - self.rest) * self.dt
        first = 0.0 if self.earlier else float(self.stamps[0])  # a part's stamps count from the record's start
        return float(self.stamps[-1]) - first + self.dt - self.rest * self.dt

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` of all columns over time in s; its ``attrs`` hold roles, units, dt and file.

        Raises
        ------
        MissingDependencyError
            Without pandas.
        InvalidArgumentError
            If two columns have the same name.

        Examples
        --------
        >>> from pathlib import Path
        >>> Log(np.array([0.0, 1.0]), np.array([0.0, 0.1]), 0.5, None, "u", "y", Path("log.csv")).to_pandas()
                    u    y
        time [s]
        0.0       0.0  0.0
        0.5       1.0  0.1
        """
        return interop.log_frame(*self._parts)

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` of the signals over time in s; their names and units are attributes.

        The variables are ``input``, ``output`` and, if there is one, ``reference``; further inputs and references are
        ``input_2``, ``reference_2`` and so on.  Other columns keep their names.

        Raises
        ------
        MissingDependencyError
            Without xarray.
        InvalidArgumentError
            If another column has one of these names.

        Examples
        --------
        >>> from pathlib import Path
        >>> log = Log(np.array([0.0, 1.0]), np.array([0.0, 0.1]), 0.5, None, "u", "speed [rpm]", Path("log.csv"))
        >>> log.to_xarray()["output"].attrs
        {'long_name': 'speed', 'units': 'rpm'}
        """
        return interop.log_dataset(*self._parts)

    @property
    def _parts(self) -> tuple[interop.Signals, interop.Others, NDArray[np.float64] | None, dict[str, Any]]:
        signals = {"input": (self.input_name, self.input), "output": (self.output_name, self.output)}
        signals |= {f"input_{i}": (name, self.others[name]) for i, name in enumerate(self.more_inputs, 2)}
        if self.reference is not None:
            signals |= {"reference": (self.reference_name, self.reference)}
        signals |= {f"reference_{i}": (name, self.others[name]) for i, name in enumerate(self.more_references, 2)}
        about = {"dt": self.dt, "input_hold": self.input_hold, "source": self.path.name}
        return signals, unused(self.others, self.more_inputs, self.more_references), self.time, about


@dataclass(frozen=True, eq=False, repr=False)
class JoinedLog(Log):
    """Several logs as one, for figures and pages: the time between two of them is no part of the record."""

    logs: tuple[Log, ...] = ()

    @property
    def duration(self) -> float:
        """Duration of all logs in s, without the time between them."""
        return sum(log.duration for log in self.logs)


def logs_in(log: Log) -> tuple[Log, ...]:
    """Return the logs that a log joins; a single one by itself."""
    return log.logs if isinstance(log, JoinedLog) else (log,)


def changed(
    log: Log, change: Callable[[NDArray[np.float64]], NDArray[np.float64]], output: NDArray[np.float64], **others: Any
) -> Log:
    """Return a log with ``change`` applied to every signal except the output, which is replaced."""
    return replace(
        log, input=change(log.input), output=output,
        reference=None if log.reference is None else change(log.reference),
        others={name: change(signal) for name, signal in log.others.items()}, **others,
    )  # fmt: skip


def unused(others: Mapping[str, NDArray[np.float64]], *used: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    """Return the further columns whose names are not in ``used``."""
    return {name: signal for name, signal in others.items() if not any(name in names for names in used)}


def without_added(rejected: Mapping[str, int], reason: str, added: int) -> dict[str, int]:
    """Return counts of rejected samples without those of `from_rest` and `leave_out`, which count under ``reason``."""
    return {name: max(0, count - added) if name == reason else count for name, count in rejected.items()}


def check_one_reference(count: int) -> None:
    """Raise InvalidArgumentError if one input has several references."""
    if count > 1:
        raise InvalidArgumentError(
            f"one input takes one reference, got {count}: give one reference, or name the other inputs, too"
        )
