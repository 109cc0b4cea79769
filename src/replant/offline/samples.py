"""Samples: what `fit`, `search` and `run` are given: a log, several, or arrays and a sampling time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.log import Log
from replant.offline.fit_result import FitResult
from replant.offline.frame_log import is_frame, log_of_frame
from replant.regressor.preprocess import Preprocess

BETWEEN = 10.0
"""Gap between two logs that are fitted together [longest interval beside it].
Derivation: a gap of any length begins a new part; none of the estimate depends on it.
"""

SAME_CLOCK = 1e-3  # difference of two logs' sampling times up to which they are the same [part]


@dataclass(frozen=True, eq=False)
class Samples:
    """Signals as they were given, not checked yet, and the names of a log.

    Attributes
    ----------
    u, y : array_like
        Raw input and output.
    dt : float
        Sampling time in s.
    t, reference : array_like or None
        Time stamps in s, and set-point or dither.
    input_name, output_name : str
        With the units in brackets at the end.
    source, sha256 : str
        Name and digest of the log's file.
    is_log : bool
        Whether they are those of a log.
    input_hold : {"zoh", "foh"}
        Whether the input is held between two samples or goes on in a straight line.
    others : mapping of str to array
        Further columns of the same rows.
    begins : tuple of int
        Samples at which another log begins: its offset and initial state are its own.
    reference_name : str
    more_inputs : tuple of str
        Names of those of ``others`` that are inputs too.
    """

    u: Any
    y: Any
    dt: float
    t: Any
    reference: Any
    input_name: str = "u"
    output_name: str = "y"
    source: str = ""
    is_log: bool = False
    input_hold: str = "zoh"
    sha256: str = ""
    others: Mapping[str, FloatArray] = field(default_factory=dict)
    begins: tuple[int, ...] = ()
    reference_name: str = ""
    more_inputs: tuple[str, ...] = ()

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
        if is_frame(u):
            if y is not None:
                raise InvalidArgumentError("a table has its own output: name its column, output=..., and leave out y")
            u, t, dt, reference = log_of_frame(u, input, output, t, dt, reference), None, None, None
        elif input is not None or output is not None:
            raise InvalidArgumentError("input and output name columns of a table, which is to be given in place of u")
        if isinstance(u, list | tuple) and u and all(isinstance(each, Log) for each in u):
            if any(given is not None for given in (y, dt, t, reference)):
                raise InvalidArgumentError("logs have their own outputs, clocks and references: give them alone")
            return cls.of_several(list(u))
        if isinstance(u, Log):
            if any(given is not None for given in (y, dt, t, reference)):
                raise InvalidArgumentError(
                    "a log has its own output, clock and reference: leave out y, dt, t, reference"
                )
            return cls(
                u.input, u.output, u.dt, u.stamps, u.reference, u.input_name, u.output_name, u.path.name, True,
                u.input_hold, u.sha256, u.others, more_inputs=u.more_inputs,
            )  # fmt: skip
        if y is None or dt is None:
            raise ArgumentTypeError("give a Log, or input u, output y and sampling time dt: fit(u, y, dt, poles=2)")
        return cls(u, y, dt, t, reference)

    @classmethod
    def of_several(cls, logs: list[Log]) -> Samples:
        """Return the samples of several logs of one rig, one behind the other with a gap between.

        Behind the gap the state is estimated anew, as behind any other, and the offset too: the logs may have begun at
        other levels.
        """
        first, origin, last = logs[0], 0.0, 0.0
        stamps: list[FloatArray] = []
        for number, log in enumerate(logs):
            if not log.input.size:
                raise InvalidArgumentError(f"log {number} has no samples; leave it out")
            for what in ("input_names", "output_name", "reference_name", "input_hold"):
                if getattr(log, what) != getattr(first, what):
                    raise InvalidArgumentError(
                        f"log {number} differs in its {what}: {getattr(log, what)!r}, the first has "
                        f"{getattr(first, what)!r}; give logs of the same signals"
                    )
            if not abs(log.dt / first.dt - 1.0) < SAME_CLOCK:
                raise InvalidArgumentError(
                    f"log {number} has the sampling time {log.dt:g} s, the first {first.dt:g} s; resample one of them"
                )
            t = first.dt * np.arange(log.input.size) if log.stamps is None else log.stamps - log.stamps[0]
            beside = max(first.dt, float(t[1] - t[0]), last) if t.size > 1 else first.dt
            stamps.append(np.asarray(origin + BETWEEN * beside * bool(stamps) + t, np.float64))
            origin, last = float(stamps[-1][-1]), float(t[-1] - t[-2]) if t.size > 1 else first.dt
        if len(logs) == 1:
            return cls.of(first, None, None, None, None)
        u, y = (np.concatenate([getattr(log, name) for log in logs]) for name in ("input", "output"))
        references = [log.reference for log in logs if log.reference is not None]
        r = np.concatenate(references) if references else None
        named = [name for name in first.others if all(name in log.others for log in logs)]
        others = {name: np.concatenate([log.others[name] for log in logs]) for name in named}
        source = ", ".join(log.path.name for log in logs)
        return cls(
            u, y, first.dt, np.concatenate(stamps), r, first.input_name, first.output_name, source, True,
            first.input_hold, others=others, more_inputs=first.more_inputs,
            begins=tuple(np.cumsum([log.input.size for log in logs[:-1]]).tolist()),
            reference_name=first.reference_name,
        )  # fmt: skip

    @property
    def inputs(self) -> Any:
        """Raw inputs (K, q), where there are several."""
        return np.column_stack([self.u, *(self.others[name] for name in self.more_inputs)]) if self.is_log else self.u

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs of a log; none of arrays."""
        return (self.input_name, *self.more_inputs) if self.is_log else ()

    @property
    def preprocess(self) -> Preprocess:
        """Working point by default: a rig is rarely at rest at zero; of arrays nothing is known."""
        return Preprocess("identity", "mean", "mean") if self.is_log else Preprocess()

    def named(self, result: FitResult) -> FitResult:
        """Return the result of a fit with the names of these samples."""
        return replace(
            result, input_name=self.input_name, output_name=self.output_name, source=self.source, sha256=self.sha256
        )
