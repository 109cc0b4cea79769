"""Trace: the result of `Identifier.update_many`, estimates and errors over a chunk; `BankTrace`: that of a bank."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.model import interop
from replant.numerics.arguments import FloatArray, IntArray, array_of_reals

Estimated = Callable[[], FloatArray]  # gives an estimate (P,)
Later = list[tuple[Estimated, FloatArray]]  # the estimates to solve for, and the rows of a trace to write them to


def write(estimate: Estimated, rows: FloatArray, later: Later | None) -> None:
    """Write an estimate into rows of a trace, or append it to ``later``."""
    if later is None:
        rows[:] = estimate()
    else:
        later.append((estimate, rows))


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """The estimate and the error over a chunk of K samples.

    Attributes
    ----------
    names : tuple of str
        Names of the P parameters.
    start : (P,) array
        The estimate before the chunk's first sample.
    parameters : (K, P) array
        The estimate after each sample, in physical units.
    errors : (K,) array
        A-priori output error y - theta' phi of each sample, in the unit of y; NaN for a rejected sample.
    time : (K,) array or None
        The time stamps of the samples in s, infinite if not finite; None without stamps.
    """

    names: tuple[str, ...]
    start: FloatArray
    parameters: FloatArray
    errors: FloatArray
    time: FloatArray | None = None

    def __repr__(self) -> str:
        newest = self.parameters[-1] if len(self) else self.start
        known = ", ".join(f"{name} {value:.4g}" for name, value in zip(self.names, newest.tolist(), strict=True))
        return f"<Trace of {len(self):,} samples: {known} after the last>"

    def __len__(self) -> int:
        return self.errors.size

    def before(self) -> FloatArray:
        """Return the estimate (K, P) held *before* each sample's own update."""
        return np.vstack([self.start[None, :], self.parameters])[:-1]

    def index(self, true: Sequence[float] | FloatArray) -> FloatArray:
        r"""Return the performance index of each parameter, :math:`J_p = \sum_k (\hat p(t_k) - p(t_k))^2`, (P,).

        The estimate at t_k is the one before the update with sample k, as in the article's figures.

        Parameters
        ----------
        true : (P,) or (K, P) array
            The true parameters in the order of ``names``; constant, or one row for each sample.

        Raises
        ------
        InvalidArgumentError
            If ``true`` has another shape.

        References
        ----------
        Bernat and Kolota (2023), (21).

        Examples
        --------
        >>> trace = Trace(("a0",), np.zeros(1), np.array([[1.0], [2.0]]), np.zeros(2))
        >>> trace.index([2.0])              # (0 - 2)^2 + (1 - 2)^2
        array([5.])
        """
        reference = np.atleast_1d(array_of_reals("true", true))
        if reference.shape not in ((len(self.names),), self.parameters.shape):
            raise InvalidArgumentError(
                f"true must have shape ({len(self.names)},) or {self.parameters.shape}, got {reference.shape}"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow is infinite
            return np.asarray(((self.before() - reference) ** 2).sum(axis=0))

    def to_pandas(self, dt: float | None = None) -> Any:
        """Return a `pandas.DataFrame`: a column for each parameter, then ``error``; a row for each sample.

        Parameters
        ----------
        dt : float, optional
            Sampling time in s, for an index of time in s from the chunk's first sample; without it the index is the
            time stamps, or the sample number if there are none.

        Raises
        ------
        MissingDependencyError
            Without pandas.

        Examples
        --------
        >>> trace = Trace(("a0", "b0"), np.zeros(2), np.array([[0.1, 1.0], [0.4, 2.0]]), np.array([1.0, 0.5]))
        >>> trace.to_pandas(dt=0.5)
                   a0   b0  error
        time [s]
        0.0       0.1  1.0    1.0
        0.5       0.4  2.0    0.5
        """
        return interop.trace_frame(self.names, self.parameters, self.errors, dt, self.time)

    def to_xarray(self, dt: float | None = None) -> Any:
        """Return an `xarray.Dataset`: ``parameters`` over time and parameter, and ``errors`` over time.

        Parameters
        ----------
        dt : float, optional
            Sampling time in s; without it the first dimension is that of the time stamps, or ``sample``, a number, if
            there are none.

        Raises
        ------
        MissingDependencyError
            Without xarray.

        Examples
        --------
        >>> trace = Trace(("a0", "b0"), np.zeros(2), np.array([[0.1, 1.0], [0.4, 2.0]]), np.array([1.0, 0.5]))
        >>> trace.to_xarray(dt=0.5)["parameters"].sel(parameter="b0").values
        array([1., 2.])
        """
        return interop.trace_dataset(self.names, self.parameters, self.errors, dt, self.time)

    def __add__(self, other: Trace) -> Trace:
        """Return this trace joined with that of the next chunk."""
        if self.names != other.names:
            raise InvalidArgumentError(f"traces of different parameters: {self.names} and {other.names}")
        return joined((self, other))


class StartingTrace(Trace):
    """A trace that begins in a start-up: its provisional estimates are computed when one of them is first read."""

    def __init__(
        self, names: tuple[str, ...], start: FloatArray, parameters: FloatArray, errors: FloatArray,
        time: FloatArray | None = None, later: Later | None = None,
    ) -> None:  # fmt: skip
        vars(self).update(names=names, _estimates=(start, parameters), errors=errors, time=time, _later=later or [])

    def __reduce__(self) -> tuple[Any, ...]:
        return Trace, (self.names, self.start, self.parameters, self.errors, self.time)

    @property
    def start(self) -> FloatArray:
        """The estimate (P,) before the chunk's first sample."""
        return self._solved()[0]

    @property
    def parameters(self) -> FloatArray:
        """The estimate (K, P) after each sample."""
        return self._solved()[1]

    def _solved(self) -> tuple[FloatArray, FloatArray]:
        """Return start and parameters, after computing them; repeated after an interrupt, or in a second thread."""
        estimates, later = vars(self)["_estimates"], vars(self)["_later"]
        for estimate, rows in later:
            rows[:] = estimate()
        vars(self)["_later"] = []
        return estimates[0], estimates[1]


@dataclass(frozen=True, eq=False, repr=False)
class BankTrace:
    """Traces, weights and lead of a bank of M members over a chunk of K samples.

    Attributes
    ----------
    pieces : tuple of tuple of Trace
        The traces of the members, for each part of the chunk.
    weights : (K, M) array
        Weights after each sample.
    lead : (K,) array of int
        Number of the member that was served after each sample.
    """

    pieces: tuple[tuple[Trace, ...], ...]
    weights: FloatArray
    lead: IntArray

    def __len__(self) -> int:
        return self.lead.size

    def __repr__(self) -> str:
        newest = ", ".join(f"{each:.3g}" for each in self.weights[-1].tolist()) if len(self) else "none"
        return f"<BankTrace of {len(self):,} samples: weights {newest} after the last>"

    @property
    def errors(self) -> FloatArray:
        """A-priori output errors (K, M) of the members, in the unit of y."""
        return np.concatenate([np.column_stack([each.errors for each in piece]) for piece in self.pieces])

    @cached_property
    def members(self) -> tuple[Trace, ...]:
        """The trace of each member, as `Identifier.update_many` of this member alone returns it.

        Computed on first access, as the estimates of a start-up are.
        """
        return tuple(joined(each) for each in zip(*self.pieces, strict=True))


def joined(traces: Sequence[Trace]) -> Trace:
    """Return the trace of consecutive pieces."""
    first = traces[0]
    if len(traces) == 1:
        return first
    parameters, errors = (np.concatenate([getattr(each, name) for each in traces]) for name in ("parameters", "errors"))
    stamps = [each.time for each in traces if each.time is not None]
    time = np.concatenate(stamps) if len(stamps) == len(traces) else None
    return Trace(first.names, first.start, parameters, errors, time)
