"""Samples: what `fit`, `search` and `run` are given: a log, or arrays and a sampling time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.log import Log
from replant.offline.fit_result import FitResult
from replant.regressor.preprocess import Preprocess


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
    source : str
        Name of the log's file.
    is_log : bool
        Whether they are those of a log.
    input_hold : {"zoh", "foh"}
        Whether the input is held between two samples or goes on in a straight line.
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

    @classmethod
    def of(cls, u: Any, y: Any, dt: float | None, t: Any, reference: Any) -> Samples:
        """Return the samples of a log, given as ``u`` alone, or those of arrays.

        Raises
        ------
        ArgumentTypeError
            If there is neither a log, nor input, output and sampling time.
        InvalidArgumentError
            If there is a log and something else.
        """
        if isinstance(u, Log):
            if any(given is not None for given in (y, dt, t, reference)):
                raise InvalidArgumentError(
                    "a log has its own output, clock and reference: leave out y, dt, t, reference"
                )
            return cls(
                u.input, u.output, u.dt, u.stamps, u.reference, u.input_name, u.output_name, u.path.name, True,
                u.input_hold,
            )  # fmt: skip
        if y is None or dt is None:
            raise ArgumentTypeError("give a Log, or input u, output y and sampling time dt: fit(u, y, dt, poles=2)")
        return cls(u, y, dt, t, reference)

    @property
    def preprocess(self) -> Preprocess:
        """Working point by default: a rig is rarely at rest at zero; of arrays nothing is known."""
        return Preprocess("identity", "mean", "mean") if self.is_log else Preprocess()

    def named(self, result: FitResult) -> FitResult:
        """Return the result of a fit with the names of these samples."""
        return replace(result, input_name=self.input_name, output_name=self.output_name, source=self.source)
